"""Which part of each product is open: peaks on it that no coder could give to a stripe with certainty.

Refused peaks on the bare belt, and false ones beside the products, leave nothing of a product open: only
what lies within its reach in the image does. That is, row by row, what lies between its outermost points,
and off the rest lines what lies up to one and a half stripe spacings beside them, or beside what is open
already.

What an open point hides lies between the belt and the product's neighbouring heights. If its height is
taken as equally likely anywhere between, a share q of the points leaves the volume uncertain by
q · (h_max / h_mean) / √12, relative, whatever an estimator put there; h are the heights of the points that
are sure.

`split_products` makes the products from calibrated slices.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.records import (
    AMBIGUOUS,
    NOTHING,
    Estimate,
    Outline,
    Peaks,
    Product,
    Profiles,
    Reason,
    StripeMap,
    Volume,
    Weight,
)
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.view import View

SHARE_MAX = 1.0 / 3.0
"""With more than a third of its points open, what is open may be half as large as what is sure, and a surface
or an outline may end where the sure points do: no interval from the sure points alone would hold."""

_REACH_SPACINGS = 1.5
"""An open stripe lies next to a sure one: one spacing off on flat ground, half as much again on a flank."""
_REACH_ROWS = 20
"""A product goes on over so many rows without a point: as long a gap as coders bridge."""
_REST_SPACINGS = 0.1
"""Nearer than this to a rest line, beside the product, a peak is belt."""
_DEPTH_SPACINGS = 0.5
"""So deep inside an outline no belt is seen: nearer to its rim a refused peak on a rest line may be belt, for
outlines err and stripes are broad. Counted from the rim, they widen good skeins' intervals by a third."""
_ACROSS_SPACINGS = 0.5
"""In a grid, a refused peak leaves nothing open that a sure line across shows: half a mesh to either side."""
_COVERAGE_FACTOR = 1.959964
"""Half width of a 95 % interval in standard deviations."""


class OpenPart(NamedTuple):
    """What is open of one product."""

    points: int
    sure: int
    """points, sure: number of refused peaks on it, and of its points with a certain stripe."""
    rows: tuple[int, int] = (0, 0)
    x_px: tuple[float, float] = (0.0, 0.0)
    """rows, x_px: where they are: first and last row, smallest and largest x; zeros where there is none."""

    @property
    def share(self) -> float:
        """Share of the product's points that is open."""
        return self.points / max(self.points + self.sure, 1)


@lru_cache(maxsize=2)
def open_parts(
    peaks: Peaks, stripes: StripeMap, outlines: tuple[Outline, ...] = ()
) -> Mapping[int, OpenPart]:
    """Give, by product, what of it is open.

    What lies inside a product's outline is the product's, also on a rest line: the top of a flat body one
    spacing of displacement high shows its stripes where the belt's neighbours would be. What lies on a rest
    line outside it is belt, though a bent product's points lie to both sides. Otherwise, a refused
    peak within reach of several products counts for each of them: it may be of any, and they may be
    pieces of one body that only what is open holds together.
    """
    refused = np.flatnonzero(stripes.peak_stripe == AMBIGUOUS)
    open_ = _Refused.of(peaks, stripes, refused) if refused.size else None
    found = {}
    for number in range(1, int(stripes.product.max(initial=0)) + 1):
        mine = (stripes.product == number) & stripes.seen
        sure = int(np.count_nonzero(mine))
        if not sure:
            continue
        own = [outline for outline in outlines if outline.product == number]
        part = np.zeros(0, np.bool_) if open_ is None else open_.within(mine, stripes.x_px, own)
        if open_ is not None and part.any():
            at, place = open_.row[part], open_.x_px[part]
            where = (int(at.min()), int(at.max())), (float(place.min()), float(place.max()))
            found[number] = OpenPart(int(np.count_nonzero(part)), sure, *where)
        else:
            found[number] = OpenPart(0, sure)
    return found


class _Refused(NamedTuple):
    """Refused peaks of a frame that no line across shows the height of, (peak,) each."""

    row: Integers
    x_px: Floats
    off_belt: Flags
    """Whether it lies off the rest lines."""
    spacing_px: float
    """Distance of rest lines."""

    @classmethod
    def of(cls, peaks: Peaks, stripes: StripeMap, refused: Integers) -> _Refused:
        """Look at the peaks with these numbers."""
        row, x_px = peaks.row[refused], peaks.x_px[refused]
        spacing_px = _spacing_px(stripes)
        shown = _shown_across(stripes, row, x_px, _ACROSS_SPACINGS * spacing_px)
        row, x_px = row[~shown], x_px[~shown]
        distance = np.abs(stripes.rest_px[:, row] - x_px)
        beside_px = np.where(np.isnan(distance), np.inf, distance).min(axis=0, initial=np.inf)
        return cls(row, x_px, beside_px > _REST_SPACINGS * spacing_px, spacing_px)

    def within(self, mine: Flags, x_px: Floats, outlines: Sequence[Outline]) -> Flags:
        """Say which of them leave a product open, whose seen points and outlines are given."""
        inside = [_inside(outline, self.row, self.x_px) for outline in outlines]
        belt = np.zeros(self.row.size, np.bool_)
        if inside:
            belt = ~self.off_belt & ~np.logical_or.reduce(inside)
        part = _within(mine, x_px, self.row, self.x_px, self.off_belt, belt, self.spacing_px)
        for outline, held in zip(outlines, inside, strict=True):
            part |= _well_inside(outline, held, self.row, self.x_px, _DEPTH_SPACINGS * self.spacing_px)
        return part


def _shown_across(stripes: StripeMap, row: Integers, x_px: Floats, within_px: float) -> Flags:
    """Say of peaks whether a line across shows the product's height so near to them."""
    across = stripes.across
    if across is None or not math.isfinite(within_px):
        return np.zeros(row.size, np.bool_)
    from scipy.spatial import cKDTree

    line, at = np.nonzero((across.product > 0) & across.seen)
    if not line.size:
        return np.zeros(row.size, np.bool_)
    # the lines across are seen in the image turned by 90° counter-clockwise
    places = np.column_stack([across.rows - 1.0 - at, across.x_px[line, at]])
    return np.asarray(cKDTree(places).query(np.column_stack([x_px, row]))[0] <= within_px)


def open_points_reason(part: OpenPart, product: Product) -> Reason | None:
    """Say how much of a product is open, where, and what that does to its number; None where nothing is."""
    if not part.points:
        return None
    where = (
        f"{part.share:.1%} of the product's points ({part.points} of {part.points + part.sure}; rows "
        f"{part.rows[0]}–{part.rows[1]}, x {part.x_px[0]:.0f}–{part.x_px[1]:.0f} px) could not be given to a "
        "stripe with certainty and are left out"
    )
    if part.share > SHARE_MAX:
        return Reason("undecided", f"{where}: too many for a number to be stated")
    wider = widened_by(part, product)
    by = f"{wider:.1%}" if wider >= 0.0005 else "less than 0.1%"
    return Reason("ambiguous", f"{where}; that widens the volume's uncertainty by {by}")


def widened_by(part: OpenPart, product: Product) -> float:
    """Give the relative standard uncertainty of the volume that comes from what is open."""
    heights = product.profiles.xyz_mm[:, :, 2]
    heights = heights[np.isfinite(heights)]
    mean_mm = float(heights.mean()) if heights.size else 0.0
    if mean_mm <= 0.0:
        return math.inf
    return part.share * float(heights.max()) / mean_mm / math.sqrt(12.0)


def widened(
    volume: Volume | None, weight: Weight | None, relative: float
) -> tuple[Volume | None, Weight | None]:
    """Widen the uncertainties of volume and weight by a relative standard uncertainty from open points."""
    if volume is not None:
        true = volume.true_mm3
        volume = replace(
            volume,
            visible_mm3=_widened(volume.visible_mm3, relative),
            true_mm3=None if true is None else _widened(true, relative),
        )
    if weight is not None:
        weight = replace(weight, mass_g=_widened(weight.mass_g, relative))
    return volume, weight


def _widened(estimate: Estimate, relative: float) -> Estimate:
    """Add in quadrature; an uncertainty that is not stated stays so."""
    added = relative * abs(estimate.value)
    low, high = estimate.interval
    reach = _COVERAGE_FACTOR * added
    return replace(
        estimate,
        std=math.hypot(estimate.std, added),
        budget={**estimate.budget, "open points": added},
        interval=(
            estimate.value - math.hypot(estimate.value - low, reach),
            estimate.value + math.hypot(high - estimate.value, reach),
        ),
    )


def _spacing_px(stripes: StripeMap) -> float:
    """Median distance of rest lines, px; of the stripes themselves where no rest line is known."""
    for lines in (stripes.rest_px, stripes.x_px):
        apart = np.diff(lines, axis=0)
        apart = apart[np.isfinite(apart)]
        if apart.size:
            return float(np.median(apart))
    return 1e9  # a single stripe; finite, for the edges of rows without a product are infinite


def _within(
    mine: Flags, x_px: Floats, row: Integers, place_px: Floats, off_belt: Flags, belt: Flags,
    spacing_px: float,
) -> Flags:  # fmt: skip
    """Mark the refused peaks within a product's reach, which grows by those that were found."""
    reach = _REACH_SPACINGS * spacing_px
    lit, places = np.flatnonzero(mine.any(axis=0)), x_px[mine]
    near: Flags = (row >= lit[0] - _REACH_ROWS) & (row <= lit[-1] + _REACH_ROWS) & ~belt
    near = near & (place_px >= places.min() - reach) & (place_px <= places.max() + reach)
    if not near.any():  # most often; and what no peak has made grow reaches no farther
        return near
    low = np.where(mine, x_px, np.inf).min(axis=0)
    high = np.where(mine, x_px, -np.inf).max(axis=0)
    found = np.zeros(row.size, np.bool_)
    for _ in range(mine.shape[0]):
        near_low, near_high = _filled(low, np.inf, row), _filled(high, -np.inf, row)
        inside = (place_px >= low[row]) & (place_px <= high[row])
        around = (place_px >= near_low - reach) & (place_px <= near_high + reach) & off_belt
        more = (inside | around) & ~found & ~belt
        if not more.any():
            break
        found |= more
        np.minimum.at(low, row[more], place_px[more])
        np.maximum.at(high, row[more], place_px[more])
    return found


def _well_inside(outline: Outline, inside: Flags, row: Integers, x_px: Floats, depth_px: float) -> Flags:
    """Say which of the places inside an outline lie that deep inside it on every side."""
    found = inside.copy()
    some = np.flatnonzero(found)
    right, down = depth_px * np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]])[:, :, None]
    around = _inside(outline, (row[some] + down).ravel(), (x_px[some] + right).ravel())
    found[some] = around.reshape(4, -1).all(axis=0)
    return found


def _inside(outline: Outline, row: Floats | Integers, x_px: Floats) -> Flags:
    """Say which places lie inside an outline: an odd number of its edges crosses the row to their left."""
    inside = np.zeros(row.size, np.bool_)
    low, high = outline.xy_px.min(axis=0), outline.xy_px.max(axis=0)
    near = np.flatnonzero((x_px >= low[0]) & (x_px <= high[0]) & (row >= low[1]) & (row <= high[1]))
    if near.size:
        (x0, y0), (x1, y1) = outline.xy_px.T, np.roll(outline.xy_px, -1, axis=0).T
        at, place = row[near], x_px[near]
        edge, of = ((y0[:, None] <= at) != (y1[:, None] <= at)).nonzero()  # few edges cross a row
        x0, y0, x1, y1 = x0[edge], y0[edge], x1[edge], y1[edge]
        left = x0 + (at[of] - y0) * (x1 - x0) / (y1 - y0) < place[of]
        inside[near] = np.bincount(of[left], minlength=near.size) % 2 == 1
    return inside


def _filled(edge: Floats, empty: float, row: Integers) -> Floats:
    """Give a product's edge at some rows; where it has no point, that of the nearest row with one."""
    known = np.flatnonzero(edge != empty)
    after = np.minimum(np.searchsorted(known, row), known.size - 1)
    before = known[np.maximum(after - 1, 0)]
    nearest = np.where(np.abs(before - row) <= np.abs(known[after] - row), before, known[after])
    return np.where(np.abs(nearest - row) <= _REACH_ROWS, edge[nearest], empty)


_NOTHING = np.int16(NOTHING)


def split_products(
    profiles: Profiles,
    outlines: tuple[Outline, ...],
    calibration: Calibration,
    acquisition_id: str,
    reasons: tuple[Reason, ...] = (),
    view: View | None = None,
) -> tuple[Product, ...]:
    """Split the slices of one frame into its products, by the number the coder gave each point."""
    highest = int(profiles.product.max(initial=0))
    numbers = range(1, 2) if highest == 1 else np.unique(profiles.product)
    by_number = {outline.product: outline for outline in outlines}
    return tuple(
        Product(
            number=int(number),
            profiles=_only(profiles, int(number)),
            calibration=calibration,
            acquisition_ids=(acquisition_id,),
            outline=by_number.get(int(number)),
            reasons=reasons + profiles.reasons,
            view=view,
        )
        for number in numbers
        if 0 < number <= highest
    )


def _only(profiles: Profiles, number: int) -> Profiles:
    """Keep the points of one product, from the first to the last of any slice; of a scan, its slices only."""
    mine = profiles.product == number
    points = _lit(mine.any(axis=0))
    # products are some of a belt's thousands of slices
    slices = _lit(mine.any(axis=1)) if profiles.scan is not None else slice(None)
    at = slices, points
    mine = mine[at]
    # adding NaN takes a third of the time of choosing between a number and NaN, and a loop over whole rows a
    # fourth of that of one over three coordinates
    others = np.where(mine, 0.0, np.nan)
    xyz_mm = profiles.xyz_mm[at]
    return Profiles(
        xyz_mm=(xyz_mm.reshape(len(mine), -1) + np.repeat(others, 3, axis=1)).reshape(xyz_mm.shape),
        product=np.where(mine, profiles.product[at], _NOTHING),
        seen=profiles.seen[at] & mine,
        x_px=profiles.x_px[at] + others,
        row_px=profiles.row_px[at] + others,
        height_std_mm=profiles.height_std_mm[at] + others,
        stripe=profiles.stripe[slices],
        frame=profiles.frame[slices],
        plane=profiles.plane[slices],
        reasons=profiles.reasons,
        scan=profiles.scan,
        unseen_margin_mm3=profiles.unseen_margin_mm3,
        flank_rel_std=profiles.flank_rel_std,
        rim_mm3=profiles.rim_mm3,
        rim_mm=profiles.rim_mm,
    )


def _lit(any_lit: Flags) -> slice:
    return slice(int(any_lit.argmax()), any_lit.size - int(any_lit[::-1].argmax()))
