"""From a rough region to its outline: the edge along normals, by dynamic programming."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats
from roemetry_volume.outline_kink import kinked
from roemetry_volume.outline_ring import along_normals, normals_of, rounded
from roemetry_volume.silhouette import area_of, evenly

_NORMALS = 400


class _Pass(NamedTuple):
    """A search: how far to both sides, in which steps, on an image smoothed by how much, how stiff."""

    reach_px: float
    step_px: float
    smooth_px: float
    bend: float
    round_off: float


_PASSES = (
    _Pass(16.0, 1.0, 2.5, 0.10, 3.0),
    _Pass(5.0, 0.5, 1.2, 0.05, 2.0),
)
_ENOUGH = 0.4
_SAMPLED = 4
_OUTWARDS_PX = 0.01
_BLUR_PX = 0.6  # of a sharp lens, with the resampling of the image
_GLOW_BLUR_PX = 2.57  # after `glow`
_LEAST_STD_PX = 0.1
_USUAL_SCATTER_PX = 0.25  # of single normals: texture, and the steps of the search
_BIASED = 0.7  # of what they scatter beyond that: noise takes the kink to one side
_GLOW_STD_PX = 0.9  # see docs/reference/plugins/edge-contour.md


class Edge(NamedTuple):
    """An outline and how well it is held.

    Attributes
    ----------
    xy_px : ndarray, shape (400, 2)
        The contour.
    std_px
        Standard uncertainty of its place as a whole: what the image's noise and texture leave open, and what
        the model of the brightness across the edge may be wrong by.
    """

    xy_px: Floats
    std_px: float


def edge_around(level: Floats, region: NDArray[np.bool_], *, shaded: bool = True) -> Edge | None:
    """Find the outline of what lies in a region; None where the region is too small to have one.

    Parameters
    ----------
    level
        (row, column) log(image / belt).
    region
        (row, column) roughly the product.
    shaded
        True in plain light, where a body darkens towards its rim and its shadow lies beside it: its edge is
        a kink. False in even light smoothed as `glow` does, where it is the steepest place.
    """
    import cv2

    found, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not found:
        return None
    chain = max(found, key=cv2.contourArea)[:, 0, :].astype(np.float64)
    if chain.shape[0] < 16 or abs(area_of(chain)) < 30.0:
        return None
    ring = rounded(evenly(chain, _NORMALS), 4.0)
    inside = float(level[region].mean())
    beside = level[::_SAMPLED, ::_SAMPLED][~region[::_SAMPLED, ::_SAMPLED]]
    ground = float(np.median(beside)) if beside.size else 0.0
    falling = level if inside >= ground else -level
    for search in _PASSES:
        smooth = cv2.GaussianBlur(falling, (0, 0), search.smooth_px)
        ring = _moved(smooth, ring, search, shaded)
    if shaded:
        for _ in range(2):
            ring, std_px, scatter_px = kinked(falling, ring, _BLUR_PX)
        # nobody has measured this camera's blur: what a third more or less would change
        narrow, wide = (kinked(falling, ring, share * _BLUR_PX).ring for share in (0.67, 1.33))
        unsure_px = _BIASED * max(scatter_px - _USUAL_SCATTER_PX, 0.0)
        model_px = math.hypot(_LEAST_STD_PX, 0.5 * _apart(narrow, wide), unsure_px)
    else:  # so smooth an image tells a kink from a step badly: how far apart they lie is all it says
        kink, std_px, _ = kinked(falling, ring, _GLOW_BLUR_PX)
        model_px = math.hypot(_GLOW_STD_PX, _apart(kink, ring))
    rows, columns = level.shape
    ring = np.clip(ring, -0.5, np.array([columns, rows]) - 0.5)
    return Edge(ring, math.hypot(std_px, model_px))


def _apart(one: Floats, other: Floats) -> float:
    """Mean distance of two outlines of the same thing, px, positive where the other is larger."""
    length = float(np.hypot(*(np.roll(one, -1, axis=0) - one).T).sum())
    return (abs(area_of(other)) - abs(area_of(one))) / length


def _moved(smooth: Floats, ring: Floats, search: _Pass, shaded: bool) -> Floats:
    """Move a ring along its normals to the edge.

    In plain light that is where brightness, falling outwards, stops to fall: where it falls most is well
    inside. An edge that is clear enough counts as much as the clearest, and of two the outer is taken: folds
    and breaks inside are clearer than the rim.
    """
    from roemetry_kernels.volume.closed_contour import closed_path

    normal = normals_of(ring)
    off = np.arange(-search.reach_px, search.reach_px + search.step_px, search.step_px)
    half = max(search.step_px, search.smooth_px)
    before, here, after = (along_normals(smooth, ring, normal, off + shift) for shift in (-half, 0.0, half))
    if shaded:
        edge = np.where(before > here, (before - 2.0 * here + after) / (half * half), 0.0)
    else:
        edge = (before - after) / (2.0 * half)
    strong = max(_ENOUGH * float(np.median(edge.max(axis=1))), 1e-9)
    if not shaded:
        strong /= _ENOUGH
    cost = -np.clip(edge / strong, 0.0, 1.0) - (_OUTWARDS_PX * off if shaded else 0.0)
    path = closed_path(cost, search.bend / max(search.step_px, 0.25), 2)
    even = rounded(off[path][:, None], search.round_off)
    return evenly(ring + even * normal, ring.shape[0])
