"""What lies on the belt: skeins of every kind, plain shapes, taller ones, two side by side."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.coded.rigs import CodingRig
from roemetry_simulate.population import moved
from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.herring import FURTHER_KINDS, build, draw
from roemetry_simulate.products.herring import KINDS as DRAWN_KINDS
from roemetry_simulate.solid import GriddedSolid, Solid

KINDS = DRAWN_KINDS + FURTHER_KINDS
"""Every kind of skein: healthy, and with each defect."""

SHAPES = ("wedge", "sphere", "cylinder", "block", "potato")
_GRID_MM = 0.25


def skein(seed: int, kind: str) -> Solid:
    """Make a skein of a kind, on a grid of 0.25 mm."""
    return build(draw(seed, kind), _GRID_MM).solid


def shape(seed: int, name: str) -> Solid:
    """Make a plain shape with sizes drawn from the seed, at most about 20 mm high (a potato 24 mm)."""
    rng = np.random.default_rng([seed, 303])
    u = rng.uniform
    sizes: dict[str, dict[str, Any]] = {
        "wedge": {
            "length_mm": u(40, 90), "width_mm": u(20, 45), "low_height_mm": u(0, 4),
            "high_height_mm": u(8, 20),
        },
        "sphere": {"radius_mm": u(6, 10)},
        "cylinder": {"length_mm": u(30, 90), "radius_mm": u(6, 10), "half": bool(u() < 0.5)},
        "block": {"length_mm": u(20, 90), "width_mm": u(15, 45), "height_mm": u(4, 20)},
        "potato": {
            "length_range_mm": (50.0, 80.0), "width_range_mm": (26.0, 40.0),
            "thickness_range_mm": (14.0, 24.0),
        },
    }  # fmt: skip
    family = PRODUCTS[name]
    options = family.Options(**sizes[name], turn_range_deg=20.0, offset_range_x_mm=6.0, offset_range_y_mm=6.0)
    return family.draw(seed, options).solid


def grown(solid: Solid, factor: float) -> GriddedSolid:
    """Make a gridded body taller by a factor."""
    assert isinstance(solid, GriddedSolid)
    layers = solid.grid * np.array([factor, factor**2, factor**2])
    return replace(solid, grid=layers)


def side_by_side(one: Solid, other: Solid, x_mm: float) -> GriddedSolid:
    """Put two gridded bodies on one belt, the first moved by −x, the second by +x; they must not touch."""
    assert isinstance(one, GriddedSolid)
    assert isinstance(other, GriddedSolid)
    step = one.step_mm
    shift = step * round(x_mm / step)
    bodies = [moved(one, -shift), moved(other, shift)]
    x0 = min(body.x0_mm for body in bodies)  # type: ignore[attr-defined]
    y0 = min(body.y0_mm for body in bodies)  # type: ignore[attr-defined]
    at = [
        (round((body.y0_mm - y0) / step), round((body.x0_mm - x0) / step), body.grid)  # type: ignore[attr-defined]
        for body in bodies
    ]
    rows = max(j + grid.shape[0] for j, _, grid in at)
    columns = max(i + grid.shape[1] for _, i, grid in at)
    layers = np.empty((rows, columns, 3))
    layers[...] = [2.0, -50.0, -50.0]
    for j, i, grid in at:
        here = layers[j : j + grid.shape[0], i : i + grid.shape[1]]
        inside = grid[..., 1] > here[..., 1]
        here[inside] = grid[inside]
    return GriddedSolid(x0, y0, step, layers)


def in_view(solid: Solid, rig: CodingRig) -> Solid:
    """Move a body along X so that it lies about the middle of what the planes and the camera see of it."""
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    feet = rig.laser.x_mm(0.5 * (y_min + y_max), 4.0)
    spacing = float(np.diff(np.sort(feet)).mean())
    low, high = float(feet.min()) - 1.2 * spacing, float(feet.max()) + 1.2 * spacing
    shift = max(low - x_min, 0.0) + min(high - x_max, 0.0)
    return solid if shift == 0.0 else moved(solid, shift)
