"""Lines of a grid: each family by the planes of light, both by what they say where they cross.

Model. Each family is coded by `planes`: the lines across in the image turned by 90°. Where a line of one
family crosses a line of the other, one place is seen on two planes of light, and its line of sight meets
both at the same height if both labels are right. If one is a stripe off, the heights differ by what a label
is worth: how far the height moves from a plane to the next one. So a crossing agrees where heights differ by
less than a share of that, far more than noise and far less than a label. A run of a line at more of whose
crossings the heights differ than agree is refused, and on a product also one that no crossing confirms.

Peaks that go on where a run on a product ends, in its direction, are its own: `planes` refuses the last
ones before a rim, for a line that turns away from its neighbours may be another one. What a rest line of the
belt explains is not followed, so that no line is followed from the product's rim onto the belt.

Peaks that `planes` refused are asked again: a run of them that crosses labelled lines of the other family
has their heights there. Where all its crossings name one plane, and the next best lies far off, it is that.

It cannot tell what both families get wrong alike. Source: our own; the
constraint is that of Salvi, Pagès, Batlle (2004), Pattern Recognition 37:827, for grids.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from roemetry.errors import StageError
from roemetry.records import SATURATED, Peaks, Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.stripes import AMBIGUOUS, NOTHING
from roemetry.records.view import View
from roemetry.stages import Capabilities, Coder
from roemetry_coding.planes import PlanesOptions, coded_by_planes
from roemetry_kernels.compiling import kernel
from roemetry_kernels.consistency import required_calibration

_LINES_APART = 3
"""Rows from one epipolar line to the next in `planes`: crossings stand farther apart and check the labels."""
_SAME = 0.12
"""Of what a label is worth in height: within it two heights are the same. Noise is a fiftieth of it."""
_OTHER = 0.5
"""Of the same: beyond it the next best plane is another."""
_STEP_PX = 3.0
"""From row to row, by which a line that goes on does not move."""
_GAP_ROWS = 8
"""Longest part of a line that is not seen and behind which it goes on: a crossing takes five to eight."""
_REACH_ROWS = 4
"""Behind its end, that a line still crosses another: half of what a crossing takes."""
_THIN_PX, _THIN_SCATTERS = 0.3, 10.0
"""Beside its rest line, from which on a line may lie on something thin, and at least in median distances of
the belt's points from theirs: seven standard deviations."""
_ALONE_ROWS = 12
"""Least length of a thin part that does not go on from the product: half a spacing."""
_END_ROWS = 3
"""From its end, within which a line contradicts none that it crosses: half of its width."""
_FOLLOWED_PX = 1.0
"""Beside where a line goes on straight, that its next peak lies: at a rim it bends by half a pixel a row."""
_ALONE_PX = 4.0
"""From a peak that is followed to the next one in its row: two widths of a line."""
_REST_PX = 1.5
"""Beside a rest line, that a peak may be of the belt."""
_BACK_ROWS = 4
"""Over which the direction of a line is taken: noise moves it by 0.02 px a row, its bend by a tenth."""
_STRAY_ROWS = 3
"""Longest piece that is taken for a shadow's edge."""
_ON_LINE_PX = 1.0
"""Down the rows, between a peak and the line of the other family that it lies on."""
_CROSSINGS_MIN = 2
"""At which a run that was refused must name the same plane."""
_CONTRADICTED_MAX = 0.25
"""Share of crossings that may disagree: beyond it neither family can be trusted."""
_WHITE_MAX = 0.3
"""Share of saturated peaks, beyond which saturation is the reason to give for that."""
_WHITE_REFUSED = 0.7
"""The same, beyond which no label is tried. On epipolar lines a row apart no crossing confirmed any label of
grids drawn so bright that 81 % or 96 % of the peaks were saturated. On lines three rows apart labels are
found at 81 %, and crossings agree with them; but no volume from such peaks has been measured."""
_TOO_BRIGHT = "shorten the exposure: where lines cross there is twice as much light"


class GridPlanes(Coder[PlanesOptions]):
    """Codes each family by its planes, and asks them where they cross."""

    capabilities = Capabilities(pattern="grid")

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame; the lines across are in `StripeMap.across`.

        Raises
        ------
        StageError
            No calibration of a grid or no peaks of one; what `planes` refuses of either family, which is
            named; nothing crosses; the families contradict each other; or most peaks are saturated.
        """
        calibration = required_calibration(calibration, "grid-planes", "without planes a peak has no height")
        if peaks.across is None or calibration.across is None:
            what = "peaks are" if peaks.across is None else "calibration is"
            raise StageError(
                f"the {what} of one family of lines, not of a grid",
                hint="set `extractor: grid-lines` and calibrate with pinhole-grid",
            )
        flags = np.append(peaks.flags, peaks.across.flags)
        white = np.count_nonzero(flags & SATURATED) / max(flags.size, 1)
        if white > _WHITE_REFUSED:
            raise StageError(f"{white:.0%} of the peaks are saturated", hint=_TOO_BRIGHT)
        upright = coded_by_planes(peaks, calibration, self.options, lines_apart=_LINES_APART)
        try:
            across = coded_by_planes(peaks.across, calibration.across, self.options, lines_apart=_LINES_APART)
        except StageError as error:
            raise StageError(f"lines across: {error.message}", hint=error.hint) from error
        upright = _followed(_without_shadow_edges(upright), peaks)
        across = _followed(_without_shadow_edges(across), peaks.across)
        pair = _Families(calibration, calibration.across)
        met = _crossings(upright, across, pair)
        if not met.agree.size or met.agree.mean() < 1.0 - _CONTRADICTED_MAX:
            if white > _WHITE_MAX:
                raise StageError(
                    f"{white:.0%} of the peaks are saturated, and heights of both families agree at only "
                    f"{met.agree.sum()} of {met.agree.size} crossings",
                    hint=_TOO_BRIGHT,
                )
            if not met.agree.size:
                raise StageError(
                    "no line crosses one of the other family", hint="is this an image of a grid?"
                )
            raise StageError(
                f"heights of both families agree at only {met.agree.sum()} of {met.agree.size} crossings: "
                "image and calibration do not belong together",
                hint="look at the image; was it turned, another pattern used, or the camera moved?",
            )
        upright, gone = _kept(upright, peaks, met.stripe, met.row, met.agree)
        across, gone_across = _kept(across, peaks.across, met.line, met.column, met.agree)
        across = _numbered(across, upright, met)
        upright = _asked_again(upright, peaks, across, pair)
        upright = _with_thin_parts(upright, calibration)
        across = _with_thin_parts(across, calibration.across)
        if gone + gone_across:
            said = Reason(
                "crossings-disagree",
                f"{gone + gone_across} runs of lines were refused: their heights do not agree with those of "
                "the lines that they cross, or they cross no line",
            )
            upright = replace(upright, reasons=(*upright.reasons, said))
        return replace(upright, across=across)


class _Families:
    """Heights by the planes of both families, of places in the image as it is."""

    def __init__(self, upright: Calibration, across: Calibration) -> None:
        assert upright.view is not None and across.view is not None
        self._views: tuple[View, View] = (upright.view, across.view)
        self._columns = upright.image_size[1]
        self.worth_mm = min(_worth_mm(upright), _worth_mm(across))

    def upright_mm(self, xy_px: Floats, stripe: Integers) -> Floats:
        """Heights (n,) of places (n, 2) on planes (n,) of the lines that cross rows."""
        return _height_mm(self._views[0], xy_px, stripe)

    def across_mm(self, xy_px: Floats, line: Integers) -> Floats:
        """The same of the lines across."""
        turned = np.column_stack([xy_px[:, 1], self._columns - 1.0 - xy_px[:, 0]])
        return _height_mm(self._views[1], turned, line)


def _worth_mm(calibration: Calibration) -> float:
    """Height from a plane to the next one, where a place in the image stays the same."""
    if calibration.stripe_count < 2:
        return float(np.ptp(calibration.height_range_mm))
    apart = np.diff(calibration.rest_line_px(np.array([0.5 * (calibration.image_size[0] - 1)])), axis=0)
    return float(np.median(np.abs(apart)) / np.median(np.abs(calibration.displacement_px_per_mm)))


def _height_mm(view: View, xy_px: Floats, plane: Integers) -> Floats:
    start, way = view.rays(xy_px)
    of = view.planes[plane]
    along = (of[:, 3] - (of[:, :3] * start).sum(axis=1)) / (of[:, :3] * way).sum(axis=1)
    return np.asarray(start[:, 2] + along * way[:, 2])


@dataclass(frozen=True, eq=False, slots=True)
class _Met:
    """Crossings: (crossing,) stripe and row, line across and its row in the turned image, and agreement."""

    stripe: Integers
    row: Integers
    line: Integers
    column: Integers
    agree: Flags


def _crossings(upright: StripeMap, across: StripeMap, pair: _Families) -> _Met:
    """Find where labelled lines cross, and whether their heights agree there."""
    upright_px, across_px = _whole(upright, _REACH_ROWS), _whole(across, _REACH_ROWS)
    line, stripe, row = _crossed(upright_px, across_px)
    column = _column_of(across_px, upright_px[stripe, row])
    first = across_px[line, column] - row
    second = across_px[line, _column_of(across_px, upright_px[stripe, row + 1])] - (row + 1)
    share = first / (first - second)
    x_px = (1.0 - share) * upright_px[stripe, row] + share * upright_px[stripe, row + 1]
    xy_px = np.column_stack([x_px, row + share])
    off = pair.upright_mm(xy_px, stripe) - pair.across_mm(xy_px, line)
    agree = np.abs(off) < _SAME * pair.worth_mm
    # beside a line's end may be another surface, which contradicts nothing
    inside = _inner(upright)[stripe, row] & _inner(across)[line, column]
    kept = agree | inside
    return _Met(stripe[kept], row[kept], line[kept], column[kept], agree[kept])


def _whole(stripes: StripeMap, reach_rows: int) -> Floats:
    """Give where lines were seen on products and on the belt, with breaks filled and ends drawn out."""
    on, belt = (
        _drawn_out(_over_gaps(np.where(stripes.seen & where, stripes.x_px, np.nan)), reach_rows)
        for where in (stripes.product > 0, stripes.product <= 0)
    )
    return np.asarray(np.where(np.isfinite(on), on, belt))


def _inner(stripes: StripeMap) -> Flags:
    """Say (stripe, row) where a line goes on both ways, on the product or on the belt."""
    there, on = np.isfinite(_whole(stripes, 0)), stripes.product > 0
    inner = there.copy()
    for step in (-_END_ROWS, _END_ROWS):
        inner &= np.roll(there, step, axis=1) & (np.roll(on, step, axis=1) == on)
    return inner


@kernel
def _crossed(x_px: Floats, across_px: Floats) -> tuple[Integers, Integers, Integers]:
    """Give (n,) line across, stripe and row where, from that row to the next, a stripe crosses the line."""
    count, rows, columns = x_px.shape[0], x_px.shape[1], across_px.shape[1]
    found, many = np.empty((3, 64), np.int64), 0
    for line in range(across_px.shape[0]):
        for stripe in range(count):
            last = np.nan
            for row in range(rows):
                below, at = np.nan, columns - 1 - np.rint(x_px[stripe, row])
                if 0 <= at < columns:  # else outside of the image, or nowhere
                    below = across_px[line, int(at)] - row
                if (last > 0.0) != (below > 0.0) and abs(below - last) < _STEP_PX:
                    if many == found.shape[1]:
                        found = np.concatenate((found, np.empty_like(found)), axis=1)
                    found[0, many], found[1, many], found[2, many] = line, stripe, row - 1
                    many += 1
                last = below
    return found[0, :many].copy(), found[1, :many].copy(), found[2, :many].copy()


def _column_of(across_px: Floats, x_px: Floats) -> Integers:
    """Give the columns of lines across at places in the image: they count as rows of the turned image do."""
    return np.asarray(across_px.shape[1] - 1 - np.rint(x_px).astype(np.int64))


@kernel
def _drawn_out(x_px: Floats, reach_rows: int) -> Floats:
    """Give lines that go on straight for so many rows behind their ends."""
    drawn, last = x_px.copy(), x_px.shape[1] - 1
    for line in range(x_px.shape[0]):
        for way in (1, -1):
            for step in range(1, reach_rows + 1):
                for end in range(_BACK_ROWS, last):
                    row, back, ahead = end, end - _BACK_ROWS, end + 1
                    beyond = min(end + step, last)
                    if way < 0:
                        row, back, ahead, beyond = last - row, last - back, last - ahead, last - beyond
                    at = x_px[line, row]
                    ends = np.isnan(x_px[line, ahead]) and np.isfinite(at + x_px[line, back])
                    if ends and np.isnan(x_px[line, beyond]):
                        drawn[line, beyond] = at + step * ((at - x_px[line, back]) / _BACK_ROWS)
    return drawn


@kernel
def _over_gaps(x_px: Floats) -> Floats:
    """Give the places of lines with breaks filled that crossings make."""
    filled, run = x_px.copy(), _runs(x_px, _GAP_ROWS)
    for line in range(x_px.shape[0]):
        before = -1
        for row in range(x_px.shape[1]):
            if run[line, row] < 0:
                continue
            if 0 <= before < row - 1 and run[line, before] == run[line, row]:
                step = (x_px[line, row] - x_px[line, before]) / (row - before)
                for k in range(before + 1, row):
                    filled[line, k] = x_px[line, before] + (k - before) * step
            before = row
    return filled


@kernel
def _runs(x_px: Floats, gap_rows: int) -> Integers:
    """Give (stripe, row) the number of the run of rows without break or step; −1 where nothing is.

    Breaks of as many as `gap_rows`, behind which the stripe lies as near as a step, are none.
    """
    found, number = np.full(x_px.shape, -1), -1
    for stripe in range(x_px.shape[0]):
        before = -1
        for row in range(x_px.shape[1]):
            if np.isnan(x_px[stripe, row]):
                continue
            goes_on = before >= 0 and row - before <= 1 + gap_rows
            if goes_on:
                step_px = abs(x_px[stripe, row] - x_px[stripe, before])
                goes_on = step_px < _STEP_PX * (1.0 + 0.25 * gap_rows)
            number += not goes_on
            found[stripe, row], before = number, row
    return found


def _followed(stripes: StripeMap, peaks: Peaks) -> StripeMap:
    """Label refused peaks that go on where a run on a product ends."""
    starts = np.searchsorted(peaks.row, np.arange(stripes.rows + 1))
    stripe, product = _follow(
        stripes.x_px, stripes.seen.copy(), stripes.product, starts, peaks.x_px, stripes.peak_stripe,
        stripes.rest_px,
    )  # fmt: skip
    more = np.flatnonzero(stripe >= 0)
    if not more.size:
        return stripes
    place = stripe[more], peaks.row[more]
    fields = _copies(stripes)
    fields["x_px"][place], fields["x_std_px"][place] = peaks.x_px[more], peaks.x_std_px[more]
    fields["product"][place], fields["ambiguous"][place] = product[more], False
    fields["seen"][place], fields["margin"][place] = True, np.nan
    fields["peak_stripe"][more] = stripe[more]
    # what is bridged reaches to what is now seen
    for x_px, seen in zip(fields["x_px"], fields["seen"], strict=True):
        gap = np.flatnonzero(np.isfinite(x_px) & ~seen)
        if gap.size:
            ends = np.flatnonzero(seen)
            x_px[gap] = np.interp(gap, ends, x_px[ends])
    return replace(stripes, **fields)


_CHANGED = ("x_px", "x_std_px", "product", "seen", "margin", "ambiguous", "peak_stripe")


def _copies(stripes: StripeMap) -> dict[str, Any]:
    return {name: getattr(stripes, name).copy() for name in _CHANGED}


@kernel
def _follow(
    x_px: Floats, seen: Flags, product: Integers, starts: Integers, peak_px: Floats, label: Integers,
    rest_px: Floats,
) -> tuple[Integers, Integers]:  # fmt: skip
    """Give (peak,) stripe and product of peaks that are followed, −1 of others; marks them as `seen`.

    `starts` (row + 1,) says where the peaks of each row begin.
    """
    count, rows = x_px.shape
    stripe, number = np.full(peak_px.size, -1), np.full(peak_px.size, -1)
    waiting = np.empty(_GAP_ROWS + 1, np.int64)
    known_row, known_px = np.empty(_BACK_ROWS, np.int64), np.empty(_BACK_ROWS)
    for s in range(count):
        for end in range(rows):
            for way in (1, -1):
                beyond = end + way
                if not (seen[s, end] and product[s, end] > 0 and 0 <= beyond < rows) or seen[s, beyond]:
                    continue
                known = 0
                for row in range(end - way * (_BACK_ROWS - 1), end + way, way):
                    if 0 <= row < rows and seen[s, row] and product[s, row] > 0:
                        known_row[known], known_px[known] = row, x_px[s, row]
                        known += 1
                if known < _BACK_ROWS:
                    continue
                last, row, held = end, beyond, 0
                while 0 <= row < rows and abs(row - last) <= _GAP_ROWS and not seen[s, row]:
                    slope = (known_px[-1] - known_px[0]) / (known_row[-1] - known_row[0])
                    expected_px = known_px[-1] + slope * (row - last)
                    best, near, next_px = _nearest_two(peak_px, starts[row], starts[row + 1], expected_px)
                    # of the stripe itself are pieces too short to be believed alone
                    free = near < _FOLLOWED_PX and (label[best] < 0 or label[best] == s) and stripe[best] < 0
                    if free and next_px > _ALONE_PX:
                        waiting[held] = best
                        held += 1
                        if _off_lines(rest_px[:, row], peak_px[best]) >= _REST_PX:
                            # what has passed a rest line, and goes on behind it, was no belt
                            for peak in waiting[:held]:
                                stripe[peak], number[peak] = s, product[s, end]
                            last, held = row, 0
                            seen[s, row] = True
                            known_row[:-1], known_px[:-1] = known_row[1:].copy(), known_px[1:].copy()
                            known_row[-1], known_px[-1] = row, peak_px[best]
                    row += way
    return stripe, number


@kernel
def _off_lines(lines_px: Floats, at_px: float) -> float:
    """Give how far the nearest line is."""
    off = np.inf
    for line_px in lines_px:
        if abs(line_px - at_px) < off:
            off = abs(line_px - at_px)
    return off


@kernel
def _nearest_two(peak_px: Floats, first: int, end: int, expected_px: float) -> tuple[int, float, float]:
    """Give the nearest of a row's peaks to where one is expected, how far it is, and the next one from it."""
    best, near = -1, np.inf
    for k in range(first, end):
        if abs(peak_px[k] - expected_px) < near:
            best, near = k, abs(peak_px[k] - expected_px)
    apart = np.inf
    for k in range(first, end):
        if k != best:
            apart = min(apart, abs(peak_px[k] - peak_px[best]))
    return best, near, apart


def _without_shadow_edges(stripes: StripeMap) -> StripeMap:
    """Leave out short pieces off the belt that a bridged gap joins to what they do not belong to.

    Where the edge of a shadow cuts a line obliquely, its last rows on the belt lie beside their rest line.
    """
    run = _runs(np.where(stripes.seen & (stripes.product > 0), stripes.x_px, np.nan), 0)
    short = np.bincount(run[run >= 0], minlength=1) <= _STRAY_ROWS
    out = (run >= 0) & short[run]
    if not out.any():
        return stripes
    rows = np.arange(stripes.rows)
    before = np.maximum.accumulate(np.where(stripes.seen, rows, 0), axis=1)
    after = np.minimum.accumulate(np.where(stripes.seen, rows, rows[-1])[:, ::-1], axis=1)[:, ::-1]
    ends = np.take_along_axis(out, before, axis=1) | np.take_along_axis(out, after, axis=1)
    return _left_out(stripes, out | (~stripes.seen & ends))


def _left_out(stripes: StripeMap, out: Flags) -> StripeMap:
    nan = np.where(out, np.nan, 1.0)
    return replace(
        stripes,
        x_px=stripes.x_px * nan,
        x_std_px=stripes.x_std_px * nan,
        margin=stripes.margin * nan,
        product=np.where(out, NOTHING, stripes.product).astype(np.int16),
        seen=stripes.seen & ~out,
    )


def _kept(
    stripes: StripeMap, peaks: Peaks, stripe: Integers, row: Integers, agree: Flags
) -> tuple[StripeMap, int]:
    """Leave out runs that more crossings contradict than confirm, on products also those that none confirms.

    Gives also how many they are.
    """
    out, many = np.zeros(stripes.x_px.shape, np.bool_), 0
    for on, least in ((stripes.product > 0, 1.0), (stripes.product <= 0, 0.0)):
        run = _runs(_drawn_out(_over_gaps(np.where(on, stripes.x_px, np.nan)), _REACH_ROWS), 0)
        at = run[stripe, row]
        counted = at >= 0
        count = int(run.max(initial=-1)) + 1
        votes = np.bincount(at[counted], np.where(agree, 1.0, -1.0)[counted], minlength=count)
        bad = votes < least
        out |= on & (run >= 0) & np.append(bad, False)[run]
        many += np.unique(run[stripes.seen & on & (run >= 0) & np.append(bad, False)[run]]).size
    if not out.any():
        return stripes, 0
    label = stripes.peak_stripe.copy()
    given = np.flatnonzero(label >= 0)
    label[given[out[label[given], peaks.row[given]]]] = AMBIGUOUS
    left = replace(_left_out(stripes, out), ambiguous=stripes.ambiguous | out, peak_stripe=label)
    return left, many


def _numbered(across: StripeMap, upright: StripeMap, met: _Met) -> StripeMap:
    """Give products across the numbers of those they cross; what crosses none is left out."""
    here, there = upright.product[met.stripe, met.row], across.product[met.line, met.column]
    product = across.product.copy()
    for number in range(1, int(across.product.max(initial=0)) + 1):
        others = here[met.agree & (there == number) & (here > 0)]
        product[across.product == number] = np.bincount(others).argmax() if others.size else NOTHING
    return replace(_left_out(across, product == NOTHING), product=product)


def _with_thin_parts(stripes: StripeMap, calibration: Calibration) -> StripeMap:
    """Give a product its thin parts, which `planes` takes for belt: they lie nearer to it than a pixel.

    On this very frame the belt's lines scatter about their rest lines by far less. What lies above that, and
    goes on from the product or is long, is the product's, if it is near one.
    """
    from scipy.spatial import cKDTree

    off = (stripes.x_px - stripes.rest_px) * np.sign(calibration.displacement_px_per_mm)[:, None]
    belt, on = stripes.seen & (stripes.product == 0), stripes.seen & (stripes.product > 0)
    if not belt.any() or not on.any():
        return stripes
    least_px = max(_THIN_PX, _THIN_SCATTERS * float(np.median(np.abs(off[belt]))))
    thin = belt & (off > least_px)
    run = _runs(np.where(thin | on, stripes.x_px, np.nan), 0)
    count = int(run.max(initial=-1)) + 1
    length = np.bincount(run[thin], minlength=count)
    joined = np.bincount(run[on], minlength=count) > 0
    thin &= (joined | (length >= _ALONE_ROWS))[run]
    stripe, row = np.nonzero(thin)
    if not stripe.size:
        return stripes
    of = np.nonzero(on)
    spacing_px = (
        abs(float(np.median(np.diff(stripes.rest_px, axis=0)))) if stripes.stripe_count > 1 else np.inf
    )
    away, nearest = cKDTree(np.column_stack([stripes.x_px[of], of[1]])).query(
        np.column_stack([stripes.x_px[stripe, row], row])
    )
    near = away < 1.5 * spacing_px
    product = stripes.product.copy()
    product[stripe[near], row[near]] = stripes.product[of][nearest[near]]
    return replace(stripes, product=product)


def _asked_again(upright: StripeMap, peaks: Peaks, across: StripeMap, pair: _Families) -> StripeMap:
    """Label runs of refused peaks by the heights of the lines across that they lie on."""
    open_ = np.flatnonzero(upright.peak_stripe < 0)
    if not open_.size:
        return upright
    row, x_px = peaks.row[open_], peaks.x_px[open_]
    run = _chained(row, x_px)
    at = across.rows - 1 - np.rint(x_px).astype(np.int64)
    line, which = np.nonzero(np.abs(across.x_px[:, at] - row) < _ON_LINE_PX)
    xy_px = np.column_stack([x_px, row]).astype(np.float64)[which]
    count = upright.stripe_count
    own_mm = pair.upright_mm(np.repeat(xy_px, count, axis=0), np.tile(np.arange(count), which.size))
    off = np.abs(own_mm.reshape(-1, count) - pair.across_mm(xy_px, line)[:, None]) / pair.worth_mm
    best = off.argmin(axis=1) if which.size else np.empty(0, np.int64)
    near = np.sort(off, axis=1)
    sure = (near[:, 0] < _SAME) & (near[:, 1:2] > _OTHER).all(axis=1)
    product = across.product[line, at[which]]
    fields = _copies(upright)
    for number in np.unique(run[which]):
        mine = run[which] == number
        named = np.unique(best[mine])
        members = np.flatnonzero(run == number)
        free = np.isnan(fields["x_px"][named[0], row[members]]).all()
        if np.unique(line[mine]).size < _CROSSINGS_MIN or named.size > 1 or not sure[mine].all() or not free:
            continue
        place = named[0], row[members]
        fields["x_px"][place], fields["x_std_px"][place] = x_px[members], peaks.x_std_px[open_[members]]
        fields["product"][place] = np.bincount(np.maximum(product[mine], 0)).argmax()
        fields["seen"][place], fields["margin"][place] = True, np.nan
        fields["ambiguous"][place] = False
        fields["peak_stripe"][open_[members]] = named[0]
    return replace(upright, **fields)


def _chained(row: Integers, x_px: Floats) -> Integers:
    """Give (peak,) the number of the run, from row to row, that each peak belongs to; one peak a row."""
    run: Integers = np.arange(row.size)
    ends: dict[int, list[int]] = {}
    for peak in range(row.size):
        near = [
            (abs(x_px[end] - x_px[peak]), end)
            for end in ends.get(row[peak] - 1, ())
            if abs(x_px[end] - x_px[peak]) < _STEP_PX
        ]
        if near:
            before = min(near)[1]
            run[peak] = run[before]
            ends[row[peak] - 1].remove(before)
        ends.setdefault(row[peak], []).append(peak)
    return run
