"""From peaks and planes of light to the cheapest labels, once and with other weights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry.calibration import Calibration
from roemetry.records import Peaks
from roemetry_kernels.label_costs import Labels, Steps, labels_of, steps_of
from roemetry_kernels.label_pieces import ENDS, end_pieces, own_costs, pieces_agree, presence_of
from roemetry_kernels.label_sweeps import swept
from roemetry_kernels.label_verdicts import (
    chosen,
    left_out,
    line_costs,
    mixed,
    shifted,
    verdicts_of,
)
from roemetry_kernels.rest_lines import RestLines
from roemetry_kernels.sight_entries import Entries, entries_of
from roemetry_kernels.sight_lines import SightLines, sight_lines
from roemetry_kernels.tracing import cut_at_rest_lines, nearest_rest, trace_fragments


@dataclass(frozen=True, slots=True)
class Weights:
    """What speaks for and against a label; the unit is a surface step of one label height.

    Attributes
    ----------
    surface
        A step of the surface between two stripes by the height that one stripe spacing stands for.
    unseen
        A stripe left out that would be seen.
    false_peak
        A peak left out.
    on_rest, long_run, anchor
        Gain of a peak on its own rest line; more if it is one of a long run; more if that begins at the
        image's border.
    on_end
        The same at the end of a run, where a body may begin.
    absent
        A stripe whose rest line shows nothing.
    tie_whole, tie_cut, tie_gap
        Change of stripe within a piece of a trace, where it was cut, and over a gap.
    agreed
        How often pieces are made to agree.
    """

    surface: float = 1.0
    unseen: float = 4.0
    false_peak: float = 6.0
    on_rest: float = 0.2
    long_run: float = 0.2
    anchor: float = 4.0
    on_end: float = 1.0
    absent: float = 3.0
    tie_whole: float = 20.0
    tie_cut: float = 1.5
    tie_gap: float = 6.0
    agreed: int = 2


BASE = Weights()
OTHERS = (replace(BASE, unseen=1.5, agreed=1), replace(BASE, surface=3.0, agreed=1))
"""Other weightings, each of which would be as good a guess: what they do not agree on is refused."""

_STEP_MAX_PX = 7.0
_BELT_ROWS_MIN = 6
_FLICKER_ROWS = 3
_END_ROWS = 8
_BORDER_ROWS = 12
_PRESENT_SHARE = 0.2
_PRESENT_ROWS_MIN = 15
_GAP_LINES = 20
_RUN_ROWS = (25, 85)
_BELOW_TOLERANCES = 1.5
_KEEP = 1.0
_ENDS_COUNT = 0.5
_MAJORITY = 0.9
_END_LINES = 30
_LOST = 0.25
_SHIFT_GAIN = 6.0
_RIVALS = 4
_LEFT_OUT_LINES = 5.0
ROUNDS = 2


class Solved(NamedTuple):
    """Verdicts on peaks.

    Attributes
    ----------
    stripe
        (peak,) stripe, −1 for none.
    dearer
        (peak,) by how much the next best verdict is dearer.
    unanimous
        (peak,) True where all weightings say the same, and so does the whole piece.
    there
        (stripe,) how surely a stripe is there at all, 0 to 1.
    entries
        The peaks on the sight lines.
    """

    stripe: Integers
    dearer: Floats
    unanimous: Flags
    there: Floats
    entries: Entries


class _Problem(NamedTuple):
    sight: SightLines
    line: Integers
    piece: Integers
    piece_line: Integers
    anchored: Flags
    there: Floats
    entries: Entries
    labels: Labels
    steps: Steps


class _Shift(NamedTuple):
    where: Flags
    stripe: int
    by: int


def solve_planes(
    peaks: Peaks, calibration: Calibration, rest: RestLines, others: tuple[Weights, ...] = OTHERS
) -> Solved:
    """Give each peak the stripe that makes the cheapest surface.

    Parameters
    ----------
    peaks
        The frame's peaks.
    calibration
        Gives planes (or at least displacements) and the range of heights.
    rest
        Its rest lines.
    others
        Further weightings that must agree.
    """
    problem = _posed(peaks, calibration, rest)
    entries, labels = problem.entries, problem.labels
    nodes = labels.low, labels.many, labels.offset
    cost = _solved(problem, BASE)
    for _ in range(ROUNDS):
        best = chosen(labels.many, labels.offset, cost)
        least = _energy(problem, best).sum()
        improved = False
        for shift in _rivals(problem, best):
            rival = _solved(problem, BASE, best, shift)
            total = _energy(problem, chosen(labels.many, labels.offset, rival)).sum()
            if total < least:
                cost, least, improved = rival, total, True
        if not improved:
            break
    stripe, dearer = verdicts_of(entries.start, entries.peak, *nodes, problem.sight.line, problem.piece, cost)
    dearer[problem.piece_line[problem.piece] == ENDS] *= _ENDS_COUNT
    unanimous = np.ones(stripe.size, np.bool_)
    for weights in others:
        other, _ = verdicts_of(
            entries.start, entries.peak, *nodes, problem.sight.line, problem.piece, _solved(problem, weights)
        )
        unanimous &= other == stripe
    unanimous &= ~mixed(problem.piece, problem.piece_line, stripe, problem.there.size, _MAJORITY)
    return Solved(stripe, dearer, unanimous, problem.there, problem.entries)


def _posed(peaks: Peaks, calibration: Calibration, rest: RestLines) -> _Problem:
    _stripes, rows = rest.x_px.shape
    sight = sight_lines(peaks, calibration, rest.x_px)
    trace, traces = trace_fragments(peaks.row_start, peaks.x_px, _STEP_MAX_PX)
    line, _ = nearest_rest(peaks.row, peaks.x_px, rest.x_px, rest.tolerance_px)
    piece, piece_line = cut_at_rest_lines(trace, line, traces, _BELT_ROWS_MIN, _FLICKER_ROWS)
    full = int(_PRESENT_SHARE * rows)
    presence = presence_of(
        sight.line, piece, piece_line, sight.enters, sight.leaves, sight.plane.shape[0], full,
        min(_PRESENT_ROWS_MIN, full), _END_LINES, _LOST,
    )  # fmt: skip
    piece, piece_line, anchored = end_pieces(peaks.row, piece, piece_line, rows, _END_ROWS, _BORDER_ROWS)
    u_per_px = float(np.nanmedian(sight.u_max - sight.u_min)) / peaks.image_size[1]
    entries = Entries(
        *entries_of(
            peaks.row, trace, piece, piece_line[piece] == ENDS, sight.line, sight.u, sight.plane.shape[0],
            u_per_px, BASE.tie_whole, BASE.tie_cut, BASE.tie_gap, _GAP_LINES,
        )
    )  # fmt: skip
    slack_mm = rest.tolerance_px / np.abs(calibration.displacement_px_per_mm)
    low_mm, high_mm = calibration.height_range_mm
    labels = Labels(
        *labels_of(
            entries.start, entries.u, sight.plane, min(low_mm, 0.0) - _BELOW_TOLERANCES * slack_mm,
            high_mm + slack_mm,
        )
    )  # fmt: skip
    steps = Steps(
        *steps_of(
            entries.start, entries.u, *labels, sight.plane, sight.lean[entries.peak], sight.u_min,
            sight.u_max, presence, u_per_px,
        )
    )  # fmt: skip
    return _Problem(sight, line, piece, piece_line, anchored, presence.max(axis=0), entries, labels, steps)


def _solved(
    problem: _Problem, weights: Weights, begun: Integers | None = None, shift: _Shift | None = None
) -> Floats:
    """Give (node,) costs; begun from (entry,) nodes with a part of the body shifted."""
    entries, labels, steps = problem.entries, problem.labels, problem.steps
    nodes = labels.low, labels.many, labels.offset
    own = _own(problem, weights)
    total = own
    if begun is not None and shift is not None:
        total = shifted(
            entries.start, entries.peak, *nodes, begun, problem.piece, problem.piece_line, own, *shift,
            _SHIFT_GAIN,
        )  # fmt: skip
    for turn in range(weights.agreed + 1):
        cost = swept(
            entries.start, entries.before, entries.after, entries.tie, *nodes, total, *steps, weights.surface,
            weights.unseen, _KEEP,
        )  # fmt: skip
        if turn < weights.agreed:
            stripes = problem.there.size
            total = pieces_agree(entries.peak, *nodes, problem.piece, problem.piece_line, stripes, cost, own)
    return np.asarray(cost)


def _rivals(problem: _Problem, best: Integers) -> list[_Shift]:
    """Name shifts of a part of the body that would bring back a stripe left out without need."""
    entries, labels, steps = problem.entries, problem.labels, problem.steps
    cost = left_out(
        entries.start, labels.low, labels.many, labels.offset, best, steps.pair, steps.pair_start,
        steps.unseen, problem.there.size,
    )  # fmt: skip
    lines = cost.sum(axis=0)
    rivals = []
    for stripe in np.argsort(-lines)[:_RIVALS]:
        if lines[stripe] > _LEFT_OUT_LINES:
            rivals += [_Shift(np.ones(cost.shape[0], np.bool_), int(stripe), by) for by in (1, -1)]
    return rivals


def _own(problem: _Problem, weights: Weights) -> Floats:
    labels = problem.labels
    return np.asarray(own_costs(
        problem.entries.peak, labels.low, labels.many, labels.offset, problem.line, problem.piece,
        problem.piece_line, problem.anchored, problem.there, weights.false_peak, weights.on_rest,
        weights.long_run, weights.anchor, weights.on_end, weights.absent, _RUN_ROWS,
    ))  # fmt: skip


def _energy(problem: _Problem, best: Integers) -> Floats:
    """Give (line,) what the chosen nodes cost with the base's weights."""
    entries, labels = problem.entries, problem.labels
    return np.asarray(line_costs(
        entries.start, entries.before, entries.tie, labels.low, labels.many, labels.offset, best,
        _own(problem, BASE), *problem.steps, BASE.surface, BASE.unseen,
    ))  # fmt: skip
