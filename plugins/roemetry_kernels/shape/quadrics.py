"""Local quadrics of a surface that is given in sections."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import kernel

COLUMNS = 6
_RIDGE = 1e-9


@kernel
def local_quadrics(x: Floats, y: Floats, z: Floats, first: int, last: int, step: int, reach: int) -> Floats:
    """Fit z = f + d·x + e·y + ½(a·x² + 2b·xy + c·y²) about places, over three sections.

    Parameters
    ----------
    x, y, z
        (section, sample) places and heights, mm.
    first, last, step
        Samples about which to fit: from the first on, every so many, before the last.
    reach
        Samples to either side that take part, every second one.

    Returns
    -------
    ndarray, shape (section − 2, place, 6)
        f, d, e, a, b, c about each place, x and y from there; of all sections but the outer two.
    """
    sections = x.shape[0]
    places = (last - first + step - 1) // step
    found = np.full((sections - 2, places, COLUMNS), np.nan)
    normal = np.empty((COLUMNS, COLUMNS + 1))
    row = np.empty(COLUMNS)
    for section in range(1, sections - 1):
        # Scales make the equations even, whatever the spacing of the sections.
        wide = 0.5 * abs(x[section + 1, first] - x[section - 1, first])
        fine = abs(y[section, first + 1] - y[section, first]) * reach
        wide, fine = max(wide, 1e-9), max(fine, 1e-9)
        for place in range(places):
            at = first + place * step
            normal[:] = 0.0
            for neighbour in range(section - 1, section + 2):
                for sample in range(at - reach, at + reach + 1, 2):
                    dx = (x[neighbour, sample] - x[section, at]) / wide
                    dy = (y[neighbour, sample] - y[section, at]) / fine
                    row[0], row[1], row[2] = 1.0, dx, dy
                    row[3], row[4], row[5] = 0.5 * dx * dx, dx * dy, 0.5 * dy * dy
                    for i in range(COLUMNS):
                        for j in range(COLUMNS):
                            normal[i, j] += row[i] * row[j]
                        normal[i, COLUMNS] += row[i] * z[neighbour, sample]
            for i in range(COLUMNS):
                normal[i, i] += _RIDGE
            _eliminate(normal)
            scales = (1.0, wide, fine, wide * wide, wide * fine, fine * fine)
            for i in range(COLUMNS):
                found[section - 1, place, i] = normal[i, COLUMNS] / scales[i]
    return found


@kernel
def _eliminate(rows: Floats) -> None:
    """Solve a symmetric positive system in place (Gauss and Jordan): the last column becomes the answer."""
    count = rows.shape[0]
    for i in range(count):
        pivot = rows[i, i]
        for j in range(i, count + 1):
            rows[i, j] /= pivot
        for k in range(count):
            if k != i:
                factor = rows[k, i]
                if factor != 0.0:
                    for j in range(i, count + 1):
                        rows[k, j] -= factor * rows[i, j]
