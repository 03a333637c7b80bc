"""How far camera, laser and belt have moved since the calibration, as one frame shows it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from roemetry.records.arrays import Checker, Floats
from roemetry.records.reasons import Reason

PARAMETERS = ("pan_px", "roll_rad", "zoom", "tilt_rad")
"""Names and units of `Alignment.motion`."""


@dataclass(frozen=True, eq=False, slots=True)
class Alignment:
    """A small motion of the camera that takes the calibrated rest lines to where a frame shows them.

    What has really moved (camera, laser or belt) cannot be told from the belt alone, and hardly matters: near
    the belt they do the same to heights. What differs is in the covariance.

    Attributes
    ----------
    motion
        (4,) what the image has done: shifted along +x at its principal point, px; turned about it, from +x
        to +y (clockwise as one looks at it), rad; grown, relative; turned about the camera's x axis (positive
        moves the image up), rad.
    covariance
        (4, 4) of the motion.
    largest_px, largest_std_px
        Largest distance along x between where the rest lines are and where the calibration has them, px, and
        its standard uncertainty.
    stripe_px
        (stripe,) what is left of each stripe's mean distance when the motion is taken out, px; NaN for
        stripes of which no belt is seen.
    reasons
        What is to be said of every product of the frame.
    """

    motion: Floats
    covariance: Floats
    largest_px: float = 0.0
    largest_std_px: float = 0.0
    stripe_px: Floats = field(default_factory=lambda: np.empty(0))
    reasons: tuple[Reason, ...] = ()

    def __post_init__(self) -> None:
        check = Checker(self)
        motion = check.array("motion", np.float64, (len(PARAMETERS),))
        check.array("covariance", np.float64, (len(PARAMETERS), len(PARAMETERS)))
        check.array("stripe_px", np.float64, (None,))
        check.require(bool(np.isfinite(motion).all()), "the motion is not finite")
        check.finish()

    @property
    def moved(self) -> bool:
        """Whether the calibration is to be corrected for this frame."""
        return bool(self.motion.any())
