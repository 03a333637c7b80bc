"""Torn frames: rows that were lost, or a frame whose lower part is another's.

Model. A product's surface is continuous from row to row, and where it is not (an edge, a step), the edge
crosses the stripes one after another: only by accident do five stripes and more jump between the same two
rows while each lies on a product before and after. A sensor's or a transport's fault tears all of them there.
The jump of a stripe between rows r and r + 1 is its step less the mean of the steps before and after it, so
that a slope is none; the product's ends are left out. On the belt it is the step less that of the rest line:
where all jump alike, what follows was taken from another place.

Fails where the tear crosses no product (then it harms none), where what is joined fits by accident, and on
steps that lie along the rows to a quarter of a degree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.image_levels import median_of

_OFF_BELT_PX = 2.0
"""Peaks farther from every rest line lie on a product."""
_REACH_SHARE = 1.0
"""Of the lines' distance: as far is a stripe looked for in the next row; farther away none is near."""
_STEP_MAX_PX = 3.0
"""Steps before and after the jump are those of a surface that this camera sees whole."""
_STRIPES_MIN = 5
_JUMP_MIN_PX = 0.4
"""A median jump below it moves no volume by more than some tenths of a percent."""
_ROUNDED_JUMP_MIN_PX = 2.5
"""The same for peaks in whole pixels: rounding alone makes jumps of up to two."""
_TIMES_USUAL = 8.0
"""So many times the jumps of the frame's other rows, which noise and texture make. Of 56 whole images of two
makers the largest jump is five times the mean."""
_SAMPLED_ROWS = 8
"""Every so many rows tell how much stripes on the belt usually jump."""


class Tear(NamedTuple):
    """A frame's tear: the row after which it lies, and the median jump there, px."""

    row: int
    jump_px: float


def tear_of(row_start: Integers, x_px: Floats, lines_px: Floats, spacing_px: float) -> Tear | None:
    """Give the tear of a frame; None of a whole one.

    Parameters
    ----------
    row_start, x_px
        Of the peaks.
    lines_px
        (row, stripe) rest lines, px.
    spacing_px
        Their smallest distance.
    """
    rounded = bool((x_px == np.rint(x_px)).all())
    least_px = _ROUNDED_JUMP_MIN_PX if rounded else _JUMP_MIN_PX
    row, jump_px, usual_px = _largest_jump(
        row_start, x_px, lines_px, _REACH_SHARE * spacing_px, _OFF_BELT_PX, _STEP_MAX_PX, _STRIPES_MIN,
        _SAMPLED_ROWS, _TIMES_USUAL, least_px,
    )  # fmt: skip
    return Tear(row, jump_px) if row >= 0 and jump_px >= max(least_px, _TIMES_USUAL * usual_px) else None


@float_kernel
def _largest_jump(
    row_start: Integers, x_px: Floats, lines_px: Floats, reach_px: float, off_belt_px: float,
    step_max_px: float, stripes_min: int, sampled: int, times_usual: float, least_px: float,
) -> tuple[int, float, float]:  # fmt: skip
    """Give the row, the median jump and the usual jump where product or belt jump most; row −1 of none."""
    rows, stripes = lines_px.shape
    on_product, line_of = np.zeros(x_px.size, np.bool_), np.zeros(x_px.size, np.int64)
    for row in range(rows):
        line = 0
        for p in range(row_start[row], row_start[row + 1]):
            while line < stripes - 1 and abs(x_px[p] - lines_px[row, line + 1]) < abs(
                x_px[p] - lines_px[row, line]
            ):
                line += 1
            line_of[p] = line
            on_product[p] = abs(x_px[p] - lines_px[row, line]) > off_belt_px
    jumps, slips = np.empty(2 * stripes + 64), np.empty(2 * stripes + 64)
    # of product and belt: rows that count, the sum of their jumps, the row that jumps most, and its jump
    counted, total = np.zeros(2), np.zeros(2)
    worst, most = np.full(2, -1), np.zeros(2)
    for row in range(1, rows - 2):
        count, slipped = 0, 0
        before, after, last = row_start[row - 1], row_start[row + 1], row_start[row + 2]
        for p in range(row_start[row], row_start[row + 1]):
            if max(count, slipped) >= jumps.size:
                break
            if after == row_start[row + 2]:
                break
            after = _nearest(x_px, after, row_start[row + 2], x_px[p])
            step = x_px[after] - x_px[p]
            if abs(step) > reach_px:
                continue
            if not on_product[p]:
                slips[slipped] = step - (lines_px[row + 1, line_of[p]] - lines_px[row, line_of[p]])
                slipped += 1
                continue
            if before == row_start[row] or last == row_start[row + 3]:  # a row without a peak
                continue
            before = _nearest(x_px, before, row_start[row], x_px[p])
            last = _nearest(x_px, last, row_start[row + 3], x_px[after])
            first_step, last_step = x_px[p] - x_px[before], x_px[last] - x_px[after]
            near = abs(first_step) <= step_max_px and abs(last_step) <= step_max_px
            if near and on_product[before] and on_product[after] and on_product[last]:
                jumps[count] = abs(step - 0.5 * (first_step + last_step))
                count += 1
        for kind in range(2):
            found = jumps[:count] if kind == 0 else slips[:slipped]
            # among few belt peaks are those of a product's rim, which steps
            if found.size < stripes_min or (kind == 1 and 4 * found.size < 3 * stripes):
                continue
            large = 0
            for jump in found:
                large += abs(jump) >= least_px
            counts = kind == 0 or row % sampled == 0  # a median takes long
            if counts or 4 * large >= 3 * found.size:
                jump = abs(median_of(found))
                if counts:
                    counted[kind] += 1.0
                    total[kind] += jump
                if jump > most[kind]:
                    worst[kind], most[kind] = row, jump
    usual = total / np.maximum(counted, 1.0)
    kind = 0 if most[0] >= max(least_px, times_usual * usual[0]) else 1
    return worst[kind], most[kind], usual[kind]


@float_kernel
def _nearest(x_px: Floats, start: int, stop: int, at_px: float) -> int:
    """Give the peak of a row, from `start` on, that is nearest to a place."""
    found = start
    while found + 1 < stop and abs(x_px[found + 1] - at_px) <= abs(x_px[found] - at_px):
        found += 1
    return found
