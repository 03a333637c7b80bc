"""Linearised standard uncertainties against Monte Carlo draws, on skeins nobody has looked at.

``python -m benchmarks uncertainty [--seed 510000] [--count 100] [--draws 2000] [--keep rows.jsonl]
[--jobs 1] [--cluster ADDRESS]``

Skeins of the whole population on the rig of ``recipes/herring_roe``: stripes and silhouettes are traced, not
rendered, and peaks are drawn with the noise that they state. Calibration, stages and options are those of
``with_outline.yaml``. A draw moves peaks, calibration and outline together and solves the surface from the
beginning, as `estimate` does; what the stages state of their own models is added to both sides. With `--keep`
what was drawn of a skein is written when it is done, and is not drawn again: only the linearisation is.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks.command import add_sharing, keep, kept, parser_of, shared
from benchmarks.volume_scenes import HERRING_ROE, exact, rig_of
from roemetry import Recipe
from roemetry.errors import RoemetryError
from roemetry.records import NOTHING, Outline, ProductTrace, StripeMap
from roemetry.run.linearisation import linearise
from roemetry.run.monte_carlo import Chain, Result, Sampler, Scene, rerun
from roemetry.run.open_parts import split_products
from roemetry_simulate.population import in_reach
from roemetry_simulate.products import PRODUCTS

_NOISE_PX, _CORRELATED_ROWS = 0.08, 1.2
_OUTLINE_STD_PX = 0.3
_CAUSES = ("peak noise", "calibration", "outline")


def main() -> None:
    """Print the ratios of standard uncertainties, and what both take."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=510000)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--keep", type=Path, help="file that a run goes on from")
    add_sharing(parser)
    given = parser.parse_args()
    drawn = {row["seed"]: row for row in kept(given.keep) if row["draws"] == given.draws}
    rows = []
    seeds = range(given.seed, given.seed + given.count)
    for spreads, compared in shared(given, partial, (_of_seed, given.draws, dict(drawn)), seeds):
        if spreads is None:
            continue
        seed = spreads["seed"]
        if seed not in drawn:
            keep(given.keep, spreads)
        drawn[seed] = spreads
        for row in compared:
            rows.append(row)
            print(seed, *(f"{name} {row[name]:.3f}" for name in _FIELDS), flush=True)
    print(f"{len(rows)} skeins, {given.draws} draws each; of the standard uncertainty of the visible")
    print(f"volume {np.median([row['share'] for row in rows]):.0%} (median) is what was drawn\n")
    for name in _FIELDS:
        each = np.array([row[name] for row in rows])
        low, middle, high = np.quantile(each, [0.05, 0.5, 0.95])
        print(
            f"{name}: linearised over drawn {min(each):.3f} to {max(each):.3f}, median {middle:.3f}, "
            f"90 % of them {low:.3f} to {high:.3f}; within 5 %: {np.mean(np.abs(each - 1.0) < 0.05):.0%}"
        )
    taken = [np.median([row["ms"] for row in each]) for each in (rows, drawn.values())]
    print("linearised, drawn: {:.0f} and {:.0f} ms a product".format(*taken))


_FIELDS = {"visible volume": "visible_mm3", "mass": "mass_g"}


@cache
def _chain() -> tuple[Recipe, Chain]:
    recipe = Recipe.load(HERRING_ROE / "with_outline.yaml")
    return recipe, Chain(
        *(recipe.stages[kind].make() for kind in ("triangulator", "volume", "weigher")), None
    )


def _of_seed(
    draws: int, drawn: dict[int, dict[str, float]], seed: int
) -> tuple[dict[str, float] | None, list[dict[str, float]]]:
    """Give a skein's spreads, if not `drawn` before, and the ratios; None where it is refused."""
    recipe, chain = _chain()
    spreads, compared = drawn.get(seed), []
    for trace, scene in _traces(recipe, chain, seed):
        if spreads is None:
            spreads = _spreads(trace, scene, chain, draws, seed)
        compared.append(_compared(trace, scene, chain, spreads))
    return spreads, compared


def _spreads(trace: ProductTrace, scene: Scene, chain: Chain, draws: int, seed: int) -> dict[str, float]:
    """Give the standard deviations that draws find, and what they take."""
    begin = time.process_time()
    drawn = list(_drawn(trace, scene, chain, draws, seed))
    spreads = {
        field: float(np.std([getattr(one, field) for one in drawn], ddof=1)) for field in _FIELDS.values()
    }
    return {"seed": seed, "draws": draws, "ms": 1e3 * (time.process_time() - begin), **spreads}


def _compared(trace: ProductTrace, scene: Scene, chain: Chain, drawn: dict[str, float]) -> dict[str, float]:
    """Give the ratios of one skein's standard uncertainties, and what linearising takes."""
    begin = time.process_time()
    (linear,) = linearise((trace,), scene, chain)
    row = {"ms": 1e3 * (time.process_time() - begin)}
    assert linear.volume is not None
    assert linear.weight is not None
    both = linear.volume.visible_mm3, linear.weight.mass_g
    for (name, field), found in zip(_FIELDS.items(), both, strict=True):
        models = [part for cause, part in found.budget.items() if cause not in _CAUSES]
        row[name] = found.std / math.hypot(drawn[field], *models)
        row.setdefault("share", drawn[field] / math.hypot(drawn[field], *models))
    return row


def _traces(recipe: Recipe, chain: Chain, seed: int) -> Iterator[tuple[ProductTrace, Scene]]:
    """Give a skein as it would have been found, with its scene; nothing of one that is refused."""
    rig, family, calibration = rig_of(0), PRODUCTS["herring-roe"], recipe.calibration
    assert calibration is not None
    made = exact(rig, in_reach(family.draw(seed, family.Options()), rig, 1.2).solid).product
    rng, points = np.random.default_rng(seed), made.profiles
    shape = (calibration.stripe_count, calibration.image_size[0])
    x_px, product = np.full(shape, np.nan), np.full(shape, NOTHING, np.int16)
    stripe, point = np.nonzero((points.product == 1) & np.isfinite(points.x_px))
    row = np.rint(points.row_px[stripe, point]).astype(np.int64)
    x_px[stripe, row] = points.x_px[stripe, point] + _NOISE_PX * rng.standard_normal(row.size)
    product[stripe, row] = 1
    seen = np.isfinite(x_px)
    unknown = np.full(shape, np.nan)
    stripes = StripeMap(
        x_px=x_px, x_std_px=np.where(seen, _NOISE_PX, np.nan), product=product, seen=seen,
        margin=np.where(seen, 1.0, np.nan), ambiguous=np.zeros(shape, np.bool_), rest_px=unknown,
        peak_stripe=np.empty(0, np.int16), correlation_rows=_CORRELATED_ROWS,
    )  # fmt: skip
    assert made.outline is not None
    outlines = (Outline(1, made.outline.xy_px, _OUTLINE_STD_PX),)
    scene = Scene(str(seed), stripes, outlines, calibration)
    profiles = chain.triangulator.triangulate(stripes, calibration)
    for found in split_products(profiles, outlines, calibration, str(seed), view=calibration.view):
        try:
            volume = chain.volume.estimate(found)
            yield ProductTrace(found, volume, chain.weigher.weigh(found, volume), None, {}), scene
        except RoemetryError:
            continue


def _drawn(trace: ProductTrace, scene: Scene, chain: Chain, draws: int, seed: int) -> Iterator[Result]:
    """Give results with all causes drawn together, each solved from the beginning."""
    assert trace.volume is not None
    trace = replace(trace, volume=replace(trace.volume, solution=None))
    rng = np.random.default_rng(seed)
    sampler = Sampler(scene, chain, rng)
    for by_number in sampler.scenes(draws, sampler.causes):
        yield rerun(chain, trace, by_number.get(trace.product.number), rng, model=False)
