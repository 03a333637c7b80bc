"""From a rough ring around a product to its outline: brightness along normals, by dynamic programming.

Model. The outline is a closed path over (normal, distance from the ring); each search takes the cheapest one,
Σ cost(normal, distance) + bend·(change of distance)² (Geiger et al. 1995), on the normals of the ring that
the search before it found:

1. wide, twice: silhouettes are sharp, brightness changes within the lens's blur; shadows of extended lamps
   and the shading of round bodies change slowly. So what counts is by how much the gradient at a fine scale
   exceeds what the gradient at a coarse scale explains, whatever its sign. The outline lies outside of what
   is seen of the product's stripes, and on this side of the stripes that are seen on the belt.
2. narrow, twice: where light changes most.
3. to a part of a pixel, five times: a round body turns away from the light, so inside the edge brightness is
   a + b·√d + c·d in the distance d from it; outside f + g·d, a shadow that thins out; both blurred. For each
   place of the edge that is a linear fit, whose squared residuals are the cost. An image out of focus is far
   better explained by a larger blur than by that of a sharp lens: then that is taken.

In a laser image only places beside stripes tell (normals on stripes follow their neighbours), and the edge
is known only where it stands out: `_seen` says how much of it does not.

Fails where a shadow's edge is as sharp as the body's (a lamp that is a point) and no stripe on the belt
lies between, and where product and belt look alike over a long part of the contour: stripes that end
elsewhere show it (`outline_surface`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import float_kernel, inlined, kernel
from roemetry_kernels.image_levels import median_of
from roemetry_volume.footprint import area_of, evenly, normals_of

_NORMALS = 400
"""Of a contour of some 800 px: one every 2 px, about the image's own resolution across a blurred edge."""
_LEAST_POINTS, _LEAST_AREA_PX2 = 3, 30.0  # a smaller ring has no inside to compare with
NORMAL_REACH = 3  # points to either side that give a normal
_ROUND_START = 6.0
"""Normals: the start is a polygon through stripes' ends, whose corners say nothing."""

_WIDE = ((4.0, 0.8, 2), (0.6, 0.6, 1))
"""Spacings of stripes, outwards and inwards, of the two wide searches, and by how much coarser they look.
Beside the product's first stripe the edge is at most one spacing away, and in the laser's shadow as far as a
body of one and a half spacings of displacement throws it; the second search has the normals of the first
one's result."""
_BEYOND_REACH_PX = 25
"""What the coarse gradient of a place takes in beyond it."""
_FINE_PX, _COARSE_PX, _EVEN_PX = 1.5, 5.0, 2.5
"""Scales of the gradients: somewhat more than a lens's blur, and that of the penumbra of a near lamp; and of
the light beyond."""
_WIDE_BEND, _WIDE_STEP = 0.005, 4
"""Bending costs little, but an edge may run no steeper than 4 px from normal to normal."""
_OUTWARDS = 0.001
"""Per pixel. Of two equally clear edges the outer: 100 px count a tenth of a clear edge. Where no edge is
clear, nothing draws the path outwards: two boxes whose end lies under a stripe came out 1 and 4 % larger."""
_COHERENT = 2.0
"""Normals, about 4 px, over which gradients are averaged along the edge: texture is shorter."""
_WIDE_ROUND, _DIRECTION_ROUND = 3.0, 8.0
"""Normals over which places and directions are smoothed: else normals cross at the corners of the start."""
_LIT, _LIT_PX = 0.2, 5.0
"""What lies outside is belt in light or in shadow: so far outside, an edge beyond which it is brighter than
the belt by so much (natural logarithm) does not count. The seen wall of a cut end is such a case."""

_NARROW_PX, _STEP_PX, _SMOOTH_PX, _NARROW_BEND, _NARROW_ROUND = 5.0, 0.5, 1.2, 0.1, 2.0
"""Reach of the narrow search: twice what the wide one may be off by; its steps, smoothing and stiffness are
of the order of the blur, and a half or twice as much moves volumes by less than 0.1 %."""

_REACH_PX, _SEARCH_PX, _SEARCH_STEP_PX = 5.0, 2.5, 0.25
"""Of the fit: how far it looks, how far the edge may be from the ring, and in which steps."""
_FIT_COHERENT, _FIT_ROUND, _FIT_BEND = 1.0, 1.5, 0.3
"""Of the fit, as above: normals that brightness and places are smoothed over, and the path's stiffness."""
_FIT_ROUNDS = 5
"""Fits, each in a window around the one before. Mostly the fifth moves the edge by less than 0.02 px; on 6 of
16 wet skeins by `mitsuba` more fits would move it by up to 0.2 px."""
_TERMS = 6  # four of the brightness and two of place and noise
_ALIKE_PX = 6.0  # along the contour: texture of belt and product, and what is smoothed over
_BLUR_PX = 0.6  # of a sharp lens, with the resampling of the image
_BLUR_UNSURE = 0.33
"""Nobody has measured this camera's: half of what a third more or less would change. Out of focus all of it:
the kink fades, and round bodies have come out too far inside by as much as blocks too far outside."""
_BLURS, _FAR_LESS = (1.6, 2.1, 2.7, 3.5, 4.5, 5.8), 0.6
"""Times the usual blur that are tried, as far as each explains more; and what the last has to leave at most
of what the usual one leaves. Sharp images are explained worse by the first."""
_MODEL_STD_PX = 0.25
"""Of the brightness model, in plain light: how far whole contours lie beside a body's silhouette, root mean
square over families and makers. Wet skeins by `mitsuba` lie 0.35 to 0.84 px inside, as a wet rim is dark, its
potatoes 0.13 to 0.18 px, its rolls 0.1 px at most; skeins of others, by their volumes, 0.1 to 0.3 px."""
_LASER_STD_PX = 0.3
"""A stripe's scattered light reaches beyond where it was taken out: 0.1 to 0.4 px on six rigs."""
_USUAL_SCATTER_PX = 0.25  # of single normals: texture, and the steps of the search
_BIASED = 0.7  # of what they scatter beyond that: noise takes the kink to one side

_FREE_LEAST = 0.2
"""Of the ring: with less of it between the stripes there is nothing to follow."""
_CLEAR = 3.0
"""Standard deviations, of the same differences on the belt, from which on a step in brightness is one."""
_CLEAR_LEAST = 0.75
"""Of the ring beside stripes: with less that is clear the rest is a guess. On nine rigs of two renderers 0.84
to 1.00 is where there is light enough to see the product, and 0.45 to 0.70 where there is not."""
_DECIDED_PX = 6
"""Where what is seen of product and belt leaves no more than that, the place is known without brightness."""


class Edge(NamedTuple):
    """An outline and how well it is held."""

    xy_px: Floats
    """(400, 2) the contour."""
    std_px: float
    """Standard uncertainty of its place as a whole: what the image's noise and texture leave open, what the
    model of the brightness across the edge may be wrong by, and how far it is not seen at all."""
    scatter_px: float
    """How far the single normals' best places scatter about the contour, standard deviation."""


Image = NDArray[np.float32]
_NO_IMAGE: Image = np.empty((0, 0), np.float32)


class Scene(NamedTuple):
    """What a contour is searched in, (row, column) each."""

    level: Image
    """log(image / belt)."""
    bounds: tuple[Image, Image] | None
    """1 where stripes show this product, and 1 where they show the belt or another product; None: nothing
    keeps an edge away."""
    stripes: Image | None
    """1 where a laser image's stripes were taken out; None: a plain-light image."""
    blur_px: float
    """By how much `level` was smoothed, standard deviation."""
    spacing_px: float
    """Distance of neighbouring stripes."""

    @property
    def marks(self) -> tuple[Image, Image, Image]:
        """Bounds and stripes, as kernels take them: empty where there are none."""
        product, belt = self.bounds or (_NO_IMAGE, _NO_IMAGE)
        return product, belt, _NO_IMAGE if self.stripes is None else self.stripes


def edge_around(scene: Scene, start: Floats) -> Edge | None:
    """Find the outline around a rough ring.

    Parameters
    ----------
    scene
        The image and what stripes show in it.
    start
        (n, 2) a closed polygon, px: through the product's outermost seen points, or around its core.

    Returns
    -------
    Edge or None
        None where the ring is too small to have an outline, or where too little of it is seen.
    """
    if start.shape[0] < _LEAST_POINTS or abs(area_of(start)) < _LEAST_AREA_PX2:
        return None
    ring = _rounded(evenly(start, _NORMALS), _ROUND_START)
    ring = _widely(scene, ring)
    for _ in range(2):
        ring = _steepest(scene.level, *scene.marks, ring)
    if scene.stripes is not None:  # light adds up, its logarithm's noise does not
        return edge_between_stripes(scene._replace(level=np.exp(scene.level)), ring)
    sharp_px = math.hypot(_BLUR_PX, scene.blur_px)
    seen = _across(scene, ring)
    blur_px = _blur_of(seen, sharp_px)
    ring, std_px, scatter_px = _fitted(scene, seen, blur_px)
    seen = _across(scene, ring)
    unsure = (1 - _BLUR_UNSURE, 1 + _BLUR_UNSURE)
    narrow, wide = (kinked(*seen, _model(share * blur_px))[0] for share in unsure)
    changed = 0.5 if blur_px == sharp_px else 1.0
    model_px = math.hypot(_MODEL_STD_PX, changed * _apart(narrow, wide))
    return _edge(scene, ring, math.hypot(std_px, model_px), scatter_px)


def edge_between_stripes(scene: Scene, ring: Floats) -> Edge | None:
    """Find the outline in a laser image's ambient light, near a contour that is right but for some pixels.

    The scene's level is the light itself, not a logarithm; `ring` (400, 2) is the contour to begin with, px.
    None where too little of it is seen.
    """
    blur_px = math.hypot(_BLUR_PX, scene.blur_px)
    ring, std_px, scatter_px = _fitted(scene, _across(scene, ring), blur_px)
    clear, open_px = _seen(scene, ring)
    if clear < _CLEAR_LEAST:
        return None
    return _edge(scene, ring, math.hypot(std_px, _LASER_STD_PX, open_px), scatter_px)


def _fitted(scene: Scene, seen: _Across, blur_px: float) -> tuple[Floats, float, float]:
    """Move a ring, and what lies across it, to the brightness's kink; see `kinked`."""
    model = _model(blur_px)
    for _ in range(_FIT_ROUNDS - 1):
        seen = _across(scene, kinked(*seen, model)[0])
    found: tuple[Floats, float, float] = kinked(*seen, model)
    return found


def _edge(scene: Scene, ring: Floats, std_px: float, scatter_px: float) -> Edge:
    rows, columns = scene.level.shape
    inside = np.clip(ring, -0.5, np.array([columns, rows]) - 0.5)
    unsure_px = _BIASED * max(scatter_px - _USUAL_SCATTER_PX, 0.0)
    return Edge(inside, math.hypot(std_px, unsure_px), scatter_px)


_REDRAWN = 8  # times: their mean is then known to a third of their spread


def redrawn(edge: Edge) -> list[Floats]:
    """Give a contour with noise put on it, `_REDRAWN` times; (point, 2) px each.

    The noise scatters as single normals' places do, and is as smooth along the contour as the brightness that
    is fitted and the places that are found are smoothed.
    """
    ring = edge.xy_px
    noise, normal = _fit_noise(ring.shape[0]), normals_of(ring, NORMAL_REACH)
    return [ring + edge.scatter_px * noise[:, k, None] * normal for k in range(_REDRAWN)]


@lru_cache(maxsize=4)
def _fit_noise(normals: int) -> Floats:
    """Give (normal, draw) noise as the fit leaves it on the contour, of places that scatter by 1."""
    rng = np.random.default_rng(0)
    single = _rounded(rng.normal(size=(normals, _REDRAWN)), _FIT_COHERENT)
    return _rounded(single / single.std(), _FIT_ROUND)


def unbound(scene: Scene, ring: Floats) -> Floats:
    """Give the edge near a ring that the image alone shows, whatever the stripes say."""
    scene = scene._replace(bounds=None)
    for _ in range(2):
        ring = _steepest(scene.level, *scene.marks, ring)
    found: Floats = kinked(*_across(scene, ring), _model(math.hypot(_BLUR_PX, scene.blur_px)))[0]
    return found


def _widely(scene: Scene, ring: Floats) -> Floats:
    """Move a ring to the sharpest closed edge between the product's stripes and the belt's."""
    import cv2

    for outwards, inwards, coarser in _WIDE:
        # only what lies within reach is looked at; of a coarser image every so many normals and places, too
        margin = int(outwards * scene.spacing_px) + _BEYOND_REACH_PX
        low = np.maximum(np.floor(ring.min(axis=0)).astype(int) - margin, 0) // coarser * coarser
        high = np.ceil(ring.max(axis=0)).astype(int) + margin + 1
        level = scene.level[low[1] : high[1], low[0] : high[0]]
        if coarser > 1:
            level = cv2.resize(level, None, fx=1 / coarser, fy=1 / coarser, interpolation=cv2.INTER_AREA)
        fine, coarse, even = (
            cv2.GaussianBlur(level, (0, 0), px / coarser) for px in (_FINE_PX, _COARSE_PX, _EVEN_PX)
        )
        ring = _moved_widely(
            fine, coarse, even, *scene.marks[:2], np.ascontiguousarray(ring[::coarser]), low, coarser,
            -inwards * scene.spacing_px, outwards * scene.spacing_px,
        )  # fmt: skip
    return ring


def _moved_widely(
    fine: Image, coarse: Image, even: Image, product: Image, belt: Image, ring: Floats, corner: Integers,
    coarser: int, inwards_px: float, outwards_px: float,
) -> Floats:  # fmt: skip
    """Move a ring along its normals to where the fine gradient exceeds the coarse one most.

    Parameters
    ----------
    fine, coarse, even
        Part of the image smoothed at three scales, so many times coarser; `corner` is its first pixel.
    product, belt
        See `Scene.marks`.
    ring
        (n, 2) px.
    corner, coarser
        See above.
    inwards_px, outwards_px
        First distance from the ring that is looked at, and the one after the last.
    """
    normal = smoothed_around(normals_of(ring, NORMAL_REACH), bell(_DIRECTION_ROUND / coarser))
    normal /= np.maximum(np.hypot(normal[:, :1], normal[:, 1:]), 1e-9)
    here = (ring - corner + 0.5) / coarser - 0.5
    every = inwards_px + np.arange(math.ceil(outwards_px - inwards_px))
    shut = shut_between(product, belt, ring, normal, every)[:, ::coarser]
    off = every[::coarser].copy()
    places = off / coarser
    sharp = _gradient(fine, here, normal, places, round(2.0 * _FINE_PX / coarser))
    sharp -= _gradient(coarse, here, normal, places, round(2.0 * _COARSE_PX / coarser))
    sharp = np.abs(smoothed_around(sharp, bell(_COHERENT / coarser)))
    sharp[shut] = 0.0
    clear = max(median_of(sharp.max(axis=1)), 1e-9)
    dark = np.clip(sampled(even, here, normal, places + _LIT_PX / coarser) / _LIT, 0.0, 1.0)
    cost = dark - np.minimum(sharp / clear, 1.0) * (1.0 + _OUTWARDS * off)
    cost[shut] = 1.0
    path = closed_path(cost, _WIDE_BEND, _WIDE_STEP)
    moved = _moved(ring, normal, off[path], _WIDE_ROUND / coarser)
    found: Floats = smoothed_around(evenly(moved, _NORMALS), bell(2.0))
    return found


def _gradient(smooth: Image, ring: Floats, normal: Floats, off: Floats, apart: int) -> Floats:
    """Give the fall of brightness outwards over so many places, at distances a place apart."""
    places = np.arange(off.size + apart) + (off[0] - 0.5 * apart)  # the ends of each are sampled once
    light: Floats = sampled(smooth, ring, normal, places)
    return (light[:, : off.size] - light[:, apart:]) / apart


def _moved(ring: Floats, normal: Floats, off: Floats, round_: float) -> Floats:
    """Move (n,) points of a ring along their normals by so much, smoothed around it."""
    even: Floats = smoothed_around(off.reshape(-1, 1), bell(round_))
    return ring + even * normal


def _steepest(level: Image, product: Image, belt: Image, stripes: Image, ring: Floats) -> Floats:
    """Move a ring along its normals to where light changes most; images as in `Scene.marks`."""
    n, normal, off = ring.shape[0], normals_of(ring, NORMAL_REACH), _NARROW_OFF_PX
    change = sampled(level, ring, normal, off - _SMOOTH_PX) - sampled(level, ring, normal, off + _SMOOTH_PX)
    change = np.abs(smoothed_around(change, bell(_COHERENT)))
    told = _beside(stripes, ring, normal)
    usual = max(median_of(change.max(axis=1)[told]), 1e-9)
    change[~told] = 0.0
    path = closed_path(shut_between(product, belt, ring, normal, off) - change / usual, _NARROW_BEND, 2)
    found: Floats = evenly(_moved(ring, normal, off[path], _NARROW_ROUND), n)
    return found


class _Across(NamedTuple):
    """What lies across a ring."""

    ring: Floats
    """(n, 2) px."""
    normal: Floats
    """(n, 2) outward unit normals."""
    light: Floats
    """(n, `_OFF_PX`) brightness along the normals."""
    told: Flags
    """(n,) where it is not a stripe's."""
    shut: Flags
    """(n, `_PLACES_PX`) where no outline runs."""


def _across(scene: Scene, ring: Floats) -> _Across:
    """Look across a ring, once for all models of the brightness there."""
    return _Across(ring, *across(scene.level, *scene.marks, ring))


@float_kernel
def across(
    level: Image, product: Image, belt: Image, stripes: Image, ring: Floats
) -> tuple[Floats, Floats, Flags, Flags]:
    """Give what `_Across` holds beside the ring."""
    normal = normals_of(ring, NORMAL_REACH)
    light = smoothed_around(sampled(level, ring, normal, _OFF_PX), bell(_FIT_COHERENT))
    shut = shut_between(product, belt, ring, normal, _PLACES_PX)
    return normal, light, _beside(stripes, ring, normal), shut


@float_kernel
def kinked(
    ring: Floats, normal: Floats, light: Floats, told: Flags, shut: Flags, model: Floats
) -> tuple[Floats, float, float]:
    """Move a ring to where the brightness has its kink.

    Parameters
    ----------
    ring, normal, light, told, shut
        See `_Across`.
    model
        See `_model`.

    Returns
    -------
    ring : ndarray, shape (n, 2)
        The outline.
    std_px : float
        Standard uncertainty of the contour's place as a whole: that of each normal, from its fit's residual
        and how fast it grows beside the best place, pooled over the contour, every 6 px by themselves.
    scatter_px : float
        How far the single normals' best places scatter about the contour, standard deviation. Beside a
        shadow as dark as the rim noise decides where the kink is, and the residual does not show it: this
        does.
    """
    (n, places), first = shut.shape, _PLACES_PX[0]
    free, spread = left_over(light, model, places)
    usual = median_of(spread[told]) or 1.0
    cost = np.empty((n, places))
    for i in range(n):
        for j in range(places):
            if not told[i]:
                free[i, j] = 0.0
            cost[i, j] = (free[i, j] + (usual if shut[i, j] else 0.0)) / usual
    exact, each, best = between_places(free, closed_path(cost, _FIT_BEND, 2))
    even = smoothed_around((first + _SEARCH_STEP_PX * exact).reshape(-1, 1), bell(_FIT_ROUND))
    clear = told & np.isfinite(each)
    usual = median_of(each[clear]) if clear.any() else np.inf
    std = _SEARCH_STEP_PX * math.sqrt(usual / (_OFF_PX.size - _TERMS) * _ALIKE_PX / _length(ring))
    scatter = (_PLACES_PX[best] - even[:, 0])[told].std()
    return evenly(ring + even * normal, n), std, scatter


def _blur_of(across: _Across, usual_px: float) -> float:
    """Give the blur of the image, px: the usual one unless a larger one leaves far less unexplained."""

    def unexplained(blur_px: float) -> float:
        cost = left_over(across.light, _model(blur_px), _PLACES_PX.size)[0]
        return median_of(cost.min(axis=1)[across.told])

    found_px = usual_px
    least = usual = unexplained(usual_px)
    for times in _BLURS:
        left = unexplained(times * usual_px)
        if left > least:
            break
        found_px, least = times * usual_px, left
    return found_px if least < _FAR_LESS * usual else usual_px


_OFF_PX = np.arange(-_REACH_PX, _REACH_PX + 0.5 * _STEP_PX, _STEP_PX)
_PLACES_PX = np.arange(-_SEARCH_PX, _SEARCH_PX + 0.5 * _SEARCH_STEP_PX, _SEARCH_STEP_PX)
_NARROW_OFF_PX = np.arange(-_NARROW_PX, _NARROW_PX + _STEP_PX, _STEP_PX)
"""Distances from the ring where brightness is sampled, where the edge may be, and of the narrow search."""


@lru_cache(maxsize=16)
def _model(blur_px: float) -> Floats:
    """Give (sample, direction · place) orthonormal directions of all that the model may be, by place.

    They are free of the mean, which every run of brightness is.
    """
    reach = _REACH_PX + max(4.0, 4.0 * blur_px)
    fine = np.arange(-reach, reach, 0.05)
    blur = np.exp(-0.5 * ((_OFF_PX[:, None] - fine[None, :]) / blur_px) ** 2)
    blur /= blur.sum(axis=1)[:, None]
    directions = []
    for place in _PLACES_PX:
        within = np.clip(place - fine, 0.0, None)
        beyond = np.clip(fine - place, 0.0, None)
        inside = (fine < place).astype(np.float64)
        design = blur @ np.column_stack([inside, np.sqrt(within), within, beyond])
        directions.append(np.linalg.qr(design - design.mean(axis=0))[0])
    return np.ascontiguousarray(np.stack(directions, axis=2).reshape(_OFF_PX.size, -1))


def _seen(scene: Scene, ring: Floats) -> tuple[float, float]:
    """Say how much of an outline stands out, and how uncertain what does not makes its place as a whole.

    Where the step in brightness across the ring is not clear, the edge lies anywhere (a rectangle) between
    the product's stripes and the belt's, or within a spacing.

    Returns
    -------
    clear : float
        Share of what lies beside stripes whose step is three times what such steps scatter on the belt.
    open_px : float
        Standard uncertainty: the mean over the ring of the rectangles' half widths over √3, and that of how
        far the outline lies from their middles.
    """
    assert scene.stripes is not None
    normal = normals_of(ring, NORMAL_REACH)
    steps, shares = _steps(scene, ring)
    away = [_steps(scene, ring + far * normal) for far in (10.0, 14.0, 18.0)]
    told = [share > _FREE_LEAST for _, share in away]
    belt = np.concatenate(
        [step[on] * np.sqrt(share[on]) for (step, share), on in zip(away, told, strict=True)]
    )
    noise = 1.4826 * median_of(np.abs(belt)) if belt.size else math.inf
    known = shares > 0.0
    clear = known & (np.abs(steps) * np.sqrt(shares) > _CLEAR * noise)
    outwards, inwards, _ = _WIDE[0]
    off = np.arange(-(outwards + inwards) * scene.spacing_px, scene.spacing_px, 1.0)
    free = ~shut_between(*scene.marks[:2], ring, normal, off)
    open_px = free.sum(axis=1)
    unknown = ~clear & (open_px > _DECIDED_PX)
    middle_px = free @ off / np.maximum(open_px, 1)
    spread_px = float((unknown * open_px).mean()) / math.sqrt(12.0)
    return float(clear.sum() / max(known.sum(), 1)), math.hypot(spread_px, (unknown * middle_px).mean())


def _steps(scene: Scene, ring: Floats) -> tuple[Floats, Floats]:
    """Give the mean step in light across a ring over neighbours beside stripes, and the share of these."""
    assert scene.stripes is not None
    normal, off = normals_of(ring, NORMAL_REACH), np.arange(1.0, 5.0)
    inside, outside = (sampled(scene.level, ring, normal, sign * off).mean(axis=1) for sign in (-1.0, 1.0))
    on = sampled(scene.stripes, ring, normal, np.arange(-4.0, 5.0)).max(axis=1)
    share = _rounded((on < 0.5).astype(np.float64)[:, None], 3.0)[:, 0]
    share[share < 0.02] = 0.0
    mean = _rounded(np.where(on < 0.5, inside - outside, 0.0)[:, None], 3.0)[:, 0]
    return mean / np.maximum(share, 0.02), share


@float_kernel
def _beside(stripes: Image, ring: Floats, normal: Floats) -> Flags:
    """Say which points of a ring lie beside stripes, not on them; all, where that would leave too few."""
    free = np.ones(ring.shape[0], np.bool_)
    if stripes.size:
        on = sampled(stripes, ring, normal, np.array([-2.0, 0.0, 2.0]))
        for i in range(free.size):
            free[i] = on[i].max() < 0.5
        if not free.mean() > _FREE_LEAST:
            free[:] = True
    return free


def _apart(one: Floats, other: Floats) -> float:
    """Mean distance of two outlines of the same thing, px, positive where the other is larger."""
    return (abs(area_of(other)) - abs(area_of(one))) / _length(one)


@float_kernel
def _length(ring: Floats) -> float:
    total, last = 0.0, ring.shape[0] - 1
    for k in range(ring.shape[0]):
        step_x, step_y = ring[k, 0] - ring[last, 0], ring[k, 1] - ring[last, 1]
        total += math.sqrt(step_x * step_x + step_y * step_y)
        last = k
    return total


def _rounded(values: Floats, sigma: float) -> Floats:
    """Smooth (n, k) values around the ring."""
    smooth: Floats = smoothed_around(np.ascontiguousarray(values), bell(sigma))
    return smooth


@float_kernel
def bell(sigma: float) -> Floats:
    """Give weights of a Gaussian out to four standard deviations, 1 in all."""
    half = int(4.0 * sigma + 0.5)
    weights = np.empty(2 * half + 1)
    for k in range(weights.size):
        weights[k] = math.exp(-0.5 * ((k - half) / sigma) ** 2)
    return weights / weights.sum()


@inlined
def _light_at(image: Image, x: float, y: float) -> float:
    """Give an image between its pixels; beyond its border, the border's."""
    rows, columns = image.shape
    x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
    i, j = max(min(int(x), columns - 2), 0), max(min(int(y), rows - 2), 0)
    left, right = np.uint64(i), np.uint64(min(i + 1, columns - 1))  # unsigned: no index from the end
    up, down = np.uint64(j), np.uint64(min(j + 1, rows - 1))
    across = x - i
    above = image[up, left] + across * (image[up, right] - image[up, left])
    below = image[down, left] + across * (image[down, right] - image[down, left])
    return above + (y - j) * (below - above)


@float_kernel
def sampled(image: Image, ring: Floats, normal: Floats, off_px: Floats) -> Floats:
    """Sample an image (n, m) at distances along the normals of a ring."""
    n, m = ring.shape[0], off_px.size
    out = np.empty((n, m))
    for i in range(n):
        for j in range(m):
            x, y = ring[i, 0] + off_px[j] * normal[i, 0], ring[i, 1] + off_px[j] * normal[i, 1]
            out[i, j] = _light_at(image, x, y)
    return out


@float_kernel
def left_over(light: Floats, model: Floats, places: int) -> tuple[Floats, Floats]:
    """Give (n, place) squared residuals of brightness under the model of each place, and their spread (n,).

    What a model leaves of a run of brightness is all of it less what lies along the model's directions.
    """
    n, m = light.shape
    cost, spread = np.empty((n, places)), np.empty(n)
    explained = np.empty(model.shape[1])
    for i in range(n):
        mean = light[i].mean()
        explained[:] = 0.0
        total = 0.0
        for k in range(m):
            value = light[i, k] - mean
            total += value * value
            for j in range(model.shape[1]):
                explained[j] += value * model[k, j]
        cost[i] = total
        for first in range(0, model.shape[1], places):
            for j in range(places):
                cost[i, j] -= explained[first + j] * explained[first + j]
        spread[i] = cost[i].max() - cost[i].min()
    return cost, spread


@kernel
def between_places(cost: Floats, path: Integers) -> tuple[Floats, Floats, Integers]:
    """Look between the places of a path, by a parabola through its neighbours' costs.

    Returns
    -------
    exact : ndarray, shape (n,)
        Where the cost is least, places.
    variance : ndarray, shape (n,)
        Twice the cost over its curvature, places²; infinite where it does not curve upwards.
    best : ndarray, shape (n,)
        The cheapest place of each ray by itself.
    """
    n, m = cost.shape
    exact, variance, best = np.empty(n), np.empty(n), np.empty(n, np.int64)
    for i in range(n):
        k = min(max(path[i], 1), m - 2)
        before, here, after = cost[i, k - 1], cost[i, k], cost[i, k + 1]
        curve = before - 2.0 * here + after
        exact[i], variance[i], best[i] = float(path[i]), np.inf, np.argmin(cost[i])
        if curve > 0.0:
            variance[i] = 2.0 * here / curve
            if k == path[i]:
                exact[i] += min(max(0.5 * (before - after) / curve, -0.75), 0.75)
    return exact, variance, best


@float_kernel
def shut_between(product: Image, belt: Image, ring: Floats, normal: Floats, off_px: Floats) -> Flags:
    """Say where (normal, distance) no outline runs: up to the last product, and from belt beyond it on."""
    n, m = ring.shape[0], off_px.size
    shut = np.ones((n, m), np.bool_)
    if not product.size:
        shut[:] = False
        return shut
    for i in range(n):
        first = m
        while first > 0:
            at = off_px[first - 1]
            if _light_at(product, ring[i, 0] + at * normal[i, 0], ring[i, 1] + at * normal[i, 1]) > 0.5:
                break
            first -= 1
        for j in range(first, m):
            at = off_px[j]
            if _light_at(belt, ring[i, 0] + at * normal[i, 0], ring[i, 1] + at * normal[i, 1]) > 0.3:
                break
            shut[i, j] = False
    return shut


@float_kernel
def smoothed_around(values: Floats, weights: Floats) -> Floats:
    """Give (n, k) sums over 2·h + 1 neighbours around a ring."""
    (n, m), half = values.shape, weights.size // 2
    out = np.zeros((n, m))
    for i in range(n):
        for tap in range(weights.size):
            of = (i + tap - half) % n
            for k in range(m):
                out[i, k] += weights[tap] * values[of, k]
    return out


@float_kernel
def closed_path(cost: Floats, bend: float, most: int) -> Integers:
    """Find the path of least cost once around.

    Parameters
    ----------
    cost : ndarray, shape (n, m)
        Cost of each of m places on each of n rays; the last ray lies beside the first.
    bend
        Cost of a step from ray to ray, times its square.
    most
        Largest step, places.

    Returns
    -------
    ndarray of int64, shape (n,)
        Place on each ray. The path is followed twice around and the middle of it taken, whose ends meet
        unless two paths cost alike; then they differ by at most `most` places.
    """
    n, m = cost.shape
    # beyond either end stands what no path takes, so that all places are treated alike, by vectors
    before, best = np.full(m + 2 * most, np.inf), np.empty(m)
    step = np.empty(m, np.int64)  # as wide as costs are, or they are not taken several at once
    came = np.zeros((2 * n, m), np.int8)
    for j in range(m):
        before[most + j] = cost[0, j]
    for k in range(1, 2 * n):
        best[:] = np.inf
        for d in range(2 * most + 1):
            dear, ahead = bend * (d - most) ** 2, before[d : d + m]
            for j in range(m):
                way = ahead[j] + dear
                less = way < best[j]
                best[j] = way if less else best[j]
                step[j] = d if less else step[j]
        for j in range(m):
            came[k, j] = step[j]
            before[most + j] = best[j] + cost[k % n, j]
    path = np.empty(2 * n, np.int64)
    path[2 * n - 1] = np.argmin(before[most : most + m])
    for k in range(2 * n - 1, 0, -1):
        path[k - 1] = path[k] + came[k, path[k]] - most
    half = n // 2
    out = np.empty(n, np.int64)
    for k in range(n):
        out[k] = path[k + n] if k < half else path[k]
    return out
