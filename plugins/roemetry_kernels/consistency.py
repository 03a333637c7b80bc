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

_MISSING_ROWS = 2
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
    stripes, rows = rest_px.shape
    belt = np.zeros((stripes, rows), np.bool_)
    body = np.zeros((stripes, rows), np.bool_)
    on_own = (stripe >= 0) & (line == stripe)
    belt[stripe[on_own], peaks.row[on_own]] = True
    off_own = (stripe >= 0) & ~on_own
    body[stripe[off_own], peaks.row[off_own]] = True
    hiding = body
    if on_bodies_too and stripes > 1:
        spacing_px = np.median(np.diff(rest_px, axis=0), axis=0)
        away_px = np.abs(peaks.x_px - rest_px[np.maximum(stripe, 0), peaks.row])
        high = off_own & (away_px >= HIDING_SPACINGS * spacing_px[peaks.row])
        hiding = np.zeros((stripes, rows), np.bool_)
        hiding[stripe[high], peaks.row[high]] = True
    refused = (stripe == AMBIGUOUS) & ((line < 0) | (not on_bodies_too))
    off_px = np.abs(rest_px[:, peaks.row[refused]] - peaks.x_px[refused])
    nearest = off_px.argmin(axis=0)
    body[nearest, peaks.row[refused]] = True
    if on_bodies_too and stripes > 1:
        refused[refused] = off_px.min(axis=0) >= HIDING_SPACINGS * spacing_px[peaks.row[refused]]
        nearest = np.abs(rest_px[:, peaks.row[refused]] - peaks.x_px[refused]).argmin(axis=0)
        hiding[nearest, peaks.row[refused]] = True
    doubt = np.zeros((stripes, rows), np.bool_)
    interrupted = []
    for s in range(stripes):
        own = np.flatnonzero(belt[s])
        hidden = body[s] | np.any(hiding[max(0, s - _REACH_STRIPES) : s + _REACH_STRIPES + 1], axis=0)
        for k in np.flatnonzero(np.diff(own) > longest_gap_rows + 1):
            unexplained = np.zeros(rows, np.bool_)
            unexplained[own[k] + 1 : own[k + 1]] = ~hidden[own[k] + 1 : own[k + 1]]
            if unexplained.sum() <= longest_gap_rows:
                continue
            interrupted.append(s + 1)
            for step in _directions(displacement_px[s]):
                active, other = unexplained.copy(), s + step
                if on_bodies_too:
                    active = _widened(active)
                while 0 <= other < stripes:
                    active &= _widened(belt[other] | body[other]) if on_bodies_too else ~body[other]
                    doubt[other] |= active & (belt[other] | on_bodies_too)
                    other += step
    if not doubt.any():
        return stripe, []
    result = stripe.copy()
    asked = (stripe >= 0) if on_bodies_too else on_own
    result[asked] = np.where(doubt[stripe[asked], peaks.row[asked]], AMBIGUOUS, stripe[asked])
    names = ", ".join(str(number) for number in dict.fromkeys(interrupted))
    said = Reason(
        "unexplained-gap",
        f"stripe {names} is interrupted where nothing is seen that could hide it; a flat product one stripe "
        "spacing of displacement high looks like that, so what lies beside it is left out",
    )
    return result, [said]


def _widened(rows: Flags) -> Flags:
    """Add the rows within 2 of a marked one: single peaks may be missing."""
    found = rows.copy()
    for by in range(1, _MISSING_ROWS + 1):
        found[by:] |= rows[:-by]
        found[:-by] |= rows[by:]
    return found


def _directions(displacement_px: float) -> tuple[int, ...]:
    return (1, -1) if np.isnan(displacement_px) else (int(np.sign(displacement_px)),)


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
