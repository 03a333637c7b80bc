"""What the stripes show of a product: its overhang beyond them, and how much of a defect they meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.solid import Solid
from roemetry_simulate.truth import StripeTruth

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class StripesShow:
    """What the stripes show of any product.

    Attributes
    ----------
    left_stripe, right_stripe : int
        Outermost stripes (1 is leftmost) with lit and seen points on the product; 0 where there is none.
    overhang_left_mm, overhang_right_mm : float
        Belt X from the outermost lit stripe (median of its points) to the end of the footprint; NaN alike.
    defect_depth_mm : float
        Largest height missing from the reference anywhere on the footprint; 0 without a reference.
    defect_seen_mm : float
        The same at the lit and seen points alone; NaN where no stripe lies on the product.
    hollow_seen_mm : float
        Largest depth of a lit stripe's height, as a function of Y, below its own upper convex hull; NaN
        alike.
    """

    left_stripe: int
    right_stripe: int
    overhang_left_mm: float
    overhang_right_mm: float
    defect_depth_mm: float
    defect_seen_mm: float
    hollow_seen_mm: float


def stripes_show(
    solid: Solid, reference: Solid | None, truth: StripeTruth, *, step_mm: float = 0.25
) -> StripesShow:
    """Find what the stripes show of any product, and how much of its defect.

    Parameters
    ----------
    solid : Solid
        The product.
    reference : Solid or None
        The same product without its defect.
    truth : StripeTruth
        Its stripes.
    step_mm : float
        Pitch of the places at which the depth is searched.

    Returns
    -------
    StripesShow
        Belt frame, millimetres.
    """
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    depth = 0.0
    if reference is not None and reference is not solid:
        x, y = np.meshgrid(np.arange(x_min, x_max, step_mm), np.arange(y_min, y_max, step_mm))
        depth = _most_mm(reference.heights_mm(x, y)[0] - solid.heights_mm(x, y)[0])
    lit = truth.on_product == 1
    stripes = np.flatnonzero(lit.any(axis=1))
    if not stripes.size:
        return StripesShow(0, 0, np.nan, np.nan, depth, np.nan, np.nan)
    left, right = int(stripes[0]), int(stripes[-1])
    points = truth.xyz_mm[lit]
    whole = solid if reference is None else reference
    return StripesShow(
        left_stripe=left + 1,
        right_stripe=right + 1,
        overhang_left_mm=float(np.median(truth.xyz_mm[left, lit[left], 0])) - x_min,
        overhang_right_mm=x_max - float(np.median(truth.xyz_mm[right, lit[right], 0])),
        defect_depth_mm=depth,
        defect_seen_mm=_most_mm(whole.heights_mm(points[:, 0], points[:, 1])[0] - points[:, 2]),
        hollow_seen_mm=max(_hollow_mm(truth.xyz_mm[i, lit[i], 1:]) for i in stripes),
    )


def _most_mm(missing_mm: Floats) -> float:
    """Largest of what is not NaN, at least 0."""
    known = missing_mm[np.isfinite(missing_mm)]
    return max(float(known.max()), 0.0) if known.size else 0.0


def _hollow_mm(profile_mm: Floats) -> float:
    """Depth of a profile, shape (n, 2) of (y, z), below its upper convex hull."""
    points = profile_mm[np.argsort(profile_mm[:, 0])]
    hull: list[Floats] = []
    for point in points:
        while len(hull) > 1:
            (ay, az), (by, bz) = hull[-2], hull[-1]
            if (by - ay) * (point[1] - az) < (bz - az) * (point[0] - ay):
                break
            hull.pop()
        hull.append(point)
    corners = np.array(hull)
    return float((np.interp(points[:, 0], corners[:, 0], corners[:, 1]) - points[:, 1]).max())
