"""Calibration of camera, both families of planes of a grid, and belt, from a board in many poses.

Each family is calibrated by itself by `pinhole-plane`, with all its checks: the lines across in the images
turned by 90°. Both see the same boards, so both find the same camera and belt c but for what the lines add.
The first family's are kept. The planes p of the other follow as what they would be found to be if c were
known to be that (conditional expectation of normal variables, Rao 1973, 8a.2):

    p + G (c₁ − c₂),   G = Σ_pc Σ_cc⁻¹,   covariance Σ_pp − G Σ_cp + G Σ_c₁ Gᵀ,   with the others G Σ_c₁,all.

Left out is that planes of both families share the boards' poses beyond what c carries. How far c₁ and c₂ lie
apart, in their standard deviations, is a check: more than the lines could add means that one family was
numbered wrongly or the projector moved.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet, Peaks
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages import Calibrator, Capabilities, StageOptions
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.grid_planes import ACROSS, METHOD, turned_parameters
from roemetry_pinhole.pinhole_plane import displacements, rest_polynomials, view_of

_APART_MAX = 3.0
"""Standard deviations, root mean square over camera and belt, that the families may lie apart."""


class PinholeGridOptions(StageOptions):
    """The pattern, and what is looked for."""

    lines: int = Field(default=11, ge=1, le=200, description="lines across; the others are the rig's stripes")
    lens: Literal["none", "radial", "brown", "rational"] = Field(
        default="brown",
        description="lens model: none; k1 k2; k1 k2 p1 p2 k3; or with k4 k5 k6 for very wide angles",
    )
    print_contrast_max: float = Field(
        default=0.25, ge=0, le=1,
        description="largest contrast of the print under a line, (light − dark)/(light + dark), to use it",
    )  # fmt: skip
    height_max_mm: float | None = Field(
        default=None, gt=0, description="greatest height to be measured, mm; none: what the boards reached"
    )


class PinholeGridCalibrator(Calibrator[PinholeGridOptions]):
    """Camera, lens, a plane of light for each line of both families, and the belt."""

    Options = PinholeGridOptions
    capabilities = Capabilities(pattern="grid")

    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate.

        Raises
        ------
        CalibrationError
            As `pinhole-plane` does of either family, which is named; or the families tell of different cameras.
        """
        options = self.options
        one = PinholeCalibrator(
            PinholeCalibratorOptions(
                lens=options.lens,
                print_contrast_max=options.print_contrast_max,
                height_max_mm=options.height_max_mm,
            )
        )
        upright = one.calibrate(observed)
        try:
            across = one.calibrate(_turned(observed, options.lines))
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
    return Peaks(
        size, np.empty(0, np.int64), none, none, none, none, none.copy(), np.empty(0, np.uint8)
    )


def _joined(upright: Calibration, across: Calibration) -> Calibration:
    """Give the calibration of both families."""
    columns = upright.image_size[1]
    count, other = upright.stripe_count, across.stripe_count
    shared = np.r_[0:12, 12 + 3 * count : 15 + 3 * count]
    first, all_first = _flat(upright), upright.covariance
    # turning back: a signed permutation, and a shift of the principal point
    back = _turning(other, columns)
    turned, shift = back[:, :-1], back[:, -1]
    second, covariance = turned @ _flat(across) + shift, turned @ across.covariance @ turned.T
    mine = np.r_[0:12, 12 + 3 * other : 15 + 3 * other]
    planes = np.arange(12, 12 + 3 * other)
    known, gain = _known(covariance[np.ix_(mine, mine)], covariance[np.ix_(planes, mine)])
    apart = first[shared] - second[mine]
    off = float(np.sqrt(max(apart @ known @ apart, 0.0) / max(np.linalg.matrix_rank(known), 1)))
    if off > _APART_MAX:
        raise CalibrationError(
            f"the two families of lines tell of cameras {off:.1f} standard deviations apart",
            hint="is `lines` right, and did neither projector nor camera move between the images?",
        )
    found = (second[planes] + gain @ apart).reshape(other, 3)
    own = covariance[np.ix_(planes, planes)] - gain @ covariance[np.ix_(mine, planes)]
    follow = gain @ all_first[shared]
    whole = np.block([[all_first, follow.T], [follow, own + follow[:, shared] @ gain.T]])
    parameters = {**upright.parameters, ACROSS: found}
    size = across.image_size
    seen = turned_parameters(parameters, columns)
    return replace(
        upright,
        method=METHOD,
        parameters=parameters,
        covariance=0.5 * (whole + whole.T),
        residuals={
            **upright.residuals,
            **{f"across_{name}": figure for name, figure in across.residuals.items()},
            "families_apart_std": off,
        },
        height_range_mm=(
            max(upright.height_range_mm[0], across.height_range_mm[0]),
            min(upright.height_range_mm[1], across.height_range_mm[1]),
        ),
        notes=(*upright.notes, *(f"lines across: {note}" for note in across.notes)),
        across=replace(
            across,
            parameters=seen,
            rest_px=rest_polynomials(seen, size),
            displacement_px_per_mm=displacements(seen, size),
            view=view_of(seen, size),
        ),
    )


def _flat(calibration: Calibration) -> Floats:
    return np.concatenate([np.ravel(one) for one in calibration.parameters.values()])


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


def _known(covariance: Floats, with_them: Floats) -> tuple[Floats, Floats]:
    """Give the inverse of what is not fixed of a covariance, and `with_them` times it."""
    std = np.sqrt(np.diag(covariance))
    scale = np.where(std > 0.0, 1.0 / np.where(std > 0.0, std, 1.0), 0.0)
    inverse = np.linalg.pinv(scale[:, None] * covariance * scale, rcond=1e-10, hermitian=True)
    inverse = scale[:, None] * inverse * scale
    return inverse, with_them @ inverse
