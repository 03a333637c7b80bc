"""Filters along the stripe: what they gain, bend and smear. Labels are taken from the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from benchmarks.extraction.bounds import bound_px
from benchmarks.extraction.drawing import CONTRAST, SIZES, Drawn, Light, Stripes, draw
from benchmarks.extraction.methods import extractors, found_in, frame_of
from benchmarks.extraction.precision import drawn_images
from benchmarks.extraction.scoring import Hits, hits, rms
from benchmarks.tables import Table, number
from roemetry.records import NOTHING, StripeMap
from roemetry.records.arrays import Floats
from roemetry.stages import Extractor, Smoother
from roemetry.stages.registry import discover

FED_BY = ("maximum-likelihood", "gaussian", "centre-of-gravity")
"""The extractor that feeds the filters: the first of these that is installed."""
STEPS_PX = (0.5, 1.0, 2.0)
_WAVE_ROWS = 60.0
_BOW = 1.0 / 16.0  # px a row²: 1 px between the middle and the ends of 9 rows
_EVERY = 40


def along(count: int, seed: int) -> list[Table]:
    """Judge every registered smoother."""
    available = dict(extractors())
    fed_by = next((name for name in FED_BY if isinstance(available.get(name), Extractor)), None)
    smoothers = dict(registered_smoothers())
    if fed_by is None or not smoothers:
        return []
    extractor = available[fed_by]
    assert isinstance(extractor, Extractor)
    rows = [judged(name, smoother, extractor, count, seed) for name, smoother in smoothers.items()]
    return [
        Table(
            f"Filters along the stripe, fed by {fed_by}; true labels; {count} VGA images a set",
            [
                "filter",
                *(f"{kind} ×" for kind in CONTRAST),
                "stated over observed: clean / speckle / hard",
                "bow of 1 px over 9 rows: mean error, px",
                *(f"step of {step:g} px: mean error beyond ± 1 row, px" for step in STEPS_PX),
            ],
            [judged("none", None, extractor, count, seed), *rows],
        )
    ]


def registered_smoothers() -> Iterator[tuple[str, Smoother[Any]]]:
    """Make every registered smoother that can be used."""
    registry = discover()
    for registered in registry.of_kind("smoother"):
        if registered.missing is None:
            yield registered.entry.name, registry.load(registered)()


def judged(
    name: str, smoother: Smoother[Any] | None, extractor: Extractor[Any], count: int, seed: int
) -> list[str]:
    """Make a row of the table; without a smoother, of the extractor alone."""
    over_bound, stated = [], []
    for kind in CONTRAST:
        errors, stds, bounds = [], [], []
        for drawn in drawn_images(kind, count, seed):
            smoothed, lit = smooth(drawn, smoother, extractor), drawn.stripes.lit & ~drawn.saturated
            error = smoothed.x_px - drawn.stripes.x_px
            here = lit & np.isfinite(error)
            errors.append(error[here])
            stds.append(smoothed.x_std_px[here])
            bounds.append(bound_px(drawn)[lit])
        error, bound, std = (np.concatenate(each) for each in (errors, bounds, stds))
        over_bound.append(number(rms(error) / rms(bound), 3))
        stated.append(number(rms(std) / rms(error), 2))
    return [
        name,
        *over_bound,
        " / ".join(stated),
        number(bow_error(smoother, extractor, count, seed), 4),
        *(number(step_error(step, smoother, extractor, count, seed), 3) for step in STEPS_PX),
    ]


def smooth(drawn: Drawn, smoother: Smoother[Any] | None, extractor: Extractor[Any]) -> StripeMap:
    """Extract, label by the truth, filter."""
    peaks = extractor.extract(frame_of(drawn.pixels, drawn.light))
    stripes = labelled(drawn.stripes, hits(drawn.stripes, found_in(peaks)), peaks.correlation_rows)
    return stripes if smoother is None else smoother.smooth(stripes)


def labelled(truth: Stripes, found: Hits, correlation_rows: float) -> StripeMap:
    """Make the map that a coder without fault would give."""
    x_px = truth.x_px + found.error_px
    seen = np.isfinite(x_px)
    return StripeMap(
        x_px=x_px,
        x_std_px=np.where(seen, found.std_px, np.nan),
        product=np.where(seen, 0, NOTHING).astype(np.int16),
        seen=seen,
        margin=np.full(x_px.shape, np.nan),
        ambiguous=np.zeros(x_px.shape, bool),
        rest_px=np.full(x_px.shape, np.nan),
        peak_stripe=np.empty(0, np.int16),
        correlation_rows=correlation_rows,
    )


def bow_error(smoother: Smoother[Any] | None, extractor: Extractor[Any], count: int, seed: int) -> float:
    """Give the mean error towards the inside of a bow, at the crests of wavy stripes."""
    towards: list[Floats] = []
    for drawn in upright(wave, count, seed, 15):
        error = smooth(drawn, smoother, extractor).x_px - drawn.stripes.x_px
        bend = np.gradient(np.gradient(drawn.stripes.x_px, axis=1), axis=1) / (2.0 * _BOW)
        crest = (np.abs(bend) > 0.95) & np.isfinite(error)
        towards.append((error * np.sign(bend))[crest])
    return float(np.concatenate(towards).mean())


def step_error(
    step_px: float, smoother: Smoother[Any] | None, extractor: Extractor[Any], count: int, seed: int
) -> float:
    """Give the largest mean error, over many steps, at 2 to 9 rows from a step."""
    by_distance: list[Floats] = []

    def steps(row: Floats, rng: np.random.Generator) -> Floats:
        return np.asarray(step_px * (np.floor((row - 0.5 * _EVERY) / _EVERY) % 2))

    for drawn in upright(steps, count, seed, 16):
        truth = drawn.stripes.x_px
        error = smooth(drawn, smoother, extractor).x_px - truth
        for edge in range(_EVERY // 2 + _EVERY, truth.shape[1] - _EVERY, _EVERY):
            sign = np.sign(truth[:, edge] - truth[:, edge - 1])[:, None]
            # rows 9 … 2 before the last row of the old level, and 2 … 9 after the first of the new one
            near = np.r_[edge - 10 : edge - 2, edge + 2 : edge + 10]
            by_distance.append(sign * error[:, near])
    return float(np.abs(np.nanmean(np.concatenate(by_distance), axis=0)).max())


def wave(row: Floats, rng: np.random.Generator) -> Floats:
    """Give a stripe that bows 1 px over 9 rows at its crests."""
    turn = 2.0 * np.pi / _WAVE_ROWS
    return np.asarray(2.0 * _BOW / turn**2 * np.sin(turn * row + rng.uniform(0.0, 2.0 * np.pi)))


def upright(
    path: Callable[[Floats, np.random.Generator], Floats], count: int, seed: int, number_: int
) -> Iterable[Drawn]:
    """Draw images without speckle of ten stripes that follow a path."""
    size = SIZES["VGA"]
    row = np.arange(size[0], dtype=np.float64)
    for image in range(count):
        rng = np.random.default_rng([seed, number_, image])
        rest = 55.0 + 58.0 * np.arange(10)[:, None] + rng.uniform(0.0, 1.0, (10, 1))
        x_px = rest + path(row, rng)
        ones = np.ones_like(x_px)
        stripes = Stripes(x_px, 2.0 * ones, 150.0 * ones, ones.astype(bool))
        yield draw(stripes, size, rng, Light())
