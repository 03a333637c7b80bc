"""Error of every volume estimator on simulated products: the tables of docs/measurements/volume.md.

``python -m benchmarks volume [--first 80000] [--count 100] [--meshes 10] [--images 0] [--page FILE]
[--jobs 1] [--cluster ADDRESS]``

Every product has a rig of its own. Stripes are traced exactly, 41 at a time, and thinned to fewer; outlines
are exact silhouettes. So are those of the other simulator's bodies, which the estimators were not developed
on. With ``--images`` skeins are rendered, too (10 s each and more, kept in the cache).
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.command import add_sharing, parser_of, shared
from benchmarks.tables import put_into, table
from benchmarks.volume_scenes import (
    Exact,
    exact,
    exact_body,
    exact_skein,
    images,
    measured,
    rig_of,
    thinned,
)
from roemetry.errors import RoemetryError
from roemetry.records.arrays import Floats
from roemetry.stages import VolumeEstimator
from roemetry_open3d.surface_mesh import SurfaceMesh
from roemetry_paper.zero_order_hold import ZeroOrderHold
from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.family import Pose, draw_pose, random_of
from roemetry_simulate.products.parts import PartsSolid, placed, plane
from roemetry_simulate.solid import Solid
from roemetry_volume.outline_surface import OutlineSurface
from roemetry_volume.slice_estimators import SlicePchip, SliceTrapezoid
from roemetry_volume.underside import fitted_share

ESTIMATORS: Mapping[str, VolumeEstimator[Any]] = {
    "zero-order-hold": ZeroOrderHold(),
    "slice-trapezoid": SliceTrapezoid(),
    "slice-pchip": SlicePchip(),
    "outline-surface": OutlineSurface(),
}
MESHES: Mapping[str, VolumeEstimator[Any]] = {"surface-mesh": SurfaceMesh()}
"""Hundreds of times as slow: measured on the first skeins only."""
STEPS = {41: 1, 21: 2, 11: 4, 6: 8, 5: 10, 3: 20}
"""How many stripes remain when each so many of 41 is kept."""
K = 1.96

_LYING = {"offset_range_x_mm": 5.0, "offset_range_y_mm": 8.0, "turn_range_deg": 15.0}
_OFF_CENTRE = {"offset_range_x_mm": 5.0, "offset_range_y_mm": 22.0, "turn_range_deg": 10.0}
_BOX = {"length_mm": 50.0, "width_mm": 25.0, **_OFF_CENTRE}
_STEPS = {"steps": 4, "tread_mm": 16.0, "width_mm": 36.0}
_HALF_ELLIPSOID = "half-ellipsoid"
BODIES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "half-ellipsoid 80 × 28 × 14 mm": (_HALF_ELLIPSOID, {"size_mm": (80.0, 28.0, 14.0), **_LYING}),
    "half-ellipsoid 64 × 40 × 18 mm": (_HALF_ELLIPSOID, {"size_mm": (64.0, 40.0, 18.0), **_LYING}),
    "half-ellipsoid 50 × 50 × 20 mm": (_HALF_ELLIPSOID, {"size_mm": (50.0, 50.0, 20.0), **_LYING}),
    "box, 16.5 mm high, off centre": ("block", {"height_mm": 16.5, **_BOX}),
    "half cylinder": ("cylinder", {"length_mm": 70.0, "radius_mm": 13.0, **_LYING}),
    "whole cylinder": ("cylinder", {"length_mm": 70.0, "radius_mm": 8.0, "half": False, **_LYING}),
    "wedge": ("wedge", {"length_mm": 70.0, "width_mm": 30.0, "high_height_mm": 16.0, **_LYING}),
    "staircase, four steps of 4 mm": ("staircase", {**_STEPS, **_LYING}),
    "truncated pyramid": ("truncated-pyramid", {**_LYING}),
    "spherical cap": ("sphere", {"radius_mm": 40.0, "height_mm": 14.0, **_LYING}),
    "ball": ("sphere", {"radius_mm": 14.0, **_LYING}),
    "potato": ("potato", {}),
    "egg": ("egg", {}),
    "fish fillet": ("fillet", {}),
    "bread roll": ("bread-roll", {}),
}
"""By name: the family, and its options; the place is drawn."""
OTHERS = ("lofted-skein", "superquadric", "supershape", "ball", "rod", "box")
"""Families of the plugin `mitsuba`."""


class Row(NamedTuple):
    """One estimate; error and standard uncertainty relative to the visible volume, NaN where refused."""

    of: str
    estimator: str
    error: float
    std: float
    milliseconds: float = math.nan


def main() -> None:
    """Measure, and write the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--first", type=int, default=80000, help="first seed of skein and rig")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--meshes", type=int, default=10, help="skeins to lay meshes through, the first ones")
    parser.add_argument("--images", type=int, default=0, help="skeins to render")
    parser.add_argument("--images-from", type=int, default=120000, help="first seed of those")
    parser.add_argument("--bodies", type=int, default=99001, help="first seed of the known bodies' rigs")
    parser.add_argument("--rigs", type=int, default=24, help="rigs for each known body")
    parser.add_argument("--others", type=int, default=885000, help="first seed of the other maker's bodies")
    parser.add_argument("--each", type=int, default=40, help="bodies of each of the other maker's families")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-volume")
    parser.add_argument("--page", type=Path, default=Path("docs/measurements/volume.md"))
    add_sharing(parser)
    given = parser.parse_args()

    def each(make: Callable[..., Any], fixed: tuple[Any, ...], tasks: Sequence[Any]) -> list[Any]:
        return list(shared(given, partial, (make, *fixed), tasks))

    def seeds(first: int, count: int) -> range:
        return range(first, first + count)

    skeins = each(_of_skein, (given.first + given.meshes,), seeds(given.first, given.count))
    rows, shares = [row for some, _ in skeins for row in some], [share for _, share in skeins]
    pictures = sum(each(from_images, (given.cache,), seeds(given.images_from, given.images)), list[Row]())
    bodies = [(name, seed) for name in BODIES for seed in seeds(given.bodies, given.rigs)]
    known = sum(each(_of_body, (), bodies), list[Row]())
    theirs = [(family, seed) for family in OTHERS for seed in seeds(given.others, given.each)]
    foreign = sum(each(_of_other, (), theirs), list[Row]())
    stated = [name for name in ESTIMATORS if name != "zero-order-hold"]
    parts = {
        "eleven stripes": judged([row for row in rows if row.of in ("11", "meshes")]),
        "how many stripes": briefs(rows, [str(count) for count in STEPS], stated, "stripes"),
        "known bodies": briefs(known, list(BODIES), list(_OF_BODIES), "body"),
        "the other simulator's bodies": briefs(foreign, OTHERS, list(_OF_BODIES), "family"),
        "underside": underside(np.array(shares)),
    }
    for light in ("plain", "laser"):
        if mine := [row for row in pictures if row.of == light]:
            parts[f"outline in {light} light"] = judged(mine)
    put_into(given.page, parts)


def measure(label: str, one: Exact, estimators: Mapping[str, VolumeEstimator[Any]]) -> list[Row]:
    """Estimate one product by each."""
    rows = []
    for name, estimator in estimators.items():
        begin = time.process_time()
        try:
            found = estimator.estimate(one.product).visible_mm3
        except RoemetryError:
            rows.append(Row(label, name, math.nan, math.nan))
            continue
        took = 1e3 * (time.process_time() - begin)
        rows.append(Row(label, name, found.value / one.visible_mm3 - 1.0, found.std / one.visible_mm3, took))
    return rows


def _of_skein(meshes_until: int, seed: int) -> tuple[list[Row], tuple[float, float, float]]:
    """Measure a skein with fewer and fewer stripes; of eleven error, std, true by visible."""
    whole, rows = exact_skein(seed, 41), list[Row]()
    share = (math.nan, math.nan, math.nan)
    for stripes, step in STEPS.items():
        rows += measure(str(stripes), thinned(whole, step), ESTIMATORS)
        if stripes == 11:
            share = (1.0 + rows[-1].error, rows[-1].std, whole.true_mm3 / whole.visible_mm3)
        if stripes == 11 and seed < meshes_until:
            rows += measure("meshes", thinned(whole, step), MESHES)
    return rows, share


def _of_body(body: tuple[str, int]) -> list[Row]:
    """Measure a known body on a rig of its own."""
    name, seed = body
    family, options = BODIES[name]
    return measure(name, exact(rig_of(seed), solid_of(family, options, seed)), _OF_BODIES)


def _of_other(body: tuple[str, int]) -> list[Row]:
    """Measure one of the other simulator's bodies."""
    family, seed = body
    return measure(family, exact_body(family, seed), _OF_BODIES)


def from_images(cache: Path, seed: int) -> list[Row]:
    """Estimate one rendered skein; nothing is taken from the truth but the calibration."""
    truth = exact_skein(seed)
    rows = []
    for light in ("plain", "laser"):
        try:
            product = measured(*images(seed, cache), truth.product.calibration, light)
        except RoemetryError:
            rows.append(Row(light, "outline-surface", math.nan, math.nan))
            continue
        few = ESTIMATORS if light == "plain" else {"outline-surface": ESTIMATORS["outline-surface"]}
        pictured = Exact(product, truth.visible_mm3, truth.true_mm3)
        rows += measure(light, pictured, few)
    return rows


def solid_of(family: str, options: Mapping[str, Any], seed: int) -> Solid:
    """Draw a body in its place."""
    if family != _HALF_ELLIPSOID:
        made = PRODUCTS[family]
        return made.draw(seed, made.Options(**options)).solid
    given = dict(options)
    length_mm, width_mm, height_mm = given.pop("size_mm")
    place = PRODUCTS["block"].Options(**given)
    return half_ellipsoid(length_mm, width_mm, height_mm, draw_pose(random_of(seed, family), place))


def half_ellipsoid(length_mm: float, width_mm: float, height_mm: float, pose: Pose) -> Solid:
    """Return the upper half of an ellipsoid that stands on the belt."""
    a, b, c = 0.5 * length_mm, 0.5 * width_mm, height_mm
    shell = (c * c / a**2, c * c / b**2, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -c * c)
    volume = 2.0 / 3.0 * math.pi * a * b * c
    at = math.radians(pose.yaw_deg)
    x = math.hypot(a * math.cos(at), b * math.sin(at))
    y = math.hypot(a * math.sin(at), b * math.cos(at))
    extent = (pose.x_mm - x, pose.x_mm + x, pose.y_mm - y, pose.y_mm + y)
    surfaces = placed([[shell, plane((0.0, 0.0, -1.0), 0.0)]], pose)
    return PartsSolid(surfaces, volume, volume, math.pi * a * b, extent, c)


def _arrays(rows: Sequence[Row]) -> tuple[Floats, Floats]:
    """Give errors and standard uncertainties, %."""
    return np.array([100.0 * row.error for row in rows]), np.array([100.0 * row.std for row in rows])


def judged(rows: Sequence[Row]) -> str:
    """Give a line for each estimator."""
    lines = []
    for name in dict.fromkeys(row.estimator for row in rows):
        mine = [row for row in rows if row.estimator == name and math.isfinite(row.error)]
        refused = sum(row.estimator == name for row in rows) - len(mine)
        label = f"`{name}`" + (f" ({refused} refused)" if refused else "")
        if mine:
            ms = float(np.median([row.milliseconds for row in mine]))
            lines.append((label, *_figures(*_arrays(mine)), f"{ms:.2f}"))
    return table((*_HEAD, "ms"), lines)


def briefs(rows: Sequence[Row], of: Sequence[str], estimators: Sequence[str], what: str) -> str:
    """Give a line for each of what was measured, and in it a cell for each estimator."""
    lines = [[name, *(brief(rows, name, estimator) for estimator in estimators)] for name in of]
    return table([what, *(f"`{estimator}`" for estimator in estimators)], lines)


def brief(rows: Sequence[Row], of: str, estimator: str) -> str:
    """Mean absolute error, 95 % point, share of intervals that hold; a dash where most were refused."""
    error, std = _arrays([row for row in rows if row.of == of and row.estimator == estimator])
    fine = np.isfinite(error)
    if fine.sum() < 0.5 * max(error.size, 1):
        return "–"
    off = np.abs(error[fine])
    return f"{off.mean():.2f} / {np.percentile(off, 95):.2f} / {100.0 * np.mean(off < K * std[fine]):.0f}"


def underside(shares: Floats) -> str:
    """Fit the share of the true volume on every other skein, and judge it on the rest."""
    visible, model_std, true = shares[np.isfinite(shares).all(axis=1)].T
    if visible.size < 6:
        return ""
    even = np.arange(visible.size) % 2 == 0
    share, scatter = fitted_share(visible[even], true[even])
    value = share * visible[~even]
    std = np.hypot(share * model_std[~even], scatter * visible[~even])
    figures = _figures(100.0 * (value / true[~even] - 1.0), 100.0 * std / true[~even])
    return f"Share {share:.3f} ± {scatter:.3f}.\n\n" + table(_HEAD, [("rounded, fitted share", *figures)])


_HEAD = ("estimator", "mean", "mean absolute", "95 % point", "largest", "intervals hold", "median width")
_OF_BODIES = {name: ESTIMATORS[name] for name in ("outline-surface", "slice-pchip")}


def _figures(error: Floats, std: Floats) -> list[str]:
    """Write the cells of `_HEAD` but the first."""
    off = np.abs(error)
    cells = [f"{error.mean():+.2f} %", f"{off.mean():.2f} %", f"{np.percentile(off, 95):.2f} %"]
    cells.append(f"{off.max():.1f} %")
    if not np.isfinite(std).any():
        return [*cells, "not stated", "not stated"]
    return [*cells, f"{100.0 * np.mean(off < K * std):.1f} %", f"{np.median(2.0 * K * std):.2f} %"]
