"""What was found in each image, and why it was or was not used: for the page of `calibrate --doctor`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roemetry.records import CalibrationSet, ImageFinding, Observation
from roemetry.records.arrays import Floats
from roemetry_pinhole.boards import BoardView, Seen
from roemetry_pinhole.geometry import ON_BELT
from roemetry_pinhole.joint import Joint

_NOBODY = np.empty((0, 2))


def findings_of(observed: CalibrationSet, seen: Seen, joined: Joint | None) -> tuple[ImageFinding, ...]:
    """Say of each image what was found and used; `joined` is None where there is no adjustment."""
    marks = {view.name: view for view in seen.views}
    used = {} if joined is None else _used(joined)
    of_pose = {
        (one.board, one.pose): f"{one.frame.name}: {seen.left_out[one.frame.name]}"
        for one in observed.observations
        if one.frame.name in seen.left_out
    }
    return tuple(
        _finding(
            one,
            marks.get(one.frame.name),
            used.get(one.frame.name),
            seen.left_out.get(one.frame.name, ""),
            of_pose.get((one.board, one.pose), "nothing of it is used"),
            joined,
        )
        for one in observed.observations
    )


def _finding(
    one: Observation,
    view: BoardView | None,
    used: tuple[Floats, int, str] | None,
    why: str,
    why_pose: str,
    joined: Joint | None,
) -> ImageFinding:
    said = [f"{len(one.peaks)} peaks found"] if len(one.peaks) else []
    if view is not None:
        said.append(f"{len(view.marks.xy_px)} corners of the board {view.board.name}")
    points = _NOBODY
    if used is not None:
        points, left, off = used
        said += (
            [f"{len(points)} stripe points used, {left} left out as far off"] if len(points) + left else []
        )
        said += [off] if off else []
    if why and used is not None:
        why = f"Its stripes are not used: {why}"
    if joined is not None and not why and used is None and one.shows in ("board", "board_on_belt", "belt"):
        why = why_pose if not said or view is None else ""
    return ImageFinding(
        observation=one,
        used=not why or used is not None,
        said="; ".join(said),
        why=why,
        corners_px=_NOBODY if view is None else view.marks.xy_px,
        points_px=points,
    )


def _used(joined: Joint) -> dict[str, tuple[Floats, int, str]]:
    """Give by image the stripe points that count, how many do not, and how far its marks are off."""
    points, kept = joined.measured.points, joined.adjusted.stripe_used
    at = np.column_stack([points.x_px, points.row_px])
    corners, found = joined.measured.corners, {}
    for pose, images, count in _images(joined):
        mine = (points.pose == pose) & (np.abs(points.counts - count) < 0.5)
        off = joined.adjusted.corner_px[(corners.pose == pose) & (np.abs(corners.counts - count) < 0.5)]
        words = f"corners off by {np.sqrt((off**2).sum(axis=1).mean()):.2f} px (rms)" if len(off) else ""
        marks, laser = images
        found[marks] = _NOBODY, 0, words
        if laser:
            found[laser] = at[mine & kept], int((mine & ~kept).sum()), "" if marks != laser else words
    return found


def _images(joined: Joint) -> Iterator[tuple[int, tuple[str, str], float]]:
    """Give each view's pose, the names of the images of its marks and of its stripes, and its counts."""
    first: dict[int, float] = {}
    for pose, view in zip(joined.pose.tolist(), joined.first.views, strict=True):
        start = first.setdefault(pose, view.count)
        count = view.count - start if np.isfinite(view.count) and np.isfinite(start) else 0.0
        yield pose, (view.name, "" if view.laser is None else view.laser.frame.name), count
    for name in joined.belts:
        yield ON_BELT, (name, name), 0.0
