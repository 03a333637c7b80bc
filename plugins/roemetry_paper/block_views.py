"""What the images of the empty belt and of the block show.

Model. On the empty belt a stripe is a line, bowed by the lens: x = a + b y + c y² (radial distortion's first
term bows a straight line by a parabola). On the block's top, h above the belt, each stripe i is displaced by
D_i, all to one side, and D changes smoothly from stripe to stripe, for the planes fan out from one projector.

Peaks of any extractor are gathered into lines first (pieces of one line are joined, a second peak in the same
stripe and stray peaks fall to the line or away), so neither speckle nor a missing peak matters. In the rows
of the block the lines are matched to stripes in order. A stripe may miss the top (it then stays on its belt
line or is hidden), so several matchings are possible: the one whose displacements are a smooth function of
the stripes' places is taken (the places' own irregularities cancel in the right one alone), and if two are
equally smooth, none. It fails where the block's rows cannot be told: all displaced stripes on belt lines.

Centres: the paper's peak is the last pixel of the highest plateau. On a stripe that is clipped at white
that is up to half the plateau to the right of its middle: 0.5 to 2 px, and only where the surface is
bright. The centre of gravity of what exceeds half the peak's height, over the contiguous pixels around it,
is free of that (clipping is symmetric) and of rounding. It assumes a symmetric profile that is alone within
its half height; at the edge of a print or of a surface it follows the edge, as any centre of gravity does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from roemetry.errors import CalibrationError, StageError
from roemetry.records import CalibrationSet, Frame, Observation, Peaks
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.rest_lines import rest_lines_of_frame
from roemetry_kernels.tracing import trace_fragments
from roemetry_paper.block_linear import displacements

_BOW_ROWS_MIN = 200
"""Rows of belt from which a parabola is determined better than a pixel's rounding; below, a straight line."""
_UNSEEN_DISTORTION = 0.01
"""Share of the image's half diagonal by which a lens for measuring may distort its corners."""
_BOW_SIGMAS = 5.0
"""A bow of fewer standard deviations is none: in a straight rig it would only add noise."""
_LINE_ROWS_MIN = 12
"""Rows of a line: from fewer its slope is not known to a pixel."""
_LINE_SHARE_MIN = 0.3
"""Of the longest line's peaks: what has fewer is a reflection or the edge of something."""
_JOIN_PX = 3.5
"""Pieces whose middle distance is less are one line: speckle splits a stripe into peaks 2 to 3 px apart."""
_SURPLUS_SHARE = 0.5
"""Of the weakest stripe's peaks: more lines than stripes are tolerated where the surplus has fewer."""
_DISPLACED_MIN_PX = 4.0
"""A stripe on the block is displaced by more than this, px: whole-pixel peaks and speckle scatter by 1 px. A
block of 16 mm displaces by 40 px and more."""
_BLOCK_ROWS_MIN = 20
"""Rows of the block's top: shorter ones give the scale to no better than 5 %."""
_RUN_GAP_ROWS = 12
"""Rows without a displaced peak that do not end the block: glints and dirt."""
_TRIM = 0.1
"""Of the top's rows at either end that are not used: edges are chamfered, and smeared by the extractor."""
_BATCH_ROWS = 8
"""Rows that are averaged into one nearly independent value: peaks are correlated over two or three rows."""
_BATCHES_MIN = 6
"""Batches from which a scatter is estimated; from fewer, rows are taken as correlated over a batch."""
_BODY_STEP_PX = 7.0
"""A trace goes on where the next row's peak is nearer, px: half the body window of the paper."""
_END_ROWS = 12
"""Rows at the image's ends where only belt is."""
_REST_RMS_MAX_PX = 1.5
"""Scatter of peaks about straight lines or parabolas, px: whole-pixel peaks in speckle give 0.2 to 0.6; more
is a bent belt or lens."""
_EDGE_ROOM_MIN_PX = 0.75
"""A block that displaces by a whole spacing puts each stripe on its neighbour's belt line; nearer than this,
px, edges cannot be told."""
_EDGE_GAP_ROWS = 3
"""Rows without a peak that do not end the block: speckle takes single peaks."""
_MAD_TO_STD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
_ROOM_MIN_PX = 1.5
"""Least room about a belt line, px: one and a half whole pixels."""
_ROOM_SIGMAS = 4.0
"""A peak is on a belt line within so many of its scatter; less than 1.5 px is within whole pixels."""
_HIDDEN_MAX = 2
"""Stripes at an end that may strike the block's side, where the camera does not see them."""
_SMOOTHER = 1.5
"""Times as smooth the chosen matching must be as the next; rows' own scatter leaves a tenth."""


@dataclass(frozen=True, eq=False, slots=True)
class BlockView:
    """A block in one image."""

    offset_px: Floats
    offset_std_px: Floats
    """offset_px, offset_std_px: (stripe,) displacement on the block's top and its standard uncertainty, px;
    NaN where not seen."""
    scatter_px: float
    """Scatter of single rows about the offsets, px."""
    width_px: float
    width_std_px: float
    """width_px, width_std_px: extent of the top along the stripes, square to its edges, and its standard
    uncertainty, px."""
    edge_rms_px: float
    """Scatter of the edges about straight lines, px."""
    yaw_rad: float
    """Turn of the block about the vertical."""
    span_px: float
    """Extent of the top across the stripes that is seen, px."""
    row_px: Floats
    """(stripe,) mean row of what `offset_px` comes from, from the middle row."""
    growth_per_px: Floats
    growth_std_per_px: Floats
    """growth_per_px, growth_std_per_px: (stripe,) relative growth of the displacement from row to row, 1/px,
    and its standard uncertainty: a camera that is tilted along the stripes sees nearer rows displaced
    further."""
    offset_per_bow: Floats
    """(stripe,) derivative of `offset_px` by the lens's distortion κ, px³."""


class RestFit(NamedTuple):
    """Rest lines of the bare belt."""

    lines_px: Floats
    """(stripe, 2 or 3) x in the middle row, px, slope, and bow."""
    rms_px: float
    """Rms distance of the peaks from them."""
    covariance: Floats
    """(stripe, k, k) of each line."""
    bow_per_px2: float
    bow_std_per_px2: float
    """bow_per_px2, bow_std_per_px2: first radial distortion of the lens about the image's middle, and its
    standard uncertainty, px⁻²: a straight line x = a is seen as a (1 + κ (a² + y²)), so its bow is κ a
    (plumb lines: Brown 1971)."""


def rest_polynomials(observed: CalibrationSet) -> RestFit:
    """Fit each stripe's rest line.

    From the images of the empty belt; without one, from the belt above and below the block.

    Raises
    ------
    CalibrationError
        Not the expected number of stripes.
    """
    # without an image of the empty belt, the belt above and below the block has to do
    belts = observed.showing("belt")
    if not belts:
        view = observed.showing("block")[0]
        return _from_block_image(view, observed.stripe_count)
    middle = (belts[0].frame.size[0] - 1) / 2.0
    stripe, from_middle, x_px = (np.empty(0) for _ in range(3))
    for view in belts:
        peaks = _centred(view)
        lines = _strongest(_lines_in(peaks, np.arange(len(peaks))), observed.stripe_count)
        # a stripe too many or too few would number all those to its right wrongly
        if len(lines) != observed.stripe_count:
            raise CalibrationError(
                f"{view.frame.name}: {observed.stripe_count} stripes are expected on the empty belt, "
                f"{len(lines)} are seen",
                hint="check `stripes` in the rig file, the extractor's threshold, turn_deg, "
                "and that every stripe crosses the whole image",
            )
        for number, line in enumerate(lines):
            row, x = _one_a_row(peaks, line)
            stripe = np.concatenate([stripe, np.full(row.size, number)])
            from_middle = np.concatenate([from_middle, row - middle])
            x_px = np.concatenate([x_px, x])
    return _fitted(stripe, from_middle, x_px, observed.stripe_count, belts[0].frame)


def view_of_block(view: Observation, fit: RestFit) -> BlockView:
    """Measure displacements and edges of the block in one image, without the lens's distortion."""
    rest_px = fit.lines_px
    stripes = rest_px.shape[0]
    peaks = _centred(view)
    from_middle = np.arange(peaks.image_size[0]) - (peaks.image_size[0] - 1) / 2.0
    # (stripe, row) rest lines in the image, as the lens shows them
    rest = np.polynomial.polynomial.polyval(from_middle, rest_px.T)
    middle_px, bow = (peaks.image_size[1] - 1) / 2.0, fit.bow_per_px2
    mean, std, scatter, at_row, growth, growth_std, by_bow = np.full((7, stripes), np.nan)
    first, last = np.full((2, stripes, 2), np.nan)
    # a stripe that misses the block keeps NaN
    for stripe, line in _on_the_block(peaks, rest, max(_ROOM_MIN_PX, _ROOM_SIGMAS * fit.rms_px)).items():
        row, x = _one_a_row(peaks, line)
        # displaced at all: beyond the scatter of whole pixels, below any block
        offset = x - rest[stripe, row]
        run = _longest_run(row, np.abs(offset) > _DISPLACED_MIN_PX)
        if run.size < _BLOCK_ROWS_MIN:
            continue
        # chamfers and smeared edges at both ends
        trim = int(_TRIM * run.size)
        inside = run[trim : run.size - trim]
        # of what is left, strays far from the median
        inside = inside[np.abs(offset[inside] - np.median(offset[inside])) < _DISPLACED_MIN_PX]
        own = row[inside]
        # displacements without the lens, and where they were read from the image's middle
        inner, straight = displacements(x[inside], from_middle[own], rest_px[stripe], middle_px, bow)
        off_middle = straight[:, 1]
        mean[stripe], std[stripe] = inner.mean(), _std_of_mean(inner)
        scatter[stripe] = inner.std()
        at_row[stripe] = off_middle.mean()
        # a line through displacement over row; its slope over its value is the relative growth
        grown, of_line, _ = _line(off_middle - off_middle.mean(), inner, 1)
        growth[stripe] = grown[1] / grown[0]
        growth_std[stripe] = np.sqrt(of_line[1, 1]) / abs(grown[0])
        # a place r from the middle is seen at r + κ r³: what one unit of κ takes off the displacement
        # where the rest line is seen in the same rows
        at_rest = np.column_stack([straight[:, 0] - inner, straight[:, 1]])
        by_bow[stripe] = np.mean(
            at_rest[:, 0] * (at_rest**2).sum(axis=1) - straight[:, 0] * (straight**2).sum(axis=1)
        )
        # by the top's own displacement, from a row in its midst up and down
        edges = _edges(peaks, rest, stripe, float(offset[inside].mean()), int(row[run[run.size // 2]]))
        if edges is not None:
            ends = np.array(edges) - (peaks.image_size[0] - 1) / 2.0
            at_edges = np.full(2, x[run].mean())
            first[stripe], last[stripe] = displacements(at_edges, ends, rest_px[stripe], middle_px, bow)[1]
    # place along X of the top, half way between its edges, without the lens
    place = 0.5 * (first[:, 0] + last[:, 0])
    width, width_std, edge_rms, yaw = _width(place, first[:, 1], last[:, 1])
    scatter_px = float(np.nanmean(scatter)) if np.isfinite(scatter).any() else np.nan
    span_px = float(np.nanmax(place) - np.nanmin(place)) if np.isfinite(place).any() else np.nan
    return BlockView(
        mean, std, scatter_px, width, width_std, edge_rms, yaw, span_px, at_row, growth, growth_std, by_bow
    )


def _centred(view: Observation) -> Peaks:
    """Give an image's peaks; whole pixels are replaced by the stripes' centres there."""
    peaks = view.peaks
    # an extractor that gives fractions or states an uncertainty has found the centre itself
    if not is_whole(peaks.x_px) or np.isfinite(peaks.x_std_px).any():
        return peaks
    x_px = centres(view.frame.pixels, peaks.row, peaks.x_px, peaks.background, peaks.amplitude)
    return replace(peaks, x_px=np.where(_in_order(peaks, x_px), x_px, peaks.x_px))


def _in_order(peaks: Peaks, x_px: Floats) -> Flags:
    """Say which peaks would still stand in a row's order; two on one plateau have the same centre."""
    # a row whose peaks would change places keeps the extractor's
    ahead = (np.diff(x_px) <= 0.0) & (np.diff(peaks.row) == 0)
    row = np.isin(peaks.row, peaks.row[1:][ahead])
    return np.asarray(~row)


def _lines_in(peaks: Peaks, chosen: Integers) -> list[Integers]:
    """Give the peaks of each line, left to right: fragments, joined where they continue each other."""
    if not chosen.size:
        return []
    row, x_px = peaks.row[chosen].astype(np.float64), peaks.x_px[chosen]
    # where each row begins among the chosen peaks
    starts = np.searchsorted(peaks.row[chosen], np.arange(peaks.image_size[0] + 1))
    fragment, _ = trace_fragments(starts, np.ascontiguousarray(x_px), _BODY_STEP_PX)
    order = np.argsort(fragment, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(fragment[order])) + 1)
    lines: list[Integers] = []
    curves: list[Floats] = []
    # long pieces first: they point well, and short ones are judged by them
    for part in sorted(parts, key=len, reverse=True):
        # two points are no course
        if len(part) < 3:
            break
        # the median distance of the piece from each line so far, at the piece's own rows
        off = [abs(float(np.median(x_px[part] - _at(curve, row[part])))) for curve in curves]
        near = int(np.argmin(off)) if off else -1
        if near >= 0 and off[near] < _JOIN_PX:
            lines[near] = np.concatenate([lines[near], part])
        elif len(part) >= _LINE_ROWS_MIN:  # a line of its own; shorter pieces near no line are dropped
            lines.append(part)
            curves.append(np.empty(0))
            near = len(lines) - 1
        else:
            continue
        curves[near] = _curve(row[lines[near]], x_px[lines[near]])
    # what is left of two halves that were both too short at first
    lines = _merged(lines, row, x_px)
    longest = max((line.size for line in lines), default=0)
    lines = [line for line in lines if line.size >= max(_LINE_ROWS_MIN, _LINE_SHARE_MIN * longest)]
    # left to right in the middle row: lines are nearly parallel, but reflections need not be
    middle = float(np.median(row))
    lines.sort(key=lambda line: float(_at(_curve(row[line], x_px[line]), middle)))
    return [np.sort(chosen[line]) for line in lines]


def _merged(lines: list[Integers], row: Floats, x_px: Floats) -> list[Integers]:
    """Join lines that are one, found in two parts before either was long enough to point well."""
    kept: list[Integers] = []
    for line in sorted(lines, key=len, reverse=True):
        for number, other in enumerate(kept):
            # the longer one's curve is extrapolated to the shorter one's rows
            curve = _curve(row[other], x_px[other])
            if abs(float(np.median(x_px[line] - _at(curve, row[line])))) < _JOIN_PX:
                kept[number] = np.concatenate([other, line])
                break
        else:
            kept.append(line)
    return kept


def _curve(row: Floats, x_px: Floats) -> Floats:
    """Give a line by row, or a parabola where there are rows enough; the last number is its middle row."""
    degree = 2 if np.ptp(row) >= _BOW_ROWS_MIN and row.size >= _BOW_ROWS_MIN else 1
    middle = row.mean()
    keep = np.ones(row.size, np.bool_)
    # three rounds, each without the strays of the one before
    found = np.zeros(1)
    for _ in range(3):
        found = np.polynomial.polynomial.polyfit(row[keep] - middle, x_px[keep], degree)
        off = np.abs(x_px - np.polynomial.polynomial.polyval(row - middle, found))
        # at least half a pixel, or whole-pixel peaks on a perfect line would be thrown out
        keep = off <= max(3.0 * _MAD_TO_STD * float(np.median(off)), 0.5)
    return np.append(found, middle)


def _at(curve: Floats, row: Floats | float) -> Floats:
    return np.asarray(np.polynomial.polynomial.polyval(np.asarray(row) - curve[-1], curve[:-1]))


def _one_a_row(peaks: Peaks, line: Integers) -> tuple[Integers, Floats]:
    """Give the rows of a line and x in each, px: the mean of its peaks by their height."""
    row, at = np.unique(peaks.row[line], return_inverse=True)
    # by light: of two speckles in one stripe the brighter is nearer to its middle
    light = np.maximum(peaks.amplitude[line], 1e-6)
    return row.astype(np.int64), np.bincount(at, light * peaks.x_px[line]) / np.bincount(at, light)


def _strongest(lines: list[Integers], count: int) -> list[Integers]:
    """Leave surplus lines out that are far weaker than the weakest stripe."""
    if len(lines) <= count:
        return lines
    size = np.array([line.size for line in lines])
    # the weakest line that is needed, and the strongest that is not
    weakest, surplus = np.sort(size)[::-1][count - 1 : count + 1]
    # as strong as a stripe: then the number of stripes is wrong, which is for the caller to say
    if surplus > _SURPLUS_SHARE * weakest:
        return lines
    return [line for line, own in zip(lines, size, strict=True) if own >= weakest]


def _on_the_block(peaks: Peaks, rest: Floats, room_px: float) -> dict[int, Integers]:
    """Give the peaks on the block's top by stripe; {} where there is none or two matchings are as good."""
    stripes = rest.shape[0]
    rows = _rows_of_block(peaks, rest, room_px)
    if rows is None:
        return {}
    first, last = rows
    chosen = np.flatnonzero((peaks.row >= first) & (peaks.row <= last))
    lines = _lines_in(peaks, chosen)
    middle = (first + last) // 2
    found = np.array([_at(_curve(peaks.row[line].astype(float), peaks.x_px[line]), middle) for line in lines])
    at_rest = rest[:, middle]
    best: list[tuple[float, float, dict[int, int]]] = []
    # the first line on the block is of stripe `shift`, if `skipped` lines before it are belt
    for shift in range(stripes):
        for skipped in range(min(shift, len(lines)) + 1):
            tried = _matched(found, at_rest, shift, skipped)
            if tried is not None:
                best.append(tried)
    if not best:
        return {}
    # first what stays unexplained, then roughness
    best.sort(key=lambda one: (one[0], one[1]))
    chosen_one = best[0]
    for other in best[1:]:
        # the same pairs reached in another way are no rival
        same = other[2] == chosen_one[2]
        # another explains as much and is nearly as smooth: it is not plain which is right
        if not same and other[0] == chosen_one[0] and other[1] < _SMOOTHER * chosen_one[1]:
            return {}
    return {stripe: lines[line] for stripe, line in chosen_one[2].items()}


def _matched(
    found: Floats, at_rest: Floats, shift: int, first_line: int
) -> tuple[float, float, dict[int, int]] | None:
    """Match lines in order to stripes from `shift` on; give what stays unexplained, roughness, px, and pairs.

    Lines before `first_line` and behind the last pair must be stripes that stay on the belt; stripes that
    are on neither count as unexplained.
    """
    pairs: dict[int, int] = {}
    side = 0.0
    for line in range(first_line, found.size):
        stripe = line - first_line + shift
        if not 0 <= stripe < at_rest.size:
            break
        offset = float(found[line] - at_rest[stripe])
        # still on its belt line, or to the other side than its neighbours: the block ends before it
        if abs(offset) <= _DISPLACED_MIN_PX or side * offset < 0.0:
            break
        side = np.sign(offset)
        pairs[stripe] = line
    # three displacements show whether they change smoothly; two always do
    if len(pairs) < min(3, at_rest.size):
        return None
    hit, line_of = np.array(list(pairs)), np.array(list(pairs.values()))
    offsets = found[line_of] - at_rest[hit]
    # in shares of the fan's width; the places' own irregularities are in `at_rest`, so the wrong shift is
    # rough
    place = (at_rest[hit] - at_rest.mean()) / max(float(np.ptp(at_rest)), 1.0)
    # with few pairs a parabola would fit whatever they are
    degree = min(2, len(pairs) - 2)
    rough = np.abs(offsets - np.polyval(np.polyfit(place, offsets, degree), place))
    # lines that are neither: a stripe that stays on the belt is near its rest line
    left = [x for number, x in enumerate(found) if number not in pairs.values()]
    # a stripe is on the block or on its belt line in these rows, not on both
    near = [int(np.abs(at_rest - x).argmin()) for x in left]
    unexplained = sum(
        abs(float(at_rest[one] - x)) >= _DISPLACED_MIN_PX or one in pairs
        for one, x in zip(near, left, strict=True)
    )
    # stripes that are seen nowhere: at an end the block's side may hide them, amid the others nothing can
    lost = [one for one in range(at_rest.size) if one not in pairs and one not in near]
    inner = sum(int(hit.min() < one < hit.max()) for one in lost)
    if len(lost) > _HIDDEN_MAX or inner:
        return None
    # not below a twentieth of a pixel: the ratio of two tiny roughnesses tells nothing
    return float(unexplained), float(max(np.median(rough), 0.05)), pairs


def _rows_of_block(peaks: Peaks, rest: Floats, room_px: float) -> tuple[int, int] | None:
    """Give the first and last row in which the belt's lines are interrupted, a little inside; or None.

    Displaced by about a spacing, stripes lie near their neighbours' belt lines: hence the narrow room.
    """
    empty = np.zeros(rest.shape[1])
    for row in range(rest.shape[1]):
        # each belt line's distance from the nearest peak of the row
        x = peaks.x_px[peaks.row_start[row] : peaks.row_start[row + 1]]
        off = np.abs(rest[:, row, None] - x[None, :]).min(axis=1, initial=np.inf)
        empty[row] = (off > room_px).mean()
    # the first and the last row hold no peaks of some extractors
    smooth = np.convolve(empty[1:-1], np.ones(_SMOOTH_ROWS) / _SMOOTH_ROWS, mode="same")
    # nearly the largest share of stripes that leave their belt line at once
    most = float(np.percentile(smooth, 99.0))
    run = _longest_run(np.arange(1, rest.shape[1] - 1), smooth > 0.5 * most)
    # fewer than one stripe leaves its line; or the block is short, or fills the image and no belt is seen
    if most < 0.8 / rest.shape[0] or run.size < _BLOCK_ROWS_MIN or run.size > 0.9 * rest.shape[1]:
        return None
    # one row inside at either end, for smoothing blurs the edges
    return int(run[0]) + 1, int(run[-1]) - 1


_SMOOTH_ROWS = 9
"""Rows that are looked at together: speckle takes a peak in thirty."""


def _fitted(stripe: Floats, from_middle: Floats, x_px: Floats, stripes: int, frame: Frame) -> RestFit:
    """Fit a line to each stripe, or a parabola to all where their bow is seen; and the lens's distortion."""
    straight = [_line(from_middle[stripe == one], x_px[stripe == one], 1) for one in range(stripes)]
    bowed = [_line(from_middle[stripe == one], x_px[stripe == one], 2) for one in range(stripes)]
    bow = np.array([line[2] for line, *_ in bowed])
    bow_std = np.sqrt([covariance[2, 2] for _, covariance, _ in bowed])
    # both are tried: a parabola that is not needed only adds noise to each line
    many = np.ptp(from_middle) >= _BOW_ROWS_MIN
    # the largest bow of all stripes decides for all: it is the lens's, not a stripe's
    seen = many and float(np.max(np.abs(bow) / bow_std)) > _BOW_SIGMAS
    found = bowed if seen else straight
    rms = float(np.sqrt(np.mean(np.concatenate([off**2 for *_, off in found]))))
    if rms > _REST_RMS_MAX_PX:
        raise CalibrationError(
            f"{frame.name}: the stripes on the belt are not straight (rms {rms:.2f} px)",
            hint="is the belt flat and empty? a strongly distorting lens needs a full camera calibration",
        )
    lines, covariance = (np.stack([one[part] for one in found]) for part in (0, 1))
    # from the middle column: a radial distortion bows a line by κ times its place there
    place = np.array([line[0] for line, *_ in bowed]) - (frame.size[1] - 1) / 2.0
    # least squares of bow = κ · place over the stripes
    weight = place / max(float((place**2).sum()), 1.0)
    kappa = float(weight @ bow)
    # Birge's ratio: where stripes bow otherwise than a radial lens says (k2, tilt), what they show counts
    birge = float(np.sqrt((((bow - kappa * place) / bow_std) ** 2).sum() / max(stripes - 1, 1)))
    kappa_std = max(birge, 1.0) * float(np.sqrt(weight**2 @ bow_std**2))
    # too few rows to see a bow: the uncertainty is that of a lens for measuring
    if not many:
        return RestFit(lines, rms, covariance, 0.0, _unseen_bow(frame))
    if not seen:
        # taken for none, it may be as large as what was found by chance
        return RestFit(lines, rms, covariance, 0.0, float(np.hypot(kappa, kappa_std)))
    return RestFit(lines, rms, covariance, kappa, kappa_std)


def _unseen_bow(frame: Frame) -> float:
    """Give the standard uncertainty of a distortion nothing is known of, px⁻²."""
    return float(_UNSEEN_DISTORTION / np.sqrt(3.0) / (0.25 * (frame.size[0] ** 2 + frame.size[1] ** 2)))


def _line(from_middle: Floats, x: Floats, degree: int) -> tuple[Floats, Floats, Floats]:
    """Coefficients, lowest power first, their covariance, and residuals without outliers."""
    keep = np.ones(x.size, np.bool_)
    off, found = x, np.zeros(degree + 1)
    for _ in range(3):
        # outliers beyond three standard deviations, at least half a pixel: a whole pixel's rounding stays
        found = np.asarray(np.polynomial.polynomial.polyfit(from_middle[keep], x[keep], degree))
        off = x - np.polynomial.polynomial.polyval(from_middle, found)
        keep = np.abs(off) <= max(3.0 * float(np.std(off[keep])), 0.5)
    return found, _of_line(from_middle[keep], off[keep], degree), off[keep]


def _of_line(from_middle: Floats, off: Floats, degree: int = 1) -> Floats:
    """Covariance of a line through rows that are correlated over a few rows: from sums of batches."""
    powers = np.polynomial.polynomial.polyvander(from_middle, degree)
    # of independent rows; the batches' sums put the correlation back in
    inverse = np.linalg.inv(powers.T @ powers)
    batches = off.size // _BATCH_ROWS
    if batches < _BATCHES_MIN:
        # too few batches: the error of a batch counts for each of its rows
        return np.asarray(float(off @ off) / off.size * _BATCH_ROWS * inverse)
    batch = np.minimum(np.arange(off.size) // _BATCH_ROWS, batches - 1)
    sums = np.stack([np.bincount(batch, column * off) for column in powers.T])
    # sandwich estimate, with a correction for the degrees of freedom that the line takes
    return np.asarray(inverse @ (sums @ sums.T) @ inverse * batches / (batches - 2))


def _from_block_image(view: Observation, stripes: int) -> RestFit:
    peaks = _centred(view)
    fragment, fragments = trace_fragments(peaks.row_start, peaks.x_px, _BODY_STEP_PX)
    try:
        lines = rest_lines_of_frame(peaks, fragment, fragments, stripes, _END_ROWS)
    except StageError as error:
        raise CalibrationError(
            f"{view.frame.name}: {error.message}", hint="add an image of the empty belt (images.belt)"
        ) from error
    if lines is None:
        raise AssertionError("rest lines of a known number of stripes are found or refused")
    rows = np.arange(peaks.image_size[0]) - (peaks.image_size[0] - 1) / 2.0
    # from the lowest power on, as `RestFit` has it
    rest = np.array([np.polyfit(rows, line, 1)[::-1] for line in lines.x_px])
    # the search for rest lines allows four standard deviations
    rms = lines.tolerance_px / 4.0
    # the belt above and below the block: at least the image's ends
    ends = np.concatenate([rows[:_END_ROWS], rows[-_END_ROWS:]])
    covariance = _of_line(ends, np.full(ends.size, rms))
    return RestFit(rest, rms, np.repeat(covariance[None], stripes, axis=0), 0.0, _unseen_bow(view.frame))


def _longest_run(rows: Integers, displaced: np.ndarray) -> np.ndarray:
    """Positions in `rows` of the longest displaced run; gaps of a few rows do not end it."""
    at = np.flatnonzero(displaced)
    if not at.size:
        return at
    pieces = np.split(at, np.flatnonzero(np.diff(rows[at]) > _RUN_GAP_ROWS) + 1)
    # the longest, not the first: dirt on the belt makes short ones
    return max(pieces, key=len)


def _edges(
    peaks: Peaks, lines: Floats, stripe: int, offset_px: float, inside: int
) -> tuple[float, float] | None:
    """First and last edge of the block's top along one stripe, rows; None where they cannot be told.

    From a row inside, go up and down while the row has a peak where the stripe is expected on the top. At a
    displacement of about a spacing the neighbour's belt line is near that place: then a peak must be
    nearer to the top's place than to any belt line, and if that leaves less than a pixel, nothing is said.

    A row that is lit in part has a peak as well, so the last row with a peak lies outside the edge on the
    mean. The edge is where the peaks' amplitude falls to half of what it is on the top.
    """
    # where the stripe is expected on the top, row by row
    top = lines[stripe] + offset_px
    # half way to the nearest belt line, or as far as a displaced stripe may be off
    room = min(_DISPLACED_MIN_PX, float(np.abs(lines - top).min()) / 2.0)
    if room < _EDGE_ROOM_MIN_PX:
        return None
    sides = []
    for step in (-1, 1):
        row, missed, light = inside, 0, []
        # over single rows without a peak, to the image's end at most
        while 0 <= row < lines.shape[1] and missed <= _EDGE_GAP_ROWS:
            own = slice(peaks.row_start[row], peaks.row_start[row + 1])
            away = np.abs(peaks.x_px[own] - top[row])
            if away.size and away.min() <= room:
                light.append(float(peaks.amplitude[own][away.argmin()]))
                missed = 0
            else:
                light.append(0.0)
                missed += 1
            row += step
        sides.append(np.array(light))
    usual = np.concatenate(sides)
    # half of what lit rows have; the rows without a peak are not part of the usual
    half = 0.5 * float(np.median(usual[usual > 0.0])) if (usual > 0.0).any() else np.nan
    first, last = (_half_way(light, half) for light in sides)
    return inside - first, inside + last


def _half_way(light: Floats, half: float) -> float:
    """Rows from the start at which light, followed to its end, falls below half for the last time."""
    lit = np.flatnonzero(light >= half)
    # not even the first row: the edge is taken half a row off
    if not lit.size:
        return 0.5
    at = int(lit[-1])
    # between the last row above half and the next, by a straight line
    after = float(light[at + 1]) if at + 1 < light.size else 0.0
    return at + float(light[at] - half) / float(light[at] - after)


def _std_of_mean(values: Floats) -> float:
    """Standard uncertainty of a mean of rows that are correlated over a few rows: from batch means."""
    batches = values.size // _BATCH_ROWS
    # too few batches to average: as uncertain as one row
    if batches < 3:
        return float(values.std())
    means = values[: batches * _BATCH_ROWS].reshape(batches, _BATCH_ROWS).mean(axis=1)
    return float(means.std(ddof=1) / np.sqrt(batches))


def _width(place: Floats, first: Floats, last: Floats) -> tuple[float, float, float, float]:
    """Extent square to the edges, its standard uncertainty, the edges' scatter, and the yaw."""
    known = np.isfinite(place)
    if known.sum() < 3:
        return np.nan, np.nan, np.nan, 0.0
    slopes, residuals, starts = [], [], []
    # both edges by lines of their own; on a turned block they are parallel
    for edge in (first[known], last[known]):
        slope, start = _robust_line(place[known], edge)
        slopes.append(slope)
        starts.append(start)
        residuals.append(edge - (start + slope * place[known]))
    slope = float(np.mean(slopes))
    middle = float(place[known].mean())
    # length between the edges along the image rows, at the middle of the stripes
    along = starts[1] - starts[0] + (slopes[1] - slopes[0]) * middle
    scatter = _MAD_TO_STD * float(np.median(np.abs(residuals)))
    # each edge is known to a row (rectangular), better by averaging over the stripes' different phases
    std = np.sqrt(2.0 * max(scatter**2, 1.0 / 12.0) / known.sum())
    # square to the edges it is shorter by the cosine of the turn
    return along * float(np.cos(np.arctan(slope))), float(std), scatter, -float(np.arctan(slope))


def _robust_line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope and intercept by medians (Theil, Sen): a few edges that ran on along a belt line do not count."""
    # all pairs; their median withstands up to 29 % of bad edges
    one, other = np.triu_indices(x.size, 1)
    slope = float(np.median((y[other] - y[one]) / (x[other] - x[one])))
    return slope, float(np.median(y - slope * x))


_REACH_MAX_PX = 15
"""Pixels on either side that are looked at: stripes wider than 30 px at half height keep part of the bias."""


def is_whole(x_px: Floats) -> bool:
    """Say whether places are whole pixels, as those of scans for maxima are."""
    return bool(x_px.size) and bool((x_px == np.rint(x_px)).all())


def centres(pixels: np.ndarray, row: Integers, x_px: Floats, background: Floats, amplitude: Floats) -> Floats:
    """Give (peak,) centres of gravity above half height, px.

    Parameters
    ----------
    pixels
        (row, column) grey levels.
    row, x_px
        (peak,) where the peaks are.
    background, amplitude
        (peak,) grey level beside each, and height above it.
    """
    if not row.size:
        return x_px
    reach = np.arange(-_REACH_MAX_PX, _REACH_MAX_PX + 1)
    # a window about each peak; what lies beyond the border counts nothing
    at = np.rint(x_px).astype(np.int64)[:, None] + reach
    inside = (at >= 0) & (at < pixels.shape[1])
    grey = pixels[row[:, None], np.clip(at, 0, pixels.shape[1] - 1)].astype(np.float64)
    # grey levels above half the peak's height
    above = np.where(inside, grey - (background + 0.5 * amplitude)[:, None], 0.0)
    high = above > 0.0
    middle = _REACH_MAX_PX
    # only what hangs together with the peak: another stripe may be near
    high[:, middle:] = np.logical_and.accumulate(high[:, middle:], axis=1)
    # from the middle outwards, to either side
    high[:, : middle + 1] = np.logical_and.accumulate(high[:, middle::-1], axis=1)[:, ::-1]
    above *= high
    total = above.sum(axis=1)
    known = total > 0.0
    found = x_px.astype(np.float64)
    found[known] = at[known, middle] + (above[known] @ reach) / total[known]
    return found
