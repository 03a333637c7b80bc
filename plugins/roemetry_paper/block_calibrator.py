"""Calibration from one block of known height (section 3.4), with a scale and with refusals.

The paper gives Ω_i = block height / displacement of stripe i on the block. It does not say where the scale
in X and Y comes from; here it comes from the block's width along the stripes, seen at the block's top.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.errors import CalibrationError
from roemetry.records import Block, CalibrationSet, Observation
from roemetry.stages import Calibrator, Capabilities, StageOptions
from roemetry_paper.block_geometry import block_view
from roemetry_paper.block_views import BlockView, rest_polynomials, view_of_block


class BlockCalibratorOptions(StageOptions):
    """What the calibration is meant for."""

    height_max_factor: float = Field(
        default=1.5, ge=1, description="greatest height to be measured, as a multiple of the block's height"
    )


_DISTANCE_MIN_HEIGHTS = 10.0
"""Nobody puts a camera nearer to the belt than ten block heights; used where the distance is not known."""
_FAN_RESIDUAL_MAX = 0.03


class BlockCalibrator(Calibrator[BlockCalibratorOptions]):
    """Ω of each stripe and one scale, from images of a block and of the empty belt."""

    Options = BlockCalibratorOptions
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
        seen = [view_of_block(view, rest_px) for view in views]
        offset_px, offset_std_px, row_px = _offsets(seen, views, observed.stripe_count)
        omega = block.height_mm / offset_px
        fan = _check_fan(omega)
        scale = _scale(seen, block, observed.working_distance_mm)
        size = views[0].frame.size
        return Calibration(
            method="block-linear",
            image_size=size,
            turn_deg=views[0].frame.turn_deg,
            rest_px=rest_px,
            displacement_px_per_mm=1.0 / omega,
            height_range_mm=(0.0, self.options.height_max_factor * block.height_mm),
            parameters={
                "omega_mm_per_px": omega,
                "mm_per_px": np.array([scale.mm_per_px]),
                "rest_error_px": np.zeros(rest_px.shape),
            },
            covariance=_covariance(omega, offset_px, offset_std_px, block, scale, rest.covariance, row_px),
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
            notes=scale.notes,
            view=block_view(size, rest_px, omega, scale.mm_per_px, observed.working_distance_mm),
        )


class _Scale(NamedTuple):
    mm_per_px: float
    relative_std: float
    notes: tuple[str, ...]


def _offsets(
    seen: list[BlockView], views: tuple[Observation, ...], stripes: int
) -> tuple[Floats, Floats, Floats]:
    """Give (stripe,) displacement on the block, its standard uncertainty, px, and row, from the best view."""
    offsets = np.stack([view.offset_px for view in seen])
    stds = np.where(np.isfinite(offsets), np.stack([view.offset_std_px for view in seen]), np.inf)
    best = stds.argmin(axis=0)
    offset = offsets[best, np.arange(stripes)]
    missing = np.flatnonzero(np.isnan(offset))
    if missing.size == stripes:
        raise CalibrationError(
            f"the block was not found in {', '.join(view.frame.name for view in views)}: "
            "no stripe is displaced over a run of rows in which all stripes are seen",
            hint="is the block under the stripes, and clean and matt? is images.block the right file? "
            "is the number of stripes right?",
        )
    if missing.size:
        names = ", ".join(str(stripe + 1) for stripe in missing)
        raise CalibrationError(
            f"stripe {names} is not seen on the block",
            hint="use a longer block, or add images with the block moved along X to where it is missing",
        )
    if (offset > 0).any() and (offset < 0).any():
        names = ", ".join(str(stripe + 1) for stripe in np.flatnonzero(offset > 0))
        raise CalibrationError(
            f"stripes {names} are displaced to the right on the block and the others to the left",
            hint="all light must come from one side; check the number of stripes and turn_deg",
        )
    rows = np.stack([view.row_px for view in seen])
    return offset, stds[best, np.arange(stripes)], rows[best, np.arange(stripes)]


def _check_fan(omega: Floats) -> float:
    """Planes that fan out from one projector have 1/Ω that varies smoothly; give the largest deviation."""
    if omega.size < 5:
        return 0.0
    index = np.arange(omega.size)
    slope = 1.0 / omega
    deviation = np.abs(slope - np.polyval(np.polyfit(index, slope, 2), index)) / np.abs(slope)
    worst = int(deviation.argmax())
    if deviation[worst] > _FAN_RESIDUAL_MAX:
        raise CalibrationError(
            f"stripe {worst + 1} does not fit the fan of the others: its displacement on the block is off by "
            f"{deviation[worst]:.1%} (at most {_FAN_RESIDUAL_MAX:.0%} is allowed)",
            hint="look at the block image: dirt, a reflection, or a stripe taken for its neighbour",
        )
    return float(deviation[worst])


def _scale(seen: list[BlockView], block: Block, working_distance_mm: float | None) -> _Scale:
    """Millimetres per pixel at belt level, from the block's width at its top."""
    widths_px = [view.width_px for view in seen if np.isfinite(view.width_px)]
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
        raise CalibrationError(
            f"by its width of {block.width_mm:g} mm the block would be at least {seen_mm:.0f} mm long, "
            f"but its length is given as {block.length_mm:g} mm",
            hint="length_mm is the side across the stripes, width_mm the one along them: are they swapped?",
        )
    own = np.hypot(block.tolerance_mm / np.sqrt(3.0) / block.width_mm, edge_std_px / width_px)
    notes = ["square pixels assumed: the scale along the stripes is used across them as well"]
    if working_distance_mm is not None:
        if working_distance_mm <= 2 * block.height_mm:
            raise CalibrationError(
                f"working_distance_mm is {working_distance_mm:g}, the block is {block.height_mm:g} mm high",
                hint="it is the distance from the camera's lens to the belt, in millimetres",
            )
        factor = working_distance_mm / (working_distance_mm - block.height_mm)
        notes.append(
            f"scale taken from the block's top to the belt by the working distance: × {factor:.4f}; "
            "it grows with height, which this model leaves out"
        )
        return _Scale(at_top * factor, float(own), tuple(notes))
    unknown = 1.0 / _DISTANCE_MIN_HEIGHTS / np.sqrt(3.0)
    notes.append(
        "the working distance is not known: the scale is that of the block's top, "
        f"and may be too small at the belt; {unknown:.1%} stands in its uncertainty"
    )
    return _Scale(at_top, float(np.hypot(own, unknown)), tuple(notes))


def _covariance(
    omega: Floats,
    offset_px: Floats,
    offset_std_px: Floats,
    block: Block,
    scale: _Scale,
    rest: Floats,
    row_px: Floats,
) -> Floats:
    """Of (Ω…, mm/px, rest lines' errors): each stripe's own reading, and the block's height common to all.

    Where the true rest line lies e px further, the displacement on the block is e too large and Ω too small
    by e over it: at the block's height the two cancel, on the belt the line's error stands alone.
    """
    n = omega.size
    covariance = np.zeros((3 * n + 1, 3 * n + 1))
    height_relative = block.tolerance_mm / np.sqrt(3.0) / block.height_mm
    covariance[:n, :n] = np.diag((omega * offset_std_px / offset_px) ** 2)
    covariance[:n, :n] += height_relative**2 * np.outer(omega, omega)
    covariance[n, n] = (scale.mm_per_px * scale.relative_std) ** 2
    for stripe in range(n):
        own = slice(n + 1 + 2 * stripe, n + 3 + 2 * stripe)
        by_rest = omega[stripe] / offset_px[stripe] * np.array([1.0, row_px[stripe]])
        covariance[own, own] = rest[stripe]
        covariance[stripe, own] = covariance[own, stripe] = rest[stripe] @ by_rest
        covariance[stripe, stripe] += by_rest @ rest[stripe] @ by_rest
    return covariance
