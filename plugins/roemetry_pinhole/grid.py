"""Calibration of camera, both families of planes of a grid, and belt, from a board in many poses.

Each family is calibrated by itself by `pinhole-plane`, with all its checks: the lines across in the images
turned by 90°. Both see the same boards, and find camera and belt c, each better where its own lines help. How
their errors go together is not known, since the boards' marks are in both; covariance intersection (Julier,
Uhlmann 1997) joins them so that the result is not surer than it may be, however they do:

    C⁻¹ = ½ C₁⁻¹ + ½ C₂⁻¹,   c = C (½ C₁⁻¹ c₁ + ½ C₂⁻¹ c₂).

The planes p of each family then are what they would have been found to be if c had been known to be that
(conditional expectation of normal variables, Rao 1973, 8a.2): p + G (c − cₖ), G = Σ_pc Cₖ⁻¹, with the
covariance Σ_pp − G Σ_cp + G C Gᵀ. How far c₁ and c₂ lie apart, in standard deviations, is a check: a family
that was numbered wrongly, or a projector that moved, shows in it.

The lines across are seen in the image turned by 90° counter-clockwise, x' = y and y' = W − 1 − x for an image
W pixels wide: the camera's axes turn to X' = Y, Y' = −X, its focal lengths change places, the principal
point becomes (c_y, W − 1 − c_x), tangential distortion (p₁, p₂) becomes (−p₂, p₁), and a plane p·X = 1 of the
camera's frame (p_y, −p_x, p_z). So a calibration of the turned image says the same in other words, and each
peak's undistorted ray meets its own plane of light (Hartley and Zisserman 2004, chapter 6) in the one belt
frame: `PinholeGrid`.

It assumes that camera and projector stood still, as both families must find one camera. It fails where either
family alone cannot be calibrated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import CalibrationError, StageError
from roemetry.records import CalibrationSet, Peaks, Profiles, StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.view import View
from roemetry.stages import Calibrator, Capabilities, StageOptions, Triangulator
from roemetry_pinhole.calibrator import BoardOptions, PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.pinhole_plane import (
    belt_pose,
    by_motion,
    camera_of,
    derived,
    flat,
    lift_stripes,
    planes_in_belt_frame,
    shifts_per_px,
    turned,
    view_of,
    with_planes_shifted,
)

APART_MAX = 3.0
"""Standard deviations, root mean square over camera and belt, that the families may lie apart."""


class PinholeGridOptions(BoardOptions):
    """The pattern, and what is looked for."""

    lines: int = Field(default=5, ge=1, le=200, description="lines across; the others are the rig's stripes")


class PinholeGridCalibrator(Calibrator[PinholeGridOptions]):
    """Camera, lens, a plane of light for each line of both families, and the belt."""

    capabilities = Capabilities(pattern="grid", fixture="roemetry_pinhole.conformance:grid_observed_of")

    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate.

        Raises
        ------
        CalibrationError
            As `pinhole-plane` does of either family, which is named; or they tell of different cameras.
        """
        shared = self.options.model_dump(include=set(BoardOptions.model_fields))
        one = PinholeCalibrator(PinholeCalibratorOptions(**shared))
        other = _turned(observed, self.options.lines)
        upright = one.calibrate(observed)
        try:
            across = one.calibrate(other)
        except CalibrationError as error:
            raise CalibrationError(f"lines across: {error.message}", hint=error.hint) from error
        return _joined(upright, across)


def _turned(observed: CalibrationSet, lines: int) -> CalibrationSet:
    """Give the images turned by 90° counter-clockwise, with the peaks of the lines across."""
    if any(one.peaks.across is None for one in observed.observations if one.frame.role == "laser"):
        raise CalibrationError("the extractor finds none", hint="set `extractor: grid-lines`")
    return replace(
        observed,
        stripe_count=lines,
        observations=tuple(
            replace(
                one,
                frame=replace(one.frame, pixels=np.ascontiguousarray(np.rot90(one.frame.pixels))),
                peaks=one.peaks.across or _none(one.frame.size[::-1]),
            )
            for one in observed.observations
        ),
    )


def _none(size: tuple[int, int]) -> Peaks:
    none = np.empty(0)
    return Peaks(size, np.empty(0, np.int64), none, none, none, none, none.copy(), np.empty(0, np.uint8))


def _joined(upright: Calibration, across: Calibration) -> Calibration:
    """Give the calibration of both families."""
    columns = upright.image_size[1]
    turning = _turning(across.stripe_count, columns)
    back = turning[:, :-1]
    one = FamilyFound.of(flat(upright.parameters), upright.covariance, upright.stripe_count)
    # back to the image's own parameters, which is linear
    other = FamilyFound.of(
        back @ flat(across.parameters) + turning[:, -1],
        back @ across.covariance @ back.T,
        across.stripe_count,
    )
    shared, covariance, off = one.combined(other)
    if off > APART_MAX:
        raise CalibrationError(
            f"the two families of lines give cameras that are {off:.1f} standard deviations apart",
            hint="is `lines` right, and did neither projector nor camera move between the images?",
        )
    # in the order of the parameters: camera, planes, belt, planes across
    follow = np.vstack([np.eye(15)[:12], one.gain, np.eye(15)[12:], other.gain])
    whole = follow @ covariance @ follow.T
    for first, found in ((12, one), (15 + one.planes.size, other)):
        own = np.s_[first : first + found.planes.size]
        # what is left of each family's planes where the shared is known
        whole[own, own] += found.own
    planes = [found.planes + found.gain @ (shared - found.shared) for found in (one, other)]
    parameters = {
        "focal_px": shared[:2],
        "principal_px": shared[2:4],
        "distortion": shared[4:12],
        "planes_per_mm": planes[0].reshape(-1, 3),
        "belt_per_mm": shared[12:],
        ACROSS: planes[1].reshape(-1, 3),
    }
    return replace(
        upright,
        method=METHOD,
        covariance=0.5 * (whole + whole.T),
        **derived(parameters, upright.image_size),
        **joined_findings(upright, across, off, "across", "lines across"),
        across=replace(
            across,
            covariance=_of_lines_across(whole, upright.stripe_count, columns),
            **derived(turned_parameters(parameters, columns), across.image_size),
        ),
    )


class FamilyFound(NamedTuple):
    """Camera and belt as one family tells them, and its planes."""

    shared: Floats
    covariance: Floats
    """shared, covariance: (15,), (15, 15) the camera's twelve numbers and the belt's three."""
    planes: Floats
    own: Floats
    """planes, own: (3 n,) and the covariance that is left of them where `shared` is known."""
    gain: Floats
    """(3 n, 15) how they follow it."""

    @classmethod
    def of(cls, values: Floats, covariance: Floats, count: int) -> FamilyFound:
        """Part parameters in the order camera, planes, belt."""
        planes = np.arange(12, 12 + 3 * count)
        shared = np.r_[0:12, 12 + 3 * count : 15 + 3 * count]
        known, with_them = covariance[np.ix_(shared, shared)], covariance[np.ix_(planes, shared)]
        gain = with_them @ inverse_of_known(known)
        own = covariance[np.ix_(planes, planes)] - gain @ with_them.T
        return cls(values[shared], known, values[planes], own, gain)

    def combined(self, other: FamilyFound) -> tuple[Floats, Floats, float]:
        """Give the weighted mean of both `shared`, its covariance, and their distance in deviations.

        Both families use the same board corners: each has half the weight, so that these count once.
        """
        apart = self.shared - other.shared
        surely = inverse_of_known(self.covariance + other.covariance)
        # numbers that were held fixed count nothing
        off = float(np.sqrt(max(apart @ surely @ apart, 0.0) / max(np.linalg.matrix_rank(surely), 1)))
        weights = 0.5 * inverse_of_known(self.covariance), 0.5 * inverse_of_known(other.covariance)
        covariance = inverse_of_known(weights[0] + weights[1])
        return self.shared - covariance @ weights[1] @ apart, covariance, off


def joined_findings(one: Calibration, two: Calibration, off: float, name: str, words: str) -> dict[str, Any]:
    """Give residuals, range of heights and notes of both families; those of the second by its name."""
    of_second = {f"{name}_{key}": figure for key, figure in two.residuals.items()}
    lows, highs = zip(one.height_range_mm, two.height_range_mm, strict=True)
    return {
        "residuals": {**one.residuals, **of_second, "families_apart_std": off},
        "height_range_mm": (max(lows), min(highs)),
        "notes": (*one.notes, *(f"{words}: {note}" for note in two.notes if note not in one.notes)),
    }


def _turning(lines: int, columns: int) -> Floats:
    """Give (n, n + 1) what takes the turned image's parameters to those of the image, and adds."""
    size = 15 + 3 * lines
    found = np.zeros((size, size + 1))
    # focal lengths change places; the principal point turns with the image
    found[[0, 1, 3], [1, 0, 2]] = 1.0
    found[2, 3], found[2, -1] = -1.0, columns - 1.0
    found[range(4, 12), range(4, 12)] = 1.0
    found[6:8, 6:8] = [[0.0, 1.0], [-1.0, 0.0]]
    for at in range(12, size, 3):
        found[at : at + 3, at : at + 3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    return found


def _of_lines_across(covariance: Floats, stripes: int, columns: int) -> Floats:
    """Give the covariance of the turned image's parameters of that of both families' parameters."""
    belt = 12 + 3 * stripes
    mine = np.r_[0:12, belt + 3 : len(covariance), belt : belt + 3]
    back = _turning((len(covariance) - belt - 3) // 3, columns)[:, :-1]
    return np.asarray(back.T @ covariance[np.ix_(mine, mine)] @ back)


def inverse_of_known(matrix: Floats) -> Floats:
    """Give the inverse of what is not 0 of a covariance or its inverse: 0 is what was held fixed."""
    # in units of their deviations: px and 1/mm differ by orders
    size = np.sqrt(np.diag(matrix))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    inverse = np.linalg.pinv(scale[:, None] * matrix * scale, rcond=1e-10, hermitian=True)
    return np.asarray(scale[:, None] * inverse * scale)


METHOD = "pinhole-grid"
ACROSS = "across_planes_per_mm"
TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Takes the camera's frame to that of the turned image."""


def turned_parameters(parameters: Mapping[str, Floats], columns: int) -> dict[str, Floats]:
    """Give `pinhole-plane`'s parameters of the lines across, for the turned image, once `columns` px wide.

    In `parameters`, of the image as it is, `across_planes_per_mm` are the planes.
    """
    lens = parameters["distortion"].copy()
    lens[2:4] = -lens[3], lens[2]
    middle = parameters["principal_px"]
    return {
        "focal_px": parameters["focal_px"][::-1],
        "principal_px": np.array([middle[1], columns - 1.0 - middle[0]]),
        "distortion": lens,
        "planes_per_mm": parameters[ACROSS] @ TURN.T,
        "belt_per_mm": TURN @ parameters["belt_per_mm"],
    }


class PinholeGrid(Triangulator[StageOptions]):
    """Each peak's ray meets its line's plane of light, of either family."""

    capabilities = Capabilities(
        height_tolerance_mm=0.01, pattern="grid", fixture="roemetry_pinhole.conformance:grid_of"
    )

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give a slice for each stripe, then one for each line across, with a point for each row or column.

        Raises
        ------
        StageError
            There are no lines across, or the map has other numbers of lines or rows than the calibration.
        """
        across = stripes.across
        if across is None or ACROSS not in calibration.parameters:
            what = "the stripes have" if across is None else "the calibration has"
            raise StageError(f"{what} no lines across: pinhole-grid triangulates grids")
        parameters = calibration.parameters
        rows, columns = calibration.image_size
        found = stripes.x_px.shape, across.x_px.shape
        made = (len(parameters["planes_per_mm"]), rows), (len(parameters[ACROSS]), columns)
        if found != made:
            raise StageError(
                f"lines and rows are {found[0]}, across {found[1]}; of the calibration {made[0]}, {made[1]}"
            )
        pose = belt_pose(parameters["belt_per_mm"])
        other = turned_parameters(parameters, columns)
        lifted = [
            lift_stripes(
                stripes.x_px, stripes.x_std_px, camera_of(parameters), parameters["planes_per_mm"],
                pose[:3, :3], pose[:3, 3],
            ),
            lift_stripes(
                across.x_px, across.x_std_px, camera_of(other), other["planes_per_mm"],
                np.ascontiguousarray(pose[:3, :3] @ TURN.T), pose[:3, 3],
            ),
        ]  # fmt: skip
        # slices of rows and of columns in one array: the shorter are filled up
        longest = max(rows, columns)

        def joined(one: Any, two: Any, nothing: float) -> Any:
            whole = np.full((len(one) + len(two), longest, *one.shape[2:]), nothing, one.dtype)
            whole[: len(one), : one.shape[1]], whole[len(one) :, : two.shape[1]] = one, two
            return whole

        xyz_mm = joined(lifted[0][0], lifted[1][0], np.nan)
        known = np.isfinite(xyz_mm[..., 0])
        row = np.broadcast_to(np.arange(rows, dtype=np.float64), stripes.x_px.shape)
        # a row of the turned image is a column counted from the right
        x_px = np.broadcast_to(columns - 1.0 - np.arange(columns), across.x_px.shape)
        planes = np.concatenate([parameters["planes_per_mm"], parameters[ACROSS]])
        return Profiles(
            xyz_mm=xyz_mm,
            product=np.where(known, joined(stripes.product, across.product, -1), -1).astype(np.int16),
            seen=joined(stripes.seen, across.seen, False) & known,
            x_px=np.where(known, joined(stripes.x_px, x_px, np.nan), np.nan),
            row_px=np.where(known, joined(row, across.x_px, np.nan), np.nan),
            height_std_mm=joined(lifted[0][1], lifted[1][1], np.nan),
            stripe=np.arange(len(planes)),
            frame=np.zeros(len(planes), np.int64),
            plane=planes_in_belt_frame(planes, pose),
        )

    def moved(self, calibration: Calibration, alignment: Alignment) -> Calibration:
        """Give the calibration of a camera turned and zoomed, of both families; see `pinhole-plane`.

        `Alignment.planes_px` are those of the stripes, then those of the lines across.
        """
        assert calibration.across is not None
        before, size = calibration.parameters, calibration.image_size
        parameters, covariance = turned(before, alignment.motion), calibration.covariance
        if alignment.covariance.any():
            covariance = covariance + by_motion(before, alignment.covariance)
        if alignment.planes_px.any():
            one, other = np.split(alignment.planes_px, [calibration.stripe_count])
            per_px = shifts_per_px(turned_parameters(parameters, size[1]), size[::-1]) @ TURN
            for name, shift_px, by in (
                ("planes_per_mm", one, shifts_per_px(parameters, size)),
                (ACROSS, other, per_px),
            ):
                parameters, covariance = with_planes_shifted(
                    parameters, covariance, name, by, shift_px, alignment.planes_std_px
                )
        return replace(
            calibration,
            covariance=covariance,
            **derived(parameters, size),
            across=replace(
                calibration.across,
                covariance=_of_lines_across(covariance, calibration.stripe_count, size[1]),
                **derived(turned_parameters(parameters, size[1]), size[::-1]),
            ),
        )

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's own parameters, so that a redrawn one moves it."""
        return view_of(calibration.parameters, calibration.image_size)
