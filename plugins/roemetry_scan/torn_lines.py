"""Lines of a scan of which a part lies beside the lines before and after it.

Model. Lines follow each other far more closely than a product's shape changes: along the belt heights rise,
fall, and step, but they do not jump for a line or two and come back. So each point is compared with the lines
before and after it, and each two with those before and after both: with their heights there and in the rows
beside, as far as an oblique edge moves from line to line, and with where the two lines on either side lead
to, as at a ridge. What lies above all of that, or below all of it, by more than noise, and by more than half
of what the lines before and after differ by, belongs to another moment: a part of the frame was another
one's, or rows of it were lost. Single points may be glare or noise, so that it takes a run of neighbours.
So does a line that shows nothing over a good part, on end, of what both of its neighbours see, and one that
begins or ends rows away from where all around it do: rows were lost. Such a line is not used; the lines
beside it bridge the gap.

It fails for three wrong lines in a row, which are a step there and a step back, and for walls across the belt
that are only a line or two thick.
"""

from __future__ import annotations

import math

import numpy as np

from roemetry.records.arrays import Flags, Floats
from roemetry_kernels.compiling import float_kernel

_LEAST_MM = 0.5
"""Less does not matter: where a tenth of the lines is off by it, so is 0.5 % of a product 10 mm high."""
_SIGMAS = 8.0
"""Times the usual scatter from line to line, beyond which it is not noise."""
_OF_STEP = 0.5
"""Of the difference of the lines before and after: beside an edge, the last whole line may lie higher."""
_RUN = 5
"""Neighbours that lie beside: noise and glare give one or two."""
_UNSEEN_MIN, _UNSEEN_SHARE = 10, 0.25
"""More points than that are missing, and more than that share of those that both neighbours see over the
belt. Where a product begins in faint light fewer are: 6 of 8 and of 9. A dark cut across a product is dropped
with it: one line, which its neighbours stand for."""
_ON_END = 0.8
"""Share of the missing points that follow each other: where light is faint, points are missing here and there
all along. Of 10 missing of 20, in any order, 8 follow each other in 4 of 1,000 draws."""
_CLEAR = 0.8
"""Of the way from the first to the last of them, belt between products included: where the neighbours miss
more, light is faint."""
_END_ROWS, _END_SCATTERS = 1.5, 8.0
"""Rows that a line's end lies away from the middle of those around it, at least, and times their scatter."""
_PART_ROWS = 20
"""Rows on end that are a part of a line, whose end counts; fewer may be the end of another one."""
_GOES_ON = 0.5
"""If more of the rows from a line's end to its neighbours' end are seen, the line goes on to that end."""
_AT_ONCE = 128
"""Lines that are looked at together: copies of all of a long scan's heights are megabytes."""
_SAMPLED = 64
"""Rows that tell the usual scatter."""


def torn_lines(height_mm: Floats, oblique_rows: int) -> Flags:
    """Say which lines (line,) of heights (line, row) are torn; NaN is not seen.

    `oblique_rows` is how far an edge may move along its line to the next one.
    """
    lines, rows = height_mm.shape
    found = np.zeros(lines, np.bool_)
    some = height_mm[:, :: max(1, rows // _SAMPLED)]
    # second differences from line to line: a slope along the belt is none
    bends = np.abs(some[:-2] - 2.0 * some[1:-1] + some[2:])
    known = bends[np.isfinite(bends)]
    if not known.size:
        return found
    # of independent errors σ a bend has √6·σ, a step between two lines √2·σ
    limit_mm = max(_LEAST_MM, _SIGMAS * 1.4826 * float(np.median(known)) / np.sqrt(3.0))
    # in blocks, for memory; only lines from which many rows jump are looked at closely
    for first in range(2, lines - 2, _AT_ONCE):
        steps = np.abs(np.diff(height_mm[first - 1 : first + _AT_ONCE], axis=0)) > limit_mm
        jumping = first + np.flatnonzero(steps.sum(axis=1) >= _RUN)
        for line in jumping[jumping < lines - 2].tolist():
            here = height_mm[line : line + 2]
            # one line, or two: more in a row are a step there and back
            for count in (1, 2)[: lines - 2 - line]:
                around = [height_mm[k] for k in (line - 2, line - 1, line + count, line + count + 1)]
                if _beside(here[:count], around, limit_mm, oblique_rows):
                    found[line : line + count] = True
    for first in range(1, lines - 1, _AT_ONCE):
        part = height_mm[first - 1 : first + _AT_ONCE + 1]
        # what is seen over the belt in both neighbours, and not here
        both = (part[:-2] > limit_mm) & (part[2:] > limit_mm)
        unseen, told = np.isnan(part[1:-1]), np.isfinite(part[:-2]) & np.isfinite(part[2:])
        many = (both & unseen).sum(axis=1)
        # many, and a good share
        for k in np.flatnonzero(many > np.maximum(_UNSEEN_MIN, _UNSEEN_SHARE * both.sum(axis=1))).tolist():
            asked = np.flatnonzero(both[k])
            # the neighbours see nearly all between: light is not faint there
            clear = told[k, asked[0] : asked[-1] + 1].mean() >= _CLEAR
            found[first + k] |= clear and _longest_run(unseen[k, asked]) >= _ON_END * many[k]
    # first and last rows of lines are looked at in the same way
    for end, is_last in zip(_ends_of_parts(height_mm), (False, True), strict=True):
        for line in np.flatnonzero(_outliers(end)).tolist():
            usual_row = round(float(np.median(end[[line - 2, line - 1, line + 1, line + 2]])))
            end_row = int(end[line])
            beyond = slice(end_row + 1, usual_row + 1) if is_last else slice(usual_row, end_row)
            found[line] |= not _goes_on(height_mm[line, beyond])
    return found


def _ends_of_parts(height_mm: Floats) -> tuple[Floats, Floats]:
    """Give the first and the last row (line,) of what is seen for `_PART_ROWS` on end; NaN where nothing is.

    Where rows were lost and the frame was filled up with its last ones, these show the line's end once more.
    """
    import cv2

    lines, rows = height_mm.shape
    part, between = (np.ones((1, min(size, rows)), np.uint8) for size in (_PART_ROWS, _RUN))
    first, last = np.full(lines, np.nan), np.full(lines, np.nan)
    for begin in range(0, lines, _AT_ONCE):
        some = slice(begin, begin + _AT_ONCE)
        seen = np.isfinite(height_mm[some]).astype(np.uint8)
        seen = cv2.morphologyEx(seen, cv2.MORPH_CLOSE, between)  # single points may be missing
        seen = cv2.morphologyEx(seen, cv2.MORPH_OPEN, part)
        any_seen = seen.any(axis=1)
        first[some] = np.where(any_seen, seen.argmax(axis=1), np.nan)
        last[some] = np.where(any_seen, rows - 1 - seen[:, ::-1].argmax(axis=1), np.nan)
    return first, last


def _outliers(end: Floats) -> Flags:
    """Say which lines' ends (line,) lie away from those of the two lines before and the two after."""
    around = np.stack([end[:-4], end[1:-3], end[3:-1], end[4:]])
    off = np.abs(end[2:-2] - np.median(around, axis=0))
    # a product that hides the end does so in neighbours, too
    calm = np.ptp(around, axis=0) <= _END_ROWS
    found = np.zeros(end.shape, np.bool_)
    known = np.isfinite(off)
    if known.any():
        limit = max(
            _END_ROWS, _END_SCATTERS * float(np.median(off[known & calm])) if (known & calm).any() else 0.0
        )
        found[2:-2] = known & calm & (off > limit)
    return found


def _goes_on(beyond_mm: Floats) -> bool:
    """Say whether a line goes on, from its end to its neighbours' ends (row,), in parts too short to count.

    A ball's shadow cuts off the last 18 rows of a plate; where rows are lost, nothing is seen out there. A
    line that reaches beyond its neighbours has no such rows.
    """
    return beyond_mm.size > 0 and bool(np.isfinite(beyond_mm).mean() >= _GOES_ON)


def _beside(here: Floats, around: list[Floats], limit_mm: float, oblique_rows: int) -> bool:
    """Say whether all of some lines (line, row) lie in a run beside the two before and the two after them."""
    _, before, after, _ = around
    beside = _beyond_both(here, before, after, limit_mm)
    if not beside.size:
        return False
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    wide = 2 * oblique_rows + 1
    # an oblique edge may bring any height of the rows beside into this line
    low = minimum_filter1d(np.fmin.reduce([np.nan_to_num(one, nan=np.inf) for one in (before, after)]), wide)
    high = maximum_filter1d(
        np.fmax.reduce([np.nan_to_num(one, nan=-np.inf) for one in (before, after)]), wide
    )
    # a ridge or a valley: where the two lines on either side lead to, if they go on straight
    led_to = 2.0 * before - around[0], 2.0 * after - around[3]
    for line in here:
        beside &= (line < low - limit_mm) | (line > high + limit_mm)
        for one in led_to:
            beside &= ~(np.abs(line - one) < limit_mm)
    return _has_run(beside)


@float_kernel
def _beyond_both(here: Floats, before: Floats, after: Floats, limit_mm: float) -> Flags:
    """Say where (row,) all lines lie beyond both neighbours, by more than half of their difference.

    Empty where no run of rows is long enough: nearly always, so all that stops early.
    """
    lines, rows = here.shape
    beside = np.empty(rows, np.bool_)
    run, longest = 0, 0
    for k in range(rows):
        low, high = min(before[k], after[k]), max(before[k], after[k])
        far = max(limit_mm, _OF_STEP * (high - low))
        # what is not seen in one of them lies beyond nothing
        one = not (math.isnan(before[k]) or math.isnan(after[k]))
        for line in range(lines):
            one &= max(low - here[line, k], here[line, k] - high) > far
        beside[k] = one
        run = run + 1 if one else 0
        longest = max(longest, run)
    return beside if longest >= _RUN else beside[:0]


def _longest_run(marked: Flags) -> int:
    """Give how many marked ones follow each other at most."""
    at = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]])))
    # beginnings and ends of runs alternate
    return int((at[1::2] - at[::2]).max(initial=0))


def _has_run(beside: Flags) -> bool:
    """Say whether so many neighbours are."""
    if np.count_nonzero(beside) < _RUN:  # nearly always
        return False
    count = np.convolve(beside, np.ones(_RUN, np.int64), "valid")
    return bool((count == _RUN).any())
