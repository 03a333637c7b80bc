"""Solids in the form that the kernels take: plain tuples of numbers and read-only arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

Reach = tuple[float, float, float, float, float, float]

NOTHING, BOX, FIELD, PARTS, MESH, FIELDS = 0, 1, 2, 3, 4, 5

NOWHERE: Reach = (0.0, 0.0, -2.0, 0.0, 0.0, -1.0)
"""A box below the belt, where no ray comes."""


def no_array(*shape: int, dtype: type[np.generic] = np.float64) -> NDArray[Any]:
    """Stand in for a member of a body that does not count."""
    nothing = np.zeros(shape, dtype=dtype)
    nothing.flags.writeable = False
    return nothing


class Body(NamedTuple):
    """Nothing, a block or a gridded body in the form the kernels take; `kind` says which members count.

    BOX takes `box`; FIELD takes `grid` to `u_slope_mm`. `reach` is a box that holds all of it: smallest x, y,
    z, largest x, y, z. `top_mm` is at or over the highest point. All arrays are read-only, so that the
    kernels are compiled once.
    """

    kind: int
    reach: Reach = NOWHERE
    box: Floats = no_array(6)
    grid: Floats = no_array(2, 2, 3)
    x0_mm: float = 0.0
    y0_mm: float = 0.0
    step_mm: float = 1.0
    top_mm: float = 0.0
    mid_slope: float = 0.0
    u_slope_mm: float = 0.0


class ExactBody(NamedTuple):
    """A body of exact surfaces in the form the kernels take.

    PARTS takes `surfaces` (see `roemetry_simulate.products.parts`); MESH takes `triangles`, `boxes` and
    `links` (see `roemetry_simulate.products.triangles`). It is a type of its own since every array that a
    kernel hands on costs time; the kernels are compiled for both.
    """

    kind: int
    reach: Reach
    top_mm: float
    surfaces: Floats = no_array(1, 11)
    triangles: Floats = no_array(1, 9)
    boxes: Floats = no_array(1, 6)
    links: NDArray[np.int64] = no_array(1, 3, dtype=np.int64)


class Fields(NamedTuple):
    """Several gridded bodies in the form the kernels take.

    `nodes` (n, 3) holds the nodes of all grids, one grid after the other, row by row; a row of `places` says
    of one of them: x0, y0, step, highest point, steepest slope of mid and of u (see `Body`), its first node,
    its rows and its columns.
    """

    kind: int
    reach: Reach
    top_mm: float
    nodes: Floats
    places: Floats
