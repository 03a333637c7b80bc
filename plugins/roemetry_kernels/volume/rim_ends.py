"""Height of the rim at the ends of stripes, from how the surface falls towards the outline."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import kernel

_STEPS = 25
_LEAST = 6
_LEAST_ROOT_MM = 0.25
_LEVEL_MM2 = 0.25  # a surface that falls by less than half a millimetre ends in an edge, as a box does


@kernel
def rim_heights(
    distance_mm: Floats, z_mm: Floats, first: Floats, size: Floats, std_mm: float
) -> tuple[Floats, Floats, Floats]:
    """Fit (z − rim)² = α·d + β·d², α ≥ 0, at each end, over rims from the belt to its lowest point.

    Parameters
    ----------
    distance_mm, z_mm : ndarray, shape (n,)
        Distance inside the outline, and height, of points of all ends, end by end, outermost first.
    first, size : ndarray, shape (ends,)
        Where each end's points begin, and how many there are.
    std_mm
        What a height's misfit is judged by.

    Returns
    -------
    rim, spread, upright : ndarray, shape (ends,)
        Mean height over what fits, weighed by how well, mm, and its standard deviation; which share of the
        fall over the end is α·d, as of a surface that meets the rim upright: a slope that meets it at an
        angle has β·d² alone, and a level top that ends in an edge nothing. NaN for an end of too few points.
    """
    ends = first.size
    rim, spread, upright = np.full(ends, np.nan), np.full(ends, np.nan), np.full(ends, np.nan)
    cost, height, straight = np.empty(_STEPS), np.empty(_STEPS), np.empty(_STEPS)
    for e in range(ends):
        a, n = int(first[e]), int(size[e])
        if n < _LEAST:
            continue
        z, d = z_mm[a : a + n], distance_mm[a : a + n]
        lowest = max(z.min(), 0.0)
        for step in range(_STEPS):
            height[step] = lowest * step / (_STEPS - 1)
            misfit, share = _misfit(z, d, height[step])
            cost[step] = misfit / (std_mm * std_mm)
            straight[step] = share
        least = cost.min()
        total, mean, square = 0.0, 0.0, 0.0
        for step in range(_STEPS):
            # neighbouring rows err alike: some four rows tell as much as one
            likely = np.exp(-0.125 * (cost[step] - least))
            total += likely
            mean += likely * height[step]
            square += likely * height[step] ** 2
        rim[e] = mean / total
        spread[e] = np.sqrt(max(square / total - rim[e] ** 2, 0.0)) + 0.5 * lowest / (_STEPS - 1)
        upright[e] = straight[cost.argmin()]
    return rim, spread, upright


@kernel
def _misfit(z: Floats, d: Floats, rim: float) -> tuple[float, float]:
    """Sum of squared misfits in height of the best α ≥ 0 and β for one rim height, mm²; share of α·d."""
    dd, dq, qq, du, qu = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(z.size):
        x = max(d[k], 0.0)
        u = (z[k] - rim) ** 2
        w = 1.0 / max(z[k] - rim, _LEAST_ROOT_MM) ** 2
        dd += w * x * x
        dq += w * x * x * x
        qq += w * x * x * x * x
        du += w * x * u
        qu += w * x * x * u
    determinant = dd * qq - dq * dq
    alpha, beta = (0.0, 0.0) if dd <= 0.0 else (max(du / dd, 0.0), 0.0)
    if determinant > 1e-12 * dd * qq:
        alpha, beta = (du * qq - qu * dq) / determinant, (qu * dd - du * dq) / determinant
        if alpha < 0.0:
            alpha, beta = 0.0, max(qu / qq, 0.0)
    total = 0.0
    for k in range(z.size):
        x = max(d[k], 0.0)
        off = z[k] - rim - np.sqrt(max(alpha * x + beta * x * x, 0.0))
        total += off * off
    far = d.max()
    fall = alpha * far + abs(beta) * far * far
    return total, alpha * far / fall if fall > _LEVEL_MM2 else 0.0
