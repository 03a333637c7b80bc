"""What labels that the energy prefers are refused for all the same: vetoes, each by its name.

Model. The energy compares whole configurations; its weak spot is where two of them cost nearly the same for a
reason that it does not contain. Each veto names one such reason and marks the peaks it concerns:

- `ends_settled`: where belt ends amid the image, a body may begin on the rest line; which of the two an end
  is must be borne out by the rest of its trace on both sides.
- `out_of_order`: labels that do not increase along an epipolar line, or occur twice in a row.
- `claimed`: a piece that is a stripe on some lines and left out on others was left out for the sake of
  another piece: one of the two is wrong, so its claim is put to the test of order as well.
- `may_be_level`: a level top that is m label heights up shows its stripes on the rest lines m further on.
  Where stripes are missing beside a body, what follows on rest lines may be more of that body: if moving it
  by up to as many stripes as are missing costs hardly more, it is refused, and what is doubted without it.
- unexplained gaps (`roemetry_kernels.consistency`): a stripe interrupted where nothing is in sight
  that could hide it. A level product one spacing high, each stripe on its neighbour's rest line, looks so.
- `going_on`: that doubt does not end where the gap does; it follows the stripe and the trace over what lies
  nearly on its rest line without reaching the image's border.
- `fits_another_stripe`: a body that would be three times more even, were all of it some stripes on: a fan's
  uneven spacing is a pattern that right labels take out and wrong ones put in.
- `denies_belt`: light on a stripe's rest line was left out because a body has that stripe on the same sight
  line. Both cannot be: a ray of light ends where it first meets something. Only at a stripe's ends on the
  body can both be seen, for light spreads over an edge: those lines are not counted. Light from inside the
  body is no ray's end: a lit top makes the wall below it glow, where the belt before the wall is lit, too.
  If the body denies no belt without what is so faint, that alone is refused. False peaks seldom lie on a
  rest line, and not on many sight lines; a body one stripe off leaves out all of a belt.
- `missing_amid`: amid a body a stripe is missing on many sight lines. A fold or a step hides one on a few; if
  half of a body is one stripe off, it is missing all along the seam. Which half cannot be said: both go.
- `left_over`: what a body is on some rows it is on the others; of a piece mostly refused none is kept.

What each is worth, on which images: docs/measurements/coding-ablation.md. Vetoes refuse, they never change a
label. They fail for bodies with level tops so low that belt's scatter covers them.
"""

from __future__ import annotations

import numpy as np

from roemetry.records import Peaks
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_coding.planes.graph import LOOK_BACK, Candidates, PairCosts, Weights
from roemetry_coding.planes.lines import OVERLAP_ROWS, Entries
from roemetry_coding.planes.pieces import ENDS, Pieces
from roemetry_kernels.compiling import kernel
from roemetry_kernels.consistency import HIDING_SPACINGS
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.rest_lines import RestLines

_ONE_SIDE = 0.4
"""How far a trace's one side speaks for an end: one of two that are asked."""
_BROKEN = 20.0
"""Cost of neighbours too far apart for one: more than any step."""
_HIGH_SHARE = 0.5
"""A body that is taken into account is at least this share of a label height high."""
_LEVEL_DEARER = 1.0
"""A level body is believed possible if it costs less than this more on a line: a third of a break."""
_LEVEL_ROWS = 40
"""A level body goes on for so many rows; fewer are as many as a break along a stripe may have."""
_FLICKER_ROWS = 3
"""So many rows of it may be missing."""
_DENIED_ROWS_MIN = 8
"""Rows of sight lines on which a body may not deny belt, but for `OVERLAP_ROWS` at either end of a stripe. Of
16 bodies on two path-traced rigs it is three at most; two that faint light put one stripe off had 15 and 34.
Both sorts stay apart with three to six lines at the ends; with two, the first has nine."""
_GLOW_SHARE = 1.0 / 3.0
"""Of a stripe's median amplitude on a body: fainter is light that came there through the body. On the wall of
a path-traced box it is 0.08 to 0.29."""
_MISSING_ROWS = 60
"""Rows of sight lines on which a stripe may be missing amid a body. On two folded skeins with one half one
stripe off it is 145 and 151, on 126 other bodies on thirteen rigs 13 at most, on 74 simulated skeins 8."""
_CLAIM_PEAKS = 4
"""A piece with so many peaks of one stripe claims it."""


@kernel
def ends_settled(pieces: Pieces, stripe: Integers) -> Floats:
    """Give (peak,) how far the rest of its trace speaks for a peak of a cut-off end; 1 for any other peak.

    1 if the trace is that stripe on both sides, less if on one, 0 if on neither.
    Where the trace is belt on one side and another stripe's product on the other, the row at which it
    changes is not known: 0 for what is called belt there, too, and for what is called product and still lies
    on the belt's rest line.

    Parameters
    ----------
    pieces
        Of traces; peaks are sorted by row.
    stripe
        (peak,) stripe, below 0 for none.
    """
    trace, piece, piece_line = pieces.trace, pieces.of, pieces.rest
    home, line = pieces.home, pieces.line
    peaks = trace.shape[0]
    votes = np.zeros(piece_line.shape[0], np.int64)
    of_piece = np.full(piece_line.shape[0], -1, np.int64)  # what most of its peaks have
    for p in range(peaks):
        f = piece[p]
        if stripe[p] < 0 or piece_line[f] == ENDS:
            continue
        # majority vote in one pass (Boyer and Moore 1991): what more than half of a piece's labels are
        # survives
        if votes[f] == 0:
            of_piece[f] = stripe[p]
        votes[f] += 1 if of_piece[f] == stripe[p] else -1
    sides = np.full((peaks, 2), -1, np.int64)
    belt = np.zeros((peaks, 2), np.bool_)
    last = np.full(peaks + 1, -1, np.int64)
    # nearest settled piece of the trace, from above and, in the second round, from below
    for side in range(2):
        last[:] = -1
        for n in range(peaks):
            p = n if side == 0 else peaks - 1 - n
            if piece_line[piece[p]] != ENDS:
                last[trace[p]] = piece[p]
            elif last[trace[p]] >= 0:
                f = last[trace[p]]
                sides[p, side] = of_piece[f]
                belt[p, side] = piece_line[f] == of_piece[f]
    found = np.ones(peaks)
    for p in range(peaks):
        if stripe[p] < 0 or piece_line[piece[p]] != ENDS:
            continue
        # both sides known and alike, none known, one known, or two that differ
        a, b = sides[p]
        if a >= 0 and a == b:
            settled = 1.0 if stripe[p] == a else 0.0
        elif a < 0 and b < 0:
            # home: the rest line it was cut off from is all there is to go by
            settled = _ONE_SIDE if stripe[p] == home[piece[p]] else 0.0
        elif a < 0 or b < 0:
            settled = _ONE_SIDE if stripe[p] == max(a, b) else 0.0
        else:
            # belt on one side, body on the other: the row of the change is open, so only what the body says
            # counts, and only off the belt's line
            here = (stripe[p] == a and not belt[p, 0]) or (stripe[p] == b and not belt[p, 1])
            still = (belt[p, 0] and line[p] == a) or (belt[p, 1] and line[p] == b)
            settled = _ONE_SIDE if here and not still else 0.0
        found[p] = settled
    return found


def claimed(pieces: Pieces, stripe: Integers, stripes: int) -> Integers:
    """Give (peak,) stripes, with the one that its piece has elsewhere for peaks that are none.

    A piece that is a stripe on some lines, and left out on others, was left out for the sake of another: one
    of the two is wrong. Ends, which may hold two stripes, claim nothing.

    Parameters
    ----------
    pieces
        Of traces.
    stripe
        (peak,) stripe, below 0 for none.
    stripes
        Number of stripes.
    """
    given = stripe >= 0
    # one vote for each labelled peak, by piece and stripe
    votes = np.bincount(pieces.of[given] * stripes + stripe[given], minlength=pieces.rest.size * stripes)
    votes = votes.reshape(-1, stripes)
    enough = (votes.max(axis=1) >= _CLAIM_PEAKS) & (pieces.rest != ENDS)
    claim = np.where(enough, votes.argmax(axis=1), -1)
    return np.where(given, stripe, claim[pieces.of])


@kernel
def out_of_order(entries: Entries, row: Integers, on_line: Integers, stripe: Integers, stripes: int) -> Flags:
    """Mark labelled peaks that are out of order on an epipolar line, or share a row and a stripe.

    A stripe may be seen twice in a row, on the belt and, displaced, on the product; there is place for one,
    so the belt's is marked.

    Parameters
    ----------
    entries
        On the lines.
    row, on_line, stripe
        (peak,) row; rest line it lies on, −1 for none; stripe, below 0 for none.
    stripes
        Number of stripes.
    """
    start, peak = entries.start, entries.peak
    wrong = np.zeros(stripe.shape[0], np.bool_)
    # along the line the stripe must increase; of two that do not, either may be wrong
    for e in range(start.shape[0] - 1):
        last = -1
        for i in range(start[e], start[e + 1]):
            p = peak[i]
            if stripe[p] < 0:
                continue
            if last >= 0 and last != p and stripe[last] >= stripe[p]:
                wrong[last] = wrong[p] = True
            last = p
    # peaks are sorted by row: the last holder of a stripe is the one in this row or none
    holder = np.full(stripes, -1, np.int64)
    for p in range(stripe.shape[0]):
        s = stripe[p]
        if s < 0 or wrong[p]:
            continue
        q = holder[s]
        if q >= 0 and row[q] == row[p]:
            # the one on its rest line gives way; of two alike both do
            one, other = on_line[q] == s, on_line[p] == s
            wrong[q] = wrong[q] or one or not other
            wrong[p] = wrong[p] or other or not one
            if wrong[p] and not wrong[q]:
                continue
        # a marked peak holds no place
        holder[s] = p
    return wrong


def denies_belt(
    entries: Entries, line: Integers, stripe: Integers, body: Integers, amplitude: Floats
) -> Flags:
    """Mark (peak,) peaks of bodies that have a stripe where its belt was seen and left out.

    If a body does so with its faint peaks alone, these are marked.

    Parameters
    ----------
    entries
        On the lines.
    line, stripe
        (peak,) rest line it lies on, −1 for none; stripe, below 0 for none.
    body
        (peak,) body, 0 for none; see `body_of`.
    amplitude
        (peak,) height above the background.
    """
    denied: Integers = _denied_rows(entries, line, stripe, body)
    doubted = (body > 0) & (denied[body] >= _DENIED_ROWS_MIN)
    if not doubted.any():
        return np.asarray(doubted)
    faint = _faint(body * (stripe.max() + 1) + stripe, doubted, amplitude)
    # once more without the faint peaks: does the body still deny?
    denied = _denied_rows(entries, line, stripe, np.where(faint, 0, body))
    return np.asarray(doubted & (faint | (denied[body] >= _DENIED_ROWS_MIN)))


def missing_amid(entries: Entries, stripe: Integers, body: Integers, there: Floats) -> Flags:
    """Mark (peak,) peaks of bodies amid which a stripe is missing on many sight lines.

    `stripe` (peak,) is below 0 for none, `body` (peak,) 0, see `body_of`; `there` as for `may_be_level`.
    """
    missing: Integers = _missing_rows(entries, stripe, body, there)
    return np.asarray((body > 0) & (missing[body] >= _MISSING_ROWS))


@kernel
def _missing_rows(entries: Entries, stripe: Integers, body: Integers, there: Floats) -> Integers:
    """Count by body the rows of sight lines on which neighbours on it have a stripe between them."""
    start, peak = entries.start, entries.peak
    missing = np.zeros((body.max() if body.size else 0) + 1, np.int64)
    for e in range(start.size - 1):
        last = -1
        for i in range(start[e], start[e + 1]):
            p = peak[i]
            if stripe[p] < 0:
                continue
            amid = last >= 0 and body[last] == body[p] > 0 and stripe[p] - stripe[last] == 2
            if amid and _any_there(there, stripe[last], stripe[p]):
                missing[body[p]] += entries.apart
            last = p
    return missing


def _faint(cell: Integers, on: Flags, amplitude: Floats) -> Flags:
    """Mark (peak,) peaks far fainter than the median of their cell, a stripe on a body; of some peaks."""
    # sorted by amplitude within each cell, so that the middle one is the median
    mine = np.flatnonzero(on)
    mine = mine[np.lexsort((amplitude[mine], cell[mine]))]
    _, first, of, count = np.unique(cell[mine], return_index=True, return_inverse=True, return_counts=True)
    faint = np.zeros(on.size, np.bool_)
    faint[mine] = amplitude[mine] < _GLOW_SHARE * amplitude[mine[first + count // 2]][of]
    return faint


@kernel
def _denied_rows(entries: Entries, line: Integers, stripe: Integers, body: Integers) -> Integers:
    """Count by body the rows of sight lines on which it has a stripe of which belt was left out.

    Not those at either end of the stripe on the body, where light spreads over the edge: an edge askew to the
    sight lines shows that on other lines for each stripe, and of a few rows a stripe becomes a body's worth.
    """
    start, peak = entries.start, entries.peak
    highest = body.max() if body.size else 0
    denied = np.zeros(highest + 1, np.int64)
    last = np.full(highest + 1, -1, np.int64)
    stripes = max(stripe.max(), line.max()) + 1 if stripe.size else 0
    # where each stripe on each body begins and ends, sight lines
    begins = np.full((highest + 1, stripes), start.size, np.int64)
    ends = np.full((highest + 1, stripes), -1, np.int64)
    for e in range(start.size - 1):
        for i in range(start[e], start[e + 1]):
            b, s = body[peak[i]], stripe[peak[i]]
            if b > 0:
                begins[b, s], ends[b, s] = min(begins[b, s], e), max(ends[b, s], e)
    for e in range(start.size - 1):
        for i in range(start[e], start[e + 1]):
            p = peak[i]
            # belt that was left out: it lies on a rest line and has no label
            if line[p] < 0 or stripe[p] >= 0:
                continue
            for j in range(start[e], start[e + 1]):
                b, s = body[peak[j]], stripe[peak[j]]
                # a body that has that very stripe on the same sight line
                if b == 0 or s != line[p] or last[b] == e:
                    continue
                # away from the stripe's ends, where light spreads over the edge; once a line
                if entries.apart * min(e - begins[b, s], ends[b, s] - e) >= OVERLAP_ROWS:
                    denied[b] += entries.apart
                    last[b] = e
    return denied


def may_be_level(
    entries: Entries, candidates: Candidates, pieces: Pieces, best: Integers, costs: PairCosts,
    weights: Weights, there: Floats, row: Integers,
) -> Flags:  # fmt: skip
    """Mark (peak,) belt that may as well be a level body's, where that goes on for some rows along a piece.

    Parameters
    ----------
    entries, candidates, pieces, costs, weights
        The graph.
    best
        (entry,) chosen node.
    there
        (stripe,) how surely a stripe is there at all: what gives no light is no stripe that is not seen.
    row
        (peak,) row, sorted.
    """
    found = _flat_top_ambiguity(entries, candidates, pieces.line, best, costs, weights, there)
    return np.asarray(on_end(row, pieces.of, found, _LEVEL_ROWS, _FLICKER_ROWS))


def nearly_belt(peaks: Peaks, stripe: Integers, rest: RestLines) -> Flags:
    """Mark (peak,) what lies so near its stripe's rest line that it could hide nothing."""
    spacing_px = np.median(np.diff(rest.x_px, axis=0)) if rest.x_px.shape[0] > 1 else np.inf
    away_px = np.abs(peaks.x_px - rest.x_px[np.maximum(stripe, 0), peaks.row])
    return np.asarray((stripe >= 0) & (away_px < HIDING_SPACINGS * spacing_px))


def body_of(row: Integers, stripe: Integers, rest: RestLines) -> Integers:
    """Number (peak,) bodies, 0 for belt: what is off its own rest line and hangs together on the stripes."""
    body: Integers = _bodies(row, stripe, rest.line, *rest.x_px.shape)
    return body


@kernel
def _bodies(row: Integers, stripe: Integers, line: Integers, stripes: int, rows: int) -> Integers:
    """Give what `body_of` does: cells of (stripe, row) that touch along or across a stripe are one body."""
    number = np.zeros((stripes + 1, rows + 1), np.int64)  # of cells; beyond the first of both nothing stands
    for p in range(row.size):
        if stripe[p] >= 0 and stripe[p] != line[p]:
            number[stripe[p] + 1, row[p] + 1] = 1
    same = np.zeros(row.size + 1, np.int64)
    count = 0
    # connected components with union-find, row by row
    for s in range(1, stripes + 1):
        for r in range(1, rows + 1):
            if not number[s, r]:
                continue
            above, beside = number[s, r - 1], number[s - 1, r]
            if above == 0 and beside == 0:
                count += 1
                same[count] = number[s, r] = count
                continue
            # two numbers meet: the smaller one stands for both
            one, other = max(above, beside), min(above, beside) or max(above, beside)
            while same[one] != one:
                one = same[one]
            while same[other] != other:
                other = same[other]
            same[max(one, other)] = number[s, r] = min(one, other)
    bodies = 0
    # 'same' now leads to final numbers, written as negative so that they are not taken for links
    for k in range(1, count + 1):  # the first number of a body stands before all others of it
        if same[k] == k:
            bodies += 1
            same[k] = -bodies
        else:
            same[k] = same[same[k]]
    body = np.zeros(row.size, np.int64)
    for p in range(row.size):
        if stripe[p] >= 0 and stripe[p] != line[p]:
            body[p] = -same[number[stripe[p] + 1, row[p] + 1]]
    return body


def numbered_by_pattern(
    row: Integers, x_px: Floats, stripe: Integers, rest: RestLines
) -> tuple[Integers, Flags]:
    """Say by how many stripes whole bodies are off, and where that cannot be said although they are.

    The distances of a fan's stripes differ from one to the next, and a body shows their pattern on top of its
    own shape. Of a level body whose labels are all k off, the second differences of its peaks from stripe to
    stripe are those of the rest lines k on, not of its own. What is left of them is small and smooth under
    right labels, large and rough under wrong ones. A fan without a pattern says nothing here.

    Returns
    -------
    shift
        (peak,) what is to be added to a body peak's stripe: a number under which its body is much evener than
        under every other one; 0 where the labels stand, and off bodies.
    wrong
        (peak,) True where a body would be much evener under another number, but under more than one.
    """
    bodies = body_of(row, stripe, rest)
    verdict = pattern_verdicts(row, x_px, stripe, bodies, rest.x_px)
    shift: Integers = verdict[0][bodies]
    wrong: Flags = verdict[1][bodies]
    return shift, wrong


@kernel
def pattern_verdicts(
    row: Integers, x_px: Floats, stripe: Integers, bodies: Integers, rest_px: Floats
) -> tuple[Integers, Flags]:
    """Give by body, of peaks' (peak,) `bodies` numbered from 1, what `numbered_by_pattern` says."""
    stripes, rows = rest_px.shape
    highest = bodies.max() if bodies.size else 0
    shift, wrong = np.zeros(highest + 1, np.int64), np.zeros(highest + 1, np.bool_)
    x, of = np.full((stripes, rows), np.nan), np.zeros((stripes, rows), np.int64)
    for p in range(row.size):
        if bodies[p]:
            x[stripe[p], row[p]], of[stripe[p], row[p]] = x_px[p], bodies[p]
    ways = 2 * _PATTERN_REACH + 1
    bend, own, at = np.empty(rows), np.empty(rows), np.empty(rows, np.int64)
    for number in range(1, highest + 1):
        # (shift, stripe) median bend of each stripe less that of the rest lines so many stripes on
        left, evener = np.full((ways, stripes), np.nan), np.zeros(ways, np.bool_)
        for s in range(1, stripes - 1):
            count = 0
            for r in range(rows):
                if of[s, r] == number:
                    # second difference across three stripes: the surface's own bend, and the fan's uneven
                    # spacing
                    bent = x[s - 1, r] - 2.0 * x[s, r] + x[s + 1, r]
                    if not np.isnan(bent):
                        bend[count], at[count] = bent, r
                        count += 1
            if count < _PATTERN_ROWS_MIN:
                continue
            usual = median_of(bend[:count])
            for way in range(ways):
                t = s + way - _PATTERN_REACH
                if 1 <= t < stripes - 1:
                    for k in range(count):
                        r = at[k]
                        own[k] = rest_px[t - 1, r] - 2.0 * rest_px[t, r] + rest_px[t + 1, r]
                    # what the rest lines so many stripes on would explain is taken off
                    left[way, s] = usual - median_of(own[:count])
        # ways in which too few stripes are told tell nothing, and `_much_evener` says so
        for way in range(ways):
            evener[way] = way != _PATTERN_REACH and _much_evener(left[way], left[_PATTERN_REACH])
        for way in range(ways):
            best = evener[way] and shift[number] == 0
            # it must beat every other number that can be told, not only the one at hand
            for other in range(ways):
                told = np.count_nonzero(~np.isnan(left[other])) >= _PATTERN_STRIPES_MIN
                best = best and (other == way or not told or _much_evener(left[way], left[other]))
            if best:
                shift[number] = way - _PATTERN_REACH
        wrong[number] = evener.any() and shift[number] == 0
    return shift, wrong


@kernel
def _much_evener(one: Floats, other: Floats) -> bool:
    """Tell whether one labelling leaves much less than another, on the stripes that both can have."""
    both = np.flatnonzero(~(np.isnan(one) | np.isnan(other)))
    if both.size < _PATTERN_STRIPES_MIN:
        return False
    # both of what bends the surface at each stripe, and of its step from each stripe to the next
    sizes, steps = np.empty((2, both.size)), np.empty((2, both.size))
    many = 0
    for k in range(both.size):
        s = both[k]
        sizes[0, k], sizes[1, k] = abs(one[s]), abs(other[s])
        # steps only between stripes side by side
        if k and s - both[k - 1] == 1:
            steps[0, many], steps[1, many] = abs(one[s] - one[s - 1]), abs(other[s] - other[s - 1])
            many += 1
    return _is_small(sizes) and many > 0 and _is_small(steps[:, :many])


@kernel
def _is_small(left: Floats) -> bool:
    """Compare the medians of the first and of the second line."""
    small, large = median_of(left[0].copy()), median_of(left[1].copy())
    return bool(small < _PATTERN_SHARE * large and large - small > _PATTERN_MIN_PX)


_PATTERN_REACH = 3
"""Stripes on and back that are tried: a body four spacings high stands beyond most rigs' range."""
_PATTERN_ROWS_MIN = 10  # from which the median of a stripe's second differences is taken
_PATTERN_STRIPES_MIN = 4
"""Stripes with second differences: fewer fit by chance."""
_PATTERN_SHARE = 1.0 / 3.0
"""Of the unevenness under another number: right labels are never three times less even than wrong ones, which
put the pattern in twice."""
_PATTERN_MIN_PX = 0.3
"""Ten times what second differences of medians over ten rows scatter by."""


def left_over(piece: Integers, stripe: Integers, kept: Integers, share_min: float) -> Flags:
    """Mark labelled peaks of pieces of which most others were refused: the doubt is the whole piece's.

    Parameters
    ----------
    piece
        (peak,) piece of its trace.
    stripe, kept
        (peak,) stripe before and after refusing, below 0 for none.
    share_min
        Share of a piece's peaks that must be left.
    """
    # labels of each piece before and after
    before, after = np.bincount(piece, stripe >= 0), np.bincount(piece, kept >= 0)
    return np.asarray((kept >= 0) & (after < share_min * before)[piece])


def going_on(row: Integers, along: Integers, asked: Flags, doubted: Flags, gap_rows: int) -> Flags:
    """Mark (peak,) those asked that go on, along a stripe or a trace, from one in doubt.

    Parameters
    ----------
    row, along
        (peak,) row; stripe or trace.
    asked, doubted
        (peak,) what may be marked; and where doubt begins.
    gap_rows
        Over a longer gap nothing goes on, rows.
    """
    which = np.flatnonzero(asked)
    # along each stripe or trace by row; a gap longer than allowed begins a new group
    which = which[np.lexsort((row[which], along[which]))]
    apart = (np.diff(along[which], prepend=-1) != 0) | (np.diff(row[which], prepend=0) > gap_rows + 1)
    group = np.cumsum(apart)
    found = np.zeros(row.size, np.bool_)
    # a group with a doubtful peak is doubtful as a whole
    found[which] = np.bincount(group, weights=doubted[which])[group] > 0.0
    return found


@kernel
def _flat_top_ambiguity(
    entries: Entries, candidates: Candidates, on_line: Integers, best: Integers, costs: PairCosts,
    weights: Weights, there: Floats,
) -> Flags:  # fmt: skip
    """Mark (peak,) belt, and what goes on from it, that could be a body's, some stripes on, hardly dearer.

    Where stripes are not seen beside a body, the next ones, one or several, are taken for the neighbours'
    stripes on a level body: those that are not seen are then on its other side. Some of them lie on their
    rest lines, the others may be bodies already.
    """
    start, peak = entries.start, entries.peak
    low, count, offset = candidates.low, candidates.many, candidates.offset
    height, label_mm = candidates.height, candidates.label_mm
    found = np.zeros(on_line.shape[0], np.bool_)
    kept = np.empty(peak.shape[0], np.int64)
    stripe = np.empty(peak.shape[0], np.int64)
    for e in range(start.shape[0] - 1):
        size = 0
        for i in range(start[e], start[e + 1]):
            k = best[i] - offset[i]
            if k < count[i]:
                kept[size], stripe[size] = i, low[i] + k
                size += 1
        for by in (-1, 1):
            for n in range(size):
                j = n + by  # on the side that the stripes would move to, and off the belt
                # at least one stripe is missing between n and its neighbour on that side
                if not 0 <= j < size or (stripe[n] - stripe[j]) * -by < 2:
                    continue
                # the neighbour must be a body, and one of the missing stripes must be there at all
                if on_line[peak[kept[j]]] == stripe[j] or not _any_there(there, stripe[n], stripe[j]):
                    continue
                # moved by one up to as many stripes as are missing
                for to in range(by, stripe[j] - stripe[n], by):
                    cost, m, belts = 0.0, n, 0
                    while True:
                        p = kept[m]
                        belts += on_line[peak[p]] == stripe[m]
                        k = stripe[m] + to - low[p]
                        if k < 0 or k >= count[p]:
                            # a height that is not possible, or that of no body
                            break
                        node = offset[p] + k
                        if height[node] < _HIGH_SHARE * label_mm[node]:
                            break
                        i = m - by  # the next stripe on the other side
                        other = to if m != n else 0
                        # what changes towards the side that is already moved, then what changes if the move
                        # ends here
                        cost += _side(
                            e, m, m + by, to, other, kept, stripe, size, entries, candidates, costs, weights
                        )
                        ended = cost + _side(
                            e, m, i, to, 0, kept, stripe, size, entries, candidates, costs, weights
                        )
                        # some belt is among the moved, and the whole is hardly dearer: all from n to m may be
                        # a body's
                        if belts > 0 and ended < _LEVEL_DEARER:
                            for t in range(min(m, n), max(m, n) + 1):
                                found[peak[kept[t]]] = True
                        # the next stripe must follow directly, or there is room again and nothing forces it
                        # along
                        if not 0 <= i < size or (stripe[i] - stripe[m]) * -by != 1:
                            break
                        m = i
    return found


@kernel
def _side(
    e: int, m: int, j: int, to: int, to_other: int, kept: Integers, stripe: Integers, size: int,
    entries: Entries, candidates: Candidates, costs: PairCosts, weights: Weights,
) -> float:  # fmt: skip
    """What it changes, towards neighbour j or the image's border there, that m is moved to another stripe."""
    low, offset, before, after = candidates.low, candidates.offset, costs.before, costs.after
    p = kept[m]
    k = stripe[m] - low[p]
    if j < 0:
        return float(weights.unseen * (before[offset[p] + k + to] - before[offset[p] + k]))
    if j >= size:
        return float(weights.unseen * (after[offset[p] + k + to] - after[offset[p] + k]))
    h = stripe[j] - low[kept[j]]
    first = entries.start[e]
    if j < m:
        was = _pair(e, kept[j], p, h, k, first, candidates.many, costs, weights)
        now = _pair(e, kept[j], p, h + to_other, k + to, first, candidates.many, costs, weights)
    else:
        was = _pair(e, p, kept[j], k, h, first, candidates.many, costs, weights)
        now = _pair(e, p, kept[j], k + to, h + to_other, first, candidates.many, costs, weights)
    return float(now - was)


@kernel
def _pair(
    e: int, q: int, p: int, h: int, k: int, first: int, count: Integers, costs: PairCosts, weights: Weights
) -> float:
    """Cost of two neighbours on line e, of their hth and kth possible stripe."""
    # no costs are kept for neighbours farther apart
    if p - q > LOOK_BACK:
        return _BROKEN
    # place of the pair in the list of `pair_costs_of`: the first entries of a line have fewer predecessors
    n, at = costs.pair_start[e], p - first
    whole = min(at, LOOK_BACK)
    n += whole * (whole - 1) // 2 + max(at - LOOK_BACK, 0) * LOOK_BACK
    n += q - max(first, p - LOOK_BACK)
    c = costs.pair[n, 2] + k * count[q] + h
    return float(min(weights.surface * costs.surface[c] + weights.unseen * costs.unseen[c], _BROKEN))


@kernel
def _any_there(there: Floats, one: int, other: int) -> bool:
    """Say whether light of any stripe between two is there at all."""
    return bool((there[min(one, other) + 1 : max(one, other)] > 0.0).any())


@kernel
def on_end(row: Integers, piece: Integers, found: Flags, rows_min: int, rows_between: int) -> Flags:
    """Mark (peak,) what was found on so many rows of its piece on end.

    Parameters
    ----------
    row, piece
        (peak,) row, in increasing order; piece of its trace.
    found
        (peak,) what is asked.
    rows_min
        Fewer rows are as many as a break along a stripe may have.
    rows_between
        So many rows between may be missing.
    """
    last = np.full(piece.max() + 1, -(rows_between + 2), np.int64)
    run_of = np.full(piece.max() + 1, -1, np.int64)
    run, first = np.full(row.shape[0], -1, np.int64), np.empty(row.shape[0], np.int64)
    length = np.zeros(row.shape[0], np.int64)
    runs = 0
    for p in range(row.shape[0]):
        f = piece[p]
        if not found[p]:
            continue
        # too many rows between: a new run of this piece
        if row[p] - last[f] > rows_between + 1:
            run_of[f], first[runs] = runs, row[p]
            runs += 1
        run[p], last[f] = run_of[f], row[p]
        length[run[p]] = row[p] - first[run[p]] + 1
    kept = np.zeros(row.shape[0], np.bool_)
    for p in range(row.shape[0]):
        kept[p] = run[p] >= 0 and length[run[p]] >= rows_min
    return kept
