"""Calibration from one block of known height (section 3.4), with a scale and with refusals.

Model. In perspective a plane of light moves its stripe by D = h / (Ω (1 − h/W)) px at height h, where W is
the camera's distance from the belt; Ω, mm/px, is what a first millimetre would tell. The block's height h and
its displacement D give Ω. Without a working distance 1/W is 0, and that is the paper's H = Ω D. A camera that
is tilted a little along the stripes sees displacements grow from row to row, for all stripes alike: by how
much is read from the block's top, too, and Ω is that of the middle row.

The paper gives Ω_i = block height / displacement of stripe i on the block. It does not say where the scale
in X and Y comes from; here it comes from the block's width along the stripes, seen at the block's top.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import CalibrationError
from roemetry.records import Block, CalibrationSet, Observation
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages import Calibrator, Capabilities, StageOptions
from roemetry_paper.block_linear import block_view
from roemetry_paper.block_views import BlockView, RestFit, rest_polynomials, view_of_block


class BlockCalibratorOptions(StageOptions):
    """What the calibration is meant for."""

    height_max_factor: float = Field(
        default=1.5, ge=1, description="greatest height to be measured, as a multiple of the block's height"
    )


_DISTANCE_MIN_HEIGHTS = 10.0
"""Nobody puts a camera nearer to the belt than ten block heights; used where the distance is not known."""
_FAN_RESIDUAL_MAX = 0.03
"""A stripe taken for its neighbour is off by more than a tenth, one on clean matt metal by less than 0.01."""
_FAN_MIN = 5
"""Stripes from which a parabola can be checked."""
_TILT_MAX = 0.15
"""Tangent of the angle (8.5°) within which a camera that is set up by eye looks straight down. A tilt across
the stripes acts on heights as a distance that is wrong by so much, relatively."""
_EXTRAPOLATED_SHARE_MAX = 0.15
"""Of the stripes may miss the block: two of fifteen. Further out a parabola is no longer sure."""


class BlockCalibrator(Calibrator[BlockCalibratorOptions]):
    """Ω of each stripe and one scale, from images of a block and of the empty belt."""

    capabilities = Capabilities(tolerance_px=0.01, relative_tolerance=0.001)

    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate.

        Raises
        ------
        CalibrationError
            No block described, no image of it, a stripe missing on the belt or on the block, displacements
            of both signs, or a stripe that does not fit the fan of the others.
        """
        block = observed.block
        if block is None:
            raise CalibrationError(
                "no block is described: its three sides are unknown",
                hint="add `target:` to the rig file, with length_mm, width_mm and height_mm",
            )
        views = observed.showing("block")
        if not views:
            raise CalibrationError("there is no image of the block", hint="name it in images.block")
        rest = rest_polynomials(observed)
        rest_px = rest.lines_px
        seen = [view_of_block(view, rest) for view in views]
        read, fan, said = _filled(_offsets(seen, views, observed.stripe_count), rest_px)
        if observed.working_distance_mm is not None and observed.working_distance_mm <= 2 * block.height_mm:
            raise CalibrationError(
                f"working_distance_mm is {observed.working_distance_mm:g}, the block is "
                f"{block.height_mm:g} mm high",
                hint="it is the distance from the camera's lens to the belt, in millimetres",
            )
        # 0 takes perspective out of every equation below, as in the paper
        per_distance = 0.0 if observed.working_distance_mm is None else 1.0 / observed.working_distance_mm
        growth, growth_std = _growth(seen)
        # D = h / (Ω (1 − h/W)), solved for Ω
        omega = block.height_mm / (1.0 - block.height_mm * per_distance) / read.offset_px
        # the reading is of the rows where the block lies; Ω is that of the middle row
        omega = omega * (1.0 + growth * read.row_px)
        scale = _scale(seen, block, observed.working_distance_mm)
        size = views[0].frame.size
        return Calibration(
            method="block-linear",
            image_size=size,
            turn_deg=views[0].frame.turn_deg,
            rest_px=rest_px,
            displacement_px_per_mm=1.0 / omega,
            # true as estimated; Monte Carlo runs draw their errors here
            height_range_mm=(0.0, self.options.height_max_factor * block.height_mm),
            parameters={
                "omega_mm_per_px": omega,
                "mm_per_px": np.array([scale.mm_per_px]),
                "rest_error_px": np.zeros(rest_px.shape),
                "inverse_distance_per_mm": np.array([per_distance]),
                "growth_per_px": np.array([growth]),
                "bow_per_px2": np.array([rest.bow_per_px2]),
            },
            covariance=_covariance(omega, read, block, scale, rest, growth_std, per_distance),
            residuals={
                "rest_line_rms_px": rest.rms_px,
                "block_top_rms_px": float(np.sqrt(np.nanmean([view.scatter_px**2 for view in seen]))),
                "block_edge_rms_px": float(np.sqrt(np.nanmean([view.edge_rms_px**2 for view in seen]))),
                "fan_largest_relative": fan,
                "scale_relative_std": scale.relative_std,
            },
            target={
                "kind": "block",
                "name": block.name,
                "length_mm": block.length_mm,
                "width_mm": block.width_mm,
                "height_mm": block.height_mm,
                "tolerance_mm": block.tolerance_mm,
                "yaw_deg": float(np.degrees(np.mean([view.yaw_rad for view in seen]))),
            },
            extractor=dict(observed.extractor),
            notes=scale.notes + said,
            view=block_view(
                size, rest_px, omega, scale.mm_per_px, observed.working_distance_mm, rest.bow_per_px2
            ),
        )


class _Scale(NamedTuple):
    mm_per_px: float
    relative_std: float
    notes: tuple[str, ...]


class _Read(NamedTuple):
    """Each stripe's displacement on the block, without the lens's distortion.

    `offset_px` (stripe,), `std_px` its standard uncertainty, `row_px` the row it is read in, from the middle
    one, `per_bow` its derivative by the lens's distortion, px³.
    """

    offset_px: Floats
    std_px: Floats
    row_px: Floats
    per_bow: Floats


def _offsets(seen: list[BlockView], views: tuple[Observation, ...], stripes: int) -> _Read:
    """Give each stripe's displacement from the view that says it best."""
    offsets = np.stack([view.offset_px for view in seen])
    # not seen counts as infinitely uncertain, so any view that shows the stripe wins
    stds = np.where(np.isfinite(offsets), np.stack([view.offset_std_px for view in seen]), np.inf)
    best = stds.argmin(axis=0)
    # NaN where no view shows it
    offset = offsets[best, np.arange(stripes)]
    missing = np.flatnonzero(np.isnan(offset))
    if missing.size == stripes:
        raise CalibrationError(
            f"the block was not found in {', '.join(view.frame.name for view in views)}: "
            "over no run of rows are the belt's lines displaced so that it is plain which line is which",
            hint="is the block under the stripes, and clean and matt? is images.block the right file? "
            "is the number of stripes right?",
        )
    # from fewer the fan's parabola cannot be checked, from the rest it would be extrapolated too far
    if missing.size > max(_EXTRAPOLATED_SHARE_MAX * stripes, 1.0) or stripes - missing.size < _FAN_MIN:
        names = ", ".join(str(stripe + 1) for stripe in missing)
        raise CalibrationError(
            f"stripe {names} is not seen on the block",
            hint="use a longer block, or add images with the block moved along X to where it is missing",
        )
    # all light comes from one side, so all stripes move to one side; else lines were matched wrongly
    if (offset > 0).any() and (offset < 0).any():
        names = ", ".join(str(stripe + 1) for stripe in np.flatnonzero(offset > 0))
        raise CalibrationError(
            f"stripes {names} are displaced to the right on the block and the others to the left",
            hint="all light must come from one side; check the number of stripes and turn_deg",
        )
    number = np.arange(stripes)
    row = np.stack([view.row_px for view in seen])[best, number]
    per_bow = np.stack([view.offset_per_bow for view in seen])[best, number]
    return _Read(offset, stds[best, number], row, per_bow)


def _growth(seen: list[BlockView]) -> tuple[float, float]:
    """Give the displacement's relative growth per row, 1/px, common to all stripes, and its uncertainty."""
    growth = np.concatenate([view.growth_per_px for view in seen])
    std = np.concatenate([view.growth_std_per_px for view in seen])
    known = np.isfinite(growth) & (std > 0.0)
    if not known.any():
        return 0.0, 0.0
    stated = float(np.sqrt((std[known] ** 2).mean()))
    seen_std = float(growth[known].std(ddof=1)) if known.sum() > 1 else 0.0
    # Birge's ratio: where stripes differ by more than each states, what they show counts
    return float(growth[known].mean()), max(stated, seen_std) / float(np.sqrt(known.sum()))


def _filled(read: _Read, rest_px: Floats) -> tuple[_Read, float, tuple[str, ...]]:
    """Check displacements by the fan of all, and take those of outer stripes that miss the block from it.

    Planes that fan out from one projector are displaced, seen from above, by an amount that is linear in the
    rest line's place; tilt bends that a little, hence a parabola. Gives displacements without gaps, the
    largest deviation from the fan, and a note.
    """
    offset_px = read.offset_px
    known = np.isfinite(offset_px)
    if known.sum() < _FAN_MIN:
        return read, 0.0, ()
    # in shares of the width of the fan: a place in px and its square would differ a thousandfold
    place = (rest_px[:, 0] - rest_px[:, 0].mean()) / max(float(np.ptp(rest_px[:, 0])), 1.0)
    powers = np.polynomial.polynomial.polyvander(place, 2)
    inverse = np.linalg.pinv(powers[known])
    fan_px = powers @ (inverse @ offset_px[known])
    # relative, as a displacement is proportional to the lean of its plane
    deviation = np.where(known, np.abs(offset_px / fan_px - 1.0), 0.0)
    worst = int(deviation.argmax())
    if deviation[worst] > _FAN_RESIDUAL_MAX:
        raise CalibrationError(
            f"stripe {worst + 1} does not fit the fan of the others: its displacement on the block is off by "
            f"{deviation[worst]:.1%} (at most {_FAN_RESIDUAL_MAX:.0%} is allowed)",
            hint="look at the block image: dirt, a reflection, or a stripe taken for its neighbour",
        )
    if known.all():
        return read, float(deviation[worst]), ()
    left = (offset_px - fan_px)[known]
    # three coefficients were fitted
    scatter_px = float(np.sqrt((left**2).sum() / max(known.sum() - 3, 1)))
    # of a prediction: a stripe's own scatter about the fan, and the fan's uncertainty at its place
    lever = np.sqrt(1.0 + ((powers @ inverse) ** 2).sum(axis=1))
    names = ", ".join(str(stripe + 1) for stripe in np.flatnonzero(~known))
    said = f"stripe {names} misses the block: its displacement is extrapolated from the fan of the others"
    # the same linear combination of the others' readings gives displacement and derivative
    filled = _Read(
        np.where(known, offset_px, fan_px),
        np.where(known, read.std_px, scatter_px * lever),
        np.where(known, read.row_px, float(np.nanmean(read.row_px))),
        powers @ (inverse @ read.per_bow[known]),
    )
    return filled, float(deviation[worst]), (said,)


def _scale(seen: list[BlockView], block: Block, working_distance_mm: float | None) -> _Scale:
    """Millimetres per pixel at belt level, from the block's width at its top."""
    widths_px = [view.width_px for view in seen if np.isfinite(view.width_px)]
    # the width alone: across the stripes the block's edges lie between two of them, unseen
    if not widths_px:
        raise CalibrationError(
            "the block's edges along the stripes cannot be told from the neighbours' belt lines",
            hint="turn the block, or use one of another height, so that a displaced stripe does not lie on "
            "its neighbour's belt line",
        )
    width_px = float(np.mean(widths_px))
    edge_std_px = float(np.nanmean([view.width_std_px for view in seen])) / np.sqrt(len(widths_px))
    at_top = block.width_mm / width_px
    seen_mm = at_top * max(view.span_px for view in seen if np.isfinite(view.span_px))
    if seen_mm > block.length_mm:
        # what is seen of the length can only be less than all of it: else the sides are swapped
        raise CalibrationError(
            f"by its width of {block.width_mm:g} mm the block would be at least {seen_mm:.0f} mm long, "
            f"but its length is given as {block.length_mm:g} mm",
            hint="length_mm is the side across the stripes, width_mm the one along them: are they swapped?",
        )
    own = np.hypot(block.tolerance_mm / np.sqrt(3.0) / block.width_mm, edge_std_px / width_px)
    # a tolerance is a half-width (rectangular), the edges' scatter a standard deviation
    notes = ["square pixels assumed: the scale along the stripes is used across them as well"]
    if working_distance_mm is not None:
        factor = working_distance_mm / (working_distance_mm - block.height_mm)
        # similar triangles: the top is W − h away from the camera, the belt W
        notes.append(
            f"scale taken from the block's top to the belt by the working distance: × {factor:.4f}; "
            "heights and places above the belt are taken in perspective with it"
        )
        return _Scale(at_top * factor, float(own), tuple(notes))
    unknown = 1.0 / _DISTANCE_MIN_HEIGHTS / np.sqrt(3.0)
    # rectangular: the scale is too small by anything from nothing to a tenth
    notes.append(
        "the working distance is not known: the scale is that of the block's top, "
        f"and may be too small at the belt; {unknown:.1%} stands in its uncertainty"
    )
    return _Scale(at_top, float(np.hypot(own, unknown)), tuple(notes))


def _covariance(
    omega: Floats,
    read: _Read,
    block: Block,
    scale: _Scale,
    rest: RestFit,
    growth_std: float,
    per_distance: float,
) -> Floats:
    """Of (Ω…, mm/px, rest lines' errors, 1/distance, growth, bow), in the order of the parameters.

    Each stripe has its own reading; the block's height, the distance, the camera's tilt and the lens are
    common to all. Where the true rest line lies e px further, the displacement on the block is e too large
    and Ω too small by e over it: at the block's height the two cancel, on the belt the line's error stands
    alone. The lens cancels likewise where the block lies, and stands alone away from it.
    """
    n, k = omega.size, rest.covariance.shape[1]
    size = n + 1 + k * n + 3  # the last three: the distance, which the rig file gives, growth and bow
    covariance = np.zeros((size, size))
    distance, growth, bow = size - 3, size - 2, size - 1
    # rows: derivatives of all parameters by growth, 1/W and the lens's bow, each common to all stripes
    common = np.zeros((3, size))
    common[0, :n], common[0, growth] = omega * read.row_px, 1.0
    common[1, :n] = omega * block.height_mm / (1.0 - block.height_mm * per_distance)
    common[1, distance] = 1.0
    # a bow that is taken out wrongly changes a displacement by `per_bow`, and Ω inversely
    common[2, :n], common[2, bow] = -omega / read.offset_px * read.per_bow, 1.0
    variances = (growth_std**2, (_TILT_MAX * per_distance) ** 2 / 3.0, rest.bow_std_per_px2**2)
    for by, variance in zip(common, variances, strict=True):
        covariance += variance * np.outer(by, by)
    height_relative = block.tolerance_mm / np.sqrt(3.0) / block.height_mm
    covariance[:n, :n] += np.diag((omega * read.std_px / read.offset_px) ** 2)
    covariance[:n, :n] += height_relative**2 * np.outer(omega, omega)
    # of one stripe's reading, independent of the others
    covariance[n, n] = (scale.mm_per_px * scale.relative_std) ** 2
    # the block's height is the same for all stripes, so their Ω err together
    for stripe in range(n):
        own = slice(n + 1 + k * stripe, n + 1 + k * (stripe + 1))
        by_rest = omega[stripe] / read.offset_px[stripe] * read.row_px[stripe] ** np.arange(k)
        covariance[own, own] = rest.covariance[stripe]
        # e px at the row where the block was read: the rest line's polynomial there
        covariance[stripe, own] = covariance[own, stripe] = rest.covariance[stripe] @ by_rest
        covariance[stripe, stripe] += by_rest @ rest.covariance[stripe] @ by_rest
    return covariance
