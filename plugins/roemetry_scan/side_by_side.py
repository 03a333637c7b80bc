"""One wide scan of several heads that look down side by side, registered by a plate of balls.

Model. Each head's slices lie in a frame of its own, on the belt that it sees. Neighbours see the same balls
of a plate in the strip that both see; the rigid motion that lays the centres of the right head's on those
of the left one's (Kabsch 1976), and how far the belt has run between both heads' first lines, carry its
points into the left head's frame. Heights of all heads on one grid are the wide scan: where two see a place,
their mean. Which ball is which is not known, and the balls of a plate are alike. So every shift that lays
three balls on three is tried, and goes if it lays a ball where the other head sees none; where more than one
is left, it has to be said how far the heads lie apart.

Uncertainty: by how much two heads' heights differ where both see the same is common to all that one of them
sees: `heads`, that difference and the registration's uncertainty over the product's footprint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roemetry.errors import CalibrationError, StageError
from roemetry.records import Estimate, Profiles, ScanFigures
from roemetry.records.arrays import Floats, Integers
from roemetry_scan.closed import OFF_MAX_MM, Registration, begun_later, laid_on
from roemetry_scan.dense import budget_of, estimate_of, sections_of
from roemetry_scan.flanks import usual_step
from roemetry_scan.formats.points import Measured, profiles_of

_BALLS_MIN = 3  # that two heads share: fewer leave a turn open
_LEVER_MIN_MM = 3.0
"""Balls that lie nearer to one straight line tell no turn about it."""
_TURNED_MAX_DEG = 10.0
"""Heads that are mounted alike are turned by less against each other."""
_SHARED_MIN = 100
"""Places of the grid that two heads have to see both."""


class Joined(NamedTuple):
    """A wide scan and how well its heads agree."""

    profiles: Profiles
    level_mm: tuple[float, ...]
    """For each pair of neighbours: by how much the right one's heights are above the left one's."""
    std_mm: float
    """Standard uncertainty of one head's heights against another's."""


def register_side_by_side(
    left: Floats, right: Floats, seen_mm: tuple[Floats, Floats], apart_mm: float | None = None
) -> Registration:
    """Find the rigid motion that lays the right head's balls (n, 3) on those of the left one.

    In `Registration`, the left head stands for the upper one.

    Parameters
    ----------
    left, right
        Centres in each head's own frame, mm; heads are mounted alike, to a few degrees.
    seen_mm
        For each head the least and the largest (X, Y) at which it would have found a ball, mm.
    apart_mm
        Y of the right head's zero in the left one's frame, to half the distance of two balls; None: not
        known.

    Raises
    ------
    CalibrationError
        Fewer than three balls are shared, they lie in a line, their distances differ, or more than one shift
        fits.
    """
    fewest = min(len(left), len(right))
    if fewest < _BALLS_MIN:
        raise CalibrationError(
            f"the heads see {len(left)} and {len(right)} balls: three that both see are the least",
            hint="carry one plate through the strip that both heads see",
        )
    # the smallest distance of two balls of each head: within a third of it a ball is no other's
    gaps = [
        np.sort(np.sqrt(((one[:, None] - one[None]) ** 2).sum(axis=2)), axis=1)[:, 1].min()
        for one in (left, right)
    ]
    near_mm = min(gaps) / 3.0
    found: list[Registration] = []
    in_line = False
    for i in range(len(left)):
        for j in range(len(right)):
            pose = np.eye(4)
            # heads are mounted alike, so a shift alone is tried first; the fit then finds the turn
            pose[:3, 3] = left[i] - right[j]
            fit = _refined(left, right, pose, near_mm)
            # a shift that puts a ball where the other head looked and saw none is wrong
            if fit is None or not _contradicts_none(left, right, fit, seen_mm, near_mm):
                continue
            match = _pairs(left, _carried(right, fit.T_top_bottom), near_mm)
            spread = left[match[0]] - left[match[0]].mean(axis=0)
            # second singular value: how far the shared balls lie off a straight line
            if np.linalg.svd(spread, compute_uv=False)[1] / math.sqrt(len(spread)) < _LEVER_MIN_MM:
                in_line = True
                continue
            # the same shift is reached by every pair of balls that it lays on each other
            shifts = [abs(one.T_top_bottom[:2, 3] - fit.T_top_bottom[:2, 3]).max() for one in found]
            if not shifts or min(shifts) > near_mm:
                found.append(fit)
    # by what is told of the mounting only one may be left
    if apart_mm is not None:
        found = [fit for fit in found if abs(fit.T_top_bottom[1, 3] - apart_mm) <= 1.5 * near_mm]
    if not found:
        said = (
            "the balls that both see lie in one line"
            if in_line
            else "no shift lays the balls of one on the other's"
        )
        raise CalibrationError(
            f"the heads do not share the plate: {said}",
            hint="is it one plate, and do both heads see three of its balls that are no line?",
        )
    if len(found) > 1:
        places = " or ".join(f"{fit.T_top_bottom[1, 3]:.1f}" for fit in found)
        raise CalibrationError(
            f"the balls of the two heads fit in {len(found)} ways: the right head lies {places} mm along Y",
            hint="say which with --apart, or let both heads see the whole plate",
        )
    return found[0]


def _pairs(left: Floats, carried: Floats, near_mm: float) -> tuple[Integers, Integers]:
    """Give the indices of balls that are each other's nearest."""
    away = np.sqrt(((carried[:, None] - left[None]) ** 2).sum(axis=2))
    match = away.argmin(axis=1)
    # mutual, so that no ball is laid on two
    mutual = (away.argmin(axis=0)[match] == np.arange(len(carried))) & (away.min(axis=1) < near_mm)
    return np.asarray(match[mutual], np.int64), np.asarray(np.flatnonzero(mutual), np.int64)


def _carried(points: Floats, pose: Floats) -> Floats:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _refined(left: Floats, right: Floats, pose: Floats, near_mm: float) -> Registration | None:
    best: Registration | None = None
    # pairs and motion in turn (iterative closest points); few rounds do for so few balls
    for _ in range(10):
        of_left, of_right = _pairs(left, _carried(right, pose), near_mm)
        if len(of_left) < _BALLS_MIN:
            return None
        pose, rms = laid_on(right[of_right], left[of_left])
        best = Registration(pose, rms, len(of_left))
    # angle of a rotation by its trace
    turned = math.degrees(math.acos(min(1.0, 0.5 * (float(np.trace(pose[:3, :3])) - 1.0))))
    sound = best is not None and best.rms_mm <= OFF_MAX_MM and turned <= _TURNED_MAX_DEG
    return best if sound else None


def _contradicts_none(
    left: Floats, right: Floats, fit: Registration, seen_mm: tuple[Floats, Floats], near_mm: float
) -> bool:
    """Say whether each ball that one head alone has found lies where the other does not look."""
    carried = _carried(right, fit.T_top_bottom)
    of_left, of_right = _pairs(left, carried, near_mm)
    # each head's lonely balls, in the frame of the other head
    back: Floats = np.asarray(np.linalg.inv(fit.T_top_bottom), np.float64)
    for alone, (low, high) in (
        (np.delete(carried, of_right, axis=0), seen_mm[0]),
        (_carried(np.delete(left, of_left, axis=0), back), seen_mm[1]),
    ):
        if ((alone[:, :2] > low) & (alone[:, :2] < high)).all(axis=1).any():
            return False
    return True


def whole_ball_extent(profiles: Profiles, radius_mm: float) -> Floats:
    """Give (2, 2) the least and the largest (X, Y) at which a ball of this radius would be seen whole, mm."""
    points = profiles.xyz_mm[profiles.seen & np.isfinite(profiles.xyz_mm[..., 0])]
    low, high = (np.quantile(points[:, :2], q, axis=0) for q in (0.001, 0.999))
    # a ball that is cut off at the side would not have been found
    return np.stack([low + radius_mm, high - radius_mm])


def joined(heads: Sequence[Profiles], registrations: Sequence[Registration]) -> Joined:
    """Join the slices of heads, from left to right, into one scan in the first one's frame.

    Parameters
    ----------
    heads
        As the assembler gives them. What was followed of flanks is left out, to be followed anew.
    registrations
        Of each head but the first, to the one before it.

    Raises
    ------
    StageError
        Heads see no strip in common, or their heights differ there by more than half a millimetre.
    """
    points = []
    for k, head in enumerate(heads):
        one = head.xyz_mm
        # from head to head back to the first: each registration is to its left neighbour
        for m in range(k, 0, -1):
            moved = begun_later(heads[m - 1], heads[m], registrations[m - 1])
            one = _carried(one, registrations[m - 1].T_top_bottom) + moved
        points.append(one)
    step = usual_step(heads[0].xyz_mm, 1)
    low, high = zip(*(_extent(one, head) for one, head in zip(points, heads, strict=True)), strict=True)
    # from the largest Y down, as rows of an image run
    y = np.arange(max(one[1] for one in high), min(one[1] for one in low), -step)
    at = np.nanmedian(np.where(heads[0].seen, points[0][..., 0], np.nan), axis=1)
    # only lines that all heads have: where one head saw nothing yet, the scan would change its width
    chosen = (at >= max(one[0] for one in low)) & (at <= min(one[0] for one in high))
    if np.count_nonzero(chosen) < 3:
        raise StageError(
            "the heads' scans show no part of the belt in common",
            hint="give all heads the counts of one encoder, and products in the same order",
        )
    at = at[chosen]
    # where belt and product lie is told apart: between them nothing is to be interpolated
    layers = [
        [_on_grid(one, head, at, y, product) for product in (True, False)]
        for one, head in zip(points, heads, strict=True)
    ]
    # product before belt: at a rim both may be seen
    heights = [np.where(np.isfinite(body), body, belt) for body, belt in layers]
    levels, scatter = [], []
    for k in range(1, len(heads)):
        shared = np.isfinite(heights[k - 1]) & np.isfinite(heights[k])
        if np.count_nonzero(shared) < _SHARED_MIN:
            raise StageError(
                f"heads {k} and {k + 1} see no strip of the belt in common: whether they agree is not known",
                hint="mount them so that their fields of view overlap",
            )
        # median and spread of the differences: level and scatter of one head against the other
        off = heights[k][shared] - heights[k - 1][shared]
        levels.append(float(np.median(off)))
        scatter.append(1.4826 * float(np.median(np.abs(off - levels[-1]))))
        if math.hypot(levels[-1], scatter[-1]) > OFF_MAX_MM:
            raise StageError(
                f"where heads {k} and {k + 1} see the same, their heights differ by {levels[-1]:+.2f} mm "
                f"and scatter by {scatter[-1]:.2f} mm",
                hint="has a head been moved since register-heads, or do the scans show different products?",
            )
    # where several heads see a place, their mean
    body, belt = (_mean([layer[k] for layer in layers]) for k in (0, 1))
    z = np.where(np.isfinite(body), body, belt)
    grid = np.stack([*np.meshgrid(at, y, indexing="ij"), z], axis=-1)
    profiles = profiles_of(Measured(np.where(np.isfinite(grid[..., 2:]), grid, np.nan)), None, "the heads")
    return Joined(
        _with_figures(profiles, heads),
        tuple(levels),
        math.hypot(*levels, *(one.std_mm for one in registrations)),
    )


def _extent(points: Floats, head: Profiles) -> tuple[Floats, Floats]:
    """Give the least and the largest (X, Y) of what a head saw, mm."""
    known = points[head.seen & (head.product >= 0)][:, :2]
    return known.min(axis=0), known.max(axis=0)


def _on_grid(points: Floats, head: Profiles, at: Floats, y: Floats, product: bool) -> Floats:
    """Give (place, y) the heights of products, or of the belt, that a head saw, NaN elsewhere.

    Each place takes the nearest of the head's slices, none farther than half their distance, as it is:
    heights between two rows beside each other are joined by a straight line.
    """
    mine = head.seen & ((head.product > 0) if product else (head.product == 0))
    place = np.nanmedian(np.where(head.seen, points[..., 0], np.nan), axis=1)
    reach = 0.51 * float(np.nanmedian(np.abs(np.diff(place))))
    found = np.full((at.size, y.size), np.nan)
    for i, x in enumerate(at):
        nearest = int(np.nanargmin(np.abs(place - x)))
        rows = np.flatnonzero(mine[nearest])
        if abs(place[nearest] - x) > reach or rows.size < 2:
            continue
        order = np.argsort(points[nearest, rows, 1])
        rows = rows[order]
        of_y, of_z = points[nearest, rows, 1], points[nearest, rows, 2]
        after = np.clip(np.searchsorted(of_y, y), 1, rows.size - 1)
        # neighbours in the row: over points that are missing nothing is joined
        beside = np.abs(rows[after] - rows[after - 1]) == 1
        found[i] = np.where(beside, np.interp(y, of_y, of_z, np.nan, np.nan), np.nan)
    return found


def _mean(layers: Sequence[Floats]) -> Floats:
    known = np.isfinite(np.stack(layers))
    total = np.where(known, np.stack(layers), 0.0).sum(axis=0)
    many = known.sum(axis=0)
    return np.where(many > 0, total / np.maximum(many, 1), np.nan)


def _with_figures(profiles: Profiles, heads: Sequence[Profiles]) -> Profiles:
    """Keep of the heads' scans what volumes' budgets take, the worst of each."""
    scans = [one.scan for one in heads if one.scan is not None]
    if len(scans) < len(heads):
        return profiles
    count = profiles.slice_count
    figures = ScanFigures(
        count, count, pitch_mm=scans[0].pitch_mm, pitch_rel_std=max(one.pitch_rel_std for one in scans),
        quantum_mm=max(one.quantum_mm for one in scans), jitter_mm=max(one.jitter_mm for one in scans),
        first_count=scans[0].first_count, mm_per_count=scans[0].mm_per_count,
    )  # fmt: skip
    return replace(profiles, scan=figures)


def volume_of(wide: Joined, labelled: Profiles, number: int) -> Estimate:
    """Give the visible volume of a product of the wide scan, mm³, with the heads in its budget."""
    found = sections_of(labelled, number)
    budget = budget_of(found, labelled, number)
    budget["heads"] = wide.std_mm * float(found.width_mm @ found.held_mm)
    return estimate_of(found.volume_mm3, budget)
