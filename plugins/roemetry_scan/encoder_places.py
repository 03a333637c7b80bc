"""From encoder counts and frame numbers to where each line was taken, and what went wrong between lines.

A counter of 16 or 32 bits overflows: a step of more than half its range is one the other way round. Belts
run one way. A line at the count of the one before shows what was shown already, and so does every line from
where the belt turns back to where it passes its farthest place again; both are left out. A line without a
count has no place. A step of more than one and a half usual ones leaves places at which no line was taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Reason
from roemetry.records.arrays import Flags, Floats, Integers

_LINES_MIN = 3
"""Fewer lines make no surface."""
_GAP_STEPS = 1.5
"""A step of more than so many usual ones has lost a line."""
_FRAMES_SHARE = 0.5
"""Of the frames whose numbers say that they were lost, so many must leave gaps in the counts as well."""


@dataclass(frozen=True, eq=False, slots=True)
class EncoderPlaces:
    """Where the lines of a scan were taken."""

    way: Floats
    """(line,) counts from the first line on, without overflows, in the belt's direction; NaN where
    missing."""
    first: float
    """Count from which `way` is told, as the counter gave it."""
    direction: float
    """1 where the counter counts up as the belt runs, −1 where down: motions are told for counts upwards."""
    place: Integers
    """(line,) place in usual steps from the first line that is used."""
    used: Flags
    """(line,) False for repeated and reversed lines and for those without a count."""
    lost: int
    repeated: int
    reversed: int
    wraps: int
    reasons: tuple[Reason, ...]


def encoder_places(count: Floats, number: Integers) -> EncoderPlaces:
    """Read the counts of a scan's lines.

    Raises
    ------
    StageError
        There are no counts, they stand still, or fewer than three lines have a place of their own.
    """
    if count.size < _LINES_MIN:
        raise StageError(
            f"the scan has {count.size} lines, {_LINES_MIN} are the least",
            hint="is it the whole scan? A folder holds the frames of all lines",
        )
    known = np.flatnonzero(np.isfinite(count))
    if known.size < _LINES_MIN:
        raise StageError(
            f"{known.size} of {count.size} lines have an encoder count: lines are placed by counts, never by "
            "their number",
            hint="give counts in the file beside the frames, or in their names; see the belt-scan source",
        )
    # overflows first: they look like a belt that jumps back
    unwrapped, wraps = _unwrapped(count[known])
    _, frame_wraps = unwrapped_numbers = _unwrapped(number.astype(np.float64))
    steps = np.diff(unwrapped)
    # the direction of most steps; single steps back are the belt's, not the counter's
    direction = float(np.sign(np.sum(np.sign(steps))))
    if direction == 0.0 or not steps.any():
        raise StageError(
            f"the encoder count stands still: {count.size} lines from {unwrapped.min():g} to "
            f"{unwrapped.max():g}",
            hint="is the encoder connected, and does the belt run?",
        )
    way = np.full(count.size, np.nan)
    way[known] = direction * (unwrapped - unwrapped[0])
    used = np.zeros(count.size, np.bool_)
    repeated = turned = 0
    farthest, before = -np.inf, -np.inf
    for line in known.tolist():
        # only what lies farther than all before is a new place
        if way[line] > farthest:
            used[line], farthest = True, way[line]
        elif way[line] == before == farthest:
            # the count stands where it stood, at the farthest place: the belt waited
            repeated += 1
        else:
            turned += 1
        before = way[line]
    if used.sum() < _LINES_MIN:
        raise StageError(
            f"{int(used.sum())} of {count.size} lines lie at a place of their own: the belt stood or ran to "
            "and fro"
        )
    ahead = np.diff(way[used])
    # of used lines; the median is the usual step even if many were lost
    usual = float(np.median(ahead))
    missed = np.where(ahead > _GAP_STEPS * usual, np.rint(ahead / usual).astype(np.int64) - 1, 0)
    place = np.zeros(count.size, np.int64)
    # places count usual steps, with those of lost lines left free
    place[np.flatnonzero(used)] = np.concatenate([[0], np.cumsum(missed + 1)])
    lost = int(missed.sum())
    frames = np.diff(unwrapped_numbers[0])
    if frame_wraps:  # cameras that count frames in 16 bits leave out 0
        frames = np.where((np.diff(number) < 0) & (number[1:] > 0), frames - 1.0, frames)
    dropped = int(np.maximum(frames - 1.0, 0.0).sum())
    return EncoderPlaces(
        way, float(unwrapped[0]), direction, place, used, lost, repeated, turned, wraps,
        _said(count.size, known.size, lost, repeated, turned, wraps, dropped, float(missed.max(initial=0))),
    )  # fmt: skip


def _unwrapped(value: Floats) -> tuple[Floats, int]:
    """Undo overflows of 16 and 32 bits; give how many there were."""
    for bits in (16, 32):
        size = 2.0**bits
        # an overflow is a step of more than half the counter's range
        steps = np.diff(value)
        # counts outside the range were never in such a counter
        fits = value.min() >= -size / 2 and value.max() < size and np.ptp(value) < size
        over = np.where(steps < -size / 2, 1.0, np.where(steps > size / 2, -1.0, 0.0))
        if fits and over.any():
            return value + size * np.concatenate([[0.0], np.cumsum(over)]), int(np.abs(over).sum())
    return value, 0


def _said(
    lines: int, known: int, lost: int, repeated: int, turned: int, wraps: int, dropped: int, longest: float
) -> tuple[Reason, ...]:
    found = []
    if lost:
        found.append(
            Reason(
                "lines-lost",
                f"{lost} lines are missing among {lines} (up to {longest:.0f} in a row): these places are "
                "bridged, and count as not seen",
            )
        )
    if known < lines:
        found.append(Reason("count-missing", f"{lines - known} lines have no encoder count and are left out"))
    if repeated:
        found.append(
            Reason(
                "lines-repeated",
                f"the belt stood still for {repeated} lines: only the first at each place is used",
            )
        )
    if turned:
        found.append(
            Reason(
                "belt-reversed", f"the belt ran backwards: {turned} lines show places that were seen before"
            )
        )
    if wraps:
        found.append(Reason("counter-wrapped", f"the encoder's counter overflowed {wraps} times: undone"))
    if dropped and lost < _FRAMES_SHARE * dropped:
        found.append(
            Reason(
                "counts-disagree",
                f"frame numbers say that {dropped} frames were lost, but the counts have {lost} gaps: do "
                "they come from an encoder?",
            )
        )
    return tuple(found)
