"""From peaks and planes of light to the cheapest labels, once and with other weights."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry.calibration import Calibration
from roemetry.records import Peaks
from roemetry_coding.plane_weights import WEIGHTS
from roemetry_kernels.coding.label_agreement import agreed
from roemetry_kernels.coding.label_costs import Labels, Steps, labels_of, steps_of
from roemetry_kernels.coding.label_cuts import best_shift
from roemetry_kernels.coding.label_doubts import claimed
from roemetry_kernels.coding.label_graph import Runs, runs_of, shifts_of
from roemetry_kernels.coding.label_pieces import ENDS, between_bare, end_pieces, own_costs, presence_of
from roemetry_kernels.coding.label_sweeps import swept
from roemetry_kernels.coding.label_verdicts import (
    chosen,
    ends_settled,
    favoured,
    stepped,
    verdicts_of,
)
from roemetry_kernels.coding.level_bodies import level_instead, on_end
from roemetry_kernels.coding.lying_still import lying_still
from roemetry_kernels.coding.rest_lines import RestLines
from roemetry_kernels.coding.sight_entries import Entries, entries_of
from roemetry_kernels.coding.sight_lines import SightLines, sight_lines
from roemetry_kernels.coding.tracing import cut_at_rest_lines, trace_fragments

_STEP_MAX_PX = 7.0
_OUTER_SHARE = 0.1
_BELT_ROWS_MIN = 6
_FLICKER_ROWS = 3
_BARE_ROWS = 20
_END_ROWS = 8
_BORDER_ROWS = 12
_PRESENT_SHARE = 0.2
_PRESENT_ROWS_MIN = 15
_GAP_LINES = 20
_RUN_ROWS = (25, 85)
_BELOW_TOLERANCES = 1.5
_KEEP = 1.0
_SMALL_COUNT = 0.4
_STRANGE_COUNT = 0.3
_LEVEL_ROWS = 40
_LEVEL_DEARER = 1.0
_FEW_PEAKS = 4
_LONG_PEAKS = 30
_BODY_PEAKS = 12
_END_LINES = 30
_LOST = 0.25
_SHIFT_GAIN = 6.0
_GAIN_MIN = 0.5
_SHIFTS_MAX = 24
_ROUNDS = 2
_DOUBT_ROUNDS = 2
_DOUBTFUL = 1.0


class Solved(NamedTuple):
    """Verdicts on peaks.

    Attributes
    ----------
    stripe
        (peak,) stripe, −1 for none.
    dearer
        (peak,) by how much the next best verdict is dearer.
    evidence
        (peak,) what the cheapest shift of its stripe, with others, to the next would cost, a sight line.
    trace, piece
        (peak,) trace, and piece of it.
    anchored
        (peak,) True where the piece is belt that reaches the image's border.
    claimed
        (peak,) stripe, or the one that its piece has elsewhere, −1 for none.
    whole
        (peak,) True where the whole piece of its trace says the same.
    there
        (stripe,) how surely a stripe is there at all, 0 to 1.
    entries
        The peaks on the sight lines.
    """

    stripe: Integers
    trace: Integers
    piece: Integers
    anchored: Flags
    claimed: Integers
    dearer: Floats
    evidence: Floats
    whole: Flags
    there: Floats
    entries: Entries


class _Problem(NamedTuple):
    sight: SightLines
    trace: Integers
    line: Integers
    piece: Integers
    piece_line: Integers
    home: Integers
    anchored: Flags
    there: Floats
    entries: Entries
    labels: Labels
    steps: Steps
    u_per_px: float


def solve_planes(peaks: Peaks, calibration: Calibration, rest: RestLines, beyond: float) -> Solved:
    """Give each peak the stripe that makes the cheapest surface.

    Parameters
    ----------
    peaks
        The frame's peaks.
    calibration
        Gives planes (or at least displacements) and the range of heights.
    rest
        Its rest lines.
    beyond
        Heights are looked for up to so many times the highest that the calibration is meant for.
    """
    problem = _posed(peaks, calibration, rest, beyond)
    entries, labels = problem.entries, problem.labels
    nodes = labels.low, labels.many, labels.offset
    own = _own(problem)
    cost = _swept(problem, own)
    best, evidence, moved = _shifted(problem, own, _agreed(problem, cost))
    moved = moved or bool((best != chosen(labels.many, labels.offset, cost)).any())
    for _ in range(_ROUNDS):
        if not moved:
            break
        cost = _swept(problem, favoured(labels.many, labels.offset, best, own, _SHIFT_GAIN))
        best, evidence, moved = _shifted(problem, own, _agreed(problem, cost))
    stripe, dearer, evidence = verdicts_of(
        entries.start, entries.peak, *nodes, problem.sight.line, problem.piece, problem.piece_line,
        cost, best, evidence,
    )  # fmt: skip
    settled = ends_settled(
        problem.trace, problem.piece, problem.piece_line, problem.home, problem.line, stripe
    )  # fmt: skip
    dearer *= settled
    piece_line = problem.piece_line[problem.piece]
    together = _together(problem, stripe, np.ones(stripe.size, np.bool_))
    short = np.clip(together / _LONG_PEAKS, _SMALL_COUNT, 1.0)
    evidence *= short
    whole = settled > 0.0
    claims = claimed(
        problem.trace, problem.piece, problem.piece_line, stripe, settled, problem.there.size, _FEW_PEAKS
    )
    strange = (piece_line >= 0) & (stripe != piece_line)
    evidence[strange & (_together(problem, stripe, piece_line == -1) < _BODY_PEAKS)] *= _STRANGE_COUNT
    level = _maybe_level(problem, peaks.row, best)
    # a few peaks by themselves on a rest line are what is left of belt, at the edge of a shadow
    alone = np.bincount(problem.trace)[problem.trace] < _BELT_ROWS_MIN
    whole &= ~(alone & (problem.line >= 0) & (problem.line != stripe))
    for _ in range(_DOUBT_ROUNDS):
        # a label may be propped up by others that are themselves in doubt
        doubtful = (stripe >= 0) & ((evidence < _DOUBTFUL) | ~whole)
        if not doubtful.any():
            break
        evidence = np.minimum(evidence, short * _without(problem, own, best, doubtful))
    # Belt that may be a level step is no reason to doubt the body beside it: that stands above the step, too.
    whole &= ~level
    if level.any():
        belt = problem.line == stripe
        doubtful = (stripe >= 0) & ((evidence < _DOUBTFUL) | ~whole)
        evidence = np.where(
            belt, np.minimum(evidence, short * _without(problem, own, best, doubtful)), evidence
        )
    return Solved(
        stripe,
        problem.trace,
        problem.piece,
        problem.anchored[problem.piece],
        claims,
        dearer,
        evidence,
        whole,
        problem.there,
        problem.entries,
    )


def _together(problem: _Problem, stripe: Integers, counted: Flags) -> Integers:
    """Give (peak,) how many of its trace that are counted have its stripe."""
    cell = problem.trace * (problem.there.size + 1) + stripe + 1
    return np.asarray(np.bincount(cell[counted], minlength=int(cell.max()) + 1)[cell])


def _agreed(problem: _Problem, cost: Floats) -> Integers:
    labels, piece = problem.labels, problem.piece
    return np.asarray(agreed(
        problem.entries.start, problem.entries.peak, labels.low, labels.many, labels.offset, piece,
        problem.piece_line, problem.there.size, cost,
    ))  # fmt: skip


def _maybe_level(problem: _Problem, row: Integers, best: Integers) -> Flags:
    """Mark (peak,) belt that may be a level body's, where that goes on for some rows along a piece."""
    entries, labels, piece = problem.entries, problem.labels, problem.piece
    found = level_instead(
        entries.start, entries.peak, labels.low, labels.many, labels.offset, labels.height,
        labels.label_mm, best, problem.line, *problem.steps, WEIGHTS.surface,
        WEIGHTS.unseen, problem.there, _LEVEL_DEARER, piece.size,
    )  # fmt: skip
    return np.asarray(on_end(row, piece, found, _LEVEL_ROWS, _FLICKER_ROWS))


def _shifted(problem: _Problem, own: Floats, best: Integers) -> tuple[Integers, Floats, bool]:
    """Shift runs of one stripe as long as that is cheaper.

    Gives (entry,) nodes; (entry,) what the cheapest shift that an entry's run is part of would cost, a sight
    line; and whether anything was shifted.
    """
    labels = problem.labels
    moved = False
    for _ in range(_SHIFTS_MAX):
        runs = _runs(problem, own, best)
        by, gain = _best_of_shifts(runs)
        if gain >= _GAIN_MIN:
            moved = True
            best = stepped(labels.many, labels.offset, best, np.where(runs.of >= 0, by[runs.of], 0))
            continue
        dearer, by = _shifts(problem, runs)
        evidence = np.where(runs.of >= 0, dearer[runs.of], np.inf)
        if not by.any():
            break
        moved = True
        best = stepped(labels.many, labels.offset, best, np.where(runs.of >= 0, by[runs.of], 0))
    return best, evidence, moved


def _runs(problem: _Problem, own: Floats, best: Integers) -> Runs:
    entries, labels = problem.entries, problem.labels
    return Runs(*runs_of(
        entries.start, entries.peak, entries.before, entries.tie, labels.low, labels.many, labels.offset,
        problem.piece, best, own, *problem.steps, WEIGHTS.surface, WEIGHTS.unseen,
    ))  # fmt: skip


def _shifts(problem: _Problem, runs: Runs) -> tuple[Floats, Integers]:
    entries = problem.entries
    lines = entries.start.size - 1
    stray = np.zeros(runs.stripe.size, np.bool_)
    dearer, by = shifts_of(
        runs.own, runs.one, runs.other, runs.both, runs.disorder, runs.start, runs.edge, runs.first,
        runs.last, runs.size, stray, lines, _GAIN_MIN,
    )  # fmt: skip
    return dearer, by


def _without(problem: _Problem, own: Floats, best: Integers, doubtful: Flags) -> Floats:
    """Give (peak,) evidence as it is without the peaks that are in doubt; infinite for these."""
    entries, labels = problem.entries, problem.labels
    left = np.where(doubtful[entries.peak], labels.offset[1:] - 1, best)
    runs = _runs(problem, own, left)
    found = np.full(doubtful.size, np.inf)
    if not runs.stripe.size:
        return found
    dearer, _ = _shifts(problem, runs)
    np.minimum.at(found, entries.peak, np.where(runs.of >= 0, dearer[runs.of], np.inf))
    return found


def _best_of_shifts(runs: Runs) -> tuple[Integers, float]:
    """Give (run,) how far to move it, and the gain, of the best set of runs to move up or down by one."""
    found = [(way, *best_shift(runs.own, runs.one, runs.other, runs.both, 1, way)) for way in (1, -1)]
    way, moved, change = min(found, key=lambda shift: shift[2])
    return np.where(moved, way, 0), -change


def _posed(peaks: Peaks, calibration: Calibration, rest: RestLines, beyond: float) -> _Problem:
    stripes, rows = rest.x_px.shape
    sight = sight_lines(peaks, calibration, rest.x_px)
    trace, traces = trace_fragments(peaks.row_start, peaks.x_px, _STEP_MAX_PX)
    line = lying_still(
        peaks.row, peaks.x_px, trace, rest.line, rest.x_px, rest.tolerance_px, rest.offset_px,
        math.ceil(_OUTER_SHARE * rows),
    )  # fmt: skip
    alone = between_bare(peaks.row, line, stripes, rows, _BARE_ROWS)
    state = np.where(alone, line + stripes, line)
    piece, piece_line = cut_at_rest_lines(trace, state, traces, _BELT_ROWS_MIN, _FLICKER_ROWS)
    piece_line = np.where(piece_line >= stripes, piece_line - stripes, piece_line)
    full = int(_PRESENT_SHARE * rows)
    presence = presence_of(
        sight.line, piece, piece_line, sight.enters, sight.leaves, sight.plane.shape[0], full,
        min(_PRESENT_ROWS_MIN, full), _END_LINES, _LOST,
    )  # fmt: skip
    piece, piece_line, anchored, home = end_pieces(
        peaks.row, piece, piece_line, rows, _END_ROWS, _BORDER_ROWS
    )
    u_per_px = float(np.nanmedian(sight.u_max - sight.u_min)) / peaks.image_size[1]
    entries = Entries(
        *entries_of(
            peaks.row, trace, piece, piece_line[piece] == ENDS, sight.line, sight.u, sight.plane.shape[0],
            u_per_px, WEIGHTS.tie_whole, WEIGHTS.tie_cut, WEIGHTS.tie_gap, _GAP_LINES,
        )
    )  # fmt: skip
    slack_mm = rest.tolerance_px / np.abs(calibration.displacement_px_per_mm)
    low_mm, high_mm = calibration.height_range_mm
    # belt that lies on its rest line from the image's border on is no product out of range: that saves time
    reach = np.where(anchored[piece[entries.peak]], 1.0, beyond)
    labels = Labels(
        *labels_of(
            entries.start, entries.u, sight.plane, min(low_mm, 0.0) - _BELOW_TOLERANCES * slack_mm,
            high_mm + slack_mm, reach,
        )
    )  # fmt: skip
    steps = Steps(
        *steps_of(
            entries.start, entries.u, *labels, sight.plane, sight.lean[entries.peak], sight.u_min,
            sight.u_max, presence, u_per_px, 2.0 * slack_mm,
        )
    )  # fmt: skip
    return _Problem(
        sight, trace, line, piece, piece_line, home, anchored, presence.max(axis=0), entries, labels,
        steps, u_per_px,
    )  # fmt: skip


def _own(problem: _Problem) -> Floats:
    labels = problem.labels
    return np.asarray(own_costs(
        problem.entries.peak, labels.low, labels.many, labels.offset, problem.line, problem.piece,
        problem.piece_line, problem.anchored, problem.there, WEIGHTS.false_peak, WEIGHTS.on_rest,
        WEIGHTS.long_run, WEIGHTS.anchor, WEIGHTS.on_end, WEIGHTS.absent, _RUN_ROWS,
    ))  # fmt: skip


def _swept(problem: _Problem, own: Floats) -> Floats:
    """Give (node,) costs."""
    entries, labels = problem.entries, problem.labels
    return np.asarray(swept(
        entries.start, entries.before, entries.after, entries.tie, labels.low, labels.many, labels.offset,
        own, *problem.steps, WEIGHTS.surface, WEIGHTS.unseen, _KEEP,
    ))  # fmt: skip
