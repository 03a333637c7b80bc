"""Weight from twenty weighed samples: error, interval and width on unseen simulated products.

``python -m benchmarks weight [--first 60000] [--count 200] [--draws 200] [--samples 20] [--family NAME …]``

Every product has a rig of its own. Its stripes are traced exactly, then moved by random errors of 0.1 px at
each point and of 0.3 px for the outline as a whole. Of all products of a family 20 are drawn as weighed
samples, again and again; the others are weighed by what those have taught. Beside it: the paper's volume
times one factor that the same 20 give.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student_t

from benchmarks.command import parser_of
from benchmarks.tables import kept_rows, table
from benchmarks.volume_scenes import Exact, calibration_of, exact, rig_of
from roemetry.errors import RoemetryError
from roemetry.records import Outline, Samples
from roemetry_paper.zero_order_hold import ZeroOrderHold
from roemetry_simulate.population import in_reach
from roemetry_simulate.products import PRODUCTS
from roemetry_volume.fitted_weight import (
    FORMS,
    FittedWeight,
    FittedWeightOptions,
    WeightModel,
    weight_features,
    with_inverse,
)
from roemetry_volume.outline_surface import OutlineSurface

FAMILIES = ("herring-roe", "fillet")
PEAK_NOISE_PX, OUTLINE_NOISE_PX = 0.1, 0.3


class Weighed(NamedTuple):
    """One product: its mass, what was measured of it, and the paper's volume."""

    seed: int
    defect: str
    mass_g: float
    paper_cm3: float
    features: dict[str, float]


def main() -> None:
    """Print a table for each family."""
    parser = parser_of(__doc__)
    parser.add_argument("--first", type=int, default=60000, help="seed of the first product and rig")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--draws", type=int, default=200, help="how often samples are drawn")
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--family", nargs="+", choices=sorted(PRODUCTS), default=list(FAMILIES))
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-weight")
    given = parser.parse_args()
    for family in given.family:
        report(family, measured(family, given.first, given.count, given.cache), given)


def report(title: str, products: Sequence[Weighed], given: argparse.Namespace) -> None:
    """Print the table of one population."""
    print(f"\n{title}: {len(products)} products measured, seeds from {given.first}")
    print(f"{given.draws} draws of {given.samples} samples; means over draws, per cent\n")
    head = ["form", "error", "95 % of errors within", "interval holds", "width", "over paper × factor"]
    rows = [[f"`{form}`", *cells_of(products, form, given.samples, given.draws)] for form in ("auto", *FORMS)]
    print(table(head, rows), end="")


def cells_of(products: Sequence[Weighed], form: str, samples: int, draws: int) -> list[str]:
    """Judge a form; "–" where it cannot be fitted."""
    rng = np.random.default_rng(len(products))
    figures = []
    for _ in range(draws):
        order = rng.permutation(len(products))
        try:
            figures.append(judged(products, order[:samples], order[samples:], form))
        except RoemetryError:
            return ["–"] * 5
    error, tail, held, width, paper = np.mean(figures, axis=0)
    cells = [f"{100 * error:.2f}", f"{100 * tail:.2f}", f"{100 * held:.1f}", f"{100 * width:.1f}"]
    return [*cells, f"{error / paper:.2f}"]


def judged(products: Sequence[Weighed], known: Any, asked: Any, form: str) -> tuple[float, ...]:
    """Fit to the known, weigh the asked: mean error, 95 % point, coverage, median width; paper's error."""
    model = fitted(products, known, form)
    factor = np.mean([products[k].mass_g / products[k].paper_cm3 for k in known])
    low, value, high, mass, paper = np.array(
        [(*interval_of(model, one.features), one.mass_g, factor * one.paper_cm3)
         for one in (products[k] for k in asked)]
    ).T  # fmt: skip
    off = np.abs(value / mass - 1.0)
    held, width = np.mean((low <= mass) & (mass <= high)), np.median((high - low) / value)
    return tuple(
        map(float, (off.mean(), np.quantile(off, 0.95), held, width, np.abs(paper / mass - 1).mean()))
    )


def fitted(products: Sequence[Weighed], known: Any, form: str) -> WeightModel:
    """Fit as `roemetry fit-weight` does, and read the file back."""
    chosen = [products[k] for k in known]
    names = tuple(dict.fromkeys(name for one in chosen for name in one.features))
    ids = tuple(str(one.seed) for one in chosen)
    values = np.array([[one.features.get(name, np.nan) for name in names] for one in chosen])
    mass_g, unknown = np.array([one.mass_g for one in chosen]), np.full(len(chosen), np.nan)
    samples = Samples(ids=ids, groups=ids, features=names, values=values, mass_g=mass_g, mass_std_g=unknown)
    content = FittedWeight.fit(samples, form=form).content
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "weight.json"
        path.write_text(content, encoding="utf-8")
        return WeightModel.load(path)


def interval_of(model: WeightModel, features: dict[str, float]) -> tuple[float, float, float]:
    """Mass with the ends of its interval, g."""
    ratio, of_fit, scatter = model.ratio(with_inverse(features))
    half = np.hypot(of_fit, scatter) / model.student_std * _factor(model.degrees_of_freedom)
    visible = features["visible_cm3"]
    return visible * (ratio - half), visible * ratio, visible * (ratio + half)


@lru_cache(maxsize=4096)
def _factor(degrees_of_freedom: float) -> float:
    return float(student_t.ppf(0.975, degrees_of_freedom))


def measured(family: str, first: int, count: int, cache: Path) -> list[Weighed]:
    """Measure products, or take them from the cache."""
    seeds = range(first, first + count)
    kept = kept_rows(cache / f"{family}.jsonl", seeds, lambda seed: measure(family, seed))
    return [Weighed(**kept[seed]) for seed in seeds if "refused" not in kept[seed]]


def measure(family: str, seed: int) -> dict[str, Any]:
    """Draw a product on a rig of its own, and measure it."""
    rig, kind = rig_of(seed, 11), PRODUCTS[family]
    drawn = in_reach(kind.draw(seed, kind.Options()), rig, 1.2)
    one = disturbed(exact(rig, drawn.solid), seed)
    product = replace(one.product, calibration=calibration_of(rig))
    try:
        volume = OutlineSurface().estimate(product)
        paper = ZeroOrderHold().estimate(product).visible_mm3.value
    except RoemetryError as error:
        return {"seed": seed, "refused": error.message}
    # `weigh` without a model gives the features, as a run does.
    features = FittedWeight(FittedWeightOptions()).weigh(product, volume).features
    assert features == weight_features(product, volume)
    truth = drawn.truth
    return Weighed(seed, truth.defect, truth.mass_g, paper / 1000.0, dict(features))._asdict()


def disturbed(one: Exact, seed: int) -> Exact:
    """Move points along their rows and the outline across itself, by random errors."""
    rng = np.random.default_rng([seed, 61])
    product = one.product
    profiles, outline, view = product.profiles, product.outline, product.view
    assert outline is not None
    assert view is not None
    x_px = profiles.x_px + PEAK_NOISE_PX * rng.standard_normal(profiles.x_px.shape)
    number = np.broadcast_to(profiles.stripe[:, None], x_px.shape)
    xyz = view.lift(np.stack([x_px, profiles.row_px], axis=-1), number)
    moved = replace(profiles, x_px=x_px, xyz_mm=xyz)
    ring = outline.xy_px
    middle = ring.mean(axis=0)
    away = (ring - middle) / np.hypot(*(ring - middle).T)[:, None]
    contour = Outline(1, ring + OUTLINE_NOISE_PX * float(rng.standard_normal()) * away, OUTLINE_NOISE_PX)
    return replace(one, product=replace(product, profiles=moved, outline=contour))
