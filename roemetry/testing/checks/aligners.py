"""What every aligner keeps: a camera at rest is left alone, a moved one is corrected, a lost belt is told."""

from __future__ import annotations

from typing import Any

import numpy as np

from roemetry.errors import StageError
from roemetry.stages import Aligner
from roemetry.testing.patterns import belt_under
from roemetry.testing.verdict import refused, require


def check_a_camera_at_rest_is_left_alone(aligner: Aligner[Any]) -> None:
    """Where the belt lies as calibrated, with a product on it, there is no correction and no reason."""
    belt = belt_under(aligner.capabilities.pattern)
    found = aligner.align(belt.at_rest, belt.calibration, belt.moved)
    require(not found.moved, f"a motion of {found.motion} is corrected where nothing has moved")
    require(not found.reasons, f"it says {[reason.code for reason in found.reasons]} of a belt at rest")


def check_a_moved_camera_is_corrected(aligner: Aligner[Any]) -> None:
    """A shift, a rotation and a zoom of 0.8 to 2 px are corrected to within 0.15 px, with a reason."""
    belt = belt_under(aligner.capabilities.pattern)
    for motion in belt.small:
        moved = belt.calibration_after(motion)
        found = aligner.align(belt.seen(moved), belt.calibration, belt.moved)
        require(found.moved and bool(found.reasons), f"{motion} is not seen, or corrected in silence")
        corrected = belt.places_px(belt.moved(belt.calibration, found))
        off = float(np.nanmax(np.abs(corrected - belt.places_px(moved))))
        require(off <= belt.within_px, f"after {motion} the corrected belt is up to {off:.2g} px off")


def check_a_far_motion_is_refused(aligner: Aligner[Any]) -> None:
    """A shift by 5 px or a rotation by 8°, as the pattern has it, and another pattern's peaks are refused."""
    belt = belt_under(aligner.capabilities.pattern)
    for motion in belt.far:
        with refused(f"a motion of {motion}", StageError):
            aligner.align(belt.after(motion), belt.calibration, belt.moved)
    if belt.foreign is not None:
        with refused("peaks of another pattern", StageError):
            aligner.align(belt.foreign, belt.calibration, belt.moved)


def check_an_unseen_belt_is_told(aligner: Aligner[Any]) -> None:
    """Without a visible belt there is no correction, and a reason says that nothing was compared."""
    belt = belt_under(aligner.capabilities.pattern)
    found = aligner.align(belt.unseen, belt.calibration, belt.moved)
    require(not found.moved, "it corrects by a belt that is not seen")
    require(bool(found.reasons), "it says nothing of a belt that is not seen")
