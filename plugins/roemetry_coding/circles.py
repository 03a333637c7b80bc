"""Circles by order and continuity: which circle, and which half of it, made each curve.

Model. The line of sight of a peak meets each half circle's cone at a height. Curves are cut into pieces
of some rows, at kinks sooner; each piece may be any half whose heights there are possible. Labels cost

- along a curve: another label from one piece to the next is dear, and cheap where the curve has a kink;
- across: of two pieces that follow each other in a row, the right one has the higher number; the surface
  rises between them by no more than a steep slope, or is broken; and a circle that reaches the row and is
  not seen between them costs, for something must hide it;
- alone: a piece on the belt costs less than one above it, which seldom lies on another circle of the belt;
  and a piece that is no circle's light costs most.

The cheapest labels are found by passing costs to and fro between neighbours (min-sum; Kschischang, Frey,
Loeliger 2001). A piece is labelled where the next best label costs more by what makes it improbable; else its
peaks are ambiguous. Heights of each half come from the cones (`View.cones`), at whatever height they are.

It fails where something hides the same number of circles on all sides of a body with steep walls all around:
its label is then told by nothing. Source: our own; the costs are those of `planes` in fewer words.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Peaks, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.stripes import AMBIGUOUS, UNLABELLED
from roemetry.records.view import View
from roemetry.stages import Capabilities, Coder
from roemetry_kernels.bridging import BridgingOptions, bridged
from roemetry_kernels.compiling import kernel
from roemetry_kernels.consistency import keep_order, refuse_uncodable, required_calibration
from roemetry_kernels.rest_lines import RestLines, calibrated_rest_lines, reasons_of
from roemetry_kernels.tracing import trace_fragments

_STEP_PX = 3.0
"""From row to row, by which a curve that goes on moves."""
_PIECE_ROWS = 12
"""Longest piece: over so many rows a label is the same unless there is a kink."""
_KINK_PX = 1.5
"""By which a peak lies beside the line through the two before it at a kink: noise is a tenth."""
_BELT_MM = 3.0
"""Height above and below the belt up to which a piece lies on it. A row that is sent twice moves the belt by
1 mm, and by 2 where circles run along rows; with 1.0 such belt was the next circle's, 54 mm up."""
_ABOVE = 0.05
"""Heights reach above the greatest one by this share of it."""
_ABOVE_COST = 1.0
"""Of a piece above the belt: as much as a slope that is a half steeper than usual."""
_BY_CHANCE = 1.8
"""More, of a piece above the belt that lies on a circle of the belt as well, within `_BELT_MM` either way. Of
heights 36 mm apart (circles 8 mm apart, a projector 105 mm aside and 470 mm up) one in six does."""
_NOTHING = 20.0
"""Of a piece that is no circle's light: two broken surfaces, and nearly one wrong order."""
_NOTHING_BESIDE = 3.0
"""Of it beside a piece that is."""
_CHANGE, _CHANGE_AT_KINK = 30.0, 3.0
"""Of another label from piece to piece."""
_DISORDER = 40.0
"""Of neighbouring pieces out of order: more than any light that is no circle's costs (`_NOTHING`)."""
_STEEP = 2.0
"""Slope of surfaces, in heights per distance, that costs 1: 63°."""
_BROKEN = 9.0
"""The most that a rise can cost: there is an edge."""
_HIDDEN, _HIDDEN_MAX = 2.5, 4
"""Of each circle that is not seen, and how many count: beyond them lies a shadow."""
_ROWS_BESIDE_MIN = 3
"""Rows that two pieces must share to be neighbours."""
_ROUNDS = 30
"""Of passing costs: more than there are pieces on most curves."""
_DAMPED = 0.5  # of a message is kept from round to round, so that loops do not swing
_EVIDENCE_MIN = 8.0
"""Cost of the next best label over the best, from which on a label is given: odds of 1 to 50."""
_LABELLED_MIN = 0.5
"""Share of the peaks with a label: of another pattern's a third gets one."""
_ON_BELT_MIN = 0.3
"""Of the outermost peaks of all rows, that lie on the belt's circles: a product may cover two in three, and
of an image that was turned a tenth does by chance."""


class CircleOrder(Coder[BridgingOptions]):
    """Labels curves by the cones that can have made them, their order and the surface's continuity."""

    capabilities = Capabilities(pattern="circles")

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame; the stripes are halves of circles, from left to right.

        Raises
        ------
        StageError
            No calibration with cones; no peak at all, or of another image size; the belt's circles lie more
            than a pixel beside the calibrated ones; fewer than half of the peaks are light of its circles; or
            hardly any lie on the belt.
        """
        refuse_uncodable(peaks, calibration)
        calibration = required_calibration(calibration, "circle-order", "without cones a peak has no height")
        view = calibration.view
        if view is None or not len(view.cones):
            raise StageError("the calibration has no cones of circles", hint="calibrate with pinhole-circles")
        pieces = _pieces_of(peaks)
        # pieces are labelled together; only then rows are looked at one by one
        evidence, label = _decided(_problem(peaks, pieces, calibration, view))
        sure = (label >= 0) & (evidence >= _EVIDENCE_MIN)
        # −1 is light of no circle: it is not ambiguous but none
        given = np.where(sure, label, np.where(label >= 0, AMBIGUOUS, UNLABELLED))
        stripe = keep_order(peaks, given[pieces.of])
        rest = _rest_of_these(peaks, stripe, calibration, len(view.cones))
        found = bridged(
            peaks,
            stripe,
            # evidence is a logarithm of odds; tanh makes a margin from 0 to 1 of it
            np.tanh(evidence / 4.0)[pieces.of],
            rest,
            longest_gap_rows=self.options.longest_gap_rows,
            smallest_product_points=self.options.smallest_product_points,
            reasons=reasons_of(rest),
        )
        return replace(found, circles=True)


def _rest_of_these(peaks: Peaks, stripe: Integers, calibration: Calibration, halves: int) -> RestLines:
    """Give the rest lines; StageError where the light is not of the calibrated circles."""
    labelled = float((stripe >= 0).mean())
    # first of all light, then of the outermost: another pattern is told before a moved belt
    if labelled < _LABELLED_MIN:
        raise StageError(
            f"only {labelled:.0%} of the peaks can be light of the {halves // 2} calibrated circles",
            hint="another pattern, a turned image, or a rig that has moved?",
        )
    rest = calibrated_rest_lines(peaks, calibration)
    rows = np.flatnonzero(np.diff(peaks.row_start) > 0)
    # product lies amid the circles: the outermost peaks of a row are the belt's
    outermost = np.concatenate([peaks.row_start[rows], peaks.row_start[rows + 1] - 1])
    on_belt = float((rest.line[outermost] >= 0).mean())
    if on_belt < _ON_BELT_MIN:
        raise StageError(
            f"only {on_belt:.0%} of the outermost peaks lie where the calibrated circles meet the belt",
            hint="is bare belt seen beside the product, and are these the circles that were calibrated?",
        )
    return rest


class _Pieces(NamedTuple):
    """Pieces of curves, each of peaks in rows that follow each other."""

    of: Integers
    """(peak,) number of its piece."""
    first: Integers
    last: Integers
    """first, last: (piece,) peaks at both ends."""
    before: Integers
    """(piece,) piece of the same curve that ends in the row before; −1: none."""
    at_kink: Flags
    """(piece,) whether a kink lies between the two."""


def _pieces_of(peaks: Peaks) -> _Pieces:
    fragment, _ = trace_fragments(peaks.row_start, peaks.x_px, _STEP_PX)
    order = np.argsort(fragment, kind="stable")
    x, curve = peaks.x_px[order], fragment[order]
    begins = np.diff(curve, prepend=-1) != 0
    bend = np.zeros(x.size)
    # second difference: how far a peak lies beside the line through the two before it
    bend[2:] = np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2])
    # the first two peaks of a curve have no two before them
    bend[begins | np.roll(begins, 1)] = 0.0
    kink = bend > _KINK_PX
    start = begins | kink
    # rows since the last beginning: a piece is cut again after so many
    at = np.arange(x.size)
    since = at - np.maximum.accumulate(np.where(start, at, 0))
    start |= since % _PIECE_ROWS == 0
    number = np.cumsum(start) - 1
    first = np.flatnonzero(start)
    last = np.append(first[1:], x.size) - 1
    of = np.empty(x.size, np.int64)
    of[order] = number
    before = np.where(begins[first], -1, np.arange(first.size) - 1)
    return _Pieces(of, order[first], order[last], before, kink[first])


class _Problem(NamedTuple):
    """What each piece may be, and what neighbours cost."""

    stripe: Integers
    """(piece, candidate) half circle; −1 of no circle's light, which stands last; −2 of no candidate."""
    alone: Floats
    """(piece, candidate) cost; infinite of no candidate."""
    edge: Integers
    """(edge, 2) pieces that are neighbours."""
    pair: Floats
    """(edge, candidate, candidate) cost."""


def _problem(peaks: Peaks, pieces: _Pieces, calibration: Calibration, view: View) -> _Problem:
    low, high = calibration.height_range_mm
    halves, count = len(view.cones), pieces.first.size
    # pieces are numbered along each curve, so the one before is the number before
    ends = np.stack([pieces.first, pieces.last], axis=1)
    xy = np.stack([peaks.x_px[ends], peaks.row[ends].astype(np.float64)], axis=2)
    z = view.lift(xy[:, None], np.arange(halves)[None, :, None])[..., 2]  # (piece, half, end)
    # both ends of the piece must be possible: a cone's height changes along it
    with np.errstate(invalid="ignore"):
        can = ((z > low - _BELT_MM) & (z < high * (1.0 + _ABOVE))).all(axis=2)
    most = int(can.sum(axis=1).max(initial=0))
    stripe = np.full((count, most + 1), -2)
    # candidates of each piece side by side, so that all pieces have one array
    rank = np.cumsum(can, axis=1) - 1
    piece, half = np.nonzero(can)
    stripe[piece, rank[piece, half]] = half
    stripe[:, most] = -1
    heights = np.where((stripe >= 0)[..., None], z[np.arange(count)[:, None], np.maximum(stripe, 0)], 0.0)
    # at both ends; a piece that crosses the belt's level is none of it
    on_belt = (np.abs(heights) < _BELT_MM).all(axis=2)
    # dearer still where a circle of the belt explains the light as well
    above = np.where(np.any(on_belt, axis=1), _ABOVE_COST + _BY_CHANCE, _ABOVE_COST)[:, None]
    alone = np.where(stripe == -2, np.inf, np.where(on_belt, 0.0, above))
    alone[:, most] = _NOTHING
    along = np.flatnonzero(pieces.before >= 0)
    change = np.where(pieces.at_kink[along], _CHANGE_AT_KINK, _CHANGE)
    one, other = stripe[pieces.before[along]], stripe[along]
    # along the curve: the same label costs nothing
    same = one[:, :, None] == other[:, None, :]
    pair = [np.where(same, 0.0, change[:, None, None])]
    edges = [np.column_stack([pieces.before[along], along])]
    beside, rows = _beside(peaks, pieces)
    edges.append(beside)
    pair.append(_across(peaks, pieces, view, calibration, stripe, heights, beside, rows))
    return _Problem(stripe, alone, np.concatenate(edges), np.concatenate(pair))


def _beside(peaks: Peaks, pieces: _Pieces) -> tuple[Integers, Floats]:
    """Give (pair, 2) pieces that follow each other in enough rows, and (pair,) the middle one of these."""
    follows = np.flatnonzero(np.diff(peaks.row) == 0)
    # one number for an ordered pair of pieces
    both = pieces.of[follows] * pieces.first.size + pieces.of[follows + 1]
    key, at, many = np.unique(both, return_inverse=True, return_counts=True)
    row = np.bincount(at, peaks.row[follows], minlength=key.size) / np.maximum(many, 1)
    enough = many >= _ROWS_BESIDE_MIN
    return np.column_stack(np.divmod(key[enough], pieces.first.size)), row[enough]


def _across(
    peaks: Peaks, pieces: _Pieces, view: View, calibration: Calibration, stripe: Integers, heights: Floats,
    beside: Integers, row: Floats,
) -> Floats:  # fmt: skip
    """Give (pair, candidate, candidate) what labels of pieces beside each other cost."""
    begin, end = peaks.row[pieces.first[beside]], peaks.row[pieces.last[beside]]
    # where between its ends each piece crosses the row
    share = np.clip((row[:, None] - begin) / np.maximum(end - begin, 1), 0.0, 1.0)

    def between(of_ends: Floats) -> Floats:
        return np.asarray(of_ends[..., 0] + (of_ends[..., 1] - of_ends[..., 0]) * share[..., None])

    z = between(heights[beside])  # (pair, 2, candidate)
    x = between(np.stack([peaks.x_px[pieces.first[beside]], peaks.x_px[pieces.last[beside]]], -1)[:, :, None])
    # heights per distance on the belt: the slope, squared and capped
    apart_mm = np.abs(x[:, 1, 0] - x[:, 0, 0]) * _mm_per_px(view)
    rise = np.abs(z[:, 1, None, :] - z[:, 0, :, None])
    cost = np.minimum((rise / (_STEEP * apart_mm[:, None, None])) ** 2, _BROKEN)
    one, other = stripe[beside[:, 0]][:, :, None], stripe[beside[:, 1]][:, None, :]
    reach = _reaching(calibration)
    at = np.clip(np.rint(row).astype(np.int64), 0, reach.shape[1] - 1)[:, None, None]
    # halves that reach this row and lie between the two labels
    hidden: Integers = reach[np.maximum(other - 1, 0), at] - reach[np.maximum(one, 0), at]
    cost = cost + _HIDDEN * np.clip(hidden, 0, _HIDDEN_MAX)
    # the right one of two must have the higher number
    cost = np.where(other > one, cost, _DISORDER)
    nothing = (one < 0) | (other < 0)
    return np.asarray(np.where(nothing, np.where(one == other, 0.0, _NOTHING_BESIDE), cost), np.float64)


def _mm_per_px(view: View) -> float:
    rows, columns = view.image_size
    at = view.at_height(np.array([[0.5 * columns, 0.5 * rows], [0.5 * columns + 1.0, 0.5 * rows]]), 0.0)
    return float(np.linalg.norm(at[1] - at[0]))


@lru_cache(maxsize=4)
def _reaching(calibration: Calibration) -> Integers:
    """Say (half, row) how many halves on the belt cross the row, up to this one; the same for all frames."""
    view = calibration.view
    assert view is not None
    rows = np.arange(view.image_size[0], dtype=np.float64)
    x_px = calibration.rest_line_px(rows)
    z = view.lift(np.stack(np.broadcast_arrays(x_px, rows), axis=2), np.arange(len(x_px))[:, None])[..., 2]
    with np.errstate(invalid="ignore"):
        # a half that does not reach a row has no place on the belt there
        return np.asarray(np.cumsum(np.abs(z) < _BELT_MM, axis=0), np.int64)


def _decided(problem: _Problem) -> tuple[Floats, Integers]:
    """Give (piece,) by how much the best label is cheaper than the next, and the label."""
    stripe, alone, edge, pair = problem
    # sums of all messages: exact on a tree, good on loops
    belief = passed_on(alone, edge, pair)
    order = np.sort(belief, axis=1)
    evidence = order[:, 1] - order[:, 0] if order.shape[1] > 1 else np.zeros(len(order))
    best = belief.argmin(axis=1)
    return np.where(np.isfinite(evidence), evidence, _NOTHING), stripe[np.arange(len(stripe)), best]


@kernel
def passed_on(alone: Floats, edge: Integers, pair: Floats) -> Floats:
    """Give (piece, candidate) what a label costs with what the pieces beside it say, and those beside them.

    Messages go both ways along every edge, all at once, each without what its receiver has said itself.
    """
    count, many = edge.shape[0], alone.shape[1]
    belief, told = alone.copy(), np.empty(many)
    message, said = np.zeros((2, count, many)), np.zeros((2, count, many))
    for _ in range(_ROUNDS):
        for way in range(2):
            for n in range(count):
                source = edge[n, way]
                for a in range(many):
                    # without what the receiver said itself, or it would hear its own words
                    told[a] = belief[source, a]
                    if np.isfinite(told[a]):
                        told[a] -= message[1 - way, n, a]
                least = np.inf
                for b in range(many):
                    cheapest = np.inf
                    for a in range(many):
                        cost = told[a] + (pair[n, b, a] if way else pair[n, a, b])
                        cheapest = min(cheapest, cost)
                    said[way, n, b] = cheapest
                    least = min(least, cheapest)
                for b in range(many):
                    # less their least: only differences matter, and sums stay finite
                    said[way, n, b] = _DAMPED * message[way, n, b] + (1.0 - _DAMPED) * (
                        said[way, n, b] - least
                    )
        # all at once: no order of edges is preferred
        message, said = said, message
        belief = alone.copy()
        for way in range(2):
            for n in range(count):
                for a in range(many):
                    belief[edge[n, 1 - way], a] += message[way, n, a]
    return belief
