"""How near to the bound: sets of unseen geometry, two materials in one image, stripes close together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.extraction.bounds import bound_px
from benchmarks.extraction.drawing import (
    CONTRAST,
    SIZES,
    Drawn,
    Light,
    Stripes,
    draw,
    drawn_set,
    unseen_stripes,
)
from benchmarks.extraction.methods import Method
from benchmarks.extraction.scoring import hits, rms
from benchmarks.tables import Table, number, percent
from roemetry.records.arrays import Floats

SLOW_IMAGES = 2
MATERIALS = (0.08, 0.25)
PITCHES = (6.0, 8.0, 10.0, 12.0)
_SIGMA_PX = 2.0
_PARTS = 5


@dataclass
class Pool:
    """Errors of many images, one element a crossing that is not saturated and was found; and the counts."""

    error_px: list[Floats] = field(default_factory=list)
    std_px: list[Floats] = field(default_factory=list)
    bound_px: list[Floats] = field(default_factory=list)
    amplitude: list[Floats] = field(default_factory=list)
    sigma_px: list[Floats] = field(default_factory=list)
    contrast: list[Floats] = field(default_factory=list)
    all_bounds_px: list[Floats] = field(default_factory=list)
    saturated_px: list[Floats] = field(default_factory=list)
    lit: int = 0
    missed: int = 0
    false: int = 0

    def add(self, drawn: Drawn, bound: Floats, method: Method, light: Light | None) -> None:
        """Find and match the peaks of one image."""
        found = hits(drawn.stripes, method.find(drawn.pixels, light))
        judged = drawn.stripes.lit & ~drawn.saturated
        here = judged & np.isfinite(found.error_px)
        for values, what in (
            (self.error_px, found.error_px),
            (self.std_px, found.std_px),
            (self.bound_px, bound),
            (self.amplitude, drawn.stripes.amplitude),
            (self.sigma_px, drawn.stripes.sigma_px),
            (self.contrast, drawn.contrast),
        ):
            values.append(what[here])
        self.all_bounds_px.append(bound[judged])
        cut = found.error_px[drawn.saturated]
        self.saturated_px.append(cut[np.isfinite(cut)])
        self.lit += found.lit
        self.missed += found.missed
        self.false += found.false

    def of(self, name: str) -> Floats:
        """Join one of the lists."""
        return np.concatenate(getattr(self, name))

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


def precision(methods: Sequence[Method], count: int, seed: int, *, known: bool) -> Table:
    """Judge methods on `count` VGA images a set; `known` says whether the sensor's noise is told."""
    rows = []
    pools = {kind: pooled(methods, drawn_images(kind, count, seed), known=known) for kind in CONTRAST}
    for method in methods:
        of = {kind: pools[kind][method.name] for kind in CONTRAST}
        hard = of["hard"]
        fifths = [
            ratio
            for each in of.values()
            for by in ("amplitude", "sigma_px")
            for ratio in each.stated_over_observed(by)
        ]
        rows.append(
            [
                method.name,
                *(number(of[kind].over_bound, 3) for kind in CONTRAST),
                " / ".join(number(1e3 * float(each.of("error_px").mean()), 1) for each in of.values()),
                number(rms(of["clean"].of("saturated_px")), 3),
                f"{percent(hard.missed, hard.lit)} / {percent(hard.false, hard.lit)}",
                f"{min(fifths):.2f}–{max(fifths):.2f}" if fifths else "not stated",
            ]
        )
    bounds = " / ".join(
        number(rms(next(iter(pools[kind].values())).of("all_bounds_px")), 4) for kind in CONTRAST
    )
    return Table(
        f"RMS error over the bound, one row; {count} VGA images a set (bound {bounds} px)",
        [
            "method",
            "clean ×",
            "speckle ×",
            "hard ×",
            "bias, 0.001 px: clean / speckle / hard",
            "saturated, clean, px",
            "hard: missed / false %",
            "stated over observed, fifths",
        ],
        rows,
    )


def drawn_images(kind: str, count: int, seed: int) -> Iterable[Drawn]:
    """Draw the images of a set, each of a geometry of its own."""
    size = SIZES["VGA"]
    for number_ in range(count):
        rng = np.random.default_rng([seed, list(CONTRAST).index(kind), number_])
        yield drawn_set(kind, size, rng, unseen_stripes(size, rng))


def pooled(methods: Sequence[Method], images: Iterable[Drawn], *, known: bool) -> dict[str, Pool]:
    """Run every method on every image; slow ones on the first two only."""
    pools = {method.name: Pool() for method in methods}
    for index, drawn in enumerate(images):
        bound = bound_px(drawn)
        for method in methods:
            if index < SLOW_IMAGES or not method.slow:
                pools[method.name].add(drawn, bound, method, drawn.light if known else None)
    return pools


def two_materials(methods: Sequence[Method], count: int, seed: int) -> Table:
    """Judge methods where a product with strong speckle lies on a belt with weak speckle."""
    size = SIZES["VGA"]
    row, column = np.mgrid[: size[0], : size[1]]
    product = np.hypot((row - size[0] / 2) / (0.35 * size[0]), (column - size[1] / 2) / (0.4 * size[1])) < 1.0
    light = Light(contrast=np.where(product, MATERIALS[1], MATERIALS[0]).astype(np.float64))

    def images() -> Iterable[Drawn]:
        for index in range(count):
            rng = np.random.default_rng([seed, 11, index])
            yield draw(unseen_stripes(size, rng), size, rng, light)

    pools = pooled(methods, images(), known=True)
    rows = []
    for method in methods:
        pool = pools[method.name]
        relative = pool.of("error_px") / pool.of("bound_px")
        contrast = pool.of("contrast")
        parts = [contrast < sum(MATERIALS) / 2.0, contrast > sum(MATERIALS) / 2.0]
        std, error = pool.of("std_px"), pool.of("error_px")
        stated = [number(rms(std[part]) / rms(error[part]), 2) for part in parts]
        rows.append(
            [
                method.name,
                number(pool.over_bound, 3),
                number(rms(relative), 3),
                *(number(rms(relative[part]), 3) for part in parts),
                " / ".join(stated) if np.isfinite(std).all() else "not stated",
            ]
        )
    low, high = MATERIALS
    return Table(
        f"Two materials in one image: contrast {high} on the product, {low} on the belt; {count} VGA images",
        [
            "method",
            "RMS over bound",
            "RMS of error/bound",
            "on the belt",
            "on the product",
            "stated over observed, belt / product",
        ],
        rows,
    )


def close_together(methods: Sequence[Method], count: int, seed: int) -> Table:
    """Judge methods on straight stripes side by side; the bound is that of one stripe alone."""
    size = SIZES["VGA"]
    results: dict[str, list[str]] = {method.name: [method.name] for method in methods}
    for index, (kind, pitch) in enumerate(
        (kind, pitch) for kind in ("clean", "speckle") for pitch in PITCHES
    ):

        def images(kind: str = kind, pitch: float = pitch, index: int = index) -> Iterable[Drawn]:
            for image in range(count):
                rng = np.random.default_rng([seed, 12, index, image])
                yield draw(side_by_side(size, pitch * _SIGMA_PX, rng), size, rng, Light(CONTRAST[kind]))

        pools = pooled(methods, images(), known=True)
        for name, pool in pools.items():
            missed = 100.0 * pool.missed / max(pool.lit, 1)
            lost = f" ({missed:.1f} % missed)" if missed >= 0.05 else ""
            results[name].append(number(pool.over_bound, 2) + lost)
    columns = [f"{kind}, {pitch:.0f} σ" for kind in ("clean", "speckle") for pitch in PITCHES]
    return Table(
        f"Stripes close together: RMS over the bound by pitch (σ {_SIGMA_PX:.0f} px); {count} VGA images",
        ["method", *columns],
        list(results.values()),
    )


def side_by_side(size: tuple[int, int], pitch_px: float, rng: np.random.Generator) -> Stripes:
    """Give straight, slightly tilted stripes of one width, of heights from 80 to 200 grey levels."""
    row = np.arange(size[0], dtype=np.float64)
    stripes = int((size[1] - 60.0) / pitch_px)
    first = 30.0 + rng.uniform(0.0, pitch_px) + pitch_px * np.arange(stripes)[:, None]
    x_px = first + 0.013 * (row - size[0] / 2)
    ones: NDArray[np.float64] = np.ones_like(x_px)
    return Stripes(x_px, _SIGMA_PX * ones, rng.uniform(80.0, 200.0, (stripes, 1)) * ones, ones.astype(bool))
