"""Bodies given by functions, sampled onto the simulator's grid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from roemetry.records.arrays import Floats
from roemetry_simulate.solid import GriddedSolid

Surface = Callable[[Floats, Floats], ArrayLike]


def on_grid(
    extent_mm: tuple[float, float, float, float],
    step_mm: float,
    mid: Surface,
    u_top: Surface,
    u_bottom: Surface,
) -> GriddedSolid:
    """Sample mid (mm), u_top and u_bottom (mm²), functions of belt X and Y, onto a grid.

    The extent (x_min, x_max, y_min, y_max) has a margin around the footprint.
    """
    x_min, x_max, y_min, y_max = extent_mm
    x = x_min + step_mm * np.arange(int(np.ceil((x_max - x_min) / step_mm)) + 1)
    y = y_min + step_mm * np.arange(int(np.ceil((y_max - y_min) / step_mm)) + 1)
    xx, yy = np.meshgrid(x, y)
    layers = [
        np.broadcast_to(np.asarray(f(xx, yy), dtype=np.float64), xx.shape) for f in (mid, u_top, u_bottom)
    ]
    return GriddedSolid(x_min, y_min, step_mm, np.stack(layers, axis=-1))
