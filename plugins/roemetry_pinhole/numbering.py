"""Which line on a board is which stripe: planes of light found jointly in all poses.

Model. A stripe is a plane of light p·X = 1 in the camera's frame. Each pose shows lines on its board, whose
ends are known in space because the board's pose is. Lines of different poses belong to one stripe when they
lie in one plane. A pose may miss stripes (cut off by the board's edge, too faint, saturated), show pieces of
one twice, and show lines that are no stripe (reflections, edges of the print). So neither the count of a
pose's lines nor their position in the row decides; the planes in space do:

1. Every line of one pose with every line of another spans a plane (least squares over four ends), and the
   other poses vote for it by how near a line of theirs lies. Lines of two boards are nearly coplanar even if
   they belong to neighbouring stripes; it is the third board that decides.
2. The order of stripes is the same on every board. Of two poses the pairing with the largest sum of votes
   that keeps the order is found by dynamic programming (Needleman and Wunsch 1970; skipping a line costs
   nothing). The best pairing over several pairs of poses is the start.
3. Each line takes the nearest plane within a tolerance, planes are fitted again, and the tolerance shrinks to
   the noise that is seen. Planes that most boards do not show, though they show stripes on both sides, are
   dropped, or those that the empty belt does not show. Lines that are left form new planes by the same vote,
   until none is left.
4. Planes that cross or coincide with better supported ones are dropped, the rest is numbered in its order. An
   image of the empty belt counts as one more pose where the belt's place is known.

A line that belongs to no plane is false and is left out. A pose most of whose lines belong to no plane is
left out with its name: mirrored or moved. It fails where all boards are parallel and near each other (any
pairing in order then lies in planes) and where stripes cross within the boards' volume.
The voting is RANSAC's (Fischler and Bolles 1981), with every pair of lines tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records.arrays import Flags, Floats, Integers

_TOLERANCE_SHARE = 0.2
"""Of the spacing of neighbouring lines: distance at which a line no longer votes. A wrong plane collects
votes by chance in 2 × 0.2 of the poses; anything from 0.1 to 0.3 gives the same numbers."""
_TOLERANCE_LEAST_SHARE = 0.04
"""Of the spacing: the tolerance shrinks no further, for poses before the adjustment err by so much."""
_NOISE_FACTOR = 4.0
"""The tolerance shrinks to so many median distances: a normal error exceeds it once in 150."""
_BASES = 4
"""Poses (those with most lines) that are paired with all others to begin with; one good one is enough. Of
what is left all poses are paired, for a stripe at the rim may lie on two or three boards alone."""
_OWN_VOTE = 0.1
"""What the two lines that a plane goes through count for it, where a line of a third board counts 1: any two
lines nearly lie in a plane. Above 0, for a stripe may lie on two boards alone."""
_ROUNDS = 5  # rounds of taking lines and fitting planes; the third changes nothing any more
_CONDITION_MAX = 1e12  # of the normal matrix of a plane: beyond, its lines are one line
_APART_SHARE = 0.4  # of the spacing: two planes nearer than this over the boards are one stripe, found twice
_SHOWN_SHARE_MIN = 0.5
"""A plane must have a line in this share of the poses that show stripes on both sides of it. Two lines on two
boards always nearly lie in one plane, so false lines make planes by chance, in 2 of 10 poses, rarely 3."""
_SHOWN_MIN = 4  # or in so many poses: a faint stripe may be found on a few boards alone
_WEAK_SHARE = 0.5
"""Of the weakest accepted plane's peaks: surplus planes with fewer than this are reflections."""
_POSE_SHARE_MIN = 0.5  # of a pose's peaks: if fewer lie on planes, its lines fit the others' by chance only
_OUTLYING_FACTOR = 8.0
"""Times the usual distance of a pose's lines from the planes of all others: moved or mirrored."""
_OUTLYING_LEAST = 1e-3  # of the distance from the camera: what is nearer than this is never called moved
_CONTRADICTING_SHARE = 0.4
"""Of the poses: where more lie off the planes of the others, nobody can say which are right."""
_CONTRADICTING_MIN = 2
"""One pose that moved among three or four is named by the others; two are as good as they."""
_OUTLYING_POSES_MIN = 4  # of fewer poses nobody could say which is wrong


@dataclass(frozen=True, eq=False, slots=True)
class PoseLines:
    """Lines on the board of one pose, left to right."""

    name: str
    """Name of the image."""
    ends_mm: Floats
    """(line, 2, 3) the ends of each in the camera's frame, mm."""
    peaks: Integers | None = None
    """(line,) how many peaks each was found from; None: equally many."""

    @property
    def count(self) -> int:
        """Number of lines."""
        return int(self.ends_mm.shape[0])

    @property
    def weight(self) -> Floats:
        """(line,) how much each counts."""
        return np.ones(self.count) if self.peaks is None else self.peaks.astype(np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class Numbered:
    """The solution."""

    stripe: list[Integers]
    """For each pose the (line,) stripe of each line, −1 for none."""
    planes: Floats
    """(stripe, 3) p·X = 1 of each plane, a first estimate, 1/mm."""
    left_out: dict[str, str]
    moved: tuple[str, ...] = ()
    """left_out, moved: poses that fit no numbering, with the reason; those of them whose board or laser
    moved: nothing in their images is to be trusted."""


def number_stripes(poses: Sequence[PoseLines], stripes: int, belt: PoseLines | None = None) -> Numbered:
    """Number the lines of all poses.

    Lines on the empty `belt`, where its place is known, are one more pose, in which nothing hides a stripe.

    Raises
    ------
    CalibrationError
        A stripe lies on fewer than two boards, or more planes are seen than there are stripes.
    """
    kept = [pose for pose in poses if pose.count]
    left_out: dict[str, str] = {}
    shows_all = belt is not None and belt.count == stripes
    # one pose at a time: without it the planes of the others may change
    while True:
        every = [*kept, *([belt] if belt is not None and belt.count else [])]
        planes, numbers = planes_of(every, belt_shows_all=shows_all)
        moved = _pose_off(kept, planes, numbers)
        if moved is None:
            break
        usual = float(np.median([pose.weight.sum() for pose in kept]))
        few = min(_FEW, stripes - 1)  # a pose that shows all of one or two stripes hides nothing
        # too little is seen to blame the pose
        hidden = moved.count <= few or moved.weight.sum() < _FEW_SHARE * usual
        left_out[moved.name] = _HIDDEN if hidden else _MOVED
        kept = [pose for pose in kept if pose is not moved]
    contradicting = [name for name, why in left_out.items() if why is _MOVED]
    if len(contradicting) >= max(_CONTRADICTING_SHARE * len(poses), _CONTRADICTING_MIN):
        raise CalibrationError(
            f"the poses contradict each other: the stripes of {len(contradicting)} of {len(poses)} "
            f"({', '.join(contradicting)}) lie on none of the planes that the others show",
            hint="is each laser image paired with the board it was taken of? did the board move between the "
            "two, or the laser or the camera between the poses?",
        )
    number_of = _numbers_of(kept, numbers, planes, stripes, belt_shows_all=shows_all)
    found = {
        pose.name: np.where(mine >= 0, number_of[mine], -1) if len(number_of) else mine
        for pose, mine in zip(kept, numbers, strict=False)
    }
    ordered = np.full((stripes, 3), np.nan)
    ordered[number_of[number_of >= 0]] = planes[number_of >= 0]
    by_pose = [found.get(pose.name, np.full(pose.count, -1)) for pose in poses]
    return Numbered([mine.astype(np.int64) for mine in by_pose], ordered, left_out, tuple(contradicting))


_MOVED = (
    "its stripes lie on none of the planes that the other poses show: is it mirrored, or another "
    "camera's, or did the board or the laser move before it was taken? Take the pose again"
)
_HIDDEN = (
    "hardly a line is seen on even print, and it lies on no plane of the other poses: are the stripes faint, "
    "or as wide as the board's squares? Tilt the board less"
)
_FEW = 2  # lines of a pose from which nothing can be told of the pose itself
_FEW_SHARE = 0.1  # of the usual pose's peaks: fewer are scraps too short to say where their lines run


def planes_of(poses: list[PoseLines], *, belt_shows_all: bool) -> tuple[Floats, list[Integers]]:
    """Find planes (plane, 3), in order, and for each pose the (line,) plane of each line, −1 for none.

    With `belt_shows_all` the last pose shows every stripe once, and nothing else.
    """
    spacing = spacing_mm(poses)
    tolerance = _TOLERANCE_SHARE * spacing
    free = [np.ones(pose.count, np.bool_) for pose in poses]
    planes = more = _best_pairing(poses, free, tolerance, _BASES)
    numbers: list[Integers] = [np.full(pose.count, -1) for pose in poses]
    left = free
    while len(more):
        reach = tolerance
        before = sum(int((mine >= 0).sum()) for mine in numbers)
        for _ in range(_ROUNDS):
            numbers = [_nearest(pose, planes, tolerance) for pose in poses]
            planes = _fitted(poses, numbers, len(planes))
            planes = planes[np.isfinite(planes).all(axis=1)]
            planes = _in_order(poses, planes, spacing)
            # only ever narrower
            tolerance = min(tolerance, _tolerance(poses, planes, spacing))
        numbers = [_nearest(pose, planes, tolerance) for pose in poses]
        plane = np.arange(len(planes))
        if belt_shows_all:
            shown = np.isin(plane, numbers[-1])
        else:
            # due where stripes on both sides are seen: nothing but the board's edge ends the row of them
            first = np.array([mine[mine >= 0].min(initial=len(planes)) for mine in numbers])
            last = np.array([mine.max(initial=-1) for mine in numbers])
            due = ((first[:, None] <= plane) & (last[:, None] >= plane)).sum(axis=0)
            seen = np.array([np.isin(plane, mine) for mine in numbers]).sum(axis=0)
            shown = (seen >= _SHOWN_SHARE_MIN * due) | (seen >= _SHOWN_MIN)
        planes = planes[shown]
        numbers = [_nearest(pose, planes, tolerance) for pose in poses]
        if sum(int((mine >= 0).sum()) for mine in numbers) <= before:
            # what these lines have in common is no stripe: each is tried once
            tried = [(distances(pose, more) <= reach).any(axis=1) for pose in poses]
            free = [one & ~(mine & tries) for one, mine, tries in zip(free, left, tried, strict=True)]
        left = [(mine < 0) & one for mine, one in zip(numbers, free, strict=True)]
        more = _best_pairing(poses, left, tolerance, len(poses))
        planes = np.concatenate([planes, more])
    return planes, numbers


def _pose_off(poses: list[PoseLines], planes: Floats, numbers: list[Integers]) -> PoseLines | None:
    """Give the pose whose lines lie farthest off the planes that the others show: mirrored, or moved.

    A board that is its own mirror image is told by nothing else.
    """
    if len(poses) < _OUTLYING_POSES_MIN or not len(planes):
        return None
    share = [
        float(pose.weight[mine >= 0].sum() / max(pose.weight.sum(), 1.0))
        for pose, mine in zip(poses, numbers, strict=False)
    ]
    # hardly any of its peaks lie on planes
    if min(share) < _POSE_SHARE_MIN:
        return poses[int(np.argmin(share))]
    off = np.full(len(poses), np.nan)
    for one, pose in enumerate(poses):
        others = [at for at in range(len(poses)) if at != one]
        # planes without this pose, or its own lines would pull them
        without = _fitted([poses[at] for at in others], [numbers[at] for at in others], len(planes))
        on = np.flatnonzero(numbers[one] >= 0)
        own = distances(pose, without)[on, numbers[one][on]]
        if np.isfinite(own).any():
            off[one] = float(np.nanmedian(own)) / float(pose.ends_mm[:, :, 2].mean())
    if not np.isfinite(off).any():
        return None
    worst = int(np.nanargmax(off))
    limit = max(_OUTLYING_FACTOR * float(np.nanmedian(off)), _OUTLYING_LEAST)
    return poses[worst] if off[worst] > limit else None


def _best_pairing(poses: list[PoseLines], free: list[Flags], tolerance: float, bases_max: int) -> Floats:
    """Give the planes (plane, 3) of the pairing in order with the largest sum of votes.

    Free lines only, and pairings of `bases_max` poses with all others.
    """
    lines = [pose.ends_mm[use] for pose, use in zip(poses, free, strict=True)]
    light = [float(pose.weight[use].sum()) for pose, use in zip(poses, free, strict=True)]
    # with most light first
    bases = [
        int(one) for one in np.argsort(-np.array(light), kind="stable")[:bases_max] if light[int(one)] > 0
    ]
    best, found = 0.0, np.empty((0, 3))
    for at, base in enumerate(bases):
        for other in range(len(lines)):
            if other == base or other in bases[:at] or not len(lines[other]):
                continue
            planes, votes = _votes(lines, base, other, tolerance)
            total, pairs = _ordered_pairs(votes)
            if total > best:
                best, found = total, planes[pairs[:, 0], pairs[:, 1]]
    return found


def _votes(lines: list[Floats], base: int, other: int, tolerance: float) -> tuple[Floats, Floats]:
    """Give the planes (i, j, 3) through each line of one pose and each of another, and their votes (i, j)."""
    one, two = lines[base], lines[other]
    # normal equations of both lines' ends add up
    square = np.einsum("lei,lej->lij", one, one)[:, None] + np.einsum("lei,lej->lij", two, two)[None]
    planes = _solved(square, one.sum(axis=1)[:, None] + two.sum(axis=1)[None])
    off = np.maximum(_off_mm(one, planes, "iek,ijk->ije"), _off_mm(two, planes, "jek,ijk->ije"))
    votes = _OWN_VOTE * _vote(off, tolerance)
    # only planes that their own two lines fit are voted on: that saves time
    likely = votes > 0.0
    for pose in range(len(lines)):
        if pose not in (base, other) and len(lines[pose]):
            nearest = _off_mm(lines[pose], planes[likely], "lek,hk->hle").min(axis=1)
            votes[likely] += _vote(nearest, tolerance)
    return planes, votes


def _solved(square: Floats, right: Floats) -> Floats:
    """Give the planes (…, 3) of normal matrices (…, 3, 3); NaN where these are of one line."""
    planes = np.full(right.shape, np.nan)
    good = np.linalg.cond(square) < _CONDITION_MAX
    planes[good] = np.linalg.solve(square[good], right[good][:, :, None])[:, :, 0]
    return planes


def _off_mm(ends: Floats, planes: Floats, axes: str) -> Floats:
    """Give the larger distance of two ends from planes, mm; `axes` names lines, ends (e) and planes."""
    size = np.sqrt((planes**2).sum(axis=-1))
    off: Floats = np.abs(np.einsum(axes, ends, planes) - 1.0).max(axis=-1)
    return np.asarray(off / (size[:, None] if axes.endswith("hle") else size))


def _vote(off_mm: Floats, tolerance: float) -> Floats:
    """1 on the plane, 0 from the tolerance on, and for NaN."""
    return np.asarray(np.fmax(0.0, 1.0 - (off_mm / tolerance) ** 2))


def _ordered_pairs(votes: Floats) -> tuple[float, Integers]:
    """Give the largest sum of votes (i, j) along a path on which both grow, and the (pair, 2) on it."""
    total = np.zeros(np.add(votes.shape, 1))
    for i, row in enumerate(votes):
        # skip a line of either pose, or pair both
        total[i + 1, 1:] = np.maximum.accumulate(np.maximum(total[i, 1:], total[i, :-1] + row))
    pairs = []
    i, j = votes.shape
    while i and j:
        if total[i, j] == total[i - 1, j]:
            i -= 1
        elif total[i, j] == total[i, j - 1]:
            j -= 1
        else:
            i, j = i - 1, j - 1
            pairs.append((i, j))
    return float(total[-1, -1]), np.array(pairs[::-1], np.int64).reshape(-1, 2)


def _nearest(pose: PoseLines, planes: Floats, tolerance: float) -> Integers:
    """Give each line the nearest plane within the tolerance; of several lines the nearest one gets it."""
    if not len(planes):
        return np.full(pose.count, -1)
    off = distances(pose, planes)
    off = np.where(np.isfinite(off), off, np.inf)
    numbers, best = off.argmin(axis=1), off.min(axis=1)
    numbers = np.where(best <= tolerance, numbers, -1)
    # a stripe is seen once in a pose: of several lines the nearest
    for number in np.unique(numbers[numbers >= 0]):
        same = np.flatnonzero(numbers == number)
        numbers[same[best[same] > best[same].min()]] = -1
    return np.asarray(numbers, np.int64)


def _fitted(poses: Sequence[PoseLines], numbers: Sequence[Integers], count: int) -> Floats:
    """Fit p·X = 1 to the ends of all lines of each plane; NaN for planes seen in fewer than two poses."""
    square, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    seen = np.zeros(count, np.int64)
    for pose, mine in zip(poses, numbers, strict=True):
        use = mine >= 0
        ends, at = pose.ends_mm[use], mine[use]
        np.add.at(square, at, np.einsum("lei,lej->lij", ends, ends))
        np.add.at(right, at, ends.sum(axis=1))
        seen[np.unique(at)] += 1
    return np.where((seen >= 2)[:, None], _solved(square, right), np.nan)


def _in_order(poses: list[PoseLines], planes: Floats, spacing: float) -> Floats:
    """Sort planes from left to right; of two that cross or coincide over the boards the weaker is dropped."""
    if not len(planes):
        return planes
    tolerance = _TOLERANCE_SHARE * spacing
    support = np.zeros(len(planes))
    for pose in poses:
        mine = _nearest(pose, planes, tolerance)
        off = distances(pose, planes)
        on = np.flatnonzero(mine >= 0)
        support[mine[on]] += _vote(off[on, mine[on]], tolerance)
    ends = np.concatenate([pose.ends_mm for pose in poses]).reshape(-1, 3)
    # where each plane stands at the corners of the volume that the boards filled, along x
    y, z = (np.percentile(ends[:, axis], [2.0, 98.0]) for axis in (1, 2))
    at = np.array([[v, w] for v in y for w in z])
    with np.errstate(divide="ignore"):
        x = (1.0 - planes[:, 1:] @ at.T) / planes[:, :1]
    kept: list[int] = []
    # the best supported first: it decides who is dropped
    for plane in np.argsort(-support, kind="stable").tolist():
        if support[plane] <= 0 or not np.isfinite(x[plane]).all():
            continue
        apart = x[kept] - x[plane]
        # left of another at one corner of the volume, right of it at another: they cross
        crosses = apart.min(axis=1, initial=np.inf) * apart.max(axis=1, initial=-np.inf) < 0.0
        near = np.abs(apart).mean(axis=1) < _APART_SHARE * spacing if kept else crosses
        if not (crosses | near).any():
            kept.append(plane)
    found = planes[sorted(kept, key=lambda plane: float(x[plane].mean()))]
    # lines are listed from left to right in the image; in space that may be either way
    turns = 0
    for pose in poses:
        mine = _nearest(pose, found, tolerance)
        turns += int(np.sign(np.diff(mine[mine >= 0])).sum())
    return found[::-1] if turns < 0 else found


def _tolerance(poses: list[PoseLines], planes: Floats, spacing: float) -> float:
    """Give the tolerance that the distances seen ask for, mm."""
    off = [distances(pose, planes).min(axis=1) for pose in poses if len(planes)]
    near = np.concatenate(off) if off else np.empty(0)
    near = near[near < _TOLERANCE_SHARE * spacing]
    usual = float(np.median(near)) if near.size else spacing
    return float(max(_NOISE_FACTOR * usual, _TOLERANCE_LEAST_SHARE * spacing))


def _numbers_of(
    poses: list[PoseLines], numbers: list[Integers], planes: Floats, stripes: int, *, belt_shows_all: bool
) -> Integers:
    """Give (plane,) the stripe of each plane, −1 for none; CalibrationError where that cannot be told."""
    count = len(planes)
    peaks = np.zeros(count)
    on: list[list[str]] = [[] for _ in range(count)]
    for pose, mine in zip(poses, numbers, strict=False):
        for plane in mine[mine >= 0]:
            on[plane].append(pose.name)
        np.add.at(peaks, mine[mine >= 0], pose.weight[mine >= 0])
    boards = np.array([len(names) for names in on], np.int64)
    for mine in numbers[len(poses) :]:
        # the belt is a board whose place is known: with one more line it determines a plane
        boards[mine[mine >= 0]] += 1
    number = np.arange(count)
    if belt_shows_all:
        # the belt shows every stripe once: its lines are the numbers
        number = np.full(count, -1)
        on_belt = numbers[len(poses)]
        number[on_belt[on_belt >= 0]] = np.flatnonzero(on_belt >= 0)
    elif count > stripes:
        strongest = np.sort(np.argsort(-peaks, kind="stable")[:stripes])
        surplus = np.setdiff1d(number, strongest)
        if peaks[surplus].max() > _WEAK_SHARE * peaks[strongest].min():
            raise CalibrationError(
                f"{count} planes of light are seen on the boards, the rig has {stripes} stripes",
                hint="correct `stripes`, or keep reflections off the boards",
            )
        number = np.full(count, -1)
        number[strongest] = np.arange(stripes)
    usable = (number >= 0) & (boards >= 2)
    if usable.sum() == stripes:
        return np.where(usable, number, -1)
    # which stripe is on too few boards, as far as that is known
    alone = [(int(number[plane]) + 1, names[0]) for plane, names in enumerate(on) if len(names) == 1]
    if not (alone and alone[0][0] > 0):
        alone = []
        for pose, mine in zip(poses, numbers, strict=False):
            for line in np.flatnonzero(mine < 0):
                alone.append((int(mine[:line].max(initial=-1)) + 2, pose.name))
        if len(alone) != 1 or count != stripes - 1:
            alone = []
    missing = sorted(set(range(stripes)) - set(number.tolist()))
    if alone:
        why = f"stripe {alone[0][0]} lies on one board alone ({alone[0][1]}): that determines no plane"
    elif belt_shows_all and missing:
        those = ", ".join(str(one + 1) for one in missing)
        why = f"stripe {those} is seen on the empty belt and on fewer than two boards"
    else:
        most = max((pose.count for pose in poses), default=0)
        why = (
            f"no numbering of {stripes} stripes fits: {count} planes of light are found on two boards or "
            f"more; the board with most lines shows {most}"
        )
    raise CalibrationError(
        why,
        hint="add poses in which the board lies under it; is `stripes` right? is each laser image paired "
        "with the board it was taken of, by one camera?",
    )


def spacing_mm(poses: Sequence[PoseLines]) -> float:
    """Give the median distance of neighbouring lines across their direction, mm."""
    gaps = []
    for pose in poses:
        if pose.count < 2:
            continue
        middle, along = pose.ends_mm.mean(axis=1), pose.ends_mm[:, 1] - pose.ends_mm[:, 0]
        along = along.mean(axis=0) / np.sqrt((along.mean(axis=0) ** 2).sum())
        apart = np.diff(middle, axis=0)
        # across the lines' direction only
        apart -= (apart @ along)[:, None] * along
        gaps.append(np.sqrt((apart**2).sum(axis=1)))
    depth = float(np.mean([pose.ends_mm[:, :, 2].mean() for pose in poses]))
    return float(np.median(np.concatenate(gaps))) if gaps else 0.05 * depth


def distances(pose: PoseLines, planes: Floats) -> Floats:
    """Give (line, plane) the larger distance of each line's ends from each plane, mm."""
    size = np.sqrt((planes**2).sum(axis=1))
    off: Floats = np.abs(np.einsum("lek,sk->lse", pose.ends_mm, planes) - 1.0).max(axis=2) / size
    return off
