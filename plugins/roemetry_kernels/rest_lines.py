"""Where the stripes lie on the bare belt: from the calibration, or from the frame's own top and bottom.

What the order of peaks along a row says about their stripes stands here, too.

It assumes bare belt at the image's top and bottom, which tell how far the belt's peaks scatter and whether
anything has moved. It fails where products lie in most of these rows.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Peaks, Reason
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry_kernels.compiling import inlined, kernel
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.tracing import nearest_rest

_SIGMAS = 4.0  # of the belt's scatter: 6 in 100,000 belt points lie farther off
_TOLERANCE_MIN_PX = 1.0  # of a rest line, however little the belt scatters
_SEARCH_PX = 3.0  # of a rest line: peaks farther off tell nothing of the belt
_MOVED_MAX_PX = 1.0  # of the belt's stripes on the mean: a frame beyond it is refused
_MOVED_PX = 0.25
"""The mean of some thousand belt points is known far better than this."""
_OUTER_SHARE = 0.1  # of the rows, at the top and the bottom: there products are fewest
_BELT_PEAKS_MIN = 10  # fewer tell no scatter
_MAD_TO_STD = 1.4826  # of a normal distribution
_MAD_MIN_PX = _TOLERANCE_MIN_PX / (_SIGMAS * _MAD_TO_STD)  # less makes no difference


class RestLines(NamedTuple):
    """Rest lines of a frame."""

    x_px: Floats
    """(stripe, row) x on the bare belt, px, increasing with the stripe in each row; NaN where the frame shows
    no belt to know them from."""
    by_row_px: Floats
    """(row, stripe) the same."""
    tolerance_px: float
    """How far a peak may be from a rest line and still lie on the belt, px."""
    line: Integers
    """(peak,) rest line that each of the frame's peaks lies on, −1 for none."""
    on_line: Integers
    """(stripe,) number of peaks on each rest line."""
    offset_px: float = 0.0
    """Mean distance of the belt's peaks from the lines, px: 0 for lines fitted to this frame, and how far
    camera, laser or belt have moved for those of a calibration."""


def unknown_rest_lines(stripes: int, peaks: Peaks) -> RestLines:
    """Give rest lines of which nothing is known: every point is off the belt."""
    return RestLines(
        x_px=np.full((stripes, peaks.image_size[0]), np.nan),
        by_row_px=np.full((peaks.image_size[0], stripes), np.nan),
        tolerance_px=np.inf,
        line=np.full(len(peaks), -1),
        on_line=np.zeros(stripes, np.int64),
    )


def calibrated_rest_lines(peaks: Peaks, calibration: Calibration) -> RestLines:
    """Take the rest lines from the calibration, the tolerance from this frame's scatter about them.

    Raises
    ------
    StageError
        Rest lines cross within the image, so that order says nothing; or the belt's stripes lie more than a
        pixel beside them.
    """
    rest = _with_peaks(peaks, *_lines_of(calibration, peaks.image_size[0]))
    if abs(rest.offset_px) > _MOVED_MAX_PX:
        raise StageError(_moved(rest.offset_px), hint="calibrate again")
    return rest


@lru_cache(maxsize=8)
def _lines_of(calibration: Calibration, rows: int) -> tuple[Floats, Floats]:
    """Give the lines over (stripe, row) and (row, stripe); one calibration's frames all have the same."""
    x_px = calibration.rest_line_px(np.arange(rows, dtype=np.float64))
    if calibration.stripe_count > 1 and not (np.diff(x_px, axis=0) > 0).all():
        raise StageError(
            "the calibration's rest lines cross, or are not numbered from left to right",
            hint="calibrate again; `roemetry lint` checks the file",
        )
    by_row = np.ascontiguousarray(x_px.T)
    x_px.flags.writeable = by_row.flags.writeable = False
    return x_px, by_row


def reasons_of(rest: RestLines) -> list[Reason]:
    """Say that the belt's stripes lie beside the lines, if they do by more than a quarter of a pixel."""
    return [Reason("moved", _moved(rest.offset_px))] if abs(rest.offset_px) > _MOVED_PX else []


def missing_stripes(live: Integers, stripes: int) -> list[Reason]:
    """Name the stripes that are not among `live`, of `stripes` that are expected."""
    if len(live) == stripes:
        return []
    dead = np.setdiff1d(np.arange(stripes), live)
    names = ", ".join(str(stripe + 1) for stripe in dead)
    return [
        Reason(
            "stripe-missing",
            f"{stripes} stripes are expected and {live.size} are seen: nothing lies on the rest "
            f"line{'s' if dead.size > 1 else ''} of stripe {names}",
        )
    ]


def _moved(offset_px: float) -> str:
    """Say that the belt's stripes are not where the calibration has them."""
    return (
        f"the belt's stripes lie {offset_px:+.2f} px beside the calibrated rest lines: camera, laser or belt "
        "has moved, and every height is off by that much"
    )


def rest_lines_of_frame(
    peaks: Peaks, fragment: Integers, fragments: int, stripe_count: int | None, end_rows: int
) -> RestLines | None:
    """Fit a straight rest line to the top and bottom segments of each stripe.

    A stripe's top segment is a fragment that begins within the first `end_rows` rows; its bottom segment
    ends within the last. They are paired in order.

    Parameters
    ----------
    peaks, fragment, fragments
        The frame's peaks, the fragment of each, and their number.
    stripe_count
        Number of stripes there must be; None if it is not known.
    end_rows
        See above, rows.

    Returns
    -------
    RestLines or None
        None where the number of stripes is not known and not as many end at the bottom as begin at the top.

    Raises
    ------
    StageError
        Fewer or more stripes begin at the top or end at the bottom than there must be.
    """
    rows = peaks.image_size[0]
    first = np.full(fragments, rows, np.int64)
    last = np.full(fragments, -1, np.int64)
    np.minimum.at(first, fragment, peaks.row)
    np.maximum.at(last, fragment, peaks.row)
    # shorter fragments do not tell where a line runs
    long_enough = last - first >= end_rows
    top = _ends(peaks, fragment, np.flatnonzero(long_enough & (first < end_rows)), end_rows, at_top=True)
    bottom = _ends(
        peaks, fragment, np.flatnonzero(long_enough & (last >= rows - end_rows)), end_rows, at_top=False
    )
    if stripe_count is None and (not top or len(top) != len(bottom)):
        return None
    if stripe_count is not None and not len(top) == len(bottom) == stripe_count:
        raise StageError(
            f"{stripe_count} stripes are expected; {len(top)} begin at the image's top "
            f"and {len(bottom)} end at its bottom",
            hint="stripes must run from top to bottom (source.turn_deg) with bare belt at both ends; "
            "or give a calibration, which knows the rest lines",
        )
    x_px = np.array([_line(a, b, rows) for a, b in zip(top, bottom, strict=True)])
    # as lines move, others are the peaks near them
    for _ in range(3):
        x_px = _refined(peaks, x_px)
    return _with_peaks(peaks, x_px, np.ascontiguousarray(x_px.T))._replace(offset_px=0.0)


def _with_peaks(peaks: Peaks, x_px: Floats, by_row: Floats) -> RestLines:
    """Give lines with what the frame's peaks say of them.

    The tolerance is four standard deviations (robust) of the peaks about the lines, at least 1 px. For it,
    and for the mean distance, only the image's top and bottom tenth are asked: amid the image a product may
    lie near the lines.
    """
    rows = x_px.shape[1]
    line, on_line, tolerance_px, mean = _on_lines(
        peaks.row_start, peaks.x_px, by_row, math.ceil(_OUTER_SHARE * rows),
        math.ceil((1.0 - _OUTER_SHARE) * rows),
    )  # fmt: skip
    return RestLines(x_px, by_row, tolerance_px, line, on_line, mean)


@kernel
def _on_lines(
    row_start: Integers, x_px: Floats, by_row: Floats, top: int, bottom: int
) -> tuple[Integers, Integers, float, float]:
    """Give (peak,) the line it lies on, (stripe,) number of those, the tolerance, and the mean distance, px.

    `by_row` are lines (row, stripe), px; the rows before `top` and from `bottom` on tell the scatter.
    """
    line, distance = np.empty(x_px.size, np.int64), np.empty(x_px.size)
    stripes = by_row.shape[1]
    lines = by_row.reshape(-1)
    for row in range(row_start.size - 1):
        begin, end = row_start[row], row_start[row + 1]
        # most rows: as many peaks as lines, each on its own
        if end - begin == stripes and _each_on_its_own(lines, row * stripes, stripes, x_px, begin):
            for k in range(np.uint64(stripes)):
                line[np.uint64(begin) + k] = k
                distance[np.uint64(begin) + k] = (
                    x_px[np.uint64(begin) + k] - lines[np.uint64(row * stripes) + k]
                )
            continue
        nearest: Any = np.uint64(row * stripes)
        last = np.uint64((row + 1) * stripes - 1)
        for p in range(np.uint64(begin), np.uint64(end)):
            off = x_px[p] - lines[nearest]
            while nearest < last and abs(x_px[p] - lines[nearest + np.uint64(1)]) < abs(off):
                nearest += np.uint64(1)
                off = x_px[p] - lines[nearest]
            line[p], distance[p] = nearest - np.uint64(row * stripes), off
    near, mad, mean = _scatter(distance, row_start[top], row_start[bottom], _SEARCH_PX, _MAD_MIN_PX)
    tolerance_px = _TOLERANCE_MIN_PX
    if near < _BELT_PEAKS_MIN:
        mean = 0.0
    else:
        tolerance_px = max(tolerance_px, _SIGMAS * _MAD_TO_STD * mad)
    on_line = np.zeros(stripes, np.int64)
    for p in range(np.uint64(line.size)):
        near_it = abs(distance[p]) <= tolerance_px
        on_line[np.uint64(line[p])] += near_it
        line[p] = line[p] if near_it else -1
    return line, on_line, tolerance_px, mean


@inlined
def _each_on_its_own(lines: Floats, first: int, stripes: int, x_px: Floats, begin: int) -> bool:
    """Say whether of as many peaks of a row as there are stripes each is nearest to its own line."""
    other: Any = np.uint64(0)
    a, b, one = np.uint64(first), np.uint64(begin), np.uint64(1)
    for k in range(np.uint64(stripes - 1)):
        here, after = x_px[b + k], x_px[b + k + one]
        line, following = lines[a + k], lines[a + k + one]
        other |= np.uint64(abs(here - following) < abs(here - line))
        other |= np.uint64(not abs(after - following) < abs(after - line))
    return other == 0


@kernel
def _scatter(
    distance: Floats, top: int, bottom: int, search_px: float, mad_px: float
) -> tuple[int, float, float]:
    """Number, median absolute deviation and mean of the distances of peaks near a line, px.

    Peaks up to `top` and from `bottom` on are asked. A deviation of no more than `mad_px` is given as that.
    """
    near = np.empty(top + distance.size - bottom + 1)
    count: Any = np.uint64(0)
    # Written whether or not it is near: a branch would be guessed wrong.
    for begin, end in ((0, top), (bottom, distance.size)):
        for p in range(np.uint64(begin), np.uint64(end)):
            near[count] = distance[p]
            count += np.uint64(abs(distance[p]) <= search_px)
    near = near[: np.int64(count)]
    if near.size == 0:
        return 0, 0.0, 0.0
    mean = near.mean()
    # Fewer than half lie beyond a quarter of that on either side of the mean: so the median does not, either.
    # If more than half lie within the other three quarters, they lie near enough to the median.
    above, below, inside = 0, 0, 0
    for p in range(np.uint64(near.size)):
        off = near[p] - mean
        above += off > 0.25 * mad_px
        below += off < -0.25 * mad_px
        inside += abs(off) <= 0.75 * mad_px
    settled = 2 * max(above, below) < near.size < 2 * inside
    if settled:
        return near.size, mad_px, mean
    middle = median_of(near)
    for p in range(near.size):
        near[p] = abs(near[p] - middle)
    return near.size, max(median_of(near), mad_px), mean


def _ends(
    peaks: Peaks, fragment: Integers, candidates: Integers, end_rows: int, *, at_top: bool
) -> list[tuple[float, float]]:
    """Give (row, x) in the middle of each candidate's outermost `end_rows` rows, from left to right."""
    ends = []
    for number in candidates:
        mine = np.flatnonzero(fragment == number)
        outermost = mine[:end_rows] if at_top else mine[-end_rows:]
        ends.append((float(np.median(peaks.row[outermost])), float(np.median(peaks.x_px[outermost]))))
    return sorted(ends, key=lambda end: end[1])


def _line(top: tuple[float, float], bottom: tuple[float, float], rows: int) -> Floats:
    slope = (bottom[1] - top[1]) / (bottom[0] - top[0])
    return np.asarray(top[1] + slope * (np.arange(rows) - top[0]), np.float64)


def _refined(peaks: Peaks, rest_px: Floats) -> Floats:
    """Fit each line again to the peaks near it, by least absolute deviations in two steps."""
    rows = np.arange(rest_px.shape[1])
    line, distance = nearest_rest(peaks.row, peaks.x_px, rest_px, _SEARCH_PX)
    refined = rest_px.copy()
    for stripe in range(rest_px.shape[0]):
        mine = line == stripe
        if mine.sum() < 20:
            continue
        off = distance[mine]
        # weights 1/|r|: least absolute deviations by least squares
        weight = 1.0 / np.maximum(np.abs(off - np.median(off)), 0.25)
        slope, shift = np.polyfit(peaks.row[mine], off, 1, w=np.sqrt(weight))
        refined[stripe] += shift + slope * rows
    return refined
