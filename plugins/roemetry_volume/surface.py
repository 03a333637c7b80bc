"""The surface between stripes and outline: a thin plate through (z − z_rim)², smooth up to the rim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from roemetry.records.arrays import Floats, Integers

CELL_MM = 2.5
STIFFNESS = 0.1
_RIDGE = 1e-6
_BELIEF = 10.0  # a dome's quadric leaves 0.2 % of the scatter, a skein's 7 %, that of steps nearly all
_GROUP = 5


@dataclass(frozen=True, eq=False, slots=True)
class Knots:
    """Points that the plate goes through: places (s scaled, v), values, weights, and the slice of each."""

    s: Floats
    v: Floats
    u: Floats
    weight: Floats
    slice: Integers


def grouped(s: Floats, v: Floats, u: Floats, slices: Integers) -> Knots:
    """Put each five neighbouring points of a slice into one, which weighs as much as they do."""
    start = np.flatnonzero(np.diff(slices, prepend=-1))
    within = np.arange(slices.size) - np.repeat(start, np.diff(start, append=slices.size))
    first = np.flatnonzero(within % _GROUP == 0)
    count = np.diff(first, append=slices.size).astype(np.float64)
    mean = [np.add.reduceat(values, first) / count for values in (s, v, u)]
    return Knots(mean[0], mean[1], mean[2], count, slices[first])


@dataclass(frozen=True, eq=False, slots=True)
class Plate:
    """A fitted plate.

    Attributes
    ----------
    grid
        Of the spline, see `roemetry_kernels.volume.surface_spline.Grid`.
    coefficients
        Of the spline.
    factor
        Banded Cholesky factor of the system.
    right
        Right-hand side of the system.
    """

    grid: Any
    coefficients: Floats
    factor: Floats
    right: Floats

    def at(self, s: Floats, v: Floats) -> Floats:
        """Value at places; s scaled."""
        from roemetry_kernels.volume.surface_spline import values_at

        values: Floats = values_at(self.coefficients, self.grid, s, v)
        return values

    def moved_by(self, change: Floats) -> Floats:
        """Give what coefficients change by when the right-hand side changes."""
        from scipy.linalg import cho_solve_banded

        moved: Floats = cho_solve_banded((self.factor, True), change, check_finite=False)
        return moved


def plate_through(
    knots: Knots, rim_s: Floats, rim_v: Floats, rim_weight: Floats, stiffness: float = 1.0
) -> Plate:
    """Fit a plate through the knots and through 0 at places of the rim; `stiffness` times as stiff."""
    from scipy.linalg import cho_solve_banded, cholesky_banded

    from roemetry_kernels.volume.surface_spline import add_points, bending

    s, v = np.concatenate([knots.s, rim_s]), np.concatenate([knots.v, rim_v])
    low_s, low_v = float(s.min()) - 0.5, float(v.min()) - 0.5
    cells = [
        max(int(np.ceil((float(x.max()) + 0.5 - low) / CELL_MM)), 1) for x, low in ((s, low_s), (v, low_v))
    ]
    grid = (low_s, low_v, CELL_MM, cells[0], cells[1])
    band = bending(grid, stiffness * STIFFNESS, _RIDGE)
    right = np.zeros(band.shape[1])
    course, off = _course(
        grid,
        (s, v),
        np.concatenate([knots.u, np.zeros_like(rim_s)]),
        np.concatenate([knots.weight, rim_weight]),
    )
    add_points(band, right, grid, s, v, off, np.concatenate([knots.weight, rim_weight]))
    factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
    found = cho_solve_banded((factor, True), right, check_finite=False)
    return Plate(grid, course + found, factor, right)


def _course(grid: Any, place: tuple[Floats, Floats], u: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Give the quadric through all points, as the spline's coefficients, and by how much each lies off it.

    It is taken by a share: the more of the points' scatter it leaves, the less it says of what is between.
    """
    (s, v), (low_s, low_v, side, cells_s, cells_v) = place, grid
    root = np.sqrt(weight)
    a, b = (s - low_s) / side, (v - low_v) / side
    design = np.column_stack([np.ones_like(a), a, b, a * a, a * b, b * b])
    c, *_ = np.linalg.lstsq(root[:, None] * design, root * u, rcond=None)
    # a cubic B-spline's coefficient k stands for the place k - 1; of a square it is a third less
    i, j = np.arange(cells_s + 3)[:, None] - 1.0, np.arange(cells_v + 3)[None, :] - 1.0
    course = (
        c[0] + c[1] * i + c[2] * j + c[3] * (i * i - 1.0 / 3.0) + c[4] * i * j + c[5] * (j * j - 1.0 / 3.0)
    )
    guess = design @ c
    left = float(
        (weight * (u - guess) ** 2).sum() / (weight * (u - np.average(u, weights=weight)) ** 2).sum()
    )
    share = max(1.0 - left, 0.0) ** _BELIEF
    return share * course.ravel(), u - share * guess


def without_slice(plate: Plate, knots: Knots, slice_: int) -> Floats:
    """Give the coefficients of the plate that a slice had no part in, by its leverage: without a refit."""
    from roemetry_kernels.volume.surface_spline import rows_of

    mine = knots.slice == slice_
    numbers, parts = rows_of(plate.grid, knots.s[mine], knots.v[mine])
    root = np.sqrt(knots.weight[mine])
    rows = np.zeros((root.size, plate.coefficients.size))
    np.put_along_axis(rows, numbers.astype(np.int64), root[:, None] * parts, axis=1)
    off = root * knots.u[mine] - rows @ plate.coefficients
    through = plate.moved_by(rows.T)
    rest = np.eye(root.size) - rows @ through
    changed: Floats = plate.coefficients - through @ np.linalg.solve(rest, off)
    return changed
