"""A known block through a recipe's own chain: whether the calibration holds, and how deep light goes.

Model. The block's top is the level on which most points above 60 % of its height lie; it ends where the light
of its stripes falls to half. Its height over the calibrated belt, the belt's own height and the width between
its edges are compared with the description, each with what redrawn calibrations, the block's tolerance and
0.1 px of peaks make it uncertain.

The same block bare and in the product's own material, in two images or each on one half of it, tells how deep
light goes into the product: what calibration and extractor do to both alike cancels in the difference; what
remains is the cover's thickness and the scatter of the stripes' differences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from roemetry.config.recipe import Recipe
from roemetry.config.target_file import read_block as block_in_file
from roemetry.errors import ConfigurationError, DataError
from roemetry.io.files import sha256_of
from roemetry.records import BELT, Acquisition, AcquisitionReference, Block, Peaks, Profiles, StripeMap, Trace
from roemetry.records.arrays import Flags, Floats
from roemetry.records.calibration import Calibration
from roemetry.records.penetration import Penetration
from roemetry.records.view import View
from roemetry.run.control_chart import Chart, Check, Quantity, judge
from roemetry.run.pipeline import Pipeline

_REDRAWS = 100
"""A standard deviation of 100 draws is uncertain by 7 %."""
_SEED = 1
"""Fixed: a check of the same image says the same."""


def check_calibration(
    recipe: Recipe, image: Path, block: Block, chart: Path | None, acquisition: Acquisition | None = None
) -> Check:
    """Measure a block again and say whether the calibration still holds.

    Parameters
    ----------
    recipe
        Its extractor, coder, triangulator and calibration are used; nothing else of it.
    image
        The block on the belt under the stripes.
    block
        Its sides and their tolerance.
    chart
        Where checks are kept: earlier ones are looked at, this one is added. None keeps nothing.
    acquisition
        The image as the camera gave it; None: it is read from the file.

    Raises
    ------
    DataError
        The recipe has no calibration, the image cannot be read, or the block is not found in it.
    OutputError
        The chart cannot be written.
    """
    calibration = recipe.calibration
    if calibration is None or "triangulator" not in recipe.stages:
        raise DataError(
            f"{recipe.path}: there is no calibration to check",
            hint="name one in `calibration`, and a triangulator in `stages`",
        )
    # The block is matt: what light does in the product is not to be added to it.
    trace = trace_of(replace(recipe, penetration=None), image, acquisition)
    profiles, light = profiles_in(trace, image)
    places = find_block(profiles, block, light)
    view = recipe.stages["triangulator"].make().view(calibration)
    reading = read_block(profiles, places, view)
    spread = _spread(recipe, trace, calibration, places)
    height, belt, width = quantities_of(reading, block, spread, _pixel_mm(calibration, profiles, places))
    check = Check(
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        calibration_sha256=calibration.sha256,
        target=block.name,
        image=image.name,
        image_sha256=sha256_of(image),
        height=height,
        belt=belt,
        width=width,
        stripes=reading.stripes,
        stripe_spread_mm=reading.stripe_spread_mm,
    )
    history = () if chart is None else Chart(chart).checks(calibration.sha256)
    verdict, reasons = judge(check, history)
    check = replace(check, verdict=verdict, reasons=reasons)
    if chart is not None:
        Chart(chart).add(check)
    return check


Light = tuple[Peaks, StripeMap]
"""The peaks of an image, and which stripe each belongs to."""


def profiles_of(recipe: Recipe, image: Path) -> tuple[Profiles, Light]:
    """Take one image through a recipe as far as its profiles; raise DataError where that cannot be done."""
    return profiles_in(trace_of(recipe, image), image)


def trace_of(recipe: Recipe, image: Path, acquisition: Acquisition | None = None) -> Trace:
    """Take one image through a recipe's chain, without draws; raise DataError where it cannot be read.

    Without the aligner, too: it would correct what a check of the calibration looks for, and takes a sample
    of two halves for a torn frame.
    """
    stages = {kind: chosen for kind, chosen in recipe.stages.items() if kind != "aligner"}
    return Pipeline(replace(recipe, stages=stages), draws=0).trace(acquisition or _read(image))


def _read(image: Path) -> Acquisition:
    from roemetry.stages.registry import discover

    registry = discover()
    source = registry.load(registry.find("source", "image-files"))()
    acquisition: Acquisition = source.read(AcquisitionReference(image.stem, {"laser": image}))
    return acquisition


def profiles_in(trace: Trace, image: Path) -> tuple[Profiles, Light]:
    """Give what a chain made of an image; raise DataError where it did not get as far as profiles."""
    if trace.profiles is None or trace.peaks is None or trace.stripes is None:
        why = "; ".join(reason.text for reason in trace.absent.values())
        raise DataError(f"{image}: the block cannot be measured: {why}")
    return trace.profiles, (trace.peaks, trace.stripes)


def _spread(recipe: Recipe, trace: Trace, calibration: Calibration, places: Places) -> Reading:
    """Standard deviation of the readings over redrawn calibrations."""
    triangulator = recipe.stages["triangulator"].make()
    redraws = calibration.redraws(np.random.default_rng(_SEED), triangulator.view)
    drawn = []
    for _ in range(_REDRAWS):
        drawn_one = next(redraws)
        profiles = triangulator.triangulate(trace.stripes, drawn_one)
        drawn.append(read_block(profiles, places, drawn_one.view))
    of = {
        name: float(np.std([getattr(reading, name) for reading in drawn], ddof=1))
        for name in ("height_mm", "belt_mm", "width_mm")
    }
    return Reading(**of, stripes=0, stripe_spread_mm=0.0)


def _pixel_mm(calibration: Calibration, profiles: Profiles, places: Places) -> tuple[float, float]:
    """Height for one pixel along the row, and length along Y for one row, mm."""
    height = float(np.median(1.0 / np.abs(calibration.displacement_px_per_mm)))
    y = np.where(places.top, profiles.xyz_mm[:, :, 1], np.nan)
    rows = np.where(places.top, profiles.row_px, np.nan)
    along = np.abs(np.diff(y, axis=1) / np.diff(rows, axis=1))
    return height, float(np.nanmedian(along))


def block_of(recipe: Recipe, target: Path | None) -> Block:
    """Give the block described in a file, or else the one the recipe's calibration was made from.

    Raises
    ------
    ConfigurationError
        The file is at fault, or none is given and the calibration was made from something else.
    """
    if target is not None:
        given = block_in_file(target.name, target.parent)
        if given is not None:
            return given
    known = dict(recipe.calibration.target) if recipe.calibration is not None else {}
    if known.get("kind") != "block":
        raise ConfigurationError(
            "no block is described: the calibration was made from something else",
            hint="name the block's description with --target",
        )
    sides = ("length_mm", "width_mm", "height_mm", "tolerance_mm")
    return Block(str(known["name"]), *(float(known[side]) for side in sides))


def quantities_of(
    reading: Reading, block: Block, spread: Reading, pixel_mm: tuple[float, float]
) -> tuple[Quantity, Quantity, Quantity]:
    """Put readings beside what they should be.

    Parameters
    ----------
    reading
        As measured.
    block
        As described; its tolerance is a rectangular distribution.
    spread
        Standard deviation of each reading over redrawn calibrations.
    pixel_mm
        Height, and length along the stripes, for one pixel, mm.
    """
    reference = block.tolerance_mm / math.sqrt(3.0)
    height_px, along_px = (_PEAK_DOUBT_PX * mm for mm in pixel_mm)
    return (
        Quantity(reading.height_mm, block.height_mm, math.hypot(reference, spread.height_mm, height_px)),
        Quantity(reading.belt_mm, 0.0, math.hypot(spread.belt_mm, height_px)),
        Quantity(
            reading.width_mm,
            block.width_mm,
            math.hypot(reference, spread.width_mm, _EDGE_DOUBT_PX / _PEAK_DOUBT_PX * along_px),
        ),
    )


_PEAK_DOUBT_PX = 0.1
"""What an extractor, and light that enters the surface, may shift all peaks of an image by."""
_EDGE_DOUBT_PX = 0.5
"""The width of ten simulated blocks, turned by up to 6 degrees, was up to 0.4 rows too small: most where the
stripes on top and belt overlap, of low blocks."""


_TOP_FROM_SHARE = 0.6
"""A product's point higher than this share of the block's height is looked at as its top."""
_TOP_SCATTERS = 4.0
"""Standard deviations from the median height within which points are the top's."""
_TOP_LEAST_SHARE = 0.02
"""Of the block's height, the same at least: a calibration that tilts the top is to be seen, not cut."""
_EDGE_ROWS = 3
"""Rows next to an edge that are not used: the extractor smears it."""
_POINTS_MIN = 10
"""Points of a stripe on the top: from fewer the mean is a peak's noise."""
_STRIPES_MIN = 3
"""Stripes on the top: with fewer a reflection would pass."""
_EDGE_GAP_ROWS = 3
"""The top's labels end, and the belt's begin, within so many rows of where its light ends: where they do not,
one of them is another stripe's."""
_EDGE_LIGHT_ROWS = 10
"""Rows of the top next to an edge whose median light is what the edge's rows are compared with."""
_MAD_TO_STD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, eq=False, slots=True)
class Places:
    """Where in the image block and belt were found: frozen, so that redrawn profiles are read alike."""

    top: Flags
    belt: Flags
    """top, belt: (slice, point) points of the block's top, away from its edges, and of the bare belt."""
    edge_rows: Floats
    """(slice, 2) image rows at which the light on the top ends; NaN where that is not seen."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A block as the chain measures it, mm."""

    height_mm: float
    """Mean height of its top over the calibrated belt plane."""
    belt_mm: float
    """Mean height of the bare belt: 0 where nothing has moved."""
    width_mm: float
    """Its side along the stripes; NaN where its edges are not seen on three stripes."""
    stripes: int
    """Number of stripes on its top."""
    stripe_spread_mm: float
    """Standard deviation of the stripes' own mean heights."""


def find_block(profiles: Profiles, block: Block, light: Light | None = None) -> Places:
    """Find a block's top, its edges where its light is given, and the belt around it.

    Raises
    ------
    DataError
        Fewer than three stripes (or than there are) show a level top near the block's height, or no belt.
    """
    height = profiles.xyz_mm[:, :, 2]
    on_product = (profiles.product > BELT) & profiles.seen
    high = on_product & (height > _TOP_FROM_SHARE * block.height_mm)
    needed = min(_STRIPES_MIN, profiles.slice_count)
    if (high.sum(axis=1) >= _POINTS_MIN).sum() < needed:
        raise DataError(
            f"the block `{block.name}` is not seen: fewer than {needed} stripes show points above "
            f"{_TOP_FROM_SHARE * block.height_mm:.1f} mm",
            hint="does it lie under the stripes? is it the block of the target file? look at the coding",
        )
    level = float(np.median(height[high]))
    scatter = _MAD_TO_STD * float(np.median(np.abs(height[high] - level)))
    near = max(_TOP_SCATTERS * scatter, _TOP_LEAST_SHARE * block.height_mm)
    whole = on_product & (np.abs(height - level) <= near)
    top = whole.copy()
    for shift in range(1, _EDGE_ROWS + 1):
        top[:, shift:] &= whole[:, :-shift]
        top[:, :-shift] &= whole[:, shift:]
    top &= (top.sum(axis=1) >= _POINTS_MIN)[:, None]
    if top.any(axis=1).sum() < needed:
        raise DataError(
            f"the block `{block.name}` has no level top: fewer than {needed} stripes show one",
            hint="is it clean, and does it lie flat?",
        )
    belt = (profiles.product == BELT) & profiles.seen
    if belt.sum() < _POINTS_MIN:
        raise DataError("no bare belt is seen beside the block", hint="leave belt free above and below it")
    if light is None:
        return Places(top, belt, np.full((len(top), 2), np.nan))
    return Places(top, belt, _edge_rows(profiles, whole, belt, top, light))


def read_block(profiles: Profiles, places: Places, view: View | None) -> Reading:
    """Measure at the places found: heights of top and belt, and the width between the edges.

    The width is taken by the view, if there is one, at the height measured: a calibration that leaves
    perspective out of X and Y would show its model's error there, not the line's.
    """
    height = profiles.xyz_mm[:, :, 2]
    on_top = places.top.any(axis=1)
    each = np.array([height[s][places.top[s]].mean() for s in np.flatnonzero(on_top)])
    return Reading(
        height_mm=float(each.mean()),
        belt_mm=float(height[places.belt].mean()),
        width_mm=_width(_seen_mm(profiles, view), profiles.row_px, places),
        stripes=int(on_top.sum()),
        stripe_spread_mm=float(each.std(ddof=1)) if each.size > 1 else float("nan"),
    )


def _edge_rows(profiles: Profiles, whole: Flags, belt: Flags, top: Flags, light: Light) -> Floats:
    """Follow each stripe from its top outwards until its light has fallen to half.

    An edge's row shows the stripe on the top and on the belt, each with a part of its light. The part says
    where in the row the edge is; which of the two a coder takes for the stripe does not matter.
    """
    rows = np.full((len(top), 2), np.nan)
    for s in np.flatnonzero(top.any(axis=1)):
        row_px, stripe = profiles.row_px[s], int(profiles.stripe[s])
        labelled, bare = row_px[whole[s]], row_px[belt[s]]
        for side, outwards in enumerate((-1, 1)):
            near = np.flatnonzero(top[s])[::outwards][-_EDGE_LIGHT_ROWS:]
            here = _StripeLight(*light, stripe, float(np.median(profiles.x_px[s, near])))
            full = float(np.median([here.at(int(row)) for row in row_px[near]]))
            edge = _half_light_row(here, int(row_px[near[-1]]), outwards, full)
            top_ends = abs(edge - labelled[::outwards][-1])
            belt_begins = (outwards * (bare - edge))[outwards * (bare - edge) > 0.0].min(initial=np.inf)
            if max(top_ends, belt_begins) <= _EDGE_GAP_ROWS:
                rows[s, side] = edge
    return rows


def _half_light_row(light: _StripeLight, row: int, outwards: int, full: float) -> float:
    """Give the row at which a stripe's light has fallen to half; NaN where it reaches the image's border."""
    before = full
    while 0 <= row + outwards < light.peaks.image_size[0]:
        row += outwards
        here = light.at(row)
        if here < 0.5 * full:
            return row - outwards * (0.5 * full - here) / (before - here)
        before = here
    return math.nan


@dataclass(frozen=True, slots=True)
class _StripeLight:
    """The light of one stripe on the block's top, at one end of it."""

    peaks: Peaks
    stripes: StripeMap
    stripe: int
    x_px: float
    """Where it lies on the top."""

    def at(self, row: int) -> float:
        """Amplitude of its peak in a row; 0 where there is none nearer to it than to its rest line."""
        first, end = self.peaks.row_start[row : row + 2]
        off = np.abs(self.peaks.x_px[first:end] - self.x_px)
        near_px = 0.5 * abs(self.x_px - self.stripes.rest_px[self.stripe, row])
        label = self.stripes.peak_stripe[first:end]
        own = (off < np.minimum(near_px, self.peaks.width_px[first:end])) & (
            (label < 0) | (label == self.stripe)
        )
        return float(self.peaks.amplitude[first:end][own].max(initial=0.0))


def _seen_mm(profiles: Profiles, view: View | None) -> Floats:
    """(slice, point, 3) the points, mm, placed by the view where there is one."""
    if view is None:
        return profiles.xyz_mm
    return view.at_height(np.stack([profiles.x_px, profiles.row_px], axis=-1), profiles.xyz_mm[:, :, 2])


def _width(xyz_mm: Floats, row_px: Floats, places: Places) -> float:
    """Distance between two parallel lines through the edges, mm."""
    both = np.flatnonzero(np.isfinite(places.edge_rows).all(axis=1))
    if both.size < _STRIPES_MIN:
        return float("nan")
    on = [np.flatnonzero(places.top[s]) for s in both]
    first, last = np.array([(at[0], at[-1]) for at in on]).T
    step = (xyz_mm[both, last] - xyz_mm[both, first]) / (row_px[both, last] - row_px[both, first])[:, None]
    ends = [
        xyz_mm[both, at] + (places.edge_rows[both, side] - row_px[both, at])[:, None] * step
        for side, at in enumerate((first, last))
    ]
    (x0, y0), (x1, y1) = ends[0][:, :2].T, ends[1][:, :2].T
    # Medians: one edge taken beside a neighbour's belt line must not turn the block.
    slope = float(np.median([*_slopes(x0, y0), *_slopes(x1, y1)]))
    apart = np.median(y0 - slope * x0) - np.median(y1 - slope * x1)
    return float(abs(apart) / np.hypot(1.0, slope))


def _slopes(x: Floats, y: Floats) -> Floats:
    """Slopes between all pairs of points (Theil and Sen)."""
    one, other = np.triu_indices(x.size, 1)
    return np.asarray((y[other] - y[one]) / (x[other] - x[one]))


Half = Literal["top", "bottom"]


def fit_penetration(
    recipe: Recipe, bare: Path, covered: Path, block: Block, *, film_mm: float, film_std_mm: float
) -> Penetration:
    """Compare a block's height bare and covered.

    What calibration and extractor do to both alike cancels in the difference; so does the block's own
    tolerance. What remains: the cover's thickness, and the scatter of the stripes' own differences.

    Parameters
    ----------
    recipe
        The line's; its penetration, if it names one, is left aside.
    bare, covered
        Images of the block: as it is (matt, opaque), and under the product's material.
    block
        As described.
    film_mm, film_std_mm
        Thickness of the cover and its standard uncertainty, mm; 0 for paint in the product's colour.

    Raises
    ------
    DataError
        The recipe has no calibration, the block is not found, or a film is thicker than the block is high.
    """
    calibration = _calibration(recipe, block, film_mm)
    plain = replace(recipe, penetration=None)
    readings = []
    for image, height_mm in ((bare, block.height_mm), (covered, block.height_mm + film_mm)):
        profiles, _ = profiles_of(plain, image)
        places = find_block(profiles, replace(block, height_mm=height_mm))
        readings.append(read_block(profiles, places, None))
    low, high = readings
    offset = film_mm - (high.height_mm - low.height_mm)
    std = math.hypot(film_std_mm, _of_mean(low), _of_mean(high))
    return _made(recipe, calibration, block, offset, std)


def fit_penetration_in_one(
    recipe: Recipe, image: Path, block: Block, covered: Half, *, film_mm: float, film_std_mm: float
) -> Penetration:
    """Compare the halves of one block in one image: one bare, the other covered or in the product's colour.

    Each stripe lies on both halves, so what it is wrong by alone cancels. The halves lie in different places,
    so what the calibration is uncertain by does not quite: redrawn calibrations say how much.

    Parameters
    ----------
    recipe, block, film_mm, film_std_mm
        As of `fit_penetration`; the step from bare to covered is the film's thickness, 0 for paint.
    image
        The block.
    covered
        Which half of it, in the image, is covered.

    Raises
    ------
    DataError
        The recipe has no calibration, the halves are not found, or a film is thicker than the block is high.
    """
    calibration = _calibration(recipe, block, film_mm)
    trace = trace_of(replace(recipe, penetration=None), image)
    profiles, _ = profiles_in(trace, image)
    halves = find_halves(profiles, block, covered)
    steps = halves.steps_mm(profiles)
    triangulator = recipe.stages["triangulator"].make()
    redraws = calibration.redraws(np.random.default_rng(_SEED))
    drawn = [
        float(halves.steps_mm(triangulator.triangulate(trace.stripes, next(redraws))).mean())
        for _ in range(_REDRAWS)
    ]
    own = float(steps.std(ddof=1)) / math.sqrt(steps.size) if steps.size > 1 else 0.0
    std = math.hypot(film_std_mm, own, float(np.std(drawn, ddof=1)))
    return _made(recipe, calibration, block, film_mm - float(steps.mean()), std)


def _calibration(recipe: Recipe, block: Block, film_mm: float) -> Calibration:
    if recipe.calibration is None:
        raise DataError(f"{recipe.path}: there is no calibration", hint="name one in `calibration`")
    if not 0 <= film_mm < block.height_mm:
        raise DataError(
            f"the cover is given as {film_mm:g} mm thick, the block as {block.height_mm:g} mm high",
            hint="use a thin, even film of the product's material, and measure it with a calliper",
        )
    return recipe.calibration


def _made(
    recipe: Recipe, calibration: Calibration, block: Block, offset_mm: float, std_mm: float
) -> Penetration:
    return Penetration(
        product=recipe.product,
        offset_mm=offset_mm,
        std_mm=std_mm,
        calibration_sha256=calibration.sha256,
        target=block.name,
        made=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _of_mean(reading: Reading) -> float:
    """Standard uncertainty of a mean height, by the spread of the stripes' own."""
    return reading.stripe_spread_mm / math.sqrt(reading.stripes)


_BETWEEN_SHARE = 0.1
"""So much of the top about its middle is left out: there the one half ends and the other begins."""


@dataclass(frozen=True, eq=False, slots=True)
class Halves:
    """(slice, point) points of the bare and of the covered half; frozen: redraws are read alike."""

    bare: Flags
    covered: Flags

    def steps_mm(self, profiles: Profiles) -> Floats:
        """Give (slice,) the covered half's mean height over the bare one's, mm, of slices that show both."""
        height = profiles.xyz_mm[:, :, 2]
        both = np.flatnonzero(self.bare.any(axis=1))
        return np.array([height[s][self.covered[s]].mean() - height[s][self.bare[s]].mean() for s in both])


def find_halves(profiles: Profiles, block: Block, covered: Half) -> Halves:
    """Find both halves of a block's top, split at its middle along the stripes.

    Parameters
    ----------
    profiles
        Of one image.
    block
        As described.
    covered
        Which half is covered, in the image: ``top`` (towards +Y) or ``bottom``.

    Raises
    ------
    DataError
        Fewer than three stripes (or than there are) show two level halves.
    """
    height = profiles.xyz_mm[:, :, 2]
    high = (profiles.product > BELT) & profiles.seen & (height > _TOP_FROM_SHARE * block.height_mm)
    halves = np.zeros((2, *high.shape), np.bool_)
    for s in range(len(high)):
        at = np.flatnonzero(high[s])
        if at.size < 2 * _POINTS_MIN:
            continue
        first, last = np.quantile(at, [0.01, 0.99])
        middle, gap = 0.5 * (first + last), max(0.5 * _BETWEEN_SHARE * (last - first), _EDGE_ROWS)
        halves[0, s, at[(at >= first + _EDGE_ROWS) & (at <= middle - gap)]] = True
        halves[1, s, at[(at >= middle + gap) & (at <= last - _EDGE_ROWS)]] = True
    for half in halves:
        if half.any():
            level = float(np.median(height[half]))
            scatter = _MAD_TO_STD * float(np.median(np.abs(height[half] - level)))
            half &= np.abs(height - level) <= max(_TOP_SCATTERS * scatter, _TOP_LEAST_SHARE * block.height_mm)
    both = (halves.sum(axis=2) >= _POINTS_MIN).all(axis=0)
    needed = min(_STRIPES_MIN, profiles.slice_count)
    if both.sum() < needed:
        raise DataError(
            f"the block `{block.name}` does not show two level halves on {needed} stripes",
            hint="does it lie under the stripes, its covered half above or below the other in the image, the "
            "border between them at its middle?",
        )
    halves &= both[:, None]
    top, bottom = halves
    return Halves(bottom, top) if covered == "top" else Halves(top, bottom)
