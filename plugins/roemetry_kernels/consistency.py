"""Making codes consistent: one peak a row and stripe, stripes in order, gaps explained.

What coders cannot work with, all of them say in the same words.
"""

from __future__ import annotations

import numpy as np

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, Peaks, Reason
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import median_of

_MISSING_ROWS = 2  # to either side: single peaks may be missing
_REACH_STRIPES = 2
"""A product hides a stripe only if it is seen within this many stripes of it."""
HIDING_SPACINGS = 0.15
"""What hides a whole stripe displaces others by so much at least."""


def keep_order(peaks: Peaks, stripe: Integers) -> Integers:
    """Refuse peaks of a row whose stripes do not increase from left to right."""
    result = stripe.copy()
    refuse_disorder(peaks.row, result, AMBIGUOUS)
    return result


@kernel
def refuse_disorder(row: Integers, stripe: Integers, refused: int) -> int:
    """Write `refused` where a row's stripes do not increase, in place; gives how many peaks stay labelled."""
    labelled, before, left = 0, -1, -1
    for p in range(row.shape[0]):
        own = stripe[p]
        if own < 0:
            continue
        labelled += 1
        # either may be the wrong one: both are refused
        if before >= 0 and row[before] == row[p] and own <= left:
            labelled -= (stripe[before] >= 0) + 1
            stripe[before] = stripe[p] = refused
        before, left = p, own
    return labelled


def refuse_unexplained_gaps(
    peaks: Peaks,
    stripe: Integers,
    line: Integers,
    rest_px: Floats,
    displacement_px: Floats,
    longest_gap_rows: int,
    *,
    on_bodies_too: bool = False,
) -> tuple[Integers, list[Reason]]:
    """Refuse belt beside a stripe that is interrupted where no product is in sight to hide it.

    A flat product whose height displaces stripes by just one spacing lies, stripe by stripe, on the
    neighbours' rest lines: it looks like bare belt with one stripe missing.

    Parameters
    ----------
    peaks
        The frame's peaks.
    stripe
        (peak,) stripe, `UNLABELLED` or `AMBIGUOUS`.
    line
        (peak,) rest line each peak lies on, −1 for none.
    rest_px
        (stripe, row) rest lines, px.
    displacement_px
        (stripe,) displacements, px, whose signs tell which way higher points move; NaN where unknown.
    longest_gap_rows
        Shorter gaps need no explanation.
    on_bodies_too
        A body may go on from a stripe that lies on its neighbour's rest line to ones that do not: refuse
        those, too, up to the first stripe that is not seen. What is refused and lies on a rest line, and a
        body too low to hide a stripe, explain nothing then.

    Returns
    -------
    tuple
        (peak,) stripes, with those peaks refused, and what to say of it.
    """
    doubt, interrupted = doubt_beside_gaps(
        peaks.row, peaks.x_px, stripe, line, rest_px, displacement_px, longest_gap_rows, on_bodies_too
    )
    if not doubt.any():
        return stripe, []
    result = stripe.copy()
    asked = (stripe >= 0) if on_bodies_too else (stripe >= 0) & (line == stripe)
    result[asked] = np.where(doubt[stripe[asked], peaks.row[asked]], AMBIGUOUS, stripe[asked])
    names = ", ".join(str(number) for number in np.flatnonzero(interrupted) + 1)
    said = Reason(
        "unexplained-gap",
        f"stripe {names} is interrupted, and nothing that is seen could hide it; a flat product one label "
        "height high looks like that, so the peaks beside it are left out",
    )
    return result, [said]


@kernel
def doubt_beside_gaps(
    row: Integers, x_px: Floats, stripe: Integers, line: Integers, rest_px: Floats, displacement_px: Floats,
    longest_gap_rows: int, on_bodies_too: bool,
) -> tuple[Flags, Flags]:  # fmt: skip
    """Give (stripe, row) what is in doubt, and (stripe,) whose belt is interrupted without an explanation.

    The parameters are those of `refuse_unexplained_gaps`, of which it is the rule.
    """
    stripes, rows = rest_px.shape
    belt, body = np.zeros((stripes, rows), np.bool_), np.zeros((stripes, rows), np.bool_)
    asks_height = on_bodies_too and stripes > 1
    hiding, high_px = body, np.zeros(rows)
    if asks_height:
        hiding = np.zeros((stripes, rows), np.bool_)
        for r in range(rows):
            # from there on a displaced stripe may hide another
            high_px[r] = HIDING_SPACINGS * median_of(rest_px[1:, r] - rest_px[:-1, r])
    for p in range(row.size):
        s, r = stripe[p], row[p]
        if s >= 0 and line[p] == s:
            belt[s, r] = True
            continue
        if s < 0:
            if s != AMBIGUOUS or (line[p] >= 0 and on_bodies_too):
                continue
            # what was refused lies on the stripe that it is nearest to
            s = np.abs(rest_px[:, r] - x_px[p]).argmin()
        body[s, r] = True
        if asks_height and abs(x_px[p] - rest_px[s, r]) >= high_px[r]:
            hiding[s, r] = True
    doubt, interrupted = np.zeros((stripes, rows), np.bool_), np.zeros(stripes, np.bool_)
    unexplained = np.zeros(rows, np.bool_)
    for s in range(stripes):
        before = -1
        for r in range(rows):
            if not belt[s, r]:
                continue
            if before >= 0 and r - before > longest_gap_rows + 1:
                unexplained[:] = False
                for at in range(before + 1, r):
                    # hidden on a body of its own, or by a stripe near by
                    hidden = body[s, at]
                    for other in range(max(0, s - _REACH_STRIPES), min(stripes, s + _REACH_STRIPES + 1)):
                        hidden = hidden or hiding[other, at]
                    unexplained[at] = not hidden
                if unexplained.sum() > longest_gap_rows:
                    interrupted[s] = True
                    for step in (1, -1):
                        if not displacement_px[s] * step <= 0.0:  # both ways where it is not known
                            _doubt_on_one_side(s, step, unexplained, belt, body, on_bodies_too, doubt)
            before = r
    return doubt, interrupted


@kernel
def _doubt_on_one_side(
    s: int, step: int, unexplained: Flags, belt: Flags, body: Flags, on_bodies_too: bool, doubt: Flags
) -> None:
    """Mark what lies on one side of a gap, from stripe to stripe as long as nothing explains it."""
    active, other = unexplained.copy(), s + step
    if on_bodies_too:
        active = _widened(active)
    while 0 <= other < belt.shape[0]:
        there = _widened(belt[other] | body[other]) if on_bodies_too else ~body[other]
        for row in range(active.size):
            active[row] &= there[row]
            doubt[other, row] |= active[row] & (on_bodies_too | belt[other, row])
        other += step


@kernel
def _widened(rows: Flags) -> Flags:
    """Add the rows within 2 of a marked one: single peaks may be missing."""
    found = rows.copy()
    for row in range(rows.size):
        if not rows[row]:
            continue
        for near in range(max(row - _MISSING_ROWS, 0), min(row + _MISSING_ROWS + 1, rows.size)):
            found[near] = True
    return found


def refuse_uncodable(peaks: Peaks, calibration: Calibration | None) -> None:
    """Raise StageError where there is no peak, or the peaks are of another image size than calibrated."""
    if not len(peaks):
        raise StageError(
            "no stripe was found in the image",
            hint="is the laser on? lower the extractor's threshold, or look at the image",
        )
    if calibration is not None and peaks.image_size != calibration.image_size:
        raise StageError(
            f"the peaks are of an image of {peaks.image_size[0]} rows and {peaks.image_size[1]} columns, "
            f"the calibration of {calibration.image_size[0]} and {calibration.image_size[1]}",
            hint="calibrate this camera, or use the region of interest it was calibrated with",
        )


def required_calibration(calibration: Calibration | None, coder: str, why: str) -> Calibration:
    """Give the calibration; raise StageError where there is none, with the reason why this coder needs it."""
    if calibration is None:
        raise StageError(
            f"the coder `{coder}` needs a calibration: {why}",
            hint="calibrate, or use the coder `window-tracking`",
        )
    return calibration


def refuse_bare_lines(seen: bool, stripes: int) -> None:
    """Raise StageError unless a stripe was seen on one of so many rest lines."""
    if not seen:
        raise StageError(
            f"no stripe lies where the {stripes} rest lines are",
            hint="camera or laser may have been moved: calibrate again, or remove what covers the belt",
        )
