"""One outline from both images: the plain-light contour and that in the laser image's ambient light.

Model. The two see the same edge in other light: a lamp's shadow or a wet rim that misleads the plain image
does not lie in the same place in the laser image, whose own errors are noise and the scattered light of
stripes. So they are two measurements of one contour, with variances σ₁² and σ₂²; their mean is weighted by
1/σ², and its variance is 1/(1/σ₁² + 1/σ₂²). Where the contours lie farther apart on the mean than both
uncertainties explain, by a factor R > 1 (the Birge ratio of two values), the mean's uncertainty is R times
that (Birge, Phys. Rev. 40, 1932).

The laser image is looked at in a window around the product only, and its contour begins at the plain one.
Where it is too dark to show the edge, the plain contour stays as it is.

Fails where both are misled the same way: a body that is as bright as the belt in every light.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_volume.ambient_light import SMOOTHED_PX, ambient_light
from roemetry_volume.edge_search import NORMAL_REACH, Edge, Scene, edge_between_stripes
from roemetry_volume.footprint import inside_by, normals_of

_MARGIN_PX = 36
"""Around the contour, besides a spacing: it may move by 12 px, and steps in brightness are compared 22 px
outside it."""


def confirmed(plain: Edge, laser: NDArray[Any], scene: Scene) -> Edge:
    """Look for a plain-light contour in the laser image, too, and give the weighted mean of both.

    Parameters
    ----------
    plain
        The contour in the plain image, px of the laser image.
    laser
        (row, column) grey levels of the laser image.
    scene
        What the plain contour was searched in.

    Returns
    -------
    Edge
        `plain` as it is where the laser image is too dark to show the edge, or nothing tells how sure one of
        the two is.
    """
    rows, columns = laser.shape
    margin = _MARGIN_PX + round(scene.spacing_px)
    left, top = np.maximum(np.floor(plain.xy_px.min(axis=0)).astype(int) - margin, 0)
    right, bottom = np.minimum(np.ceil(plain.xy_px.max(axis=0)).astype(int) + margin, (columns, rows))
    window = np.s_[top:bottom, left:right]
    light, stripes = ambient_light(laser[window], scene.spacing_px)
    product, belt = scene.marks[:2]
    within = Scene(
        light.astype(np.float32), (product[window], belt[window]) if product.size else None,
        stripes.astype(np.float32), SMOOTHED_PX, scene.spacing_px,
    )  # fmt: skip
    corner = np.array([left, top], np.float64)
    found = edge_between_stripes(within, plain.xy_px - corner)
    if found is None or not math.isfinite(found.std_px) or not math.isfinite(plain.std_px):
        return plain
    return weighted_mean(plain, found._replace(xy_px=found.xy_px + corner))


def weighted_mean(one: Edge, other: Edge) -> Edge:
    """Give the mean of two contours of one edge, weighted by their variances; see the module's model."""
    apart = inside_by(other.xy_px, one.xy_px)
    both = one.std_px**2 + other.std_px**2
    share = one.std_px**2 / both
    std_px = one.std_px * other.std_px / math.sqrt(both)
    std_px *= max(1.0, abs(float(apart.mean())) / math.sqrt(both))
    moved = one.xy_px + share * apart[:, None] * normals_of(one.xy_px, NORMAL_REACH)
    return Edge(moved, std_px, one.scatter_px)
