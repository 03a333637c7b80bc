"""Error of volume on bodies whose shape is known, each on rigs drawn anew: for the page about volume."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.volume_scenes import exact, rig_of
from benchmarks.volume_tables import K, table
from roemetry.errors import RoemetryError
from roemetry.io.files import write_whole
from roemetry.stages import VolumeEstimator
from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.family import Pose, draw_pose, random_of
from roemetry_simulate.products.parts import PartsSolid, placed, plane
from roemetry_simulate.solid import Solid

RIGS = 24
_LYING = {"offset_range_x_mm": 5.0, "offset_range_y_mm": 8.0, "turn_range_deg": 15.0}
_OFF_CENTRE = {"offset_range_x_mm": 5.0, "offset_range_y_mm": 22.0, "turn_range_deg": 10.0}
_HALF_ELLIPSOID = "half-ellipsoid"
BODIES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "half-ellipsoid 80 × 28 × 14 mm": (_HALF_ELLIPSOID, {"size_mm": (80.0, 28.0, 14.0), **_LYING}),
    "half-ellipsoid 64 × 40 × 18 mm": (_HALF_ELLIPSOID, {"size_mm": (64.0, 40.0, 18.0), **_LYING}),
    "half-ellipsoid 50 × 50 × 20 mm": (_HALF_ELLIPSOID, {"size_mm": (50.0, 50.0, 20.0), **_LYING}),
    "box, 16.5 mm high, off centre": (
        "block",
        {"length_mm": 50.0, "width_mm": 25.0, "height_mm": 16.5, **_OFF_CENTRE},
    ),
    "half cylinder": ("cylinder", {"length_mm": 70.0, "radius_mm": 13.0, **_LYING}),
    "whole cylinder": ("cylinder", {"length_mm": 70.0, "radius_mm": 8.0, "half": False, **_LYING}),
    "wedge": ("wedge", {"length_mm": 70.0, "width_mm": 30.0, "high_height_mm": 16.0, **_LYING}),
    "staircase, four steps of 4 mm": (
        "staircase",
        {"steps": 4, "tread_mm": 16.0, "width_mm": 36.0, **_LYING},
    ),
    "truncated pyramid": ("truncated-pyramid", {**_LYING}),
    "spherical cap": ("sphere", {"radius_mm": 40.0, "height_mm": 14.0, **_LYING}),
    "ball": ("sphere", {"radius_mm": 14.0, **_LYING}),
    "potato": ("potato", {}),
    "egg": ("egg", {}),
    "fish fillet": ("fillet", {}),
    "bread roll": ("bread-roll", {}),
}
"""By name: the family, and its options; the place is drawn."""


class BodyRow(NamedTuple):
    """One estimate of one body; error and uncertainty relative to the visible volume, NaN where refused."""

    body: str
    seed: int
    estimator: str
    error: float
    std: float


def body_rows(
    first: int, cache: Path, estimators: Mapping[str, VolumeEstimator[Any]], code: str
) -> list[BodyRow]:
    """Measure every body on its rigs, or take what was measured with the same code."""
    rows = []
    for number, (name, (family, options)) in enumerate(BODIES.items()):
        path = cache / f"body{number}_{first}_{code}.json"
        if not path.exists():
            found: list[BodyRow] = []
            for seed in range(first, first + RIGS):
                found += _on_rig(name, solid_of(family, options, seed), seed, estimators)
            cache.mkdir(parents=True, exist_ok=True)
            write_whole(path, json.dumps(found))
        rows += [BodyRow(*row) for row in json.loads(path.read_text("utf-8"))]
    return rows


def solid_of(family: str, options: Mapping[str, Any], seed: int) -> Solid:
    """Draw a body in its place."""
    if family != _HALF_ELLIPSOID:
        made = PRODUCTS[family]
        return made.draw(seed, made.Options(**options)).solid
    given = dict(options)
    size = given.pop("size_mm")
    place = PRODUCTS["block"].Options(**given)
    return half_ellipsoid(*size, pose=draw_pose(random_of(seed, family), place))


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


def _on_rig(
    name: str, solid: Solid, seed: int, estimators: Mapping[str, VolumeEstimator[Any]]
) -> list[BodyRow]:
    one = exact(rig_of(seed), solid)
    rows = []
    for estimator, stage in estimators.items():
        try:
            found = stage.estimate(one.product).visible_mm3
        except RoemetryError:
            rows.append(BodyRow(name, seed, estimator, math.nan, math.nan))
            continue
        error, std = found.value / one.visible_mm3 - 1.0, found.std / one.visible_mm3
        rows.append(BodyRow(name, seed, estimator, error, std))
    return rows


def bodies(rows: Sequence[BodyRow], estimators: Sequence[str]) -> str:
    """Give the largest error of each body, and how many intervals hold the truth."""
    lines = []
    for name in dict.fromkeys(row.body for row in rows):
        cells = []
        for estimator in estimators:
            mine = [row for row in rows if row.body == name and row.estimator == estimator]
            error = 100.0 * np.array([row.error for row in mine if math.isfinite(row.error)])
            std = 100.0 * np.array([row.std for row in mine if math.isfinite(row.error)])
            if not error.size:
                cells.append("refused")
                continue
            held = int((np.abs(error) < K * std).sum())
            worst = error[np.argmax(np.abs(error))]
            cells.append(f"{np.abs(error).mean():.2f} / {worst:+.2f} / {held} of {error.size}")
        lines.append((name, *cells))
    return table(("body", *(f"`{name}`" for name in estimators)), lines)
