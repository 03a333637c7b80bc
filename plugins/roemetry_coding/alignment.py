"""From a fitted motion of the belt's light to what is done about it: nothing, a correction, or a refusal.

Shared by the aligners of lines, grids and dots, which fit the motion each in its own way. A motion is
corrected from where it is surely there and matters, and refused from where its first order no longer holds.

A shift may come from the camera, the laser or the belt. On the belt they do the same; at the height h they
differ by the shift times h over their distance. That much of the zoom is not known, and stands in its
variance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Reason
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.stages import StageOptions
from roemetry_kernels.compiling import float_kernel

STEPS = np.array([2.0, 5e-3, 5e-3, 2e-2])
"""Steps of numerical derivatives, units of `PARAMETERS`: each moves a usual image's edge by one or two
pixels, far more than the 0.002 px to which rest lines are approximated, and far less than what bends."""
SEARCH_PX = 6.0
"""What lies farther from its place is no belt; twice what can be corrected."""
SEARCH_SPACING = 0.3
"""The same as a share of the smallest distance of neighbours: beyond it the next one is as near."""
WIDTHS = (1.0, 0.5, 0.25)
"""Widths of the biweight over the search, one a round: a product's light lies anywhere within the search, the
belt's crowds, so narrowing finds the crowd. Fewer rounds may stop at a product's edge."""
LAST_ROUNDS = 4  # at most, with the width of the last biweight, until nothing moves
SETTLED_PX = 0.002
"""A round that moves nothing by more is the last: far below the 0.01 px to which the fit is known."""
SIGMAS = 4.0
"""Width of the biweight in the last rounds, standard deviations: 92 % efficient for normal noise."""
SIGMA_MIN_PX = 0.05
"""Less scatter than this says more of rounding than of the belt."""
OUTER_SHARE = 0.1
_OUTER_FIT_MIN = 0.3
"""Of the light in the first and last tenth so much must lie on the moved places: a product may cover
two thirds there; what fits by chance holds a seventh."""
SIGNIFICANT = 3.0
"""Standard deviations from which a motion is taken for real."""
_CHECKED_STD_PX = 0.25
"""With places less sure than this, motion that matters could not be seen."""
_QUANTUM_PX = 0.005
"""Steps to which the correction is rounded at the image's edge, so that frames of one state of the rig share
one corrected calibration. A tenth of the smallest correction."""
_TOLD_SHARE = 0.15
"""A part of the motion that does less at the image's edge than this share of the largest is not told."""


class AlignerOptions(StageOptions):
    """From which motion on a frame is corrected, and from which it is refused."""

    correct_from_px: float = Field(
        default=0.05,
        gt=0,
        description="motion of a rest line or dot from which it is corrected, px",
    )
    refuse_from_px: float = Field(
        default=3.0, gt=0, description="motion of a rest line or dot from which it is refused, px"
    )


class FittedMotion(NamedTuple):
    """A motion of the belt's light in an image, each part in the units in which it moves some place by 1 px.

    `motion` (4,) and `covariance` (4, 4); `edges` (place, 4) what each part does at places at the image's
    edge, px; `scale` (4,) takes it to the units of `PARAMETERS`.
    """

    motion: Floats
    covariance: Floats
    edges: Floats
    scale: Floats


class Light(NamedTuple):
    """Words for messages: what lies on the belt, where the calibration has it, and at which ends it must."""

    what: str
    where: str
    ends: str


def refuse_far(outer: int, outer_fit: int, light: Light) -> None:
    """Refuse by a StageError a frame of whose light at the ends too little fits any small motion.

    `outer` of it were compared, `outer_fit` fit.
    """
    if outer and outer_fit < _OUTER_FIT_MIN * outer:
        raise StageError(
            f"only {outer_fit / outer:.0%} of the {light.what} at the {light.ends} lie within about a pixel "
            f"of {light.where}, with any small motion of the camera",
            hint="camera, laser or belt have moved far, or the calibration is of another rig: "
            "calibrate again",
        )


def alignment_of(
    fit: FittedMotion, options: AlignerOptions, focal_px: float, light: Light, distant: int
) -> Alignment:
    """Say what is done about a fitted motion.

    Parameters
    ----------
    fit
        The motion.
    options
        From where on it is corrected and refused.
    focal_px
        Focal length, px; infinite where the camera has none.
    light
        Words for messages.
    distant
        Number of the motion's parts, from the first on the shift along x and then that along y, that differ
        by what has moved.

    Raises
    ------
    StageError
        The light has moved farther than can be corrected.
    """
    largest, largest_std, natural, rounded, covariance = _at_the_edge(
        fit.motion, fit.covariance, fit.edges, fit.scale, _QUANTUM_PX
    )
    # clearly too far, with its uncertainty: a motion that is hardly known refuses nothing
    if largest > options.refuse_from_px + 2.0 * largest_std:
        raise StageError(
            f"the belt's {light.what} lie up to {largest:.1f} px beside {light.where} "
            f"({_in_words(natural, fit.motion)}): too far to be corrected",
            hint="fasten camera and laser, and calibrate again",
        )
    reasons = []
    # both must hold: it matters, and it is real
    corrected = largest > max(options.correct_from_px, SIGNIFICANT * largest_std)
    if corrected:
        reasons.append(
            Reason(
                "moved",
                f"the belt's {light.what} lie up to {largest:.2f} px beside {light.where} "
                f"({_in_words(natural, fit.motion)}): corrected, with its uncertainty",
            )
        )
    elif largest_std > _CHECKED_STD_PX:
        # nothing corrected, but much could have moved unseen
        reasons.append(
            Reason(
                "belt-not-seen",
                "too little of the bare belt is seen: whether camera, laser or belt have moved is known only "
                f"to {2 * largest_std:.1f} px",
            )
        )
    shifts = np.array([natural[0] / focal_px, natural[3] if math.isfinite(focal_px) else 0.0])[:distant]
    covariance[2, 2] += float((shifts**2).sum())  # what has moved is not known: see above
    return Alignment(
        # rounded, so that frames of one state share one moved calibration
        motion=rounded if corrected else np.zeros(4),
        covariance=covariance,
        largest_px=largest,
        largest_std_px=largest_std,
        reasons=tuple(reasons),
        edge_px=tuple(round(px, 4) for px in fit.motion.tolist()),
    )


def not_compared() -> Alignment:
    """Say that too little belt is seen to compare it."""
    return Alignment(
        np.zeros(4),
        np.zeros((4, 4)),
        reasons=(
            Reason(
                "belt-not-seen",
                "too little of the bare belt is seen to compare it with the calibration: whether "
                "camera, laser or belt have moved is not known",
            ),
        ),
    )


def focal_px_of(calibration: Calibration) -> float:
    """Focal length, px; of a telecentric camera, or where none is known, as good as infinite."""
    view = calibration.view
    return math.inf if view is None or view.telecentric else float(view.camera_matrix[0, 0])


def _in_words(motion: Floats, edge_px: Floats) -> str:
    """Say in which way and by how much the image has moved; what moves its edge by little is left out.

    `motion` in the units of `PARAMETERS`, `edge_px` what each does at the image's edge.
    """
    pan, roll, zoom, tilt = motion
    turn = "clockwise" if roll > 0 else "counter-clockwise"
    words = (
        f"image shifted by {pan:+.2f} px along x",
        f"turned by {math.degrees(abs(roll)):.2f}° {turn}",
        f"grown by {zoom:+.2%}" if zoom > 0 else f"shrunk by {-zoom:.2%}",
        f"camera tilted by {math.degrees(tilt):+.2f}° about its x axis",
    )
    # parts that do little at the edge would only lengthen the message
    told = np.abs(edge_px) >= _TOLD_SHARE * np.abs(edge_px).max()
    return ", ".join(word for word, tell in zip(words, told, strict=True) if tell)


@float_kernel
def _at_the_edge(
    motion: Floats, covariance: Floats, edges: Floats, scale: Floats, quantum: float
) -> tuple[float, float, Floats, Floats, Floats]:
    """Say how far a motion moves the edge where it does most, px, its uncertainty, and what it is in nature.

    That is as found, rounded to `quantum` at the edge, and its covariance, in the units of `PARAMETERS`.
    """
    worst, largest, variance = 0, -1.0, 0.0
    for place in range(len(edges)):
        off = 0.0
        for k in range(4):
            off += edges[place, k] * motion[k]
        if not abs(off) <= largest:  # NaN stays: of no motion it is said that it is small
            worst, largest = place, abs(off)
    natural, rounded, scaled = np.empty(4), np.empty(4), np.empty((4, 4))
    for k in range(4):
        natural[k] = motion[k] * scale[k]
        # rounded in px at the edge, then taken to natural units
        rounded[k] = np.rint(motion[k] / quantum) * quantum * scale[k]
        for j in range(4):
            variance += edges[worst, k] * covariance[k, j] * edges[worst, j]
            scaled[k, j] = covariance[k, j] * scale[k] * scale[j]
    return largest, math.sqrt(max(variance, 0.0)), natural, rounded, scaled
