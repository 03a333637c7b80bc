"""The graph that is solved: pieces of traces, the stripes that each entry may be, and what these cost.

Model. Entry i (see `lines`) gets a label: one of the stripes whose height there is possible, or none. With
w from `Weights` and all sums over entries on epipolar lines, the energy is

    E = Σ_i U(k_i) + Σ_(i, j adjacent on a line) P(k_i, k_j) + Σ_(i, j successive on a trace) T [k_i ≠ k_j]

U, a label by itself: `false_peak` for none, down to a tenth of it where the light is faint beside its
neighbours (`faint`); for stripe k, less where the peak lies on k's rest line, most in a run that reaches the
image's border, and more where it lies but a little beside it (`film`); `absent` for a stripe whose rest line
shows nothing.

P, two labels k < l side by side, with nothing between them: infinite unless stripes increase; else
`surface` · min((Δz / half a label height)², 1) + `unseen` · (stripes between k and l that would be seen).
Δz is the rise that the surface's own slope, from the next peak on either side, does not explain. A label
height is the height that displaces a stripe by one spacing: a step by that much is what a wrong label makes,
so half of it is where a step is as bad as a break. The cost is capped, for bodies end: a break from belt to
body costs a third of one amid a body. This is the truncated quadratic of robust smoothness (Blake and
Zisserman, Visual Reconstruction, 1987), with visibility added.

Visibility. A stripe left out between two others lies on the surface between them. Of all surfaces between two
heights the one that hides most drops beside the higher place and goes on level at the lower. A stripe there
is hidden if its light falls behind the higher place as the camera sees it, or on the wall itself where the
line of sight does not lean so that it would show the wall. Or nothing hides it, the surface goes on and its
light was lost: that costs a seen stripe, and no break. The cheaper explanation counts. At an image's borders
the stripes that would be seen beyond the outermost label are counted.

T, the ties of `lines`, with which neighbouring lines agree.

Assumes one opaque surface seen and lit from above, stripes in order, belt at z = 0 with stripes on it at the
image's borders. Fails where order cannot decide: a level top a whole number of label heights up looks like
belt (see `vetoes`), and so does a body without light whose neighbours carry on smoothly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry_coding.planes.lines import Entries, EpipolarLines
from roemetry_coding.planes.pieces import ENDS, Pieces
from roemetry_kernels.compiling import inlined, kernel


class Weights(NamedTuple):
    """What speaks for and against a label; the unit is a third of a whole break of the surface."""

    surface: float = 3.0
    """A step of the surface between two stripes by half a label height or more."""
    unseen: float = 4.0
    """A stripe left out that would be seen."""
    false_peak: float = 6.0
    """A peak left out: more than to leave out a stripe, less than to leave out two."""
    faint: float = 0.9
    """A peak left out that has much less light than those beside it costs this share less."""
    on_rest: float = 0.2
    anchor: float = 4.0
    """on_rest, anchor: gain of a peak on its own rest line; more if it is one of a run that reaches the
    image's border."""
    on_end: float = 1.0
    """The same at the end of a run, where a body may begin."""
    film: float = 1.0
    """A surface that lies beside its rest line by less than `_FILM` label heights: a top that is whole label
    heights up, taken for another stripe, is such a film, here a little above the belt and there below it."""
    absent: float = 3.0
    """A stripe whose rest line shows nothing."""
    tie_whole: float = 300.0
    tie_cut: float = 1.5
    tie_gap: float = 60.0
    """tie_whole, tie_cut, tie_gap: change of stripe within a piece of a trace (never), where it was cut (half
    a break), and over a gap of two ends that point at each other exactly."""


WEIGHTS = Weights()

LOOK_BACK = 4
"""Peaks on a line before a peak that may be its neighbour: up to three side by side may be false; more are
no single reflection but another product. Costs of pairs are listed by it."""
_HIDDEN = 0.06
"""What a stripe left out costs where it would be hidden, of what it costs where it would be seen: hidden by
chance, it is still the rarer case."""
_MERGED_PX, _APART_PX = 2.0, 7.0
"""A stripe nearer to another than this may merge with it, or is seen beyond doubt, px: extractors part peaks
that are about 2 widths of 1 to 3.5 px apart."""
_LEFT_OUT_MAX = 4
"""So many stripes further on, one that is apart and inside the image is counted from sums, to save time."""
_CLIFF = 0.5
"""A step is a break from this many label heights on: there the next stripe's label fits as well. At
0.4 up to 4 % of an image's points change, and volumes from slices by up to 0.3 %; at 0.62 0.5 and 1.1 %."""
_RIM = 1.0 / 3.0
"""A break between belt and body, of one amid a body: every body has two, amid it they are rare. At 0.27 or
0.42 up to 0.3 % of an image's points change, and volumes from slices by up to 1.1 %."""
_THERE = 0.2
"""A stripe that is there as surely as this costs nothing: a fifth of the rows that make it certain."""
_FILM = 0.1
"""Lower than this many label heights, some tenths of a millimetre, a body is but a rim of a few rows."""
_FAINT, _BRIGHT = 0.1, 0.35
"""Light of a piece over that beside it. Of false peaks in rendered images (gloss, light that comes out of a
body again) 91 % have less than 0.3; of peaks on bodies 0.02 % have, and 0.2 % less than 0.5."""
_LEAN_HIDES, _LEAN_SHOWS = -0.05, 0.15
"""A line of sight that leans towards the light by less hides a wall, by more shows it; mm for a mm down. At 0
a wall is seen edge-on; walls that stand within some 8 degrees of upright are undecided."""


class Candidates(NamedTuple):
    """Stripes that each entry may be."""

    low: Integers
    many: Integers
    """low, many: (entry,) first stripe and number of stripes that are possible, which follow each other."""
    offset: Integers
    """(entry + 1,) where each entry's nodes begin: one for each possible stripe, and a last one for none."""
    height: Floats
    """(node,) height, mm; 0 for none."""
    label_mm: Floats
    """(node,) change of height from one stripe to the next at this place, mm."""


class PairCosts(NamedTuple):
    """Costs of going from one entry to a later one of the same line, and of beginning and ending."""

    pair: Integers
    """(pair, 3) left entry, right entry, and where its costs begin, right stripe by right stripe; sorted by
    right entry."""
    pair_start: Integers
    """(line + 1,) where each line's pairs begin."""
    surface: NDArray[np.float32]
    unseen: NDArray[np.float32]
    """surface, unseen: (cost,) squared step of the surface in half label heights, at most 1; visible stripes
    left out."""
    before: Floats
    after: Floats
    """before, after: (node,) visible stripes left out to the left, and to the right, if this is the first or
    last."""


@kernel(error_model="numpy")
def candidates_of(
    entries: Entries, plane: Floats, low_mm: Floats, high_mm: Floats, reach: Floats
) -> Candidates:
    """List the stripes whose height at an entry lies within bounds.

    Parameters
    ----------
    entries, plane
        See `lines`.
    low_mm, high_mm
        (stripe,) bounds, mm.
    reach
        (entry,) factor on the upper bound.
    """
    start, u = entries.start, entries.u
    size, stripes = u.shape[0], plane.shape[1]
    low = np.zeros(size, np.int64)
    count = np.zeros(size, np.int64)
    offset = np.zeros(size + 1, np.int64)
    # first pass: which stripes; second: their heights, when the number of nodes is known
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            last = -1
            for k in range(stripes):
                z = _height(plane[e, k], u[i])
                if low_mm[k] <= z <= reach[i] * high_mm[k]:
                    if count[i] == 0:
                        low[i] = k
                        count[i] = 1
                    last = k
            if last >= 0:
                # possible stripes follow each other, so first and last are enough
                count[i] = last - low[i] + 1
            # one more node, for none
            offset[i + 1] = offset[i] + count[i] + 1
    height = np.zeros(offset[-1])
    label_mm = np.ones(offset[-1])
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            for k in range(low[i], low[i] + count[i]):
                z = _height(plane[e, k], u[i])
                # from the neighbour on either side; the last stripe has only one before it
                other = k + 1 if k + 1 < stripes else k - 1
                node = offset[i] + k - low[i]
                height[node] = z
                if other >= 0:
                    label_mm[node] = max(1e-6, abs(_height(plane[e, other], u[i]) - z))
    return Candidates(low, count, offset, height, label_mm)


@kernel(error_model="numpy")
def pair_costs_of(
    entries: Entries, candidates: Candidates, lines: EpipolarLines, presence: Floats, u_per_px: float,
    belt_mm: Floats, weights: Weights,
) -> PairCosts:  # fmt: skip
    """Work out what two labels side by side on a line cost each other.

    Parameters
    ----------
    entries, candidates, lines
        Entries, what each may be, and where it lies.
    presence
        (line, stripe) 0 for a stripe that is not there at all, 1 for one whose belt is seen.
    u_per_px
        Change of u for a pixel.
    belt_mm
        (stripe,) up to this height a point is belt, mm.
    weights
        Say which of two explanations is the cheaper one.
    """
    start, u, lean = entries.start, entries.u, lines.lean[entries.peak]
    low, count, offset = candidates.low, candidates.many, candidates.offset
    height, label_mm = candidates.height, candidates.label_mm
    plane = lines.plane
    count_lines = plane.shape[0]
    pairs, costs = 0, 0
    # pairs are counted first, so that the arrays can be made in one piece
    for e in range(count_lines):
        for p in range(start[e], start[e + 1]):
            for q in range(max(start[e], p - LOOK_BACK), p):
                pairs += 1
                costs += count[p] * count[q]
    pair = np.empty((pairs, 3), np.int64)
    pair_start = np.zeros(count_lines + 1, np.int64)
    surface = np.empty(costs, np.float32)
    unseen = np.empty(costs, np.float32)
    before, after = _borders(entries, candidates, lines, presence, u_per_px)
    # running sums of presence, so that stripes between two are counted without a loop
    sums = np.zeros((count_lines, plane.shape[1] + 1))
    for e in range(count_lines):
        for k in range(plane.shape[1]):
            sums[e, k + 1] = sums[e, k] + presence[e, k]
    slope = _slopes(entries, candidates, plane)
    n, c = 0, 0
    for e in range(count_lines):
        rising = _rising(plane[e])
        for p in range(start[e], start[e + 1]):
            for q in range(max(start[e], p - LOOK_BACK), p):
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
                        # out of order: never
                        if t >= s:
                            surface[c] = np.inf
                            unseen[c] = np.inf
                            c += 1
                            continue
                        z_t = height[offset[q] + j]
                        # the least of three predictions: level, and the slopes from either side carried on
                        # over the stripes between
                        rise = z_s - z_t
                        step = abs(rise)
                        step = min(step, abs(rise - (s - t) * slope[offset[q] + j, 0]))
                        step = min(step, abs(rise - (s - t) * slope[offset[p] + i, 1]))
                        step /= _CLIFF * label
                        on_belt = abs(z_t) <= belt_mm[t], abs(z_s) <= belt_mm[s]
                        # exactly one on the belt: an edge of a body, which every body has two of
                        if on_belt[0] != on_belt[1]:
                            surface[c] = min(step * step, _RIM)
                        elif s - t > 1 and not on_belt[0]:
                            # stripes are missing amid a body: its surface there is broken, unless (below)
                            # only their light was lost
                            surface[c] = 1.0
                        else:
                            # squared and capped: a step beyond half a label height is as bad as any
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
                            broken = weights.surface * surface[c] + weights.unseen * unseen[c]
                            if weights.surface * whole + weights.unseen * lost < broken:
                                surface[c], unseen[c] = whole, lost
                        else:
                            unseen[c] = 0.0
                        c += 1
        pair_start[e + 1] = n
    return PairCosts(pair, pair_start, surface, unseen, before, after)


@kernel(error_model="numpy")
def _slopes(entries: Entries, candidates: Candidates, plane: Floats) -> Floats:
    """Give (node, 2) the rise per stripe from the peak before, and to the peak after, taken for neighbours.

    All labels of a line shifted by one change it little, so it is known before any label is.
    """
    start, u = entries.start, entries.u
    low, count, offset = candidates.low, candidates.many, candidates.offset
    height = candidates.height
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
    entries: Entries, candidates: Candidates, on: EpipolarLines, presence: Floats, u_per_px: float
) -> tuple[Floats, Floats]:
    """Count the stripes that would be seen between each node and the image's borders."""
    start, u, plane, u_min, u_max = entries.start, entries.u, on.plane, on.u_min, on.u_max
    low, count, offset = candidates.low, candidates.many, candidates.offset
    height = candidates.height
    lines, stripes = plane.shape[0], plane.shape[1]
    before, after = np.zeros(offset[-1]), np.zeros(offset[-1])
    seen_left, seen_right = np.zeros(stripes + 1), np.zeros(stripes + 1)
    belt_u = np.zeros(stripes)
    inside = np.zeros((2, stripes), np.bool_)  # at any height, as seen from the left and the right border
    for e in range(lines):
        if np.isnan(u_min[e]) or start[e] == start[e + 1]:
            continue
        # the highest label of the line: no stripe is looked for above it
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
                    # a stripe that merges with this one is not missing
                    apart = _ramp((u[p] - belt_u[k]) / u_per_px, _MERGED_PX, _APART_PX)
                    there = 1.0
                    if not inside[0, k]:
                        there = _at_border(plane[e, k], z, u_min[e], np.inf, u_per_px)
                    # far enough: from here on the sums of the belt hold
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
                    # no more than it would be seen on the bare belt
                    weight = presence[e, k] * min(apart, there)
                    after[offset[p] + i] += min(seen_right[k] - seen_right[k + 1], weight)
    return before, after


@inlined
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
    # nothing can hide: all that is there would be seen
    if hides == 0.0 or room == 0.0:
        return least + most * there
    seen = 0.0
    for k in range(t + 1, s):
        u = _place(plane[e, k], z)
        # on the lower level beside the wall; the nearer to the wall, the surer it is hidden
        inside = u - left if not rising else right - u
        behind = hides * (1.0 - _ramp(inside / u_per_px, _MERGED_PX, _APART_PX))
        seen += presence[e, k] * (1.0 - behind)
    return least + most * seen


@inlined
def _height(plane: Floats, u: float) -> float:
    return (plane[0] * u + plane[1]) / (plane[2] * u + plane[3])


@inlined
def _rising(planes: Floats) -> bool:
    """Say whether a higher stripe gives a greater height at the same place of a line.

    Asked of two neighbours on the belt: a line of sight runs away from planes far off its own, which it would
    meet behind the camera, and what it says of those is the opposite.
    """
    # amid the fan; two stripes side by side tell the sense
    k = planes.shape[0] // 2
    return planes.shape[0] > 1 and _height(planes[k], _place(planes[k - 1], 0.0)) > 0.0


@inlined
def _place(plane: Floats, z: float) -> float:
    return (plane[3] * z - plane[1]) / (plane[0] - plane[2] * z)


@inlined
def _ramp(value: float, low: float, high: float) -> float:
    return min(max((value - low) / (high - low), 0.0), 1.0)


@inlined
def _at_border(plane: Floats, z: float, left: float, right: float, u_per_px: float) -> float:
    """How surely a stripe at a height would be seen between two places of a line, 0 to 1."""
    u = _place(plane, z)
    return _ramp(min(u - left, right - u) / u_per_px, _MERGED_PX, _APART_PX)


@kernel
def unary_costs(
    entries: Entries, candidates: Candidates, pieces: Pieces, there: Floats, weights: Weights,
    anchor_rows: int,
) -> Floats:  # fmt: skip
    """Give (node,) costs of a label by itself.

    Parameters
    ----------
    entries, candidates, pieces
        Entries, what each may be, and the piece it is part of.
    there
        (stripe,) how surely a stripe is there, 0 to 1.
    weights
        What a label costs.
    anchor_rows
        A run of so many rows that reaches the image's border gains in full.
    """
    peak, low, count, offset = entries.peak, candidates.low, candidates.many, candidates.offset
    piece = pieces.of
    rows = np.zeros(pieces.rest.shape[0], np.int64)
    for p in range(piece.shape[0]):
        rows[piece[p]] += 1
    own = np.zeros(offset[-1])
    for i in range(peak.shape[0]):
        # own rest line: little for a single peak, much in a run that comes from the image's border
        p = peak[i]
        for k in range(count[i]):
            s = low[i] + k
            node = offset[i] + k
            if pieces.line[p] == s:
                own[node] -= weights.on_end if pieces.rest[piece[p]] == ENDS else weights.on_rest
                if pieces.rest[piece[p]] == s and pieces.anchored[piece[p]]:
                    own[node] -= weights.anchor * min(rows[piece[p]] / anchor_rows, 1.0)
            elif abs(candidates.height[node]) < _FILM * candidates.label_mm[node]:
                # hardly above the belt: a film, which a body is not
                own[node] += weights.film
            # a stripe that is not there at all is nobody's label
            own[node] += weights.absent * (1.0 - min(1.0, there[s] / _THERE))
        # faint light is more likely a reflection: cheaper to leave out
        faint = 1.0 - _ramp(pieces.light[piece[p]], _FAINT, _BRIGHT)
        own[offset[i + 1] - 1] = weights.false_peak * (1.0 - weights.faint * faint)
    return own
