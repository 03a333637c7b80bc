"""How near to the bound: precision, materials, stripes close together; bias; filters along the stripe."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.extraction.drawing import (
    CONTRAST,
    SIZES,
    Drawn,
    Hits,
    Light,
    Stripes,
    bound_px,
    draw,
    drawn_set,
    hits,
    rms,
    stripes_of,
    unseen_stripes,
)
from benchmarks.extraction.methods import Method, found_in, frame_of, there
from benchmarks.tables import Table, number, percent
from roemetry.records import NOTHING, StripeMap
from roemetry.records.arrays import Floats
from roemetry.stages import Extractor, Smoother
from roemetry.stages.registry import discover

VGA = SIZES["VGA"]
SLOW_IMAGES = 2
MATERIALS = (0.08, 0.25)
PITCHES = (6.0, 8.0, 10.0, 12.0)
_SIGMA_PX = 2.0
_PARTS = 5


class Pool:
    """Errors of many images, one element a crossing that is not saturated and was found; and the counts."""

    def __init__(self) -> None:
        self._lists: dict[str, list[Floats]] = defaultdict(list)
        self.lit = self.missed = self.false = 0

    def add(self, drawn: Drawn, bound: Floats, method: Method, light: Light | None) -> None:
        """Find and match the peaks of one image."""
        found, stripes = hits(drawn.stripes, method.find(drawn.pixels, light)), drawn.stripes
        judged = stripes.lit & ~drawn.saturated
        here = judged & np.isfinite(found.error_px)
        each = {
            "error_px": found.error_px, "std_px": found.std_px, "bound_px": bound,
            "amplitude": stripes.amplitude, "sigma_px": stripes.sigma_px, "contrast": drawn.contrast,
        }  # fmt: skip
        for name, values in each.items():
            self._lists[name].append(values[here])
        self._lists["all_bounds_px"].append(bound[judged])
        cut = found.error_px[drawn.saturated]
        self._lists["saturated_px"].append(cut[np.isfinite(cut)])
        self.lit += found.lit
        self.missed += found.missed
        self.false += found.false

    def of(self, name: str) -> Floats:
        """Join one of the lists."""
        return np.concatenate(self._lists[name])

    @property
    def over_bound(self) -> float:
        """RMS error over the RMS of the bound."""
        return rms(self.of("error_px")) / rms(self.of("all_bounds_px"))

    def stated_over_observed(self, by: str) -> list[float]:
        """RMS of the stated uncertainty over that of the errors, in each fifth by amplitude or width."""
        key, error, std = self.of(by), self.of("error_px"), self.of("std_px")
        if not len(key) or not np.isfinite(std).all():
            return []
        order = np.argsort(key, kind="stable")
        cuts = np.linspace(0, len(order), _PARTS + 1).astype(int)
        return [rms(std[order[a:b]]) / rms(error[order[a:b]]) for a, b in pairwise(cuts)]


def pooled(methods: Sequence[Method], images: Iterable[Drawn], *, known: bool = True) -> dict[str, Pool]:
    """Run every method on every image; slow ones on the first two only."""
    pools = {method.name: Pool() for method in methods}
    for index, drawn in enumerate(images):
        bound = bound_px(drawn)
        for method in methods:
            if index < SLOW_IMAGES or not method.slow:
                pools[method.name].add(drawn, bound, method, drawn.light if known else None)
    return pools


def drawn_images(kind: str, count: int, seed: int) -> Iterable[Drawn]:
    """Draw the images of a set, each of a geometry of its own."""
    for image in range(count):
        rng = np.random.default_rng([seed, list(CONTRAST).index(kind), image])
        yield drawn_set(kind, VGA, rng, unseen_stripes(VGA, rng))


def precision(methods: Sequence[Method], count: int, seed: int, *, known: bool) -> Table:
    """Judge methods on `count` VGA images a set; `known` says whether the sensor's noise is told."""
    pools = {kind: pooled(methods, drawn_images(kind, count, seed), known=known) for kind in CONTRAST}
    rows = []
    for method in methods:
        of = {kind: pools[kind][method.name] for kind in CONTRAST}
        hard, by = of["hard"], ("amplitude", "sigma_px")
        fifths = [ratio for each in of.values() for key in by for ratio in each.stated_over_observed(key)]
        rows.append([
            method.name, *(number(each.over_bound, 3) for each in of.values()),
            " / ".join(number(1e3 * float(each.of("error_px").mean()), 1) for each in of.values()),
            number(rms(of["clean"].of("saturated_px")), 3),
            f"{percent(hard.missed, hard.lit)} / {percent(hard.false, hard.lit)}",
            f"{min(fifths):.2f}–{max(fifths):.2f}" if fifths else "not stated",
        ])  # fmt: skip
    first = methods[0].name
    bounds = " / ".join(number(rms(pools[kind][first].of("all_bounds_px")), 4) for kind in CONTRAST)
    return Table(
        f"RMS error over the bound, one row; {count} VGA images a set (bound {bounds} px)",
        ["method", *(f"{kind} ×" for kind in CONTRAST), "bias, 0.001 px: clean / speckle / hard",
         "saturated, clean, px", "hard: missed / false %", "stated over observed, fifths"], rows,
    )  # fmt: skip


def two_materials(methods: Sequence[Method], count: int, seed: int) -> Table:
    """Judge methods where a product with strong speckle lies on a belt with weak speckle."""
    row, column = np.mgrid[: VGA[0], : VGA[1]]
    product = np.hypot((row - VGA[0] / 2) / (0.35 * VGA[0]), (column - VGA[1] / 2) / (0.4 * VGA[1])) < 1.0
    light = Light(contrast=np.where(product, MATERIALS[1], MATERIALS[0]).astype(np.float64))

    def images() -> Iterable[Drawn]:
        for index in range(count):
            rng = np.random.default_rng([seed, 11, index])
            yield draw(unseen_stripes(VGA, rng), VGA, rng, light)

    rows = []
    for name, pool in pooled(methods, images()).items():
        std, error = pool.of("std_px"), pool.of("error_px")
        relative, strong = error / pool.of("bound_px"), pool.of("contrast") > sum(MATERIALS) / 2.0
        stated = [number(rms(std[part]) / rms(error[part]), 2) for part in (~strong, strong)]
        rows.append([
            name, number(pool.over_bound, 3), number(rms(relative), 3),
            *(number(rms(relative[part]), 3) for part in (~strong, strong)),
            " / ".join(stated) if np.isfinite(std).all() else "not stated",
        ])  # fmt: skip
    low, high = MATERIALS
    return Table(
        f"Two materials in one image: contrast {high} on the product, {low} on the belt; {count} VGA images",
        ["method", "RMS over bound", "RMS of error/bound", "on the belt", "on the product",
         "stated over observed, belt / product"], rows,
    )  # fmt: skip


def close_together(methods: Sequence[Method], count: int, seed: int) -> Table:
    """Judge methods on straight stripes side by side; the bound is that of one stripe alone."""
    results: dict[str, list[str]] = {method.name: [method.name] for method in methods}
    cases = [(kind, pitch) for kind in ("clean", "speckle") for pitch in PITCHES]
    for index, (kind, pitch) in enumerate(cases):
        drawn = []
        for image in range(count):
            rng = np.random.default_rng([seed, 12, index, image])
            drawn.append(draw(side_by_side(pitch * _SIGMA_PX, rng), VGA, rng, Light(CONTRAST[kind])))
        for name, pool in pooled(methods, drawn).items():
            missed = 100.0 * pool.missed / max(pool.lit, 1)
            lost = f" ({missed:.1f} % missed)" if missed >= 0.05 else ""
            results[name].append(number(pool.over_bound, 2) + lost)
    title = f"Stripes close together: RMS over the bound by pitch (σ {_SIGMA_PX:.0f} px); {count} VGA images"
    head = ["method", *(f"{kind}, {pitch:.0f} σ" for kind, pitch in cases)]
    return Table(title, head, list(results.values()))


def side_by_side(pitch_px: float, rng: np.random.Generator) -> Stripes:
    """Give straight, slightly tilted stripes of one width, of heights from 80 to 200 grey levels."""
    stripes = int((VGA[1] - 60.0) / pitch_px)
    first = 30.0 + rng.uniform(0.0, pitch_px) + pitch_px * np.arange(stripes)[:, None]
    x_px = first + 0.013 * (np.arange(VGA[0], dtype=np.float64) - VGA[0] / 2)
    return stripes_of(x_px, _SIGMA_PX, rng.uniform(80.0, 200.0, (stripes, 1)))


# Mean errors over sub-pixel phases, heights and widths: what averaging would not take away.

PHASES = 10
AMPLITUDES = (60.0, 120.0, 200.0)
SIGMAS_PX = (1.5, 2.2, 3.0)
ROWS_AN_IMAGE = 1000
_PITCH_PX = 60


def bias(methods: Sequence[Method], rows: int, seed: int) -> Table:
    """Give the largest mean error over all cells; `rows` is the number of rows behind each mean when clean.

    With speckle five times as many are drawn, since the scatter is larger.
    """
    results: dict[str, list[str]] = {method.name: [method.name] for method in methods if not method.slow}
    kinds = {kind: CONTRAST[kind] for kind in ("clean", "speckle")}
    for kind, contrast in kinds.items():
        images = max(1, (rows if kind == "clean" else 5 * rows) // ROWS_AN_IMAGE)
        means = {name: np.full((images, 3, 3, PHASES), np.nan) for name in results}
        for cell, (sigma, top) in enumerate(np.ndindex(3, 3)):
            for image in range(images):
                rng = np.random.default_rng([seed, 13, cell, image, int(contrast > 0)])
                drawn = _phases(SIGMAS_PX[sigma], AMPLITUDES[top], contrast, rng)
                for method in methods:
                    if method.name in results:
                        error = hits(drawn.stripes, method.find(drawn.pixels, drawn.light)).error_px
                        count = np.isfinite(error).sum(axis=1)
                        mean = np.nansum(error, axis=1) / np.maximum(count, 1)
                        means[method.name][image, sigma, top] = np.where(count > 0, mean, np.nan)
        for name, by_image in means.items():
            results[name] += summary(by_image)
    columns = [f"{kind}: {what}" for kind in kinds for what in ("largest", "typical standard error")]
    return Table(
        f"Bias: the largest of {PHASES} × {len(AMPLITUDES)} × {len(SIGMAS_PX)} mean errors "
        f"({rows} rows each when clean, {5 * rows} with speckle), px",
        ["method", *columns], list(results.values()),
    )  # fmt: skip


def _phases(sigma_px: float, amplitude: float, contrast: float, rng: np.random.Generator) -> Drawn:
    """Draw ten upright stripes, one a sub-pixel phase."""
    x_px = (_PITCH_PX * (np.arange(PHASES) + 0.5) + np.arange(PHASES) / PHASES)[:, None]
    stripes = stripes_of(x_px * np.ones((PHASES, ROWS_AN_IMAGE)), sigma_px, amplitude)
    return draw(stripes, (ROWS_AN_IMAGE, _PITCH_PX * (PHASES + 1)), rng, Light(contrast))


def summary(by_image: Floats) -> list[str]:
    """Give the largest mean over the images with its sign, and the typical standard error of such a mean.

    The standard error comes from the scatter among images: neighbouring rows share their speckle.
    """
    if np.isnan(by_image).any():
        return ["not always found", "–"]
    mean, images = by_image.mean(axis=0), by_image.shape[0]
    error = by_image.std(axis=0, ddof=1) / np.sqrt(images) if images > 1 else np.full(mean.shape, np.nan)
    return [number(float(mean.ravel()[np.abs(mean).argmax()]), 4), number(float(rms(error)), 4)]


# Filters along the stripe: what they gain, bend and smear. Labels are taken from the truth.

FED_BY = "maximum-likelihood"
"""The extractor that feeds the filters."""
STEPS_PX = (0.5, 1.0, 2.0)
_WAVE_ROWS = 60.0
_BOW = 1.0 / 16.0  # px a row²: 1 px between the middle and the ends of 9 rows
_EVERY = 40

Smooth = Callable[[Drawn], StripeMap]


def along(count: int, seed: int) -> list[Table]:
    """Judge every registered smoother."""
    available, registry = dict(there()), discover()
    smoothers = {
        one.entry.name: registry.load(one)() for one in registry.of_kind("smoother") if one.missing is None
    }
    rows = []
    for name, smoother in {"none": None, **smoothers}.items():
        smooth = _smoothing(smoother, available[FED_BY])
        rows.append([
            name, *_over_bound(smooth, count, seed), number(_bow_error(smooth, count, seed), 4),
            *(number(_step_error(step, smooth, count, seed), 3) for step in STEPS_PX),
        ])  # fmt: skip
    title = f"Filters along the stripe, fed by {FED_BY}; true labels; {count} VGA images a set"
    head = ["filter", *(f"{kind} ×" for kind in CONTRAST), "stated over observed: clean / speckle / hard",
            "bow of 1 px over 9 rows: mean error, px",
            *(f"step of {step:g} px: mean error beyond ± 1 row, px" for step in STEPS_PX)]  # fmt: skip
    return [Table(title, head, rows)]


def _smoothing(smoother: Smoother[Any] | None, extractor: Extractor[Any]) -> Smooth:
    """Give what extracts, labels by the truth, and filters."""

    def smooth(drawn: Drawn) -> StripeMap:
        """Give the map of a drawn image, filtered."""
        peaks = extractor.extract(frame_of(drawn.pixels, drawn.light))
        found = hits(drawn.stripes, found_in(peaks))
        stripes = _labelled(drawn.stripes, found, peaks.correlation_rows)
        return stripes if smoother is None else smoother.smooth(stripes)

    return smooth


def _labelled(truth: Stripes, found: Hits, correlation_rows: float) -> StripeMap:
    """Make the map that a coder without fault would give."""
    x_px = truth.x_px + found.error_px
    seen, unknown = np.isfinite(x_px), np.full(x_px.shape, np.nan)
    return StripeMap(
        x_px=x_px, x_std_px=np.where(seen, found.std_px, np.nan),
        product=np.where(seen, 0, NOTHING).astype(np.int16), seen=seen, margin=unknown,
        ambiguous=np.zeros(x_px.shape, bool), rest_px=unknown, peak_stripe=np.empty(0, np.int16),
        correlation_rows=correlation_rows,
    )  # fmt: skip


def _over_bound(smooth: Smooth, count: int, seed: int) -> list[str]:
    """Give the errors over the bound by set, and what is stated over them."""
    over_bound, stated = [], []
    for kind in CONTRAST:
        errors, stds, bounds = [], [], []
        for drawn in drawn_images(kind, count, seed):
            smoothed, lit = smooth(drawn), drawn.stripes.lit & ~drawn.saturated
            error = smoothed.x_px - drawn.stripes.x_px
            here = lit & np.isfinite(error)
            errors.append(error[here])
            stds.append(smoothed.x_std_px[here])
            bounds.append(bound_px(drawn)[lit])
        error, std, bound = (rms(np.concatenate(each)) for each in (errors, stds, bounds))
        over_bound.append(number(error / bound, 3))
        stated.append(number(std / error, 2))
    return [*over_bound, " / ".join(stated)]


def _bow_error(smooth: Smooth, count: int, seed: int) -> float:
    """Give the mean error towards the inside of a bow, at the crests of wavy stripes."""
    towards: list[Floats] = []
    for drawn in _upright(_wave, count, seed, 15):
        error = smooth(drawn).x_px - drawn.stripes.x_px
        bend = np.gradient(np.gradient(drawn.stripes.x_px, axis=1), axis=1) / (2.0 * _BOW)
        crest = (np.abs(bend) > 0.95) & np.isfinite(error)
        towards.append((error * np.sign(bend))[crest])
    return float(np.concatenate(towards).mean())


def _step_error(step_px: float, smooth: Smooth, count: int, seed: int) -> float:
    """Give the largest mean error, over many steps, at 2 to 9 rows from a step."""
    by_distance: list[Floats] = []

    def steps(row: Floats, rng: np.random.Generator) -> Floats:
        return np.asarray(step_px * (np.floor((row - 0.5 * _EVERY) / _EVERY) % 2))

    for drawn in _upright(steps, count, seed, 16):
        truth = drawn.stripes.x_px
        error = smooth(drawn).x_px - truth
        for edge in range(_EVERY // 2 + _EVERY, truth.shape[1] - _EVERY, _EVERY):
            sign = np.sign(truth[:, edge] - truth[:, edge - 1])[:, None]
            # rows 9 … 2 before the last row of the old level, and 2 … 9 after the first of the new one
            near = np.r_[edge - 10 : edge - 2, edge + 2 : edge + 10]
            by_distance.append(sign * error[:, near])
    return float(np.abs(np.nanmean(np.concatenate(by_distance), axis=0)).max())


def _wave(row: Floats, rng: np.random.Generator) -> Floats:
    """Give a stripe that bows 1 px over 9 rows at its crests."""
    turn = 2.0 * np.pi / _WAVE_ROWS
    return np.asarray(2.0 * _BOW / turn**2 * np.sin(turn * row + rng.uniform(0.0, 2.0 * np.pi)))


def _upright(
    path: Callable[[Floats, np.random.Generator], Floats], count: int, seed: int, own: int
) -> Iterable[Drawn]:
    """Draw images without speckle of ten stripes that follow a path; `own` is the path's part of the seed."""
    row = np.arange(VGA[0], dtype=np.float64)
    for image in range(count):
        rng = np.random.default_rng([seed, own, image])
        rest = 55.0 + 58.0 * np.arange(10)[:, None] + rng.uniform(0.0, 1.0, (10, 1))
        yield draw(stripes_of(rest + path(row, rng), 2.0, 150.0), VGA, rng, Light())
