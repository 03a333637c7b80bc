"""A known block through a recipe's own chain, judged and written down."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from roemetry.calibration import Calibration
from roemetry.checking.block_reading import Places, Reading, find_block, read_block
from roemetry.checking.chart import Chart
from roemetry.checking.judging import Check, judged, quantities_of
from roemetry.errors import DataError
from roemetry.files import sha256_of
from roemetry.pipeline import Pipeline
from roemetry.recipe import Recipe
from roemetry.records import Acquisition, AcquisitionReference, Block, Profiles, Trace

_REDRAWS = 100
_SEED = 1


def check_calibration(recipe: Recipe, image: Path, block: Block, chart: Path | None) -> Check:
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
    trace = trace_of(replace(recipe, penetration=None), image)
    profiles = profiles_in(trace, image)
    places = find_block(profiles, block)
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
    verdict, reasons = judged(check, history)
    check = replace(check, verdict=verdict, reasons=reasons)
    if chart is not None:
        Chart(chart).add(check)
    return check


def profiles_of(recipe: Recipe, image: Path) -> Profiles:
    """Take one image through a recipe as far as its profiles; raise DataError where that cannot be done."""
    return profiles_in(trace_of(recipe, image), image)


def trace_of(recipe: Recipe, image: Path) -> Trace:
    """Take one image through a recipe's chain, without draws; raise DataError where it cannot be read."""
    return Pipeline(recipe, draws=0).trace(_read(image))


def _read(image: Path) -> Acquisition:
    from roemetry.registry import discover

    registry = discover()
    source = registry.load(registry.find("source", "image-files"))()
    acquisition: Acquisition = source.read(AcquisitionReference(image.stem, {"laser": image}))
    return acquisition


def profiles_in(trace: Trace, image: Path) -> Profiles:
    """Give what a chain made of an image; raise DataError where it did not get as far as profiles."""
    if trace.profiles is None:
        why = "; ".join(reason.text for reason in trace.absent.values())
        raise DataError(f"{image}: the block cannot be measured: {why}")
    return trace.profiles


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
