"""From a rough ring around a product to its outline: the edge along normals, by dynamic programming.

Two searches, each on the normals of the ring that the one before found, each the cheapest closed path
through a strip (normal, distance):

1. wide: around the product's outermost seen points, outwards no further than the next stripe that lies on
   the belt. Silhouettes are sharp: brightness changes within the lens's blur. Shadows of extended lamps and
   the shading of round bodies change slowly. So what counts is by how much the gradient at a fine scale
   exceeds what the gradient at a coarse scale explains, whatever its sign.
2. to a part of a pixel, in plain light: `kinked`. A body darkens towards its rim and its shadow lies beside
   it, so the edge is where brightness stops to change, not where it changes most.

It fails where a shadow's edge is as sharp as the body's (a lamp that is a point), and where product and belt
look alike over a long part of the contour: stripes that end elsewhere show it (`outline_doubts`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Flags, Floats
from roemetry_volume.outline_image import SMOOTHED_PX
from roemetry_volume.outline_kink import along_normals, beside, kinked, normals_of, rounded
from roemetry_volume.silhouette import area_of, evenly

_NORMALS = 400
_LEAST_POINTS, _LEAST_AREA_PX2 = 16, 30.0
_ROUND_START = 6.0
"""Normals: the start is a polygon through stripes' ends, whose corners say nothing."""

_WIDE = ((4.0, 0.8), (0.6, 0.6))
"""Spacings of stripes, outwards and inwards, of the two wide searches. Beside the product's first stripe the
edge is at most one spacing away, and in the laser's shadow as far as a body of one and a half spacings of
displacement throws it; the second search has the normals of the first one's result."""
_FINE_PX, _COARSE_PX = 1.5, 5.0
"""Scales of the gradients: somewhat more than a lens's blur, and that of the penumbra of a near lamp."""
_WIDE_BEND, _WIDE_STEP = 0.005, 4
"""Bending costs little, but an edge may run no steeper than 3 px from normal to normal."""
_WIDE_OUTWARDS_PX = 0.001
"""Of two equally clear edges the outer: 100 px count a tenth of a clear edge."""
_COHERENT = 2.0
"""Normals, about 4 px, over which gradients are averaged along the edge: texture is shorter."""
_WIDE_ROUND = 3.0
_DIRECTION_ROUND = 8.0
"""Normals are smoothed over so many of them, else they cross at the corners of the start."""
_LIT, _LIT_PX = 0.2, 5.0
"""What lies outside is belt in light or in shadow: so far outside, an edge beyond which it is brighter than
the belt by so much (natural logarithm) does not count. The seen wall of a cut end is such a case."""
_CLEAR = 1.0
"""Of the usual strength of the strongest edge: an edge so clear counts in full."""

_NARROW_PX, _STEP_PX, _SMOOTH_PX, _BEND, _ROUND = 5.0, 0.5, 1.2, 0.05, 2.0
_ENOUGH = 0.4
_NARROW_OUTWARDS_PX = 0.01
_TO_THE_KINK = 5
"""Fits of the kink, each in a window around the one before: the fifth moves it by less than 0.02 px."""
_BLUR_PX = 0.6  # of a sharp lens, with the resampling of the image
_LEAST_STD_PX = 0.1
_AMBIENT_STD_PX = 0.3
"""Light beside a stripe fills its place, which shifts slanted edges: by 0.2 to 0.4 px on drawn ellipses."""
_USUAL_SCATTER_PX = 0.25  # of single normals: texture, and the steps of the search
_BIASED = 0.7  # of what they scatter beyond that: noise takes the kink to one side


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


def edge_around(
    level: Floats,
    start: Floats,
    belt: Flags,
    spacing_px: float,
    *,
    stripes: Flags | None = None,
) -> Edge | None:
    """Find the outline around a rough ring; None where the ring is too small to have one.

    Parameters
    ----------
    level
        (row, column) log(image / belt).
    start
        (n, 2) a closed polygon, px: through the product's outermost seen points, or around its core.
    belt
        (row, column) True on stripes that lie on the belt or on another product: the outline runs on this
        side of them.
    spacing_px
        Distance of neighbouring stripes.
    stripes
        (row, column) True where stripes were taken out of a laser image, which is smoothed by `SMOOTHED_PX`.
    """
    if start.shape[0] < 3 or abs(area_of(start)) < _LEAST_AREA_PX2:
        return None
    level = level.astype(np.float32)
    ring = rounded(evenly(start, _NORMALS), _ROUND_START)
    for outwards, inwards in _WIDE:
        ring = _widely(level, ring, belt, (outwards * spacing_px, inwards * spacing_px))
    if stripes is not None:
        ring, std_px = _between(np.exp(level), ring, stripes)
        return Edge(_within(ring, level), std_px)
    ring = _narrowly(level, ring)
    for _ in range(_TO_THE_KINK):
        ring, std_px, scatter_px = kinked(level, ring, _BLUR_PX)
    # nobody has measured this camera's blur: what a third more or less would change
    narrow, wide = (kinked(level, ring, share * _BLUR_PX).ring for share in (0.67, 1.33))
    unsure_px = _BIASED * max(scatter_px - _USUAL_SCATTER_PX, 0.0)
    model_px = math.hypot(_LEAST_STD_PX, 0.5 * _apart(narrow, wide), unsure_px)
    return Edge(_within(ring, level), math.hypot(std_px, model_px))


def _within(ring: Floats, level: Floats) -> Floats:
    rows, columns = level.shape
    return np.clip(ring, -0.5, np.array([columns, rows]) - 0.5)


def _between(light: Floats, ring: Floats, stripes: Flags) -> tuple[Floats, float]:
    """Give the ring between the steepest place and the kink of smoothed light, and its standard uncertainty.

    A step that was smoothed is steepest in its middle; a body that darkens towards its rim is steepest within
    it, and the kink, which lies at the rim, is drawn outwards by noise. Between the two the edge may lie
    anywhere.
    """
    for _ in range(2):
        ring = _steepest(light, ring, stripes)
    kink = ring
    for _ in range(_TO_THE_KINK):
        kink, std_px, scatter_px = kinked(light, kink, math.hypot(_BLUR_PX, SMOOTHED_PX), stripes)
    apart_px = _apart(ring, kink)
    middle = ring + 0.5 * apart_px * normals_of(ring)
    unsure_px = _BIASED * max(scatter_px - _USUAL_SCATTER_PX, 0.0)
    return middle, math.hypot(std_px, _AMBIENT_STD_PX, apart_px / math.sqrt(12.0), unsure_px)


def _apart(one: Floats, other: Floats) -> float:
    """Mean distance of two outlines of the same thing, px, positive where the other is larger."""
    length = float(np.hypot(*(np.roll(one, -1, axis=0) - one).T).sum())
    return (abs(area_of(other)) - abs(area_of(one))) / length


def _widely(level: Floats, ring: Floats, belt: Flags, reach_px: tuple[float, float]) -> Floats:
    """Move a ring to the sharpest closed edge before the belt's stripes."""
    import cv2

    from roemetry_volume.closed_contour import closed_path

    outwards, inwards = reach_px
    # only what lies within reach is looked at
    low = np.maximum(np.floor(ring.min(axis=0) - outwards).astype(int) - 20, 0)
    high = np.ceil(ring.max(axis=0) + outwards).astype(int) + 21
    window = (slice(low[1], high[1]), slice(low[0], high[0]))
    level, ring = level[window], ring - low
    normal = rounded(normals_of(ring), _DIRECTION_ROUND)
    normal /= np.maximum(np.hypot(normal[:, 0], normal[:, 1]), 1e-9)[:, None]
    off = np.arange(-inwards, outwards, 1.0)

    def gradient(scale_px: float) -> Floats:
        smooth = cv2.GaussianBlur(level, (0, 0), scale_px)
        before, after = (along_normals(smooth, ring, normal, off + at) for at in (-scale_px, scale_px))
        return np.asarray(rounded((before - after) / (2.0 * scale_px), _COHERENT))

    sharp = np.abs(gradient(_FINE_PX) - gradient(_COARSE_PX))
    behind = along_normals(belt[window].astype(np.float32), ring, normal, off) > 0.3
    behind &= off[None] > 0.0
    behind = np.cumsum(behind, axis=1) > 0
    sharp[behind] = 0.0
    clear = max(_CLEAR * float(np.median(sharp.max(axis=1))), 1e-9)
    cost = -np.clip(sharp / clear, 0.0, 1.0) - _WIDE_OUTWARDS_PX * off[None]
    lit = along_normals(cv2.GaussianBlur(level, (0, 0), _COARSE_PX / 2.0), ring, normal, off + _LIT_PX)
    cost += np.clip(lit / _LIT, 0.0, 1.0)
    cost[behind] = 1.0
    path = closed_path(cost, _WIDE_BEND, _WIDE_STEP)
    even = rounded(off[path][:, None], _WIDE_ROUND)
    return np.asarray(low + rounded(evenly(ring + even * normal, _NORMALS), 2.0))


def _narrowly(level: Floats, ring: Floats) -> Floats:
    """Move a ring along its normals to where brightness, changing outwards, stops to change.

    An edge that is clear enough counts as much as the clearest, and of two the outer is taken: folds and
    breaks inside are clearer than the rim.
    """
    import cv2

    from roemetry_volume.closed_contour import closed_path

    normal = normals_of(ring)
    off = np.arange(-_NARROW_PX, _NARROW_PX + _STEP_PX, _STEP_PX)
    smooth = cv2.GaussianBlur(level, (0, 0), _SMOOTH_PX)
    before, here, after = (
        along_normals(smooth, ring, normal, off + shift) for shift in (-_SMOOTH_PX, 0.0, _SMOOTH_PX)
    )
    # a body may be brighter than what is beside it on one side, and darker on the other
    sign = np.sign(rounded(before[:, :1] - after[:, -1:], _DIRECTION_ROUND))
    edge = np.where(sign * (before - here) > 0.0, sign * (before - 2.0 * here + after), 0.0)
    strong = max(_ENOUGH * float(np.median(edge.max(axis=1))), 1e-9)
    cost = -np.clip(edge / strong, 0.0, 1.0) - _NARROW_OUTWARDS_PX * off
    path = closed_path(cost, _BEND / _STEP_PX, 2)
    return evenly(ring + rounded(off[path][:, None], _ROUND) * normal, ring.shape[0])


def _steepest(light: Floats, ring: Floats, stripes: Flags) -> Floats:
    """Move a ring along its normals to where light changes most."""
    from roemetry_volume.closed_contour import closed_path

    normal = normals_of(ring)
    off = np.arange(-_NARROW_PX, _NARROW_PX + _STEP_PX, _STEP_PX)
    before, after = (along_normals(light, ring, normal, off + shift) for shift in (-_SMOOTH_PX, _SMOOTH_PX))
    change = np.abs(rounded(before - after, _COHERENT))
    told = beside(stripes, ring, normal)
    cost = -change / max(float(np.median(change[told].max(axis=1))), 1e-9)
    cost[~told] = 0.0
    path = closed_path(cost, _BEND / _STEP_PX, 2)
    return evenly(ring + rounded(off[path][:, None], _ROUND) * normal, ring.shape[0])
