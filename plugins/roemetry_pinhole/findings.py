"""What was found in each image, and why it was or was not used: for the pages of a calibration.

`findings_of` is for the page of `calibrate --doctor`, `target_views` for the evidence.
"""

from __future__ import annotations

import numpy as np

from roemetry.records import CalibrationSet, ImageFinding, TargetView
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry_pinhole.boards import Seen
from roemetry_pinhole.geometry import ON_BELT
from roemetry_pinhole.joint_adjustment import JointAdjustment

_NOBODY = np.empty((0, 2))


def findings_of(
    observed: CalibrationSet, seen: Seen, joined: JointAdjustment | None
) -> tuple[ImageFinding, ...]:
    """Say of each image what was found and used; `joined` is None where there is no adjustment."""
    marks = {view.name: view for view in seen.views}
    used = {} if joined is None else _used(joined)
    of_pose = {
        (one.board, one.pose): f"{one.frame.name}: {seen.left_out[one.frame.name]}"
        for one in observed.observations
        if one.frame.name in seen.left_out
    }
    found = []
    for one in observed.observations:
        name = one.frame.name
        view, points, why = marks.get(name), _NOBODY, seen.left_out.get(name, "")
        said = [f"{len(one.peaks)} peaks found"] if len(one.peaks) else []
        if view is not None:
            said.append(f"{len(view.marks.xy_px)} corners of the board {view.board.name}")
        if name in used:
            points, left, off = used[name]
            if len(points) + left:
                said.append(f"{len(points)} stripe points used, {left} left out as far off")
            said += [off] if off else []
            why = f"Its stripes are not used: {why}" if why else ""
        elif joined is not None and not why and one.shows in ("board", "board_on_belt", "belt"):
            why = of_pose.get((one.board, one.pose), "nothing of it is used") if view is None else ""
        corners = _NOBODY if view is None else view.marks.xy_px
        found.append(ImageFinding(one, not why or name in used, "; ".join(said), why, corners, points))
    return tuple(found)


def _used(joined: JointAdjustment) -> dict[str, tuple[Floats, int, str]]:
    """Give by image the stripe points that count, how many do not, and how far its marks are off."""
    points, kept = joined.measured.points, joined.adjusted.stripe_used
    at = points.xy_px
    corners, found, first = joined.measured.corners, {}, dict[int, float]()
    # of each view its pose, the images of its marks and of its stripes, and its counts
    views = []
    for pose, view in zip(joined.pose.tolist(), joined.first.views, strict=True):
        start = first.setdefault(pose, view.count)
        count = view.count - start if np.isfinite(view.count) and np.isfinite(start) else 0.0
        views.append((pose, view.name, "" if view.laser is None else view.laser.frame.name, count))
    for pose, marks, laser, count in [*views, *((ON_BELT, name, name, 0.0) for name in joined.belts)]:
        mine = (points.pose == pose) & (np.abs(points.counts - count) < 0.5)
        off = joined.adjusted.corner_px[(corners.pose == pose) & (np.abs(corners.counts - count) < 0.5)]
        words = f"corners off by {np.sqrt((off**2).sum(axis=1).mean()):.2f} px (rms)" if len(off) else ""
        found[marks] = _NOBODY, 0, words
        if laser:
            found[laser] = at[mine & kept], int((mine & ~kept).sum()), "" if marks != laser else words
    return found


def target_views(
    joined: JointAdjustment, observed: CalibrationSet, calibration: Calibration
) -> tuple[TargetView, ...]:
    """Give the views of boards that are used, and the first image of the empty belt."""
    points, adjusted = joined.measured.points, joined.adjusted
    geometry, view = adjusted.geometry, calibration.view
    peaks_px = points.xy_px
    found, first = [], 0
    for number, board in zip(joined.pose.tolist(), joined.first.views, strict=True):
        count = len(board.marks.xy_px)
        moved = joined.measured.corners.counts[first] if count else 0.0
        mine = adjusted.stripe_used & (points.pose == number) & (points.counts == moved)
        shown = board.laser or board.plain
        if shown is not None:
            turn, shift = geometry.rotation[number], geometry.shift[number] + moved * geometry.travel
            border = np.empty((0, 3))  # or the four corners of the board's pattern, in the belt frame
            if view is not None and joined.board is not None:
                size = joined.board.pitch_mm * np.array([joined.board.columns, joined.board.rows, 0.0])
                corners = size * [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] @ turn.T + shift
                border = corners @ view.T_belt_camera[:3, :3].T + view.T_belt_camera[:3, 3]
            found.append(
                TargetView(
                    name=board.name if board.laser is None else board.laser.frame.name,
                    frame=shown.frame,
                    peaks_px=peaks_px[mine],
                    stripe=points.stripe[mine].astype(np.int64),
                    corners_px=board.marks.xy_px,
                    used=adjusted.corner_used[first : first + count],
                    border_mm=border,
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
