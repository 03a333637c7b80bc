"""How far a curve runs below its own upper convex hull."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import kernel


@kernel
def hollow_depth(across: Floats, height: Floats) -> Floats:
    """Depth of each curve below its upper convex hull (Andrew's monotone chain).

    Parameters
    ----------
    across, height
        (curve, n) strictly increasing places, and heights over them; no NaN.

    Returns
    -------
    ndarray, shape (curve, n)
        Hull less height, at least 0; 0 where the curve touches its hull.
    """
    curves, count = height.shape
    depth = np.zeros((curves, count))
    corner = np.empty(count, np.int64)
    for c in range(curves):
        corners = 0
        for i in range(count):
            while corners > 1:
                a, b = corner[corners - 2], corner[corners - 1]
                turn = (across[c, b] - across[c, a]) * (height[c, i] - height[c, a]) - (
                    height[c, b] - height[c, a]
                ) * (across[c, i] - across[c, a])
                if turn < 0.0:
                    break
                corners -= 1
            corner[corners] = i
            corners += 1
        for k in range(corners - 1):
            a, b = corner[k], corner[k + 1]
            slope = (height[c, b] - height[c, a]) / (across[c, b] - across[c, a])
            for i in range(a + 1, b):
                depth[c, i] = max(height[c, a] + slope * (across[c, i] - across[c, a]) - height[c, i], 0.0)
    return depth
