"""A cubic spline on a grid: its bending energy, the equations that points add, and its values.

A spline on a grid of cells has (cells + 3) coefficients each way; each place is shared by four of them each
way (uniform cubic B-splines). Those along the shorter side of the grid run fastest, along v if both are
equal: the band of the equations is then as narrow as it can be, and the time to factor it grows with its
square.
"""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import kernel

Grid = tuple[float, float, float, int, int]
"""Place of the first cell's corner along s and v, the cells' side, cells along s and along v."""


@kernel
def fastest(grid: Grid) -> tuple[bool, int]:
    """Say whether coefficients along s run fastest, not those along v, and how many there are that way."""
    along_s = grid[3] < grid[4]
    return along_s, (grid[3] if along_s else grid[4]) + 3


@kernel
def bending(grid: Grid, weight: float, ridge: float) -> Floats:
    """Give the thin plate's bending energy, ∫ f_ss² + 2 f_sv² + f_vv², of the spline's coefficients.

    Parameters
    ----------
    grid
        See `Grid`.
    weight
        What the energy is multiplied with.
    ridge
        Added to the diagonal, which keeps the system solvable where no point is near.

    Returns
    -------
    ndarray, shape (bandwidth + 1, coefficients)
        Lower band of the matrix as `scipy.linalg.cholesky_banded` takes it.
    """
    side = grid[2]
    # the energy is the same with both ways exchanged: only which is the longer one counts
    slow, fast = max(grid[3], grid[4]), min(grid[3], grid[4])
    high = fast + 3
    band = np.zeros((3 * high + 4, (slow + 3) * high))
    band[0, :] = ridge
    flat, slope, bend = _unit_grams()
    for a in range(4):
        for b in range(4):
            for c in range(4):
                for d in range(4):
                    # a, c along the longer side; b, d along the other; lengths: two derivatives each way
                    # and one area
                    part = bend[a, c] * flat[b, d] + 2.0 * slope[a, c] * slope[b, d]
                    part = weight * (part + flat[a, c] * bend[b, d]) / (side * side)
                    for i in range(slow):
                        for j in range(fast):
                            one = (i + a) * high + j + b
                            other = (i + c) * high + j + d
                            # symmetric: the lower band is enough
                            if one >= other:
                                band[one - other, other] += part
    return band


@kernel
def _unit_grams() -> tuple[Floats, Floats, Floats]:
    """Integrals over one unit cell of products of the four cubics, of their slopes and of their bends."""
    flat, slope, bend = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    # Gauss and Legendre's four nodes, exact up to the seventh degree
    nodes = (0.069431844202973712, 0.330009478207571868, 0.669990521792428132, 0.930568155797026287)
    weights = (0.173927422568726929, 0.326072577431273071, 0.326072577431273071, 0.173927422568726929)
    for k in range(4):
        x = nodes[k]
        f = _cubics(x)
        # slopes and bends of the four cubics
        g = (-0.5 * (1.0 - x) ** 2, 1.5 * x * x - 2.0 * x, -1.5 * x * x + x + 0.5, 0.5 * x * x)
        h = (1.0 - x, 3.0 * x - 2.0, 1.0 - 3.0 * x, x)
        for a in range(4):
            for b in range(4):
                flat[a, b] += weights[k] * f[a] * f[b]
                slope[a, b] += weights[k] * g[a] * g[b]
                bend[a, b] += weights[k] * h[a] * h[b]
    return flat, slope, bend


@kernel
def _cubics(x: float) -> tuple[float, float, float, float]:
    """Give the four uniform cubic B-splines at a place 0…1 of a cell."""
    rest = 1.0 - x
    return (
        rest**3 / 6.0,
        (3.0 * x**3 - 6.0 * x * x + 4.0) / 6.0,
        (3.0 * rest**3 - 6.0 * rest * rest + 4.0) / 6.0,
        x**3 / 6.0,
    )


@kernel
def _cell(at: float, start: float, side: float, cells: int) -> tuple[int, float]:
    place = (at - start) / side
    cell = min(max(int(np.floor(place)), 0), cells - 1)
    return cell, min(max(place - cell, 0.0), 1.0)


@kernel
def add_points(
    band: Floats, right: Floats, grid: Grid, s: Floats, v: Floats, values: Floats, weights: Floats
) -> None:
    """Add weighted points to the normal equations."""
    along_s, high = fastest(grid)
    number, part = np.empty(16, np.int64), np.empty(16)
    for a in range(4):
        for b in range(4):
            number[4 * a + b] = a * high + b
    for k in range(s.size):
        i, x = _cell(s[k], grid[0], grid[2], grid[3])
        j, y = _cell(v[k], grid[1], grid[2], grid[4])
        if along_s:
            i, x, j, y = j, y, i, x
        f, g = _cubics(x), _cubics(y)
        first = i * high + j
        for a in range(4):
            for b in range(4):
                part[4 * a + b] = f[a] * g[b]
        for a in range(16):
            weighed = weights[k] * part[a]
            right[first + number[a]] += weighed * values[k]
            for b in range(a + 1):
                band[number[a] - number[b], first + number[b]] += weighed * part[b]


@kernel
def values_at(coefficients: Floats, grid: Grid, s: Floats, v: Floats) -> Floats:
    """Evaluate the surface at places (n,)."""
    out = np.zeros(s.size)
    along_s, high = fastest(grid)
    for k in range(s.size):
        i, x = _cell(s[k], grid[0], grid[2], grid[3])
        j, y = _cell(v[k], grid[1], grid[2], grid[4])
        if along_s:
            i, x, j, y = j, y, i, x
        f, g = _cubics(x), _cubics(y)
        for a in range(4):
            for b in range(4):
                out[k] += f[a] * g[b] * coefficients[(i + a) * high + j + b]
    return out
