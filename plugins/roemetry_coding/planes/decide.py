"""From the cheapest labels to verdicts on peaks: how sure each is, and what is refused.

Model. A peak takes the label of its entry on the nearest line; a piece that is nearly all one stripe is no
heap of false peaks, so none of its peaks is left out alone. Two figures say how sure a label is: by how much
the entry's next best label is dearer (`dearer`), and what the cheapest shift by one stripe of its run, with
all that must go along, would cost on each line touched (`evidence`, see `shifts`). Evidence counts less where
a trace has few peaks of the stripe, and where belt became a body; then it is taken once more without the
labels that are in doubt, twice, for they may prop up others.

Both figures were compared with truth on the scenes of two simulators that share no line (ray-cast skeins and
shapes on rigs of 11 and 21 stripes, whole and damaged; Monte-Carlo renderings of two rigs): how often a label
with such a figure was wrong is what `_SHIFTED` and `_ALONE` hold, made monotone. The margin m of the larger
error says that a label is wrong with a probability of about (1 − m)/2. What is below the margin asked for is
refused; what the vetoes mark is, too.

Fails where an assumption of `graph` does: the margin knows nothing of it. So no error is stated below 5·10⁻⁵.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records import AMBIGUOUS, Peaks, Reason
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry_coding.planes.graph import WEIGHTS, Candidates
from roemetry_coding.planes.lines import Entries
from roemetry_coding.planes.pieces import ENDS, Pieces
from roemetry_coding.planes.shifts import evidence_without
from roemetry_coding.planes.solve import Problem, Solved
from roemetry_coding.planes.vetoes import (
    body_of,
    claimed,
    denies_belt,
    ends_settled,
    going_on,
    left_over,
    may_be_level,
    missing_amid,
    nearly_belt,
    numbered_by_pattern,
    out_of_order,
)
from roemetry_kernels.compiling import kernel
from roemetry_kernels.consistency import refuse_unexplained_gaps
from roemetry_kernels.rest_lines import RestLines

_SHIFTED = (
    (0.3, 0.5), (0.6, 0.1), (0.8, 0.03), (1.0, 6e-3), (1.5, 3e-3), (2.0, 1e-3), (3.0, 2e-4), (8.0, 5e-5),
)  # fmt: skip
"""Evidence, and how often a label with it was wrong: the more, the less often."""
_ALONE = ((0.0, 0.03), (2.0, 0.02), (3.0, 8e-3), (4.0, 5e-3), (6.0, 5e-4), (10.0, 1e-4))
"""By how much the second best is dearer, and how often a label was wrong whose evidence was large. Both
columns times 1.25 change up to 2.3 % of an image's points, and volumes from slices by up to 1.7 %; times 0.8
0.6 and 0.4 %."""
_FEW_PEAKS, _FEW_COUNT = 4, 0.5
"""A piece of fewer peaks has hardly anything that bears it out: its difference counts for half."""
_LONG_PEAKS, _SMALL_COUNT = 30, 0.4
"""Evidence counts in full for a trace with so many labels of a stripe, and down to this share for fewer: the
ends of a run, where its costs are least known, are more of a short one."""
_BODY_PEAKS, _STRANGE_COUNT = 12, 0.3
"""Evidence counts for so little where a piece of belt became another stripe and fewer peaks of its trace that
are off all rest lines have that stripe."""
_PATTERN_EVIDENCE, _PATTERN_DEARER = 1.5, 6.0
"""What a number counts for that a fan's pattern gives: a margin of 0.994."""
_DOUBTFUL = 1.0
"""Evidence below which a label may not prop up another; a margin of 0.988."""
_DOUBT_ROUNDS = 2
"""More rounds doubt no more."""
_WHOLE_PEAKS, _WHOLE_SHARE = 6, 0.75
"""A piece with as many peaks, this share of them one stripe, holds no false ones."""
_LEFT_SHARE, _BODY_LEFT_SHARE = 0.5, 0.75
"""Of a piece with fewer of its labels left, none is kept; of a body where a gap is unexplained. With 0.4 of a
piece nothing changes, with 0.62 up to 7 % of an image's points and 0.2 % of a volume."""
_ABOVE_ODDS = 50.0
"""A product higher than the calibration is meant for is so many times less likely than one that is not."""
_ABOVE_SHARE_MIN = 0.25
"""Of a product a twentieth too high about this share of the body points lies above the range. Fewer go:
pieces by themselves, where belt is missing, that nothing else keeps from being high."""
_ALONE_PEAKS = 6
"""A trace of fewer peaks on another stripe's rest line is what is left of that belt at a shadow's edge."""
_FOLLOWED_PEAKS = 5
"""Some trace of a stripe on a body is followed over so many peaks, or the others are specks: 2 % of white
pixels gave a stripe that a skein hid 14 peaks in pieces of at most three, and the skein 36 % more volume."""
_CONTESTED_PEAKS = 4
"""Order must speak against so many peaks of a piece before the piece is contested: at a body's edge its
stripe may be seen twice for a row or two."""


class Verdicts(NamedTuple):
    """Verdicts on peaks."""

    stripe: Integers
    claims: Integers
    """stripe, claims: (peak,) stripe; stripe, or the one that its piece claims; −1 for none."""
    height_mm: Floats
    """(peak,) height as that stripe, 0 for none."""
    dearer: Floats
    evidence: Floats
    """dearer, evidence: (peak,) by how much the next best verdict is dearer; what the cheapest shift would
    cost, a line."""
    sure: Flags
    """(peak,) False where a veto speaks against it, whatever the figures."""


def stripes_of(problem: Problem, solved: Solved) -> Integers:
    """Give (peak,) the stripes that `verdicts_of` judges, −1 for none."""
    return _labels_of(problem, solved)[0]


def _labels_of(problem: Problem, solved: Solved) -> tuple[Integers, Floats, Floats, Floats]:
    labels: tuple[Integers, Floats, Floats, Floats] = _peak_labels(
        problem.entries, problem.candidates, problem.pieces, problem.lines.line, solved.cost, solved.best,
        solved.evidence,
    )  # fmt: skip
    return labels


def verdicts_of(problem: Problem, solved: Solved, row: Integers) -> Verdicts:
    """Judge the labels of (peak,) peaks in sorted rows."""
    pieces, candidates, entries = problem.pieces, problem.candidates, problem.entries
    stripe, height_mm, dearer, evidence = _labels_of(problem, solved)
    settled = ends_settled(pieces, stripe)
    # an end's label is as sure as the trace around it says
    dearer *= settled
    dearer[np.bincount(pieces.of)[pieces.of] < _FEW_PEAKS] *= _FEW_COUNT
    sure = settled > 0.0
    alone = np.bincount(pieces.trace)[pieces.trace] < _ALONE_PEAKS
    sure &= ~(alone & (pieces.line >= 0) & (pieces.line != stripe))
    short = np.clip(
        _together(problem, stripe, np.ones(stripe.size, np.bool_)) / _LONG_PEAKS, _SMALL_COUNT, 1.0
    )
    evidence *= short
    # belt by its rest line, another stripe by its label: an edge
    of_rest = pieces.rest[pieces.of]
    strange = (of_rest >= 0) & (stripe != of_rest)
    evidence[strange & (_together(problem, stripe, of_rest == -1) < _BODY_PEAKS)] *= _STRANGE_COUNT

    def without(doubtful: Flags) -> Floats:
        found = evidence_without(
            entries, candidates, pieces.of, solved.best, problem.own, problem.costs, WEIGHTS, doubtful
        )
        return np.asarray(short * found)

    before = np.zeros(stripe.size, np.bool_)
    # labels that are in doubt may prop each other up; the evidence is taken without them
    for _ in range(_DOUBT_ROUNDS):
        doubtful = (stripe >= 0) & ((evidence < _DOUBTFUL) | ~sure)
        if (doubtful == before).all():  # nothing, or nothing new: the evidence would stay as it is
            break
        evidence, before = np.minimum(evidence, without(doubtful)), doubtful
    level = may_be_level(entries, candidates, pieces, solved.best, problem.costs, WEIGHTS, problem.there, row)
    sure &= ~level
    if level.any():
        # belt that may be a level step is no reason to doubt the body beside it: that stands above it, too
        doubtful = (stripe >= 0) & ((evidence < _DOUBTFUL) | ~sure)
        evidence = np.where(pieces.line == stripe, np.minimum(evidence, without(doubtful)), evidence)
    claims = claimed(pieces, stripe, problem.there.size)
    return Verdicts(stripe, claims, height_mm, dearer, evidence, sure)


def decided(
    problem: Problem,
    verdicts: Verdicts,
    peaks: Peaks,
    calibration: Calibration,
    rest: RestLines,
    margin_min: float,
    longest_gap_rows: int,
) -> tuple[Integers, Floats, list[Reason]]:
    """Refuse what is in doubt or out of order; give (peak,) stripe or verdict, margin, and what to say."""
    pieces, stripes = problem.pieces, problem.there.size
    # a fan's pattern may say the number outright
    verdicts = _renumbered(verdicts, peaks, rest, calibration.displacement_px_per_mm)
    stripe = verdicts.stripe.copy()
    bodies = body_of(peaks.row, verdicts.stripe, rest)
    denies = denies_belt(problem.entries, pieces.line, verdicts.stripe, bodies, peaks.amplitude)
    margin = margin_of(verdicts.dearer, verdicts.evidence)
    # a tolerance of the rest line, in height
    slack_mm = rest.tolerance_px / np.abs(calibration.displacement_px_per_mm)
    above = verdicts.height_mm > calibration.height_range_mm[1] + slack_mm[np.maximum(stripe, 0)]
    # what rises above the range out of a body within it is that body's, and the product is refused for it
    if above.any():
        above &= _mostly(above, body_of(peaks.row, stripe, rest))
    # a label above the range must be so much surer
    margin[above] = np.maximum(1.0 - _ABOVE_ODDS * (1.0 - margin[above]), 0.0)
    # only a few: they are pieces, not a product out of range, and are refused by themselves
    if np.count_nonzero(above) <= _ABOVE_SHARE_MIN * np.count_nonzero((stripe >= 0) & (stripe != rest.line)):
        stripe[above] = AMBIGUOUS
    # then the vetoes, one after another; those from order on see what the ones before left
    stripe[(stripe >= 0) & ~(verdicts.sure & (margin >= margin_min))] = AMBIGUOUS
    stripe[denies] = AMBIGUOUS
    stripe[missing_amid(problem.entries, verdicts.stripe, bodies, problem.there)] = AMBIGUOUS
    stripe[out_of_order(problem.entries, peaks.row, rest.line, stripe, stripes)] = AMBIGUOUS
    # also of what pieces claim: a piece that order often speaks against is refused where it has labels
    wrong = out_of_order(problem.entries, peaks.row, rest.line, verdicts.claims, stripes)
    often = np.bincount(pieces.of[wrong], minlength=pieces.rest.size) >= _CONTESTED_PEAKS
    stripe[wrong & often[pieces.of] & (stripe >= 0)] = AMBIGUOUS
    stripe, gaps = refuse_unexplained_gaps(
        peaks,
        stripe,
        rest.line,
        rest.x_px,
        calibration.displacement_px_per_mm,
        longest_gap_rows,
        on_bodies_too=True,
    )
    # a stripe interrupted with nothing in sight to hide it: the doubt is followed along stripe and trace
    if gaps:
        partly = left_over(pieces.of, verdicts.stripe, stripe, _BODY_LEFT_SHARE)
        stripe[partly & (rest.line != verdicts.stripe)] = AMBIGUOUS
        level = ~pieces.anchored[pieces.of] & nearly_belt(peaks, verdicts.stripe, rest)
        for along in (verdicts.stripe, pieces.trace):
            stripe[going_on(peaks.row, along, level, stripe < 0, longest_gap_rows)] = AMBIGUOUS
    # last: what is left of a piece after all that must be most of it
    stripe[left_over(pieces.of, verdicts.stripe, stripe, _LEFT_SHARE)] = AMBIGUOUS
    stripe[_never_followed(problem, stripe, body_of(peaks.row, stripe, rest))] = AMBIGUOUS
    # what a pattern contradicts even now is wrong
    still, wrong = numbered_by_pattern(peaks.row, peaks.x_px, stripe, rest)
    stripe[wrong | (still != 0)] = AMBIGUOUS
    return stripe, margin, gaps


def _never_followed(problem: Problem, stripe: Integers, body: Integers) -> Flags:
    """Mark (peak,) labels of stripes of which a body shows short traces alone."""
    on = body > 0
    together = _together(problem, np.maximum(stripe, -1), on)
    cell = body * problem.there.size + np.maximum(stripe, 0)
    # the longest trace of each stripe on each body
    most = np.zeros(int(cell.max(initial=0)) + 1, np.int64)
    np.maximum.at(most, cell[on], together[on])
    return np.asarray(on & (most[cell] < _FOLLOWED_PEAKS))


def _mostly(which: Flags, body: Integers) -> Flags:
    """Mark (peak,) peaks of bodies most of which are marked."""
    of_body = np.bincount(body, minlength=1)
    share = np.bincount(body, which, minlength=of_body.size) / np.maximum(of_body, 1)
    return np.asarray((body > 0) & (share[body] > 0.5))


def _renumbered(verdicts: Verdicts, peaks: Peaks, rest: RestLines, px_per_mm: Floats) -> Verdicts:
    """Give whole bodies the number that the fan's pattern says, where it says one."""
    shift, _ = numbered_by_pattern(peaks.row, peaks.x_px, verdicts.stripe, rest)
    # on most frames no body is told
    moved = np.flatnonzero(shift)
    if not moved.size:
        return verdicts
    stripe, claims = verdicts.stripe.copy(), verdicts.claims.copy()
    evidence, dearer = verdicts.evidence.copy(), verdicts.dearer.copy()
    stripe[moved] += shift[moved]
    claims[moved] = stripe[moved]
    evidence[moved], dearer[moved] = _PATTERN_EVIDENCE, _PATTERN_DEARER
    height_mm = verdicts.height_mm.copy()
    off_px = peaks.x_px[moved] - rest.x_px[stripe[moved], peaks.row[moved]]
    height_mm[moved] = off_px / px_per_mm[stripe[moved]]
    return Verdicts(stripe, claims, height_mm, dearer, evidence, verdicts.sure)


def margin_of(dearer: Floats, evidence: Floats) -> Floats:
    """Give (peak,) margins, 0 to 1.

    Parameters
    ----------
    dearer
        (peak,) by how much the second-best verdict is dearer.
    evidence
        (peak,) what the cheapest shift of the whole run, and others with it, costs a line.

    Returns
    -------
    numpy.ndarray
        A margin m says that the label is wrong with a probability of about (1 − m)/2; 0, that it is wrong as
        often as not, or more often.
    """
    # the worse of both figures; a probability of 0.5 is a margin of 0
    wrong = np.maximum(_counted(dearer, _ALONE), _counted(evidence, _SHIFTED))
    return np.asarray(1.0 - 2.0 * wrong)


def _counted(value: Floats, points: tuple[tuple[float, float], ...]) -> Floats:
    """Interpolate the logarithm of a share between points."""
    at, share = np.array(points).T
    # in most frames most labels lie beyond the last point
    found, within = np.full(value.size, share[-1]), np.flatnonzero(~(value >= at[-1]))
    found[within] = np.exp(np.interp(value[within], at, np.log(share)))
    return found


def _together(problem: Problem, stripe: Integers, counted: Flags) -> Integers:
    """Give (peak,) how many of its trace that are counted have its stripe."""
    # −1 for none takes the first place
    cell = problem.pieces.trace * (problem.there.size + 1) + stripe + 1
    return np.asarray(np.bincount(cell[counted], minlength=int(cell.max()) + 1)[cell])


@kernel
def _peak_labels(
    entries: Entries, candidates: Candidates, pieces: Pieces, line: Floats, cost: Floats, best: Integers,
    evidence: Floats,
) -> tuple[Integers, Floats, Floats, Floats]:  # fmt: skip
    """Give (peak,) stripe or −1, height, how much dearer the next best is, and evidence; of its nearest line.

    A peak between two lines takes the verdict on which its neighbours in its piece agree; where lines
    are more than a row apart, at the end of a piece, that of the only one.
    """
    low, count, offset = candidates.low, candidates.many, candidates.offset
    piece, piece_line = pieces.of, pieces.rest
    peaks = line.shape[0]
    entry = _nearest_entry(entries.start, entries.peak, count, line)
    votes, voted = np.zeros(piece_line.shape[0], np.int64), np.full(piece_line.shape[0], -1, np.int64)
    size, least = np.zeros(piece_line.shape[0], np.int64), np.full(piece_line.shape[0], np.inf)
    # first round: majority of each piece (Boyer and Moore 1991); second: how large it is
    for turn in range(2):
        for p in range(peaks):
            i, f = entry[p], piece[p]
            if i < 0 or piece_line[f] == ENDS:
                continue
            k = best[i] - offset[i]
            if turn == 0:
                if k < count[i]:
                    if votes[f] == 0:
                        voted[f] = low[i] + k
                    votes[f] += 1 if voted[f] == low[i] + k else -1
            else:
                size[f] += 1
                if k < count[i] and voted[f] == low[i] + k:
                    votes[f] += 1
                    least[f] = min(least[f], evidence[i])
        if turn == 0:
            # counted anew
            votes[:] = 0
    stripe = np.full(peaks, -1, np.int64)
    dearer, sure, height_mm = np.zeros(peaks), np.zeros(peaks), np.zeros(peaks)
    for p in range(peaks):
        i, f = entry[p], piece[p]
        if i < 0:
            continue
        node, sure[p] = best[i], evidence[i]
        whole = size[f] >= _WHOLE_PEAKS and votes[f] >= _WHOLE_SHARE * size[f]
        k = voted[f] - low[i]
        whole = whole and 0 <= k < count[i]
        # left out alone amid a piece of one stripe: it takes that label
        if whole and node == offset[i + 1] - 1:
            node, sure[p] = offset[i] + k, least[f]
        second = np.inf
        # the label for none is no rival within a whole piece
        for n in range(offset[i], offset[i + 1] - whole):
            if n != node:
                second = min(second, cost[n])
        k = node - offset[i]
        stripe[p] = low[i] + k if k < count[i] else -1
        dearer[p] = max(second - cost[node], 0.0)
        height_mm[p] = candidates.height[node]
    # peaks without an entry: between the nearest of their piece before and behind
    before = np.full(piece.shape[0], -1, np.int64)
    last = np.full(piece.shape[0], -1, np.int64)
    for p in range(peaks):
        if entry[p] < 0:
            before[p] = last[piece[p]]
        else:
            last[piece[p]] = p
    last[:] = -1
    for p in range(peaks - 1, -1, -1):
        if entry[p] >= 0:
            last[piece[p]] = p
            continue
        one, other = before[p], last[piece[p]]
        if entries.apart > 1:
            # rows at the end of a piece may lie beyond its last line, and have one neighbour
            if one < 0 and other >= 0 and abs(line[p] - line[other]) < 1.0:
                one = other
            elif other < 0 and one >= 0 and abs(line[p] - line[one]) < 1.0:
                other = one
        if one >= 0 and other >= 0 and stripe[one] == stripe[other]:
            stripe[p], dearer[p] = stripe[one], min(dearer[one], dearer[other])
            sure[p] = min(sure[one], sure[other])
            height_mm[p] = 0.5 * (height_mm[one] + height_mm[other])
    return stripe, height_mm, dearer, sure


@kernel
def _nearest_entry(start: Integers, peak: Integers, count: Integers, line: Floats) -> Integers:
    """Give (peak,) its entry on the line nearest to it, −1 for none that could be any stripe."""
    entry = np.full(line.shape[0], -1, np.int64)
    nearest = np.full(line.shape[0], np.inf)
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            off = abs(line[peak[i]] - e)
            if off < nearest[peak[i]] and count[i] > 0:
                nearest[peak[i]], entry[peak[i]] = off, i
    return entry
