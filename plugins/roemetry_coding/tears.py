"""Torn frames: rows that were lost, or a part that belongs to another frame, told by the stripes' peaks.

Jumps. A product's surface is continuous from row to row, and where it is not (an edge, a step), the edge
crosses the stripes one after another: only by accident do five stripes and more jump between the same two
rows while each lies on a product before and after. A sensor's or a transport's fault tears all of them there.
The jump of a stripe between rows r and r + 1 is its step less the mean of the steps before and after it, so
that a slope is none; the product's ends are left out. On the belt it is the step less that of the rest line:
where all jump alike, what follows was taken from another place.

Shifts. Where a product is level nothing jumps, but lines lean: all belt below lies aside by the lean times
the rows lost, which means over 40 rows tell. Textures shift it, too, by less than some seven lost rows do.

Grain. A smaller shift counts where the grain of the light breaks off, too. Speckle and texture displace a
stripe and brighten it, and the lens blurs them over rows: so from row to row both change by less than they do
over three. Of each stripe the change between rows r and r + 1 less a quarter of those before and after it,
squared, is compared with its mean over some eight rows on either side; at a tear it is several times as large
on all stripes at once. Edges of blocks of a JPEG file break it off, too, but every eight rows.

Fails where the tear crosses no product (then it harms none), where what is joined fits by accident (few rows
lost on a level product, or lines that do not lean), and on steps along the rows to a quarter of a degree.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.image_levels import median_of

_OFF_BELT_PX = 2.0
"""Peaks farther from every rest line lie on a product."""
_REACH_SHARE = 1.0
"""Of the lines' distance: as far is a stripe looked for in the next row; farther away none is near."""
_STEP_MAX_PX = 3.0
"""Steps before and after the jump are those of a surface that this camera sees whole."""
_STRIPES_MIN = 5  # that two neighbouring rows share: the median jump of fewer is not asked for
_JUMP_MIN_PX = 0.4
"""A median jump below it moves no volume by more than some tenths of a percent."""
_ROUNDED_JUMP_MIN_PX = 2.5
"""The same for peaks in whole pixels: rounding alone makes jumps of up to two."""
_TIMES_USUAL = 8.0
"""So many times the jumps of the frame's other rows, which noise and texture make. Of 56 whole images of two
makers the largest jump is five times the mean."""
_SAMPLED_ROWS = 8
"""Every so many rows tell how much stripes usually jump; blocks of so many tell the belt's shift."""
_BELT_PX = 1.0
"""Peaks so near to a rest line tell where the belt lies."""
_APART = 6.0
"""With lines so many times farther apart, peaks that lie so near to a line are each other's next ones."""
_SHIFT_BLOCKS, _SHIFT_STRIPES, _SHIFT_FULL = 5, 3, 0.85
"""Blocks above and below a row that are compared, on stripes that lie on the belt in such a part of both."""
_SHIFT_MIN_PX = 0.08
"""Lines lean by a hundredth: seven rows lost. Without a fault, textures shift it by up to 0.04 px."""


_SHIFT_WITH_GRAIN_PX = 0.03
"""Lines lean by a hundredth: three rows lost, where the grain breaks off there, too."""
_GRAIN_ROWS, _GRAIN_BESIDE, _GRAIN_REACH_PX = 24, 8, 1.2
"""So many rows above and below a shift are looked at, of stripes that go on within so many pixels, against so
many rows on either side."""
_FROM_RIM = 3
"""Rows on either side in which a stripe lies on the belt, or on a product: rims may lie along the rows."""
_GRAIN_MOST = 8.0
"""One stripe counts for no more: an edge, or glare."""
_GRAIN_MIN, _GRAIN_TIMES_NEXT = 2.5, 1.6
"""Times the usual change, and times that of any other boundary near it."""


class Tear(NamedTuple):
    """A frame's tear: the row after which it lies, and the median jump there, px; or the belt's shift."""

    row: int
    jump_px: float
    of_belt: bool = False


def tear_of(
    row_start: Integers, x_px: Floats, amplitude: Floats, lines_px: Floats, spacing_px: float
) -> Tear | None:
    """Give the tear of a frame; None of a whole one.

    Parameters
    ----------
    row_start, x_px, amplitude
        Of the peaks.
    lines_px
        (row, stripe) rest lines, px.
    spacing_px
        Their smallest distance.
    """
    # to whole or half pixels, as by middles of runs
    # eight peaks tell most frames apart; only of those that look rounded all are asked
    rounded = all(float(2.0 * x).is_integer() for x in x_px[:8])
    if rounded:
        twice = 2.0 * x_px
        rounded = bool((np.floor(twice) == twice).all())
    least_px = _ROUNDED_JUMP_MIN_PX if rounded else _JUMP_MIN_PX
    row, jump_px, usual_px, shift_row, shift_px, usual_shift_px, bends = _largest_jump(
        row_start, x_px, lines_px, _REACH_SHARE * spacing_px, _OFF_BELT_PX, _BELT_PX, _STEP_MAX_PX,
        _STRIPES_MIN, _SAMPLED_ROWS, _TIMES_USUAL, least_px,
    )  # fmt: skip
    # jumps first: they need no belt, and are plain where they are
    if row >= 0 and jump_px >= max(least_px, _TIMES_USUAL * usual_px):
        return Tear(row, jump_px)
    # whole pixels hide shifts of hundredths
    if shift_row < 0 or rounded:
        return None
    # a bend in the lines goes on behind the worst place; a shift does not
    if shift_px >= max(_SHIFT_MIN_PX, _TIMES_USUAL * usual_shift_px) and not bends:
        return Tear(shift_row, shift_px, of_belt=True)
    # too small for itself: the grain must break off within some rows of it
    if shift_px >= _SHIFT_WITH_GRAIN_PX:
        row, change, next_change = _grain(
            row_start, x_px, amplitude, lines_px, shift_row - _GRAIN_ROWS, shift_row + _GRAIN_ROWS,
            _GRAIN_BESIDE, _GRAIN_REACH_PX, _GRAIN_MOST, _STRIPES_MIN, _BELT_PX, _OFF_BELT_PX, _FROM_RIM,
        )  # fmt: skip
        if change >= max(_GRAIN_MIN, _GRAIN_TIMES_NEXT * next_change):
            return Tear(row, shift_px, of_belt=True)
    return None


@float_kernel
def _largest_jump(
    row_start: Integers, x_px: Floats, lines_px: Floats, reach_px: float, off_belt_px: float,
    belt_px: float, step_max_px: float, stripes_min: int, sampled: int, times_usual: float, least_px: float,
) -> tuple[int, float, float, int, float, float, bool]:  # fmt: skip
    """Give the row, the median jump and the usual jump where product or belt jump most; row −1 of none.

    And the same of where the belt is shifted most (`_shift`).
    """
    rows, stripes = lines_px.shape
    lines, none, wide, one = lines_px.reshape(-1), np.uint64(x_px.size), np.uint64(stripes), np.uint64(1)
    on_product = np.zeros(x_px.size + 1, np.bool_)  # places are unsigned: a signed one is asked for its sign
    # of each peak on a row that is not bare belt: the nearest one in the next row, `none` where none is near;
    # the peak whose nearest it is; the step to the next row
    after, before = np.full(x_px.size + 1, none, np.uint32), np.full(x_px.size + 1, none, np.uint32)
    step = np.empty(x_px.size)
    blocks = rows // sampled
    off_sum, near = np.zeros((blocks + 1, stripes)), np.zeros((blocks + 1, stripes))
    of_product = np.zeros(rows, np.int64)
    room = np.uint64(2 * stripes + 64)
    jumps, slips = np.empty(room), np.empty(room)
    # of product and belt: rows that count, the sum of their jumps, the row that jumps most, and its jump
    counted, total = np.zeros(2), np.zeros(2)
    worst, most = np.full(2, -1), np.zeros(2)
    told_apart = reach_px > _APART * belt_px
    for row in range(rows - 1):
        block = min(row // sampled + 1, blocks)
        line, last = np.uint64(row * stripes), np.uint64((row + 1) * stripes - 1)
        begin, end, stop = (
            np.uint64(row_start[row]),
            np.uint64(row_start[row + 1]),
            np.uint64(row_start[row + 2]),
        )
        slipped, large_slips = np.uint64(0), np.uint64(0)
        # counted by peaks alone at first: cheap, and most rows of a frame are bare belt
        bare = told_apart and end - begin == wide and stop - end == wide
        if bare:  # as most rows: every stripe on its own line, here and in the next row
            off_rest = np.uint64(0)
            for k in range(wide):
                here, there = x_px[begin + k] - lines[line + k], x_px[end + k] - lines[line + wide + k]
                slip = there - here
                slips[k] = slip
                large_slips += np.uint64(abs(slip) >= least_px)
                off_rest += np.uint64(not abs(here) <= belt_px) + np.uint64(not abs(there) <= belt_px)
            bare = off_rest == 0
        if bare:
            slipped = wide
            for k in range(wide):
                off_sum[block, k] += x_px[begin + k] - lines[line + k]
                near[block, k] += 1.0
        else:
            large_slips = np.uint64(0)
            nearest = end
            for p in range(begin, end):
                x = x_px[p]
                off = abs(x - lines[line])
                # peaks and lines both rise along the row, so the nearest line only moves on
                while line < last:
                    to_next = abs(x - lines[line + one])
                    if not to_next < off:
                        break
                    line, off = line + one, to_next
                on_product[p] = off > off_belt_px
                # for the belt's shift, by blocks of rows
                if off <= belt_px:
                    stripe = line - np.uint64(row * stripes)
                    off_sum[block, stripe] += x - lines[line]
                    near[block, stripe] += 1.0
                if nearest == stop:
                    continue
                way = x_px[nearest] - x
                # as for lines: the nearest peak of the next row only moves on
                while nearest + one < stop:
                    farther = x_px[nearest + one] - x
                    if abs(farther) > abs(way):
                        break
                    nearest, way = nearest + one, farther
                step[p] = way
                if abs(way) > reach_px:
                    continue
                after[p], before[nearest] = nearest, p
                if on_product[p]:
                    of_product[row] += 1
                elif slipped < room:
                    # on the belt a slope is that of the rest line, and no jump
                    slip = way - (lines[line + wide] - lines[line])
                    slips[slipped] = slip
                    large_slips += np.uint64(abs(slip) >= least_px)
                    slipped += one
        # among few belt peaks are those of a product's rim, which steps
        if slipped < stripes_min or 4 * slipped < 3 * wide or row == 0 or row >= rows - 2:
            continue
        if row % sampled == 0 or 4 * large_slips >= 3 * slipped:  # a median takes long
            _note(abs(median_of(slips[:slipped])), row, row % sampled == 0, 1, counted, total, worst, most)
    for row in range(1, rows - 2):
        if of_product[row] < stripes_min:
            continue
        count, large = np.uint64(0), np.uint64(0)
        for p in range(np.uint64(row_start[row]), np.uint64(row_start[row + 1])):
            if count >= room:
                break
            # four rows of one stripe: the step in the middle against those before and after
            third = np.uint64(after[p])
            if third == none or not on_product[p]:
                continue
            first = np.uint64(before[p])
            if not (on_product[first] and on_product[third] and on_product[after[third]]):
                continue  # `none` is on none
            if abs(step[first]) <= step_max_px and abs(step[third]) <= step_max_px:
                jump = abs(step[p] - 0.5 * (step[first] + step[third]))
                jumps[count] = jump
                large += np.uint64(jump >= least_px)
                count += one
        if count >= stripes_min and (row % sampled == 0 or 4 * large >= 3 * count):
            _note(median_of(jumps[:count]), row, row % sampled == 0, 0, counted, total, worst, most)
    usual = total / np.maximum(counted, 1.0)
    # product first; the belt only where no product jumps enough
    kind = 0 if most[0] >= max(least_px, times_usual * usual[0]) else 1
    return worst[kind], most[kind], usual[kind], *_shift(off_sum, near, sampled)


@float_kernel
def _grain(
    row_start: Integers, x_px: Floats, amplitude: Floats, lines_px: Floats, first_row: int, last_row: int,
    beside: int, reach_px: float, most: float, stripes_min: int, belt_px: float, off_belt_px: float,
    from_rim: int,
) -> tuple[int, float, float]:  # fmt: skip
    """Give the row after which the grain breaks off most, by how much, and by how much elsewhere at most.

    Both over the usual change of each stripe; elsewhere is more than two rows away. Row −1 where too few
    stripes go on.
    """
    rows = row_start.size - 1
    first_row, last_row = max(first_row, 1), min(last_row, rows - 3)
    low, high = max(first_row - beside - 2, 0), min(last_row + beside + 2, rows - 1)
    # sums forget by one part in `beside` a row, so they reach over some eight rows
    fading = 1.0 - 1.0 / beside
    start, size = row_start[low], row_start[high + 1] - row_start[low]
    after, before = np.full(size, -1), np.full(size, -1)
    kind = np.zeros(size, np.int64)  # 1 on the belt, 2 on a product, 0 between
    for row in range(low, high + 1):
        line = 0
        for p in range(row_start[row], row_start[row + 1]):
            while line + 1 < lines_px.shape[1] and abs(x_px[p] - lines_px[row, line + 1]) < abs(
                x_px[p] - lines_px[row, line]
            ):
                line += 1
            off = abs(x_px[p] - lines_px[row, line])
            kind[p - start] = 1 if off <= belt_px else 2 if off > off_belt_px else 0
    for row in range(low, high):
        nearest, stop = row_start[row + 1], row_start[row + 2]
        for p in range(row_start[row], row_start[row + 1]):
            while nearest + 1 < stop and abs(x_px[nearest + 1] - x_px[p]) <= abs(x_px[nearest] - x_px[p]):
                nearest += 1
            if nearest < stop and abs(x_px[nearest] - x_px[p]) <= reach_px:
                after[p - start], before[nearest - start] = nearest - start, p - start
    above, below = np.zeros(size, np.int64), np.zeros(size, np.int64)  # rows in which it is of the same kind
    for p in range(size):
        if before[p] >= 0 and kind[before[p]] == kind[p]:
            above[p] = above[before[p]] + 1
    for p in range(size - 1, -1, -1):
        if after[p] >= 0 and kind[after[p]] == kind[p]:
            below[p] = below[after[p]] + 1
    moved, brighter = np.full(size, -1.0), np.full(size, -1.0)  # squares of the changes; -1: none
    for p in range(size):
        a, c = before[p], after[p]
        # four peaks of a stripe: b and c on either side of the boundary, a before, d behind
        d = -1 if c < 0 else after[c]
        if a >= 0 and d >= 0:
            b = p + start
            a, c, d = a + start, c + start, d + start
            # c − b less a quarter of the changes before and after it: (5 (c − b) − (d − a)) / 4, free of
            # slopes
            moved[p] = (1.25 * (x_px[c] - x_px[b]) - 0.25 * (x_px[d] - x_px[a])) ** 2
            # relative to the light, so that bright stripes count no more than dim ones
            light = amplitude[b] + amplitude[c]
            if light > 0.0:
                brighter[p] = (
                    (2.5 * (amplitude[c] - amplitude[b]) - 0.5 * (amplitude[d] - amplitude[a])) / light
                ) ** 2
    # of what is above and below each peak: sums that fade along the stripe, and of how many rows they are
    sums = np.zeros((6, size + 1))  # the last place is that of no peak
    rows_up, moved_up, brighter_up = sums[0], sums[1], sums[2]
    rows_down, moved_down, brighter_down = sums[3], sums[4], sums[5]
    for p in range(size):
        to, counts = before[p], min(moved[p], brighter[p]) >= 0.0
        rows_up[p] = fading * rows_up[to] + (1.0 if counts else 0.0)
        moved_up[p] = fading * moved_up[to] + (moved[p] if counts else 0.0)
        brighter_up[p] = fading * brighter_up[to] + (brighter[p] if counts else 0.0)
    for p in range(size - 1, -1, -1):
        to, counts = after[p], min(moved[p], brighter[p]) >= 0.0
        rows_down[p] = fading * rows_down[to] + (1.0 if counts else 0.0)
        moved_down[p] = fading * moved_down[to] + (moved[p] if counts else 0.0)
        brighter_down[p] = fading * brighter_down[to] + (brighter[p] if counts else 0.0)
    change = np.zeros(rows)
    worst = -1
    for row in range(first_row, last_row + 1):
        stripes, total = 0, 0.0
        for p in range(row_start[row] - start, row_start[row + 1] - start):
            if moved[p] < 0.0 or brighter[p] < 0.0:
                continue
            if kind[p] == 0 or above[p] < from_rim or below[p] <= from_rim:
                continue
            # the usual change is of rows above b and below c: the boundary itself is in neither
            known = rows_up[before[p]] + rows_down[after[p]]
            usual_moved = moved_up[before[p]] + moved_down[after[p]]
            usual_brighter = brighter_up[before[p]] + brighter_down[after[p]]
            if known >= 0.5 * beside and usual_moved > 0.0 and usual_brighter > 0.0:
                stripes += 1
                total += min(moved[p] * known / usual_moved, most)
                total += min(brighter[p] * known / usual_brighter, most)
        if stripes >= stripes_min:
            change[row] = total / (2.0 * stripes)
            if worst < 0 or change[row] > change[worst]:
                worst = row
    if worst < 0:
        return -1, 0.0, 0.0
    elsewhere = 0.0
    for row in range(first_row, last_row + 1):
        # what else breaks off near here: edges of JPEG blocks do every eight rows
        if abs(row - worst) > 2:
            elsewhere = max(elsewhere, change[row])
    return worst, change[worst], elsewhere


@inlined
def _note(
    middle: float,
    row: int,
    counts: bool,
    kind: int,
    counted: Floats,
    total: Floats,
    worst: Integers,
    most: Floats,
) -> None:
    """Keep a row's median jump: among the usual ones where it counts, and as the largest where it is."""
    if counts:
        counted[kind] += 1.0
        total[kind] += middle
    if middle > most[kind]:
        worst[kind], most[kind] = row, middle


@float_kernel
def _shift(off_sum: Floats, near: Floats, sampled: int) -> tuple[int, float, float, bool]:
    """Give the row at which the belt is shifted most, how far, how far it usually is, and whether it bends.

    Usually: as far as chance shifts as many stripes as tell it there. A bend in the lines goes on. Row −1 of
    none.

    Parameters
    ----------
    off_sum, near : ndarray, shape (block + 1, stripe)
        By blocks of `sampled` rows, from the second on: sum of the distances of belt peaks from their line,
        px, and their number. Both are summed up in place.
    """
    blocks, stripes = near.shape
    shift, shifts, middle = np.zeros(blocks), np.empty(stripes), np.empty(blocks)
    sure = np.zeros(blocks)  # the scatter of a median of few stripes is larger by the root of their number
    known, full = 0, _SHIFT_FULL * _SHIFT_BLOCKS * sampled
    # running sums, so that any run of blocks is a difference
    for k in range(1, blocks):
        for s in range(stripes):
            off_sum[k, s] += off_sum[k - 1, s]
            near[k, s] += near[k - 1, s]
    for k in range(_SHIFT_BLOCKS, blocks - _SHIFT_BLOCKS):
        count = 0
        for s in range(stripes):
            above = near[k, s] - near[k - _SHIFT_BLOCKS, s]
            below = near[k + _SHIFT_BLOCKS, s] - near[k, s]
            # belt on nearly all rows of both runs: a stripe that a product covers tells nothing
            if above > full and below > full:
                shifts[count] = (off_sum[k + _SHIFT_BLOCKS, s] - off_sum[k, s]) / below
                shifts[count] -= (off_sum[k, s] - off_sum[k - _SHIFT_BLOCKS, s]) / above
                count += 1
        shift[k] = median_of(shifts[:count]) if count >= _SHIFT_STRIPES else np.inf
        if count >= _SHIFT_STRIPES:
            sure[k] = math.sqrt(count / stripes)
            middle[known] = shift[k]
            known += 1
    if known < 2 * _SHIFT_BLOCKS:
        return -1, 0.0, 0.0, False
    # the median over the frame is no tear
    turned = median_of(middle[:known])  # of a camera that has turned: the same everywhere
    known, worst, most = 0, -1, 0.0
    for k in range(_SHIFT_BLOCKS, blocks - _SHIFT_BLOCKS):
        if sure[k] > 0.0:
            middle[known] = sure[k] * abs(shift[k] - turned)
            if middle[known] > most:
                worst, most = k, middle[known]
            known += 1
    usual = median_of(middle[:known])
    if worst < 0:
        return -1, 0.0, 0.0, False
    # in px again, after comparing by certainty
    most, usual = most / sure[worst], usual / sure[worst]
    bends = False
    for k in (worst - _SHIFT_BLOCKS, worst + _SHIFT_BLOCKS):
        if _SHIFT_BLOCKS <= k < blocks - _SHIFT_BLOCKS:
            bends |= np.inf > abs(shift[k] - turned) > 0.5 * most
    return worst * sampled - 1, most, usual, bends
