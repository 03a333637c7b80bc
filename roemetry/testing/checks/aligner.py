"""What every aligner keeps: what has moved is found, and what it does not know it does not say."""

from __future__ import annotations

from typing import Any

import numpy as np

from roemetry.errors import StageError
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment
from roemetry.stages import Aligner
from roemetry.testing.scenes import LinearRig, moved_rig
from roemetry.testing.verdict import refused, require

_WITHIN_PX = 0.1
"""Stripes whose peaks scatter by 0.1 px, over hundreds of rows, are known to a tenth of this."""


def check_a_camera_at_rest_is_left_alone(aligner: Aligner[Any]) -> None:
    """Where the belt lies as calibrated, with a product on it, nothing is corrected and nothing is said."""
    rig = LinearRig()
    found = _align(aligner, rig, rig.x_px(rig.dome()))
    require(not found.moved, f"a motion of {found.motion} is corrected where nothing has moved")
    require(not found.reasons, f"it says {[reason.code for reason in found.reasons]} of a belt at rest")


def check_a_small_shift_is_taken_out(aligner: Aligner[Any]) -> None:
    """An image shifted by 0.8 px is corrected to within 0.1 px, and it is said."""
    _taken_out(aligner, (0.8, 0.0, 0.0, 0.0))


def check_a_small_turn_is_taken_out(aligner: Aligner[Any]) -> None:
    """An image turned by 0.5°, which leaves the stripes' mean in place, is corrected to within 0.1 px."""
    _taken_out(aligner, (0.0, np.radians(0.5), 0.0, 0.0))


def check_a_small_zoom_is_taken_out(aligner: Aligner[Any]) -> None:
    """An image grown by 0.6 %, which leaves the stripes' mean in place, is corrected to within 0.1 px."""
    _taken_out(aligner, (0.0, 0.0, 0.006, 0.0))


def check_a_far_motion_is_refused(aligner: Aligner[Any]) -> None:
    """An image turned by 8° is refused by a `StageError`."""
    rig = LinearRig()
    with refused("an image turned by 8°", StageError):
        _align(aligner, rig, _moved_px(rig, (0.0, np.radians(8.0), 0.0, 0.0)))


def check_an_unseen_belt_is_told(aligner: Aligner[Any]) -> None:
    """Where no belt is seen nothing is corrected, and that it was not compared is said or refused."""
    rig = LinearRig()
    try:
        found = _align(aligner, rig, np.full((rig.stripes, rig.rows), np.nan))
    except StageError:
        return
    require(not found.moved, "it corrects by a belt that is not seen")
    require(bool(found.reasons), "it says nothing of a belt that is not seen")


def _align(aligner: Aligner[Any], rig: LinearRig, x_px: Floats) -> Alignment:
    return aligner.align(rig.peaks(x_px, scatter_px=0.1).peaks, rig.calibration(), moved_rig)


def _moved_px(
    rig: LinearRig, motion: tuple[float, float, float, float], height_mm: Floats | None = None
) -> Floats:
    """Give (stripe, row) centres, px, of a scene whose camera has moved since the rig's calibration."""
    moved = moved_rig(rig.calibration(), Alignment(np.array(motion), np.zeros((4, 4))))
    rest: Floats = moved.rest_line_px(np.arange(rig.rows, dtype=np.float64))
    return rest if height_mm is None else rest + rig.px_per_mm * height_mm


def _taken_out(aligner: Aligner[Any], motion: tuple[float, float, float, float]) -> None:
    rig = LinearRig()
    found = _align(aligner, rig, _moved_px(rig, motion, rig.dome()))
    require(found.moved, f"{motion} is not seen")
    require(bool(found.reasons), f"{motion} is corrected in silence")
    rows = np.arange(rig.rows, dtype=np.float64)
    off_px = moved_rig(rig.calibration(), found).rest_line_px(rows) - _moved_px(rig, motion)
    worst = float(np.abs(off_px).max())
    require(worst <= _WITHIN_PX, f"after {motion} the corrected lines are up to {worst:.2g} px off")
