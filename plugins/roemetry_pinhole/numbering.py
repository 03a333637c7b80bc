"""Which stripe is which in each pose: solved over all poses together.

The lines of one pose stand in the order of their planes, but a board's edge may cut some off. A numbering is
right when the lines of one number, seen on several boards, lie in one plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.arrays import Floats
from roemetry.errors import CalibrationError

_NEIGHBOUR_SHARE = 0.35
_AMBIGUOUS = 1.5
_ROUNDS = 4
_SECONDS = 4
_CONDITION_MAX = 1e12
_STRANGE_FACTOR = 8.0
_STRANGE_LEAST = 1e-3
"""Of the distance from the camera."""
_STRANGE_POSES_MIN = 4
"""Of fewer poses nobody could say which is wrong."""


@dataclass(frozen=True, eq=False, slots=True)
class PoseLines:
    """Lines on the board of one pose, left to right: (line, 2, 3) their ends in the camera's frame, mm."""

    name: str
    ends_mm: Floats

    @property
    def count(self) -> int:
        """Number of lines."""
        return int(self.ends_mm.shape[0])


@dataclass(frozen=True, eq=False, slots=True)
class Numbered:
    """The solution.

    Attributes
    ----------
    stripe
        For each pose the (line,) stripe of each line, −1 for none.
    planes
        (stripe, 3) p·X = 1 of each plane, a first estimate, 1/mm.
    left_out
        Poses that fit no numbering, with the reason.
    """

    stripe: list[np.ndarray]
    planes: Floats
    left_out: dict[str, str]


def number_stripes(poses: list[PoseLines], stripes: int) -> Numbered:
    """Number the lines of all poses.

    Raises
    ------
    CalibrationError
        No numbering fits, or a stripe lies on fewer than two boards.
    """
    shown = [pose for pose in poses if 0 < pose.count <= stripes]
    offsets = _offsets(shown, stripes)
    numbers = {
        id(pose): np.arange(pose.count) + offset
        for pose, offset in zip(shown, offsets, strict=True)
        if offset is not None
    }
    by_order = dict(numbers)
    for _ in range(_ROUNDS):
        planes = _planes([(pose, numbers[id(pose)]) for pose in shown if id(pose) in numbers], stripes)
        numbers = {id(pose): _nearest(pose, planes) for pose in shown}
    strange = _strange(shown, [numbers[id(pose)] for pose in shown], stripes)
    for pose in strange:
        numbers[id(pose)] = np.full(pose.count, -1)
    if strange:
        planes = _planes([(pose, numbers[id(pose)]) for pose in shown], stripes)
    left_out = {
        pose.name: "its stripes lie on none of the planes that the other poses show: is it mirrored, or did "
        "the board or the laser move before it was taken? Take the pose again"
        for pose in shown
        if not (numbers[id(pose)] >= 0).any()
    }
    found = [numbers.get(id(pose), np.empty(0, np.int64)) for pose in poses]
    _check(poses, found, [by_order.get(id(pose), np.empty(0)) for pose in poses], stripes)
    return Numbered(found, planes, left_out)


def _strange(shown: list[PoseLines], numbers: list[np.ndarray], stripes: int) -> list[PoseLines]:
    """Give the poses whose lines lie far off the planes that the others show: mirrored, or moved.

    A board that is its own mirror image is told by nothing else.
    """
    kept = list(zip(shown, numbers, strict=True))
    found: list[PoseLines] = []
    while len(kept) > _STRANGE_POSES_MIN:
        off = np.full(len(kept), np.nan)
        for one, (pose, mine) in enumerate(kept):
            on = np.flatnonzero(mine >= 0)
            planes = _planes([other for at, other in enumerate(kept) if at != one], stripes)
            own = _distances(pose, planes)[on, mine[on]]
            if np.isfinite(own).any():
                off[one] = float(np.nanmedian(own)) / float(pose.ends_mm[:, :, 2].mean())
        if not np.isfinite(off).any():
            break
        worst = int(np.nanargmax(off))
        if off[worst] <= max(_STRANGE_FACTOR * float(np.nanmedian(off)), _STRANGE_LEAST):
            break
        found.append(kept.pop(worst)[0])
    return found


def _check(poses: list[PoseLines], found: list[np.ndarray], by_order: list[np.ndarray], stripes: int) -> None:
    for stripe in range(stripes):
        on = [pose.name for pose, numbers in zip(poses, found, strict=True) if (numbers == stripe).any()]
        if len(on) < 2:
            # of a line on one board alone there is no plane; its order says which it is
            seen = [
                pose.name for pose, numbers in zip(poses, by_order, strict=True) if (numbers == stripe).any()
            ]
            where = f"on one board alone ({(on or seen)[0]})" if on or len(seen) == 1 else "on no board"
            raise CalibrationError(
                f"stripe {stripe + 1} lies {where}: that determines no plane",
                hint="add poses in which the board lies under it; is `stripes` right?",
            )


def _offsets(shown: list[PoseLines], stripes: int) -> list[int | None]:
    """Give the number of each pose's first line; None where it cannot be told yet."""
    full = [pose.count == stripes for pose in shown]
    if sum(full) >= 2:
        return _extended([0 if one else None for one in full], shown, stripes)
    anchor = int(np.argmax([pose.count for pose in shown]))
    best: tuple[float, list[int | None]] | None = None
    most = np.argsort([-pose.count for pose in shown], kind="stable")[: _SECONDS + 1].tolist()
    for second in most:
        if second == anchor:
            continue
        for shift in range(1 - shown[second].count, shown[anchor].count):
            start: list[int | None] = [None] * len(shown)
            start[anchor], start[second] = 0, shift
            tried = _extended(start, shown, stripes)
            known = [(o, pose) for o, pose in zip(tried, shown, strict=True) if o is not None]
            first = min(o for o, _ in known)
            if max(o + pose.count for o, pose in known) - first != stripes:
                continue
            moved = [None if o is None else o - first for o in tried]
            cost = _cost(moved, shown, stripes)
            if best is None or cost < best[0]:
                best = cost, moved
    if best is None:
        raise CalibrationError(
            f"no numbering of the stripes fits all poses: at most {shown[anchor].count} of {stripes} stripes "
            "lie on one board",
            hint="take two poses in which the board lies under all stripes; is `stripes` right?",
        )
    return best[1]


def _extended(start: list[int | None], shown: list[PoseLines], stripes: int) -> list[int | None]:
    """Add poses, each at the place where its lines are nearest to the planes known so far."""
    offsets = list(start)
    low = min(o for o in offsets if o is not None)
    while True:
        known = [(pose, o) for pose, o in zip(shown, offsets, strict=True) if o is not None]
        planes = _planes(
            [(pose, np.arange(pose.count) + o - low + stripes) for pose, o in known], 3 * stripes
        )
        best: tuple[float, int, int] | None = None
        for number, pose in enumerate(shown):
            if offsets[number] is not None:
                continue
            line = np.arange(pose.count)
            shift = np.arange(3 * stripes - pose.count + 1)
            square = _distances(pose, planes)[line, shift[:, None] + line] ** 2
            known_lines = np.isfinite(square).sum(axis=1)
            enough = known_lines >= max(1, min(pose.count, stripes) // 2)
            costs = np.where(enough, np.sqrt(np.nansum(square, axis=1) / np.maximum(known_lines, 1)), np.inf)
            order = np.argsort(costs)
            if not np.isfinite(costs[order[0]]):
                continue
            if len(order) > 1 and costs[order[1]] < _AMBIGUOUS * costs[order[0]]:
                continue
            if best is None or costs[order[0]] < best[0]:
                best = float(costs[order[0]]), number, int(order[0]) - stripes + low
        if best is None:
            return offsets
        offsets[best[1]] = best[2]


def _cost(offsets: list[int | None], shown: list[PoseLines], stripes: int) -> float:
    known = [
        (pose, np.arange(pose.count) + o) for pose, o in zip(shown, offsets, strict=True) if o is not None
    ]
    planes = _planes(known, stripes)
    off = np.concatenate([_distances(pose, planes)[np.arange(pose.count), at] for pose, at in known])
    missing = len(shown) - len(known)
    return float(np.sqrt(np.nanmean(off**2))) * (1.0 + missing) if np.isfinite(off).any() else np.inf


def _planes(known: list[tuple[PoseLines, np.ndarray]], stripes: int) -> Floats:
    """Fit p·X = 1 to the ends of all lines of each number; NaN for numbers seen on fewer than two boards."""
    square, right = np.zeros((stripes, 3, 3)), np.zeros((stripes, 3))
    boards = np.zeros(stripes, np.int64)
    for pose, numbers in known:
        use = numbers >= 0
        ends, at = pose.ends_mm[use], numbers[use]
        np.add.at(square, at, np.einsum("lei,lej->lij", ends, ends))
        np.add.at(right, at, ends.sum(axis=1))
        boards[np.unique(at)] += 1
    planes = np.full((stripes, 3), np.nan)
    good = (boards >= 2) & (np.linalg.cond(square) < _CONDITION_MAX)
    planes[good] = np.linalg.solve(square[good], right[good][:, :, None])[:, :, 0]
    return planes


def _distances(pose: PoseLines, planes: Floats) -> Floats:
    """Give (line, plane) the larger distance of each line's ends from each plane, mm."""
    size = np.sqrt((planes**2).sum(axis=1))
    off: Floats = np.abs(np.einsum("lek,sk->lse", pose.ends_mm, planes) - 1.0).max(axis=2) / size
    return off


def _nearest(pose: PoseLines, planes: Floats) -> np.ndarray:
    """Give each line the plane nearest to it, if it is far nearer than to the neighbours."""
    off = _distances(pose, planes)
    off = np.where(np.isnan(off), np.inf, off)
    numbers = off.argmin(axis=1)
    best = off.min(axis=1)
    apart = np.sort(off, axis=1)[:, 1] if planes.shape[0] > 1 else np.full(len(off), np.inf)
    numbers = np.where(best <= _NEIGHBOUR_SHARE * apart, numbers, -1)
    for number in np.unique(numbers[numbers >= 0]):
        same = np.flatnonzero(numbers == number)
        numbers[same[best[same] > best[same].min()]] = -1
    return np.asarray(numbers)
