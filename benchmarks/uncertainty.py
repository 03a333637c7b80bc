"""Linearised standard uncertainties against Monte Carlo draws, on skeins nobody has looked at.

``python -m benchmarks uncertainty [--seed 510000] [--count 100] [--draws 2000]``

Skeins of the whole population on the rig of ``recipes/herring_roe``: stripes and silhouettes are traced, not
rendered, and peaks are drawn with the noise that they state. Calibration, stages and options are those of
``with_outline.yaml``. A draw moves peaks, calibration and outline together and solves the surface from the
beginning, as `estimate` does; what the stages state of their own models is added to both sides.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=510000)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--draws", type=int, default=2000)
    given = parser.parse_args()
    recipe = Recipe.load(HERRING_ROE / "with_outline.yaml")
    chain = Chain(*(recipe.stages[kind].make() for kind in ("triangulator", "volume", "weigher")), None)
    ratios: dict[str, list[float]] = {"visible volume": [], "mass": []}
    shares, taken = [], np.zeros(2)
    for seed in range(given.seed, given.seed + given.count):
        for trace, scene in _traces(recipe, chain, seed):
            begin = time.process_time()
            (linear,) = linearise((trace,), scene, chain)
            between = time.process_time()
            drawn = list(_drawn(trace, scene, chain, given.draws, seed))
            taken += between - begin, time.process_time() - between
            assert linear.volume is not None
            assert linear.weight is not None
            for name, found, field in (
                ("visible volume", linear.volume.visible_mm3, "visible_mm3"),
                ("mass", linear.weight.mass_g, "mass_g"),
            ):
                models = [part for cause, part in found.budget.items() if cause not in _CAUSES]
                spread = float(np.std([getattr(one, field) for one in drawn], ddof=1))
                ratios[name].append(found.std / math.hypot(spread, *models))
                if name == "visible volume":
                    shares.append(spread / math.hypot(spread, *models))
                    print(seed, f"{ratios[name][-1]:.3f}", f"{shares[-1]:.2f}", flush=True)
    print(f"{len(shares)} skeins, {given.draws} draws each; of the standard uncertainty of the visible")
    print(f"volume {np.median(shares):.0%} (median) is what was drawn, the rest what stages state\n")
    for name, found in ratios.items():
        low, middle, high = np.quantile(found, [0.05, 0.5, 0.95])
        off = np.abs(np.array(found) - 1.0)
        print(
            f"{name}: linearised over drawn {min(found):.3f} to {max(found):.3f}, median {middle:.3f}, "
            f"90 % of them {low:.3f} to {high:.3f}; within 5 %: {np.mean(off < 0.05):.0%}"
        )
    print("linearised, drawn: {:.0f} and {:.0f} ms a product".format(*1e3 * taken / max(len(shares), 1)))


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
    stripes = StripeMap(
        x_px=x_px,
        x_std_px=np.where(seen, _NOISE_PX, np.nan),
        product=product,
        seen=seen,
        margin=np.where(seen, 1.0, np.nan),
        ambiguous=np.zeros(shape, np.bool_),
        rest_px=np.full(shape, np.nan),
        peak_stripe=np.empty(0, np.int16),
        correlation_rows=_CORRELATED_ROWS,
    )
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


if __name__ == "__main__":
    main()
