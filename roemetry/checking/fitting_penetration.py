"""How deep light goes into a product: a block measured bare, and in the product's own material."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from roemetry.calibration import Calibration
from roemetry.checking.block_reading import Reading, find_block, read_block
from roemetry.checking.checking import profiles_in, profiles_of, trace_of
from roemetry.checking.two_coloured import Half, find_halves
from roemetry.errors import DataError
from roemetry.penetration import Penetration
from roemetry.recipe import Recipe
from roemetry.records import Block


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
        profiles = profiles_of(plain, image)
        seen = replace(block, height_mm=height_mm)
        readings.append(read_block(profiles, find_block(profiles, seen), None))
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
    profiles = profiles_in(trace, image)
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


_REDRAWS = 100
_SEED = 1


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
