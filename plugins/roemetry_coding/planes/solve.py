"""The cheapest labels: exact on every epipolar line, made to agree along traces, then improved as a whole.

Model. The energy of `graph` on one line is a chain; its least cost for every entry and label is found
exactly, forwards and backwards (dynamic programming). Across lines only the ties couple. What a line knows is
handed down, trace by trace, to the next line and so on to the last, and the same upwards; a line's cost is
shared out among its entries before it is handed on, so that what is known once (all stripes are shifted by
one) does not count once for every stripe. That is sequential tree-reweighted message passing with one sweep
each way (Kolmogorov, IEEE PAMI 28, 2006), truncated at the tie.

A piece of a trace is one stripe, so each takes the label that is cheapest for the whole of it. What such
sweeps leave wrong are whole groups of runs, shifted by one stripe: `shifts` moves them where that lowers the
exact energy, `whole_bodies` moves all of a body, and the sweeps are repeated about what they found.

Evidence of a label: what the cheapest shift of its run, with all that must go along, would cost on each line
that is touched (`shifts`); for a short run of few peaks less, since its ends weigh more. Labels in doubt may
prop up others: the evidence is taken once more without them, twice.

Fails where several groups would have to move at once to lower the energy, or where shifts of parts of a body
by two stripes are the alternative: those are looked for in level bodies only (`vetoes`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Peaks
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry_coding.planes.graph import (
    WEIGHTS,
    Candidates,
    PairCosts,
    Weights,
    candidates_of,
    pair_costs_of,
    unary_costs,
)
from roemetry_coding.planes.lines import Entries, EpipolarLines, entries_of, epipolar_lines
from roemetry_coding.planes.pieces import (
    ENDS,
    Pieces,
    between_bare,
    cut_ends,
    found_share,
    on_rest_line,
    presence_of,
    relative_light,
)
from roemetry_coding.planes.shifts import cheapest_shifts, of_entries, shift_labels
from roemetry_coding.planes.whole_bodies import whole_body_shifts
from roemetry_kernels.compiling import inlined, kernel
from roemetry_kernels.rest_lines import RestLines
from roemetry_kernels.tracing import cut_at_rest_lines, trace_fragments

_STEP_MAX_PX = 7.0
"""Longest step of a trace from row to row, px: a surface that falls by 80 degrees along the stripe."""
OUTER_SHARE = 0.1
"""Share of the image's rows, at its top and bottom, where belt is expected."""
_BELT_ROWS_MIN = 6
"""A trace on a rest line for fewer rows crosses it."""
_FLICKER_ROWS = 3
"""A trace beside its rest line for so few rows is noise, rows."""
_BARE_ROWS = 20
"""A rest line is bare where nothing lies on it for so many rows on end: as long a gap as coders bridge."""
_FOUND_MAX = 0.99
"""A stripe found in this share of the rows is as good as always found: 1 − e⁻⁴ = 0.982 gives 4, the full
weight `unseen`."""
_END_ROWS = 8
"""Cut off where a belt ends amid the image: a body may have begun within the tolerance, rows. With 6 or 10 no
more than 0.4 % of an image's points change, but they lie at products' ends: single volumes from slices change
by up to 4.2 % (r.m.s. 1.2), more than by any other constant of the coder."""
_BORDER_ROWS = 12
"""Belt that ends this near to the image's border is taken to leave it, rows: a peak or two may be missing."""
_PRESENT_SHARE = 0.2
"""A stripe whose belt is seen on this share of the rows is certainly there."""
_PRESENT_ROWS_MIN = 15
"""A stripe seen on its rest line in fewer rows is not there: bodies cross rest lines."""
_END_LINES = 30
"""A stripe's belt may begin or end this far from the image's border."""
_LOST = 0.25
"""Where it does not reach so far: how surely it is there, still."""
_ANCHOR_ROWS = 25
"""Belt of so many rows that reaches the image's border is belt."""
_BELOW_TOLERANCES = 1.5
"""How far below the belt a point may be, in tolerances of a rest line."""
_BODY_MOVES_MAX = 3
"""After bodies were moved, all are looked at again, up to so many times: one move is usual, none on most
frames."""
_BODY_GAIN = 0.05
"""A body is moved where that is cheaper by this cost on each line; less is no difference."""
_SHIFT_GAIN = 6.0
_ROUNDS = 2
"""Sweeps are repeated up to twice with the labels found by shifts cheaper by as much as a false peak."""
_EMPTY = 3.0
"""A line with no stripe at all costs this many visible stripes left out."""
_WIDE = 4
"""Costs of steps are taken so many at once: an entry has one to eight labels, and loops over each pair's few
would mostly begin and end."""
_DEAR = 20.0
"""Costs count up to this when a piece's lines vote: more than any wrong label costs on one line."""
_SMALL_ROWS = 12
"""A piece of so few rows gives way to a larger one."""


class Problem(NamedTuple):
    """A frame's graph."""

    lines: EpipolarLines
    pieces: Pieces
    entries: Entries
    """lines, pieces, entries: peaks on epipolar lines, pieces of traces, and traces on the lines."""
    there: Floats
    """(stripe,) how surely a stripe is there at all, 0 to 1."""
    visible: Floats
    """(line, stripe) how much it counts that a stripe is not seen, 0 to 1."""
    u_per_px: float
    """Change of a place on a line for a pixel."""
    candidates: Candidates
    costs: PairCosts
    """candidates, costs: what each entry may be, and what neighbours cost each other."""
    own: Floats
    """(node,) cost of a label by itself."""


class Solved(NamedTuple):
    """The cheapest labels."""

    best: Integers
    evidence: Floats
    """best, evidence: (entry,) chosen node, and what the cheapest shift that its run is part of would cost, a
    line."""
    cost: Floats
    """(node,) by how much it is dearer than its entry's cheapest node."""


def build_problem(
    peaks: Peaks, calibration: Calibration, rest: RestLines, reach: float, lines_apart: int = 1
) -> Problem:
    """Set up a frame's graph.

    Parameters
    ----------
    peaks
        The frame's peaks.
    calibration
        Gives planes (or at least displacements) and the range of heights.
    rest
        Its rest lines.
    reach
        Heights are looked for up to so many times the highest that the calibration is meant for.
    """
    lines = epipolar_lines(peaks, calibration, rest.x_px)
    pieces, presence = _pieces(peaks, rest, lines)
    lines, presence = lines.every(lines_apart), np.ascontiguousarray(presence[::lines_apart])
    u_per_px = float(np.nanmedian(lines.u_max - lines.u_min)) / peaks.image_size[1]
    ties = WEIGHTS.tie_whole, WEIGHTS.tie_cut, WEIGHTS.tie_gap
    loose = pieces.rest[pieces.of] == ENDS
    belt = pieces.rest[pieces.of] != -1
    entries = entries_of(pieces.trace, pieces.of, loose, belt, lines, u_per_px, ties, lines_apart)
    # a stripe that is found with probability p, and is not seen, costs −log(1 − p); WEIGHTS.unseen at most
    rows, stripes = peaks.image_size[0], presence.shape[1]
    # by the image's top and bottom, where nothing can cover the belt
    outer = math.ceil(OUTER_SHARE * rows)
    found = found_share(peaks.row, rest.line, stripes, rows, outer)
    surprise = np.minimum(-np.log1p(-np.minimum(found, _FOUND_MAX)) / WEIGHTS.unseen, 1.0)
    # a faint stripe's belt may be in pieces too short to follow, and is there all the same
    bare = ((peaks.row < outer) | (peaks.row >= rows - outer)) & (rest.line >= 0)
    seen = np.bincount(rest.line[bare], minlength=stripes)
    # either way of seeing it is enough
    there = np.where(seen >= _PRESENT_SHARE * outer, 1.0, presence.max(axis=0))
    visible = presence * surprise
    graph = _graph_of(lines, pieces, entries, there, visible, u_per_px, calibration, rest, reach)
    return Problem(lines, pieces, entries, there, visible, u_per_px, *graph)


def reaching(problem: Problem, calibration: Calibration, rest: RestLines, reach: float) -> Problem:
    """Give the problem with heights looked for as far as another `reach`; see `build_problem`."""
    candidates, costs, own = _graph_of(*problem[:6], calibration, rest, reach)
    return problem._replace(candidates=candidates, costs=costs, own=own)


def _graph_of(
    lines: EpipolarLines, pieces: Pieces, entries: Entries, there: Floats, visible: Floats, u_per_px: float,
    calibration: Calibration, rest: RestLines, reach: float,
) -> tuple[Candidates, PairCosts, Floats]:  # fmt: skip
    """Give what each entry may be and what that costs: the last fields of `Problem`."""
    # what a tolerance of the rest line means in height, by stripe
    slack_mm = rest.tolerance_px / np.abs(calibration.displacement_px_per_mm)
    low_mm, high_mm = calibration.height_range_mm
    # belt that lies on its rest line from the image's border on is no product out of range: that saves time
    reaches = np.where(pieces.anchored[pieces.of[entries.peak]], 1.0, reach)
    below_mm = min(low_mm, 0.0) - _BELOW_TOLERANCES * slack_mm
    candidates = candidates_of(entries, lines.plane, below_mm, high_mm + slack_mm, reaches)
    costs = pair_costs_of(entries, candidates, lines, visible, u_per_px, 2.0 * slack_mm, WEIGHTS)
    return candidates, costs, unary_costs(entries, candidates, pieces, there, WEIGHTS, _ANCHOR_ROWS)


def cheapest_labels(problem: Problem) -> Solved:
    """Find the cheapest labels of all entries, and the evidence for them."""
    candidates = problem.candidates
    # exact on each line; pieces then choose as a whole, and groups are shifted where that is cheaper
    cost = _min_marginals(problem, problem.own)
    best, evidence, moved = _shifted(problem, agreed(problem.entries, candidates, problem.pieces, cost))
    # nothing was changed by hand: another sweep would find the same
    moved = moved or bool((best != argmin_labels(candidates, cost)).any())
    for _ in range(_ROUNDS):
        if not moved:
            break
        # the sweeps start from the improved labels, which are made cheaper, so that they must be beaten
        cost = _min_marginals(problem, favour_labels(candidates, best, problem.own, _SHIFT_GAIN))
        best, evidence, moved = _shifted(problem, agreed(problem.entries, candidates, problem.pieces, cost))
    return Solved(best, evidence, cost)


def _pieces(peaks: Peaks, rest: RestLines, lines: EpipolarLines) -> tuple[Pieces, Floats]:
    """Cut the traces; give them, and (line, stripe) how surely a stripe's belt is there to be seen."""
    stripes, rows = rest.x_px.shape
    trace, traces = trace_fragments(peaks.row_start, peaks.x_px, _STEP_MAX_PX)
    line = on_rest_line(
        peaks.row, peaks.x_px, trace, rest.line, rest.x_px, rest.tolerance_px, rest.offset_px,
        math.ceil(OUTER_SHARE * rows),
    )  # fmt: skip
    # a peak alone between bare lines is kept apart from its run: `line + stripes` cuts there
    alone = between_bare(peaks.row, line, stripes, rows, _BARE_ROWS)
    state = np.where(alone, line + stripes, line)
    piece, of_piece = cut_at_rest_lines(trace, state, traces, _BELT_ROWS_MIN, _FLICKER_ROWS)
    # back to the line's own number
    of_piece = np.where(of_piece >= stripes, of_piece - stripes, of_piece)
    full = int(_PRESENT_SHARE * rows)
    presence = presence_of(
        lines.line, piece, of_piece, lines.enters, lines.leaves, lines.plane.shape[0], full,
        min(_PRESENT_ROWS_MIN, full), _END_LINES, _LOST,
    )  # fmt: skip
    # after presence is known: cut ends count as belt there
    piece, of_piece, anchored, home = cut_ends(peaks.row, piece, of_piece, rows, _END_ROWS, _BORDER_ROWS)
    light = np.bincount(piece, relative_light(peaks.row_start, peaks.amplitude)) / np.bincount(piece)
    return Pieces(trace, piece, line, of_piece, home, anchored, light), presence


def _shifted(problem: Problem, best: Integers) -> tuple[Integers, Floats, bool]:
    """Shift runs and whole bodies; give nodes, evidence, and whether anything was shifted."""
    entries, candidates, own, costs = problem.entries, problem.candidates, problem.own, problem.costs
    moved = False
    for _ in range(_BODY_MOVES_MAX):
        # moving bodies changes what runs touch, so both are looked at in turn
        best, evidence, shifted, runs = cheapest_shifts(
            entries, candidates, problem.pieces.of, best, own, costs, WEIGHTS
        )
        dearer, by = whole_body_shifts(
            entries, candidates, problem.pieces.line, best, runs, own, costs, WEIGHTS
        )
        # evidence: the cheaper of a group's and of the whole body's shift
        evidence = np.minimum(evidence, of_entries(runs, dearer, np.inf))
        by = np.where(dearer < -_BODY_GAIN, by, 0)
        moved = moved or shifted or bool(by.any())
        if not by.any():
            break
        best = shift_labels(candidates, best, of_entries(runs, by, 0))
    return best, evidence, moved


def _min_marginals(problem: Problem, own: Floats) -> Floats:
    """Give (node,) costs."""
    return np.asarray(min_marginals(problem.entries, problem.candidates, own, problem.costs, WEIGHTS))


@kernel
def min_marginals(
    entries: Entries, candidates: Candidates, own: Floats, costs: PairCosts, weights: Weights
) -> Floats:
    """Give each node its least cost in its line with what the other lines say, less the least of its entry.

    Parameters
    ----------
    entries, candidates, costs
        The graph.
    own
        (node,) cost of a label by itself.
    weights
        What a break of the surface, and a visible stripe left out, cost.
    """
    start, many, offset = entries.start, candidates.many, candidates.offset
    size = own.shape[0]
    from_up, from_down = np.zeros(size), np.zeros(size)
    # costs of labels left out at the line's ends
    first, last = weights.unseen * costs.before, weights.unseen * costs.after
    begin, blocks, back, step = _steps_to(candidates, costs, weights)
    nothing = np.full(size + _WIDE, np.inf)  # no path goes by way of a node that stands for no stripe
    work = _Work(
        begin, blocks, back, step, first, last, nothing, nothing.copy(), nothing.copy(), np.zeros(size),
        np.empty(_WIDE),
    )  # fmt: skip
    cost = np.zeros(size)
    empty = weights.unseen * _EMPTY
    lines = start.shape[0] - 1
    for downwards in (True, False):
        said = from_up if downwards else from_down
        for k in range(lines):
            e = k if downwards else lines - 1 - k
            for i in range(start[e], start[e + 1]):
                for node in range(offset[i], offset[i] + many[i]):
                    # relative to leaving the entry out, so that leaving out costs 0 and a line's empty
                    # solution too
                    work.total[node] = own[node] + said[node] - own[offset[i + 1] - 1]
                    work.taken[node] = 0.0
            # a line's message is spread evenly over its entries: full knowledge at each would be counted
            # several times
            _share_out(start[e], start[e + 1], many, offset, work)
            for i in range(start[e], start[e + 1]):
                # each entry hands on its share of the line's cost, by the tie at most
                if downwards and entries.after[i] >= 0:
                    j = entries.after[i]
                    _hand_on(i, j, entries.tie[j], candidates, work.taken, from_up)
                elif not downwards and entries.before[i] >= 0:
                    _hand_on(i, entries.before[i], entries.tie[i], candidates, work.taken, from_down)
    # final costs: own, with both neighbours' messages
    for e in range(lines):
        for i in range(start[e], start[e + 1]):
            for node in range(offset[i], offset[i] + many[i]):
                work.total[node] = own[node] + from_up[node] + from_down[node] - own[offset[i + 1] - 1]
        _solve_line(start[e], start[e + 1], many, offset, work, empty, cost)
    return cost


class _Work(NamedTuple):
    """What the lines' solver reads, and its room; all costs beyond that of leaving all entries out."""

    begin: Integers
    blocks: Integers
    back: Integers
    step: NDArray[np.float32]
    """begin, blocks, back, step: see `_steps_to`."""
    first: Floats
    last: Floats
    """first, last: (node,) cost of being a line's first, and last, label."""
    total: Floats
    """(node,) cost by itself, with what other lines say."""
    forward: Floats
    backward: Floats
    """forward, backward: (node,) least cost up to, and from, a node, its own included."""
    taken: Floats
    """(node,) what a line's cost is taken apart into."""
    least: Floats
    """(`_WIDE`,) room."""


@inlined
def _steps_to(
    candidates: Candidates, costs: PairCosts, weights: Weights
) -> tuple[Integers, Integers, Integers, NDArray[np.float32]]:
    """Lay out what a step to each node costs from all nodes before it that it may be come to from.

    Returns
    -------
    begin, blocks, back : ndarray, shape (entry,)
        Where the costs of an entry's first node begin, those of its next one follow; how many blocks of
        `_WIDE` these are, and from which node on.
    step : ndarray
        The costs; infinite from nodes that stand for no stripe, and from those that fill the last block.
    """
    many, offset, pair = candidates.many, candidates.offset, costs.pair
    entries = many.shape[0]
    begin, blocks, back = np.zeros(entries + 1, np.int64), np.zeros(entries, np.int64), offset[:-1].copy()
    # back to the first entry it has a pair with: the list is read from its end, so the earliest is written
    # last
    for n in range(pair.shape[0] - 1, -1, -1):
        back[pair[n, 1]] = offset[pair[n, 0]]
    for p in range(entries):
        blocks[p] = (offset[p] - back[p] + _WIDE - 1) // _WIDE
        # whole blocks, padded with infinite costs
        begin[p + 1] = begin[p] + many[p] * blocks[p] * _WIDE
    step = np.full(begin[entries], np.float32(np.inf))
    for n in range(pair.shape[0]):
        q, p, c = pair[n, 0], pair[n, 1], pair[n, 2]
        at = begin[p] + offset[q] - back[p]
        for _ in range(many[p]):
            for j in range(many[q]):
                step[at + j] = weights.surface * costs.surface[c] + weights.unseen * costs.unseen[c]
                c += 1
            at += blocks[p] * _WIDE
    return begin, blocks, back, step


@inlined
def _share_out(a: int, b: int, many: Integers, offset: Integers, work: _Work) -> None:
    """Take the cost of a line's entries a to b − 1 apart: evenly from the left, what is left from there."""
    total, taken, forward, backward = work.total, work.taken, work.forward, work.backward
    # forward and backward costs must be those of the line as it is before anything is taken
    _backwards(a, b, many, offset, work)
    for p in range(a, b):
        _arrive(p, many, offset, work)
        # min-marginals of entry p, less their least
        least = np.inf
        for node in range(offset[p], offset[p] + many[p]):
            least = min(least, forward[node] + backward[node] - total[node])
        # the k-th of n takes 1/n of what is left, so that all take the same
        share = 1.0 / (b - p)
        for node in range(offset[p], offset[p] + many[p]):
            part = share * (forward[node] + backward[node] - total[node] - least)
            taken[node] += part
            forward[node] -= part
            total[node] -= part
    # what is left after the first pass is taken from the right, all of it
    _end(a, b, many, offset, work)
    for p in range(b - 1, a - 1, -1):
        least = np.inf
        for node in range(offset[p], offset[p] + many[p]):
            backward[node] += total[node]
            least = min(least, forward[node] + backward[node] - total[node])
        for node in range(offset[p], offset[p] + many[p]):
            part = forward[node] + backward[node] - total[node] - least
            taken[node] += part
            backward[node] -= part
        _depart(p, many, offset, work)


@inlined
def _backwards(a: int, b: int, many: Integers, offset: Integers, work: _Work) -> None:
    """Write the least cost of the line from each node on."""
    _end(a, b, many, offset, work)
    for p in range(b - 1, a - 1, -1):
        for node in range(offset[p], offset[p] + many[p]):
            work.backward[node] += work.total[node]
        _depart(p, many, offset, work)


@inlined
def _end(a: int, b: int, many: Integers, offset: Integers, work: _Work) -> None:
    """Write the cost behind each node as if it were the line's last label."""
    for p in range(a, b):
        for node in range(offset[p], offset[p] + many[p]):
            work.backward[node] = work.last[node]


@inlined
def _arrive(p: int, many: Integers, offset: Integers, work: _Work) -> None:
    """Write the least cost up to each node of entry p, come to from any before it, or as the first."""
    step, forward, least, c = work.step, work.forward, work.least, np.uint64(work.begin[p])
    # a few lanes side by side: the compiler makes vector instructions of them
    for node in range(offset[p], offset[p] + many[p]):
        at = np.uint64(work.back[p])
        for k in range(_WIDE):
            least[k] = np.inf
        for _ in range(work.blocks[p]):
            for k in range(np.uint64(_WIDE)):
                least[k] = min(least[k], forward[at + k] + step[c + k])
            at += np.uint64(_WIDE)
            c += np.uint64(_WIDE)
        # as the line's first label
        lowest = work.first[node]
        for k in range(_WIDE):
            lowest = min(lowest, least[k])
        forward[node] = lowest + work.total[node]


@inlined
def _depart(p: int, many: Integers, offset: Integers, work: _Work) -> None:
    """Lower the costs from nodes before entry p on by going on to it."""
    step, backward, c = work.step, work.backward, np.uint64(work.begin[p])
    for node in range(offset[p], offset[p] + many[p]):
        later, at = backward[node], np.uint64(work.back[p])
        for _ in range(work.blocks[p]):
            for k in range(np.uint64(_WIDE)):
                backward[at + k] = min(backward[at + k], later + step[c + k])
            at += np.uint64(_WIDE)
            c += np.uint64(_WIDE)


@inlined
def _hand_on(i: int, j: int, tie: float, candidates: Candidates, taken: Floats, message: Floats) -> None:
    """Write what entry i says to entry j of the next line; a change of stripe costs the tie at most."""
    low, count, offset = candidates.low, candidates.many, candidates.offset
    least = np.inf
    for node in range(offset[i], offset[i] + count[i]):
        # only differences matter; the least of them is 0
        least = min(least, taken[node])
    for b in range(count[j]):
        a = low[j] + b - low[i]
        # a stripe that the entry above cannot be costs the tie
        said = tie
        if 0 <= a < count[i]:
            said = min(tie, taken[offset[i] + a] - least)
        message[offset[j] + b] = said


@inlined
def _solve_line(
    a: int, b: int, many: Integers, offset: Integers, work: _Work, empty: float, cost: Floats
) -> None:
    """Write the line's least cost for each node of its entries a to b − 1, less the least of the entry."""
    step, total, forward, backward = work.step, work.total, work.forward, work.backward
    _backwards(a, b, many, offset, work)
    # an entry is left out if the line ends before it, begins behind it, or two others step over it
    ended = empty
    for p in range(a, b):
        _arrive(p, many, offset, work)
        cost[offset[p + 1] - 1] = ended
        # least cost of a line that ended before p
        for node in range(offset[p], offset[p] + many[p]):
            ended = min(ended, forward[node] + work.last[node])
    begun = empty
    for p in range(b - 1, a - 1, -1):
        left_out = offset[p + 1] - 1
        cost[left_out] = min(cost[left_out], begun)
        for node in range(offset[p], offset[p] + many[p]):
            begun = min(begun, backward[node] + work.first[node])
            cost[node] = forward[node] + backward[node] - total[node]
    for p in range(a, b):  # entries between two are left out
        over, q = np.inf, p
        # first entry that p may be come to from
        while q > a and offset[q] > work.back[p]:
            q -= 1
        for k in range(q, p - 1):
            c = work.begin[p] + offset[k] - work.back[p]
            for node in range(offset[p], offset[p] + many[p]):
                for j in range(many[k]):
                    over = min(over, forward[offset[k] + j] + step[c + j] + backward[node])
                c += work.blocks[p] * _WIDE
            # entry k + 1 is stepped over from every entry up to k: `over` keeps the least of these
            cost[offset[k + 2] - 1] = min(cost[offset[k + 2] - 1], over)
    for p in range(a, b):
        least = np.inf
        for node in range(offset[p], offset[p + 1]):
            least = min(least, cost[node])
        for node in range(offset[p], offset[p + 1]):
            cost[node] -= least


@kernel
def agreed(entries: Entries, candidates: Candidates, pieces: Pieces, cost: Floats) -> Integers:
    """Give (entry,) the node of the stripe that is cheapest for its whole piece.

    Single entries that are cheapest as no stripe stay so; ends choose for themselves. Of two that stand
    out of order on a line, the one of an end or of a small piece is no stripe.

    Parameters
    ----------
    entries, candidates, pieces
        The graph.
    cost
        (node,) costs.
    """
    peak, low, count, offset = entries.peak, candidates.low, candidates.many, candidates.offset
    piece, piece_line = pieces.of, pieces.rest
    stripes = 0
    for i in range(peak.shape[0]):
        stripes = max(stripes, low[i] + count[i])
    gain = np.zeros((piece_line.shape[0], stripes))
    best = np.empty(peak.shape[0], np.int64)
    # the label for none is the default
    for i in range(peak.shape[0]):
        best[i] = offset[i + 1] - 1
        for k in range(count[i]):
            node = offset[i] + k
            # capped: one line that forbids a label must not outvote all others
            gain[piece[peak[i]], low[i] + k] += _DEAR - min(cost[node], _DEAR)
            if cost[node] < cost[best[i]]:
                best[i] = node
    stripe = np.empty(piece_line.shape[0], np.int64)
    for f in range(piece_line.shape[0]):
        stripe[f] = np.argmax(gain[f])
    for i in range(peak.shape[0]):
        f = piece[peak[i]]
        k = stripe[f] - low[i]
        # pieces decide together, but entries that are cheapest as nothing stay nothing
        if piece_line[f] != ENDS and best[i] < offset[i + 1] - 1:
            best[i] = offset[i] + k if 0 <= k < count[i] else offset[i + 1] - 1
    _put_in_order(entries, candidates, pieces, best)
    return best


@kernel
def _put_in_order(entries: Entries, candidates: Candidates, pieces: Pieces, best: Integers) -> None:
    start, peak = entries.start, entries.peak
    low, count, offset = candidates.low, candidates.many, candidates.offset
    piece, piece_line = pieces.of, pieces.rest
    size = np.zeros(piece_line.shape[0], np.int64)
    for i in range(peak.shape[0]):
        # ends count as size 0: they give way first
        size[piece[peak[i]]] += entries.apart * (piece_line[piece[peak[i]]] != ENDS)
    for e in range(start.shape[0] - 1):
        last = -1
        for i in range(start[e], start[e + 1]):
            if best[i] - offset[i] >= count[i]:
                continue
            # out of order: the stripe to the left is not smaller
            while last >= 0 and low[last] + best[last] - offset[last] >= low[i] + best[i] - offset[i]:
                before, here = size[piece[peak[last]]], size[piece[peak[i]]]
                # the smaller one gives way, unless both are large; then it stays for `shifts` and the vetoes
                if here <= before and here <= _SMALL_ROWS:
                    best[i] = offset[i + 1] - 1
                    break
                if before > _SMALL_ROWS:
                    break
                best[last] = offset[last + 1] - 1
                last -= 1
                # back to the last entry that still has a label
                while last >= start[e] and best[last] - offset[last] >= count[last]:
                    last -= 1
                if last < start[e]:
                    last = -1
            if best[i] - offset[i] < count[i]:
                last = i


@kernel
def argmin_labels(candidates: Candidates, cost: Floats) -> Integers:
    """Give (entry,) the cheapest of its nodes."""
    count, offset = candidates.many, candidates.offset
    best = np.empty(count.shape[0], np.int64)
    for i in range(count.shape[0]):
        best[i] = offset[i + 1] - 1
        for node in range(offset[i], offset[i] + count[i]):
            if cost[node] < cost[best[i]]:
                best[i] = node
    return best


@kernel
def favour_labels(candidates: Candidates, best: Integers, own: Floats, gain: float) -> Floats:
    """Give (node,) own costs with the chosen stripes cheaper by a gain."""
    count, offset = candidates.many, candidates.offset
    found = own.copy()
    for i in range(count.shape[0]):
        if best[i] - offset[i] < count[i]:
            found[best[i]] -= gain
    return found
