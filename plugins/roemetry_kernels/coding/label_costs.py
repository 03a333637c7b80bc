"""Which stripes each peak may be, and what it costs two neighbours on a sight line to be these two."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel

_LOOK_BACK = 4
"""Up to three peaks side by side may be false."""
_HIDDEN = 0.06
"""What a stripe left out costs where it would be hidden, of what it costs where it would be seen."""
_MERGED_PX = 2.0
_APART_PX = 7.0
"""A stripe nearer to another than this may merge with it, or is seen beyond doubt."""
_LEFT_OUT_MAX = 4
_CLIFF = 0.5
_RIM = 1.0 / 3.0
_LEAN_HIDES = -0.05
_LEAN_SHOWS = 0.15


class Labels(NamedTuple):
    """Stripes that are possible.

    Attributes
    ----------
    low, many
        (entry,) first stripe and number of stripes that are possible, which follow each other.
    offset
        (entry + 1,) where each entry's nodes begin: one for each possible stripe, and a last one for none.
    height
        (node,) height, mm; 0 for none.
    label_mm
        (node,) change of height from one stripe to the next at this place, mm.
    """

    low: Integers
    many: Integers
    offset: Integers
    height: Floats
    label_mm: Floats


class Steps(NamedTuple):
    """Costs of going from one entry to a later one of the same line, and of beginning and ending.

    Attributes
    ----------
    pair
        (pair, 3) left entry, right entry, and where its costs begin, right stripe by right stripe; sorted by
        right entry.
    pair_start
        (line + 1,) where each line's pairs begin.
    surface, unseen
        (cost,) squared step of the surface, at most 1; and visible stripes left out between.
    before, after
        (node,) visible stripes left out to the left, and to the right, if this is the first or last.
    """

    pair: Integers
    pair_start: Integers
    surface: NDArray[np.float32]
    unseen: NDArray[np.float32]
    before: Floats
    after: Floats


@kernel(error_model="numpy")
def labels_of(
    start: Integers, u: Floats, plane: Floats, low_mm: Floats, high_mm: Floats, beyond: Floats
) -> tuple[Integers, Integers, Integers, Floats, Floats]:
    """List the stripes whose height at an entry lies within bounds; the fields of `Labels`.

    Parameters
    ----------
    start, u, plane
        See `roemetry_kernels.coding.sight_entries.Entries` and `roemetry_kernels.coding.sight_lines`.
    low_mm, high_mm
        (stripe,) bounds, mm.
    beyond
        (entry,) factor on the upper bound.
    """
    size, stripes = u.shape[0], plane.shape[1]
    low = np.zeros(size, np.int64)
    count = np.zeros(size, np.int64)
    offset = np.zeros(size + 1, np.int64)
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            last = -1
            for k in range(stripes):
                z = _height(plane[e, k], u[i])
                if low_mm[k] <= z <= beyond[i] * high_mm[k]:
                    if count[i] == 0:
                        low[i] = k
                        count[i] = 1
                    last = k
            if last >= 0:
                count[i] = last - low[i] + 1
            offset[i + 1] = offset[i] + count[i] + 1
    height = np.zeros(offset[-1])
    label_mm = np.ones(offset[-1])
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            for k in range(low[i], low[i] + count[i]):
                z = _height(plane[e, k], u[i])
                other = k + 1 if k + 1 < stripes else k - 1
                node = offset[i] + k - low[i]
                height[node] = z
                if other >= 0:
                    label_mm[node] = max(1e-6, abs(_height(plane[e, other], u[i]) - z))
    return low, count, offset, height, label_mm


@kernel(error_model="numpy")
def _height(plane: Floats, u: float) -> float:
    return (plane[0] * u + plane[1]) / (plane[2] * u + plane[3])


@kernel(error_model="numpy")
def _place(plane: Floats, z: float) -> float:
    return (plane[3] * z - plane[1]) / (plane[0] - plane[2] * z)


@kernel(error_model="numpy")
def _ramp(value: float, low: float, high: float) -> float:
    return min(max((value - low) / (high - low), 0.0), 1.0)


@kernel(error_model="numpy")
def _at_border(plane: Floats, z: float, left: float, right: float, u_per_px: float) -> float:
    """How surely a stripe at a height would be seen between two places of a line, 0 to 1."""
    u = _place(plane, z)
    return _ramp(min(u - left, right - u) / u_per_px, _MERGED_PX, _APART_PX)


@kernel(error_model="numpy")
def _left_out(
    e: int, t: int, s: int, plane: Floats, z: float, left: float, right: float, hides: float, rising: bool,
    room: float, u_per_px: float, presence: Floats, sums: Floats,
) -> float:  # fmt: skip
    """Sum up how surely stripes between t and s, which were left out between two others, would be seen.

    `hides` is how surely the line of sight leans so that the higher place may hide them, `room` how surely
    they would not merge with the two; `sums` holds the running sum of their presence.
    """
    there = sums[e, s] - sums[e, t + 1]
    least, most = _HIDDEN * there, (1.0 - _HIDDEN) * room
    if hides == 0.0 or room == 0.0:
        return least + most * there
    seen = 0.0
    for k in range(t + 1, s):
        u = _place(plane[e, k], z)
        inside = u - left if not rising else right - u
        behind = hides * (1.0 - _ramp(inside / u_per_px, _MERGED_PX, _APART_PX))
        seen += presence[e, k] * (1.0 - behind)
    return least + most * seen


@kernel(error_model="numpy")
def steps_of(
    start: Integers, u: Floats, low: Integers, count: Integers, offset: Integers, height: Floats,
    label_mm: Floats, plane: Floats, lean: Floats, u_min: Floats, u_max: Floats, presence: Floats,
    u_per_px: float, belt_mm: Floats,
) -> tuple[Integers, Integers, NDArray[np.float32], NDArray[np.float32], Floats, Floats]:  # fmt: skip
    """Work out the fields of `Steps`.

    A stripe left out between two others lies on the surface between them. Of all surfaces between two heights
    the one that hides most drops beside the higher place and goes on level at the lower. A stripe there is
    hidden if its light falls behind the higher place as the camera sees it, and if the line of sight leans
    that way: a surface seen from above cannot hide what lies under it. Else it would be seen, unless the two
    are so near each other that what lies between them merges with them.

    Parameters
    ----------
    start, u, low, count, offset, height, label_mm
        See `roemetry_kernels.coding.sight_entries` and `Labels`.
    plane, u_min, u_max, u_per_px
        See `roemetry_kernels.coding.sight_lines`.
    lean
        (entry,) see `roemetry_kernels.coding.sight_lines`.
    presence
        (line, stripe) 0 for a stripe that is not there at all, 1 for one whose belt is seen.
    """
    lines = plane.shape[0]
    pairs, costs = 0, 0
    for e in range(lines):
        for p in range(start[e], start[e + 1]):
            for q in range(max(start[e], p - _LOOK_BACK), p):
                pairs += 1
                costs += count[p] * count[q]
    pair = np.empty((pairs, 3), np.int64)
    pair_start = np.zeros(lines + 1, np.int64)
    surface = np.empty(costs, np.float32)
    unseen = np.empty(costs, np.float32)
    before, after = _borders(start, u, low, count, offset, height, plane, u_min, u_max, presence, u_per_px)
    sums = np.zeros((lines, plane.shape[1] + 1))
    for e in range(lines):
        for k in range(plane.shape[1]):
            sums[e, k + 1] = sums[e, k] + presence[e, k]
    slope = _slopes(start, u, low, count, offset, height, plane)
    n, c = 0, 0
    for e in range(lines):
        for p in range(start[e], start[e + 1]):
            # stripes rise to the right where a higher one gives a greater height at the same place
            rising = _height(plane[e, plane.shape[1] - 1], u[p]) > _height(plane[e, 0], u[p])
            for q in range(max(start[e], p - _LOOK_BACK), p):
                pair[n, 0], pair[n, 1], pair[n, 2] = q, p, c
                n += 1
                apart_px = (u[p] - u[q]) / u_per_px
                lean_over = -lean[q] if not rising else lean[p]
                hides = 1.0 - _ramp(lean_over, _LEAN_HIDES, _LEAN_SHOWS)
                for i in range(count[p]):
                    s = low[p] + i
                    z_s, label = height[offset[p] + i], label_mm[offset[p] + i]
                    for j in range(count[q]):
                        t = low[q] + j
                        if t >= s:
                            surface[c] = np.inf
                            unseen[c] = np.inf
                            c += 1
                            continue
                        z_t = height[offset[q] + j]
                        rise = z_s - z_t
                        step = abs(rise)
                        step = min(step, abs(rise - (s - t) * slope[offset[q] + j, 0]))
                        step = min(step, abs(rise - (s - t) * slope[offset[p] + i, 1]))
                        step /= _CLIFF * label
                        on_belt = abs(z_t) <= belt_mm[t], abs(z_s) <= belt_mm[s]
                        if on_belt[0] != on_belt[1]:
                            surface[c] = min(step * step, _RIM)
                        elif s - t > 1 and not on_belt[0]:
                            surface[c] = 1.0
                        else:
                            surface[c] = min(step * step, 1.0)
                        if s - t > 1:
                            # the higher place may go on until just before the next stripe would show on it
                            left, right = u[q], u[p]
                            if rising and z_s > z_t:
                                right = max(left, min(right, _place(plane[e, s - 1], z_s)))
                            elif not rising and z_t > z_s:
                                left = min(right, max(left, _place(plane[e, t + 1], z_t)))
                            room = _ramp(apart_px / (s - t), _MERGED_PX, _APART_PX)
                            unseen[c] = _left_out(
                                e, t, s, plane, min(z_s, z_t), left, right, hides, rising, room, u_per_px,
                                presence, sums,
                            )  # fmt: skip
                            # or nothing hides them: the surface goes on, and their light was lost
                            lost = sums[e, s] - sums[e, t + 1]
                            whole = min(step * step, 1.0)
                            if 3.0 * whole + 4.0 * lost < 3.0 * surface[c] + 4.0 * unseen[c]:
                                surface[c], unseen[c] = whole, lost
                        else:
                            unseen[c] = 0.0
                        c += 1
        pair_start[e + 1] = n
    return pair, pair_start, surface, unseen, before, after


@kernel(error_model="numpy")
def _slopes(
    start: Integers, u: Floats, low: Integers, count: Integers, offset: Integers, height: Floats,
    plane: Floats,
) -> Floats:  # fmt: skip
    """Give (node, 2) the rise per stripe from the peak before, and to the peak after, taken for neighbours.

    All labels of a line shifted by one change it little, so it is known before any label is.
    """
    slope = np.zeros((height.shape[0], 2))
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            for k in range(low[i], low[i] + count[i]):
                node = offset[i] + k - low[i]
                if i > start[e] and k > 0:
                    slope[node, 0] = height[node] - _height(plane[e, k - 1], u[i - 1])
                if i + 1 < start[e + 1] and k + 1 < plane.shape[1]:
                    slope[node, 1] = _height(plane[e, k + 1], u[i + 1]) - height[node]
    return slope


@kernel(error_model="numpy")
def _borders(
    start: Integers, u: Floats, low: Integers, count: Integers, offset: Integers, height: Floats,
    plane: Floats, u_min: Floats, u_max: Floats, presence: Floats, u_per_px: float,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Count the stripes that would be seen between each node and the image's borders."""
    lines, stripes = plane.shape[0], plane.shape[1]
    before, after = np.zeros(offset[-1]), np.zeros(offset[-1])
    seen_left, seen_right = np.zeros(stripes + 1), np.zeros(stripes + 1)
    belt_u = np.zeros(stripes)
    inside = np.zeros((2, stripes), np.bool_)  # at any height, as seen from the left and the right border
    for e in range(lines):
        if np.isnan(u_min[e]) or start[e] == start[e + 1]:
            continue
        top = 0.0
        for node in range(offset[start[e]], offset[start[e + 1]]):
            top = max(top, height[node])
        for k in range(stripes):  # on the belt, as far as the image's borders go
            seen = _at_border(plane[e, k], 0.0, u_min[e], u_max[e], u_per_px)
            seen_left[k + 1] = seen_left[k] + presence[e, k] * seen
            belt_u[k], top_u = _place(plane[e, k], 0.0), _place(plane[e, k], top)
            inside[0, k] = min(belt_u[k], top_u) - u_min[e] >= _APART_PX * u_per_px
            inside[1, k] = u_max[e] - max(belt_u[k], top_u) >= _APART_PX * u_per_px
        for k in range(stripes - 1, -1, -1):
            seen = seen_left[k + 1] - seen_left[k]
            seen_right[k] = seen_right[k + 1] + seen
        for p in range(start[e], start[e + 1]):
            for i in range(count[p]):
                s, z = low[p] + i, max(height[offset[p] + i], 0.0)
                for k in range(s - 1, -1, -1):
                    apart = _ramp((u[p] - belt_u[k]) / u_per_px, _MERGED_PX, _APART_PX)
                    there = 1.0
                    if not inside[0, k]:
                        there = _at_border(plane[e, k], z, u_min[e], np.inf, u_per_px)
                    if k < s - _LEFT_OUT_MAX and apart == 1.0 and there == 1.0:
                        before[offset[p] + i] += seen_left[k + 1]
                        break
                    weight = presence[e, k] * min(apart, there)
                    before[offset[p] + i] += min(seen_left[k + 1] - seen_left[k], weight)
                for k in range(s + 1, stripes):
                    apart = _ramp((belt_u[k] - u[p]) / u_per_px, _MERGED_PX, _APART_PX)
                    there = 1.0
                    if not inside[1, k]:
                        there = _at_border(plane[e, k], z, -np.inf, u_max[e], u_per_px)
                    if k > s + _LEFT_OUT_MAX and apart == 1.0 and there == 1.0:
                        after[offset[p] + i] += seen_right[k]
                        break
                    weight = presence[e, k] * min(apart, there)
                    after[offset[p] + i] += min(seen_right[k] - seen_right[k + 1], weight)
    return before, after
