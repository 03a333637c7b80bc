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
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet, Peaks
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages import Calibrator, Capabilities
from roemetry_pinhole.calibrator import BoardOptions, PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.grid_planes import ACROSS, METHOD, turned_parameters
from roemetry_pinhole.pinhole_plane import derived, flat

_APART_MAX = 3.0
"""Standard deviations, root mean square over camera and belt, that the families may lie apart."""


class PinholeGridOptions(BoardOptions):
    """The pattern, and what is looked for."""

    lines: int = Field(default=5, ge=1, le=200, description="lines across; the others are the rig's stripes")


class PinholeGridCalibrator(Calibrator[PinholeGridOptions]):
    """Camera, lens, a plane of light for each line of both families, and the belt."""

    Options = PinholeGridOptions
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
    one = _Found.of(flat(upright.parameters), upright.covariance, upright.stripe_count)
    other = _Found.of(
        back @ flat(across.parameters) + turning[:, -1],
        back @ across.covariance @ back.T,
        across.stripe_count,
    )
    apart = one.shared - other.shared
    surely = _inverse(one.covariance + other.covariance)
    off = float(np.sqrt(max(apart @ surely @ apart, 0.0) / max(np.linalg.matrix_rank(surely), 1)))
    if off > _APART_MAX:
        raise CalibrationError(
            f"the two families of lines tell of cameras {off:.1f} standard deviations apart",
            hint="is `lines` right, and did neither projector nor camera move between the images?",
        )
    weights = 0.5 * _inverse(one.covariance), 0.5 * _inverse(other.covariance)
    covariance = _inverse(weights[0] + weights[1])
    shared = one.shared + covariance @ weights[1] @ (other.shared - one.shared)
    # in the order of the parameters: camera, planes, belt, planes across
    follow = np.vstack([np.eye(15)[:12], one.gain, np.eye(15)[12:], other.gain])
    whole = follow @ covariance @ follow.T
    for first, found in ((12, one), (15 + one.planes.size, other)):
        own = np.s_[first : first + found.planes.size]
        whole[own, own] += found.own
    belt = 12 + one.planes.size
    mine = np.r_[0:12, belt + 3 : len(whole), belt : belt + 3]
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
        residuals={
            **upright.residuals,
            **{f"across_{name}": figure for name, figure in across.residuals.items()},
            "families_apart_std": off,
        },
        height_range_mm=(
            max(upright.height_range_mm[0], across.height_range_mm[0]),
            min(upright.height_range_mm[1], across.height_range_mm[1]),
        ),
        notes=(
            *upright.notes,
            *(f"lines across: {note}" for note in across.notes if note not in upright.notes),
        ),
        across=replace(
            across,
            covariance=back.T @ whole[np.ix_(mine, mine)] @ back,
            **derived(turned_parameters(parameters, columns), across.image_size),
        ),
    )


class _Found(NamedTuple):
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
    def of(cls, values: Floats, covariance: Floats, count: int) -> _Found:
        """Part parameters in the order camera, planes, belt."""
        planes = np.arange(12, 12 + 3 * count)
        shared = np.r_[0:12, 12 + 3 * count : 15 + 3 * count]
        known, with_them = covariance[np.ix_(shared, shared)], covariance[np.ix_(planes, shared)]
        gain = with_them @ _inverse(known)
        own = covariance[np.ix_(planes, planes)] - gain @ with_them.T
        return cls(values[shared], known, values[planes], own, gain)


def _turning(lines: int, columns: int) -> Floats:
    """Give (n, n + 1) what takes the turned image's parameters to those of the image, and adds."""
    size = 15 + 3 * lines
    found = np.zeros((size, size + 1))
    found[[0, 1, 3], [1, 0, 2]] = 1.0
    found[2, 3], found[2, -1] = -1.0, columns - 1.0
    found[range(4, 12), range(4, 12)] = 1.0
    found[6:8, 6:8] = [[0.0, 1.0], [-1.0, 0.0]]
    for at in range(12, size, 3):
        found[at : at + 3, at : at + 3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    return found


def _inverse(matrix: Floats) -> Floats:
    """Give the inverse of what is not 0 of a covariance or its inverse: 0 is what was held fixed."""
    size = np.sqrt(np.diag(matrix))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    inverse = np.linalg.pinv(scale[:, None] * matrix * scale, rcond=1e-10, hermitian=True)
    return np.asarray(scale[:, None] * inverse * scale)
