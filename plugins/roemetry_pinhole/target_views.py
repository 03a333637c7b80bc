"""The images a calibration rests on: corners and stripes as they were used, and where the boards stood."""

from __future__ import annotations

import numpy as np

from roemetry.records import CalibrationSet, TargetView
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry_pinhole.geometry import ON_BELT
from roemetry_pinhole.joint import Joint


def target_views(joined: Joint, observed: CalibrationSet, calibration: Calibration) -> tuple[TargetView, ...]:
    """Give the views of boards that are used, and the first image of the empty belt."""
    points, adjusted = joined.measured.points, joined.adjusted
    geometry, view = adjusted.geometry, calibration.view
    peaks_px = np.column_stack([points.x_px, points.row_px])
    found, first = [], 0
    for number, board in zip(joined.pose.tolist(), joined.first.views, strict=True):
        count = len(board.marks.xy_px)
        moved = joined.measured.corners.counts[first] if count else 0.0
        mine = adjusted.stripe_used & (points.pose == number) & (points.counts == moved)
        shown = board.laser or board.plain
        if shown is not None:
            turn, shift = geometry.rotation[number], geometry.shift[number] + moved * geometry.travel
            found.append(
                TargetView(
                    name=board.name if board.laser is None else board.laser.frame.name,
                    frame=shown.frame,
                    peaks_px=peaks_px[mine],
                    stripe=points.stripe[mine].astype(np.int64),
                    corners_px=board.marks.xy_px,
                    used=adjusted.corner_used[first : first + count],
                    border_mm=_border(joined, view.T_belt_camera, turn, shift)
                    if view is not None
                    else np.empty((0, 3)),
                )
            )
        first += count
    belt = next((one for one in observed.showing("belt") if one.frame.role == "laser"), None)
    if belt is not None:
        mine = adjusted.stripe_used & (points.pose == ON_BELT)
        found.append(
            TargetView(belt.frame.name, belt.frame, peaks_px[mine], points.stripe[mine].astype(np.int64))
        )
    return tuple(found)


def _border(joined: Joint, to_belt: Floats, turn: Floats, shift: Floats) -> Floats:
    """Give the four corners of the board's pattern in the belt frame."""
    board = joined.board
    if board is None:
        return np.empty((0, 3))
    x, y = board.columns * board.pitch_mm, board.rows * board.pitch_mm
    corners = np.array([[0.0, 0, 0], [x, 0, 0], [x, y, 0], [0, y, 0]]) @ turn.T + shift
    return np.asarray(corners @ to_belt[:3, :3].T + to_belt[:3, 3])
