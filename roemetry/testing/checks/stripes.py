"""What every coder, smoother and outliner keeps: labels right or refused, never silently wrong.

Of every aligner: what has moved is found, and what it does not know it does not say.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import RoemetryError, StageError
from roemetry.records import AMBIGUOUS, BELT, NOTHING, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Coder, Outliner, Smoother
from roemetry.testing.cases import cases_for
from roemetry.testing.scenes import SEED, LinearRig, wrong_labels
from roemetry.testing.verdict import refused, require

_SCATTER_PX = 0.1  # of the peaks that coders are given
_END_ROWS = 2
_LABELLED_MIN = 0.99
"""Share of the points that must be labelled where nothing makes it hard."""
_CLEAR_MM = 1.0
"""A point above this height is certainly off the belt: 2 px on this rig."""


def check_a_dome_is_labelled_whole(coder: Coder[Any]) -> None:
    """On a smooth dome at least 99 % of the points are labelled, and none wrongly."""
    rig = LinearRig()
    coded = _coded(coder, rig, rig.dome())
    _none_wrong(coded)
    _nearly_all(coded, np.isfinite(coded.x_px), "points of a dome")


def check_a_mirrored_rig_is_labelled_alike(coder: Coder[Any]) -> None:
    """With the laser on the other side the dome is labelled just as well."""
    rig = LinearRig().mirrored()
    coded = _coded(coder, rig, rig.dome())
    _none_wrong(coded)
    _nearly_all(coded, np.isfinite(coded.x_px), "points of a dome")


def check_a_missing_stripe_shifts_nothing(coder: Coder[Any]) -> None:
    """A missing stripe does not shift its neighbours' numbers."""
    rig = LinearRig()
    coded = _coded(coder, rig, rig.dome(), hidden=(3, slice(None)))
    _none_wrong(coded)
    _nearly_all(coded, np.isfinite(coded.x_px), "points of the stripes that are left")
    require(not coded.map.seen[3].any(), "the missing stripe is given points")


def check_a_hidden_body_shifts_nothing(coder: Coder[Any]) -> None:
    """A stripe that is invisible on the product does not shift the labels of bodies beside it."""
    rig = LinearRig()
    heights = rig.belt()
    heights[1:6, 60:140] = 12.0
    coded = _coded(coder, rig, heights, hidden=(1, slice(58, 142)))
    _none_wrong(coded)


def check_a_stripe_hidden_at_both_ends_shifts_nothing(coder: Coder[Any]) -> None:
    """A stripe of which only the middle is visible does not shift the labels of bodies beside it."""
    rig = LinearRig()
    for height_mm in (3.0, 10.0):
        x_px = rig.x_px(rig.dome(height_mm))
        x_px[4, :30] = x_px[4, 170:] = np.nan
        x_px[0, 100:160] = np.nan
        _none_wrong(_coded_x(coder, rig, x_px))


def check_gaps_shift_nothing(coder: Coder[Any]) -> None:
    """Gaps of various lengths along the stripes change no label of other points."""
    rig = LinearRig()
    rng = np.random.default_rng(7)
    x_px = rig.x_px(rig.dome())
    for _ in range(14):
        start = int(rng.integers(20, 170))
        x_px[int(rng.integers(rig.stripes)), start : start + int(rng.integers(2, 30))] = np.nan
    _none_wrong(_coded_x(coder, rig, x_px))


def check_a_body_past_its_neighbours_rest_line_is_not_mistaken(coder: Coder[Any]) -> None:
    """A body with displacements above a spacing is labelled correctly, or refused alone or with its frame."""
    rig = LinearRig()
    x_px = rig.x_px(rig.dome(24.0))
    try:
        coded = _coded_x(coder, rig, x_px)
    except RoemetryError:
        return
    _none_wrong(coded)


def check_an_untouched_stripe_is_belt(coder: Coder[Any]) -> None:
    """A stripe beside all products is belt on all its rows."""
    rig = LinearRig()
    coded = _coded(coder, rig, rig.dome())
    for stripe in (0, rig.stripes - 1):
        here = coded.map.product[stripe, _END_ROWS:-_END_ROWS]
        require(
            bool((here == BELT).all()),
            f"{int((here != BELT).sum())} of {here.size} rows of stripe {stripe + 1} are not belt",
        )


def check_a_bare_belt_has_no_product(coder: Coder[Any]) -> None:
    """An empty belt is belt: no point of it is a product."""
    rig = LinearRig()
    coded = _coded(coder, rig, rig.belt())
    found = int((coded.map.product > 0).sum())
    require(found == 0, f"{found} points of the bare belt are taken for a product")
    _nearly_all(coded, np.isfinite(coded.x_px), "points of the belt")


def check_a_smooth_wedge_is_product(coder: Coder[Any]) -> None:
    """A wedge that rises from the belt with slope 0.5, without step or break, is product, not belt."""
    rig = LinearRig()
    row = np.arange(rig.rows)
    rise = np.clip(0.5 * rig.mm_per_px * np.minimum(row - 40, 160 - row), 0.0, None)
    heights = np.where(np.isin(np.arange(rig.stripes), (2, 3, 4))[:, None], rise, 0.0)
    coded = _coded(coder, rig, heights)
    _is_product(coded, heights >= _CLEAR_MM, "the wedge")
    there = heights[:, _END_ROWS:-_END_ROWS] == 0.0
    off = coded.map.product[:, _END_ROWS:-_END_ROWS][there] > 0
    require(off.mean() <= 0.03, f"{off.mean():.1%} of the belt around the wedge is taken for product")


def check_a_grazed_tail_is_product(coder: Coder[Any]) -> None:
    """Where a stripe just grazes a product's thin tail, 3 mm high, those points are product, not belt."""
    rig = LinearRig()
    heights = rig.dome(12.0)
    heights[[0, 1, 5, 6]] = 0.0
    heights[5] = 3.0 * rig.bump(0.3, 0.7)
    coded = _coded(coder, rig, heights)
    tail = np.zeros(heights.shape, np.bool_)
    tail[5] = heights[5] >= _CLEAR_MM
    _is_product(coded, tail, "the tail")


def check_every_peak_gets_a_verdict(coder: Coder[Any]) -> None:
    """Every peak gets a stripe, `UNLABELLED` or `AMBIGUOUS`, and no stripe gets two peaks of one row."""
    rig = LinearRig()
    coded = _coded(coder, rig, rig.dome())
    verdict = coded.map.peak_stripe
    require(verdict.size == coded.truth.size, f"{verdict.size} verdicts on {coded.truth.size} peaks")
    require(
        bool(((verdict >= AMBIGUOUS) & (verdict < coded.map.stripe_count)).all()),
        f"verdicts from {verdict.min()} to {verdict.max()} for {coded.map.stripe_count} stripes",
    )
    given = verdict >= 0
    cells = np.unique(np.stack([verdict[given], coded.row[given]]), axis=1)
    require(cells.shape[1] == given.sum(), "a stripe is given two peaks of one row")


def check_labelled_points_are_peaks(coder: Coder[Any]) -> None:
    """The `x_px` of every seen point is that of a peak of its row with its label."""
    rig = LinearRig()
    coded = _coded(coder, rig, rig.dome())
    seen = coded.map.seen
    given = np.full(seen.shape, np.nan)
    mine = coded.map.peak_stripe >= 0
    given[coded.map.peak_stripe[mine], coded.row[mine]] = coded.found_px[mine]
    other = seen & (given != coded.map.x_px)
    require(not other.any(), f"{int(other.sum())} of {int(seen.sum())} seen points are not where a peak is")
    require(seen.sum() == mine.sum(), f"{int(mine.sum())} peaks labelled, {int(seen.sum())} points seen")


def check_what_is_not_seen_is_marked(coder: Coder[Any]) -> None:
    """A bridged point is never marked as seen."""
    rig = LinearRig()
    coded = _coded(coder, rig, rig.dome(), hidden=(3, slice(90, 100)))
    false = int(coded.map.seen[3, 90:100].sum())
    require(false == 0, f"{false} of 10 rows without a peak are marked as seen")


def check_rest_lines_are_the_calibrations(coder: Coder[Any]) -> None:
    """With a calibration, `rest_px` is its rest line on every row."""
    rig = LinearRig()
    off = np.abs(_coded(coder, rig, rig.dome()).map.rest_px - rig.rest_px())
    require(bool((off <= 1e-9).all()), f"rest lines are off by up to {np.nanmax(off):.3g} px, or not known")


def check_another_image_size_is_refused(coder: Coder[Any]) -> None:
    """Peaks of another image size than the calibration's are refused by a `StageError`."""
    rig = LinearRig()
    other = LinearRig(rows=rig.rows // 2)
    with refused("peaks of 100 rows with a calibration of 200", StageError):
        coder.code(other.peaks(other.x_px(other.belt())).peaks, rig.calibration())


class _Coded(NamedTuple):
    """A labelled scene: the map, each peak's true stripe, row and x, and the true (stripe, row) centres."""

    map: StripeMap
    truth: Integers
    row: Integers
    found_px: Floats
    x_px: Floats


def _coded(
    coder: Coder[Any], rig: LinearRig, heights: Floats, hidden: tuple[int, slice] | None = None
) -> _Coded:
    x_px = rig.x_px(heights)
    if hidden is not None:
        x_px[hidden] = np.nan
    return _coded_x(coder, rig, x_px)


def _coded_x(coder: Coder[Any], rig: LinearRig, x_px: Floats) -> _Coded:
    found = rig.peaks(x_px, _SCATTER_PX)
    relative = coder.capabilities.relative_numbers
    stripes = coder.code(found.peaks, None if relative else rig.calibration())
    truth = found.stripe - _offset(stripes, found.stripe) if relative else found.stripe
    return _Coded(stripes, truth, found.peaks.row, found.peaks.x_px, x_px)


def _offset(stripes: StripeMap, truth: Integers) -> int:
    """Give by how much most numbers of a coder that counts from the first stripe seen fall short."""
    given = np.flatnonzero(stripes.peak_stripe[: truth.size] >= 0)
    short, count = np.unique(truth[given] - stripes.peak_stripe[given], return_counts=True)
    return int(short[count.argmax()]) if count.size else 0


def _none_wrong(coded: _Coded) -> None:
    verdict = coded.map.peak_stripe
    require(verdict.size == coded.truth.size, f"{verdict.size} verdicts on {coded.truth.size} peaks")
    wrong = int(wrong_labels(verdict, coded.truth).sum())
    require(wrong == 0, f"{wrong} of {verdict.size} peaks carry another stripe's number")


def _nearly_all(coded: _Coded, wanted: Flags, what: str) -> None:
    inner = slice(_END_ROWS, -_END_ROWS)
    share = coded.map.seen[:, inner][wanted[:, inner]].mean()
    require(share >= _LABELLED_MIN, f"only {share:.1%} of the {what} are labelled")


def _is_product(coded: _Coded, wanted: Flags, what: str) -> None:
    there = coded.map.product[wanted]
    share = (there > 0).mean()
    belt, nothing = (there == BELT).mean(), (there == NOTHING).mean()
    require(
        share >= _LABELLED_MIN,
        f"only {share:.1%} of {what} is product; belt {belt:.1%}, unlabelled {nothing:.1%}",
    )


_ROUGH_PX = 0.2  # scatter of an ordinary extractor in speckle
_STRAIGHT_TOLERANCE_PX = 1e-6  # rounding of a fit in double precision
_STEP_ROWS = 2  # beside a step that a smoother may bend


def check_straight_stripes_stay(smoother: Smoother[Any]) -> None:
    """Straight noise-free stripes stay in place to 1e-6 px."""
    rig = LinearRig()
    given = rig.stripe_map(rig.belt())
    found = smoother.smooth(given)
    off = float(np.abs(found.x_px - given.x_px).max())
    require(off <= _STRAIGHT_TOLERANCE_PX, f"a straight stripe moves by {off:.2g} px")


def check_scatter_becomes_less(smoother: Smoother[Any]) -> None:
    """On straight stripes the scatter decreases, and so does the stated uncertainty."""
    rig = LinearRig()
    true = rig.stripe_map(rig.belt())
    noise = np.random.default_rng(SEED).normal(0.0, _ROUGH_PX, true.x_px.shape)
    given = replace(true, x_px=true.x_px + noise, x_std_px=np.full(noise.shape, _ROUGH_PX))
    found = smoother.smooth(given)
    scatter = float(np.std(found.x_px - true.x_px))
    require(scatter < 0.8 * _ROUGH_PX, f"a scatter of {_ROUGH_PX} px becomes {scatter:.3f} px")
    stated = float(np.median(found.x_std_px))
    require(0.8 < stated / scatter < 1.25, f"the scatter is {scatter:.3f} px, {stated:.3f} px are stated")
    require(
        found.correlation_rows > given.correlation_rows, "errors of neighbours are still called independent"
    )


def check_labels_and_gaps_stay(smoother: Smoother[Any]) -> None:
    """Labels, gaps, `seen` and `ambiguous` do not change."""
    rig = LinearRig()
    given = rig.stripe_map(rig.dome())
    x_px = given.x_px.copy()
    x_px[2, 90:110] = np.nan
    gap = np.isnan(x_px)
    given = replace(
        given,
        x_px=x_px,
        seen=~gap,
        product=np.where(gap, -1, given.product),
        x_std_px=np.where(gap, np.nan, 0.1),
    )
    found = smoother.smooth(given)
    for field in ("product", "seen", "ambiguous", "peak_stripe", "rest_px"):
        same = np.array_equal(getattr(found, field), getattr(given, field), equal_nan=field == "rest_px")
        require(same, f"{field} is changed")
    require(bool((np.isnan(found.x_px) == gap).all()), "a gap is filled, or a point is lost")


def check_a_step_stays_a_step(smoother: Smoother[Any]) -> None:
    """A step along a stripe, much larger than the scatter, stays within two rows of its place."""
    rig = LinearRig()
    heights = rig.belt()
    heights[3, 100:] = 5.0
    given = rig.stripe_map(heights)
    found = smoother.smooth(given)
    off = np.abs(found.x_px - given.x_px)[3]
    far = np.abs(np.arange(rig.rows) - 99.5) > _STEP_ROWS
    require(float(off[far].max()) < 0.1, f"a step of 10 px is smeared: {off[far].max():.2f} px beside it")


def check_contours_lie_in_the_image(outliner: Outliner[Any]) -> None:
    """Contours have at least three points, lie within the image, and are numbered from 1, each once."""
    case = cases_for(outliner).ordinary
    rows, columns = case.inputs[0].size
    outlines = case.call(outliner)
    require(outlines, "a bright product on a dark belt is not found")
    numbers = [outline.product for outline in outlines]
    require(len(set(numbers)) == len(numbers) and min(numbers) >= 1, f"they are numbered {numbers}")
    for outline in outlines:
        require(outline.xy_px.shape[0] >= 3, f"a contour of {outline.xy_px.shape[0]} points")
        inside = (outline.xy_px >= -0.5) & (outline.xy_px <= np.array([columns, rows]) - 0.5)
        require(bool(inside.all()), "a contour leaves the image")
