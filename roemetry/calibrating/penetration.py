"""How deep light goes into a product: a block measured bare, and in the product's own material.

In two images, or in one of a block half of which is covered. What calibration and extractor do to both alike
cancels in the difference; what remains is the cover's thickness and the scatter of the stripes' differences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from roemetry.calibrating.block_check import (
    Reading,
    find_block,
    profiles_in,
    profiles_of,
    read_block,
    trace_of,
)
from roemetry.config.recipe import Recipe
from roemetry.errors import DataError
from roemetry.records import BELT, Block, Profiles
from roemetry.records.arrays import Flags, Floats
from roemetry.records.calibration import Calibration
from roemetry.records.penetration import Penetration

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
"""A standard deviation of 100 draws is uncertain by 7 %."""
_SEED = 1
"""Fixed: a fit of the same image says the same."""


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


_TOP_FROM_SHARE = 0.6
"""A product's point higher than this share of the block's height is looked at as its top."""
_EDGE_ROWS = 3
"""Rows next to an edge that are not used: the extractor smears it."""
_BETWEEN_SHARE = 0.1
"""So much of the top about its middle is left out: there the one half ends and the other begins."""
_POINTS_MIN = 10
"""Points of a stripe on a half."""
_STRIPES_MIN = 3
"""Stripes that show both halves."""
_SCATTERS = 4.0
"""Standard deviations from a half's median height within which points are its own."""
_LEAST_SHARE = 0.02
"""Of the block's height, the same at least."""
_MAD_TO_STD = 1.4826


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
            half &= np.abs(height - level) <= max(_SCATTERS * scatter, _LEAST_SHARE * block.height_mm)
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
