"""An outline to a part of a pixel: a model of the brightness across it, fitted on every normal."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Flags, Floats
from roemetry_volume.silhouette import area_of, evenly

_REACH_PX = 5.0
_STEP_PX = 0.5
_SEARCH_PX = 2.5
_SEARCH_STEP_PX = 0.25
_NEIGHBOURS = 1.0
_ROUND_OFF = 1.5
_BEND = 0.3
_TERMS = 6
_FREE_LEAST = 0.2
"""Of the ring: with less of it between the stripes there is nothing to follow."""
_ALIKE_PX = 6.0  # along the contour: texture of belt and product, and what is smoothed over


class Kinked(NamedTuple):
    """An outline at the kink.

    Attributes
    ----------
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

    ring: Floats
    std_px: float
    scatter_px: float


def kinked(level: Floats, ring: Floats, blur_px: float, stripes: Flags | None = None) -> Kinked:
    """Move a ring to where the brightness has its kink.

    Inside, brightness is a + b·√d + c·d in the distance d from the edge (a round body turns away from the
    light as the root of d); outside f + g·d (a shadow that thins out); both blurred. For each place of the
    edge that is a linear fit; the places are then chosen around the ring together.

    Parameters
    ----------
    level
        (row, column) log(image / belt), falling outwards.
    ring : ndarray, shape (n, 2)
        The outline to about two pixels.
    blur_px
        Standard deviation of the image's blur, px.
    stripes
        (row, column) True where the image tells nothing: normals that begin there follow their neighbours.
    """
    from roemetry_volume.closed_contour import closed_path

    normal = normals_of(ring)
    off, places, residual = _model(blur_px)
    seen = rounded(along_normals(level, ring, normal, off), _NEIGHBOURS)
    cost = np.stack([((seen @ left) ** 2).sum(axis=1) for left in residual], axis=1)
    told = beside(stripes, ring, normal)
    usual = float(np.median((cost.max(axis=1) - cost.min(axis=1))[told])) or 1.0
    cost[~told] = 0.0
    path = closed_path(cost / usual, _BEND, 2)
    row = np.arange(ring.shape[0])
    inner = np.clip(path, 1, places.size - 2)
    before, here, after = (cost[row, inner + k] for k in (-1, 0, 1))
    curve = before - 2.0 * here + after
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(curve > 0.0, np.clip(0.5 * (before - after) / curve, -0.75, 0.75), 0.0)
    exact = places[path] + _SEARCH_STEP_PX * np.where(inner == path, part, 0.0)
    even = rounded(exact[:, None], _ROUND_OFF)
    clear = (curve > 0.0) & told
    noise = here[clear] / (off.size - _TERMS)
    each = 2.0 * noise * _SEARCH_STEP_PX**2 / curve[clear]
    length = float(np.hypot(*(np.roll(ring, -1, axis=0) - ring).T).sum())
    std = math.sqrt(float(np.median(each)) * _ALIKE_PX / length) if clear.any() else math.inf
    scatter = float((places[cost.argmin(axis=1)] - even[:, 0])[told].std())
    return Kinked(evenly(ring + even * normal, ring.shape[0]), std, scatter)


@lru_cache(maxsize=4)
def _model(blur_px: float) -> tuple[Floats, Floats, Floats]:
    """Distances of samples, places of the edge, and for each the matrix that leaves what does not fit."""
    off = np.arange(-_REACH_PX, _REACH_PX + 0.5 * _STEP_PX, _STEP_PX)
    places = np.arange(-_SEARCH_PX, _SEARCH_PX + 0.5 * _SEARCH_STEP_PX, _SEARCH_STEP_PX)
    reach = _REACH_PX + max(4.0, 4.0 * blur_px)
    fine = np.arange(-reach, reach, 0.05)
    blur = np.exp(-0.5 * ((off[:, None] - fine[None, :]) / blur_px) ** 2)
    blur /= blur.sum(axis=1)[:, None]
    residual = []
    for place in places:
        within = np.clip(place - fine, 0.0, None)
        beyond = np.clip(fine - place, 0.0, None)
        inside = (fine < place).astype(np.float64)
        design = blur @ np.column_stack([np.ones_like(fine), inside, np.sqrt(within), within, beyond])
        q, _ = np.linalg.qr(design)
        residual.append(np.eye(off.size) - q @ q.T)
    return off, places, np.array(residual)


def along_normals(image: Floats, ring: Floats, normal: Floats, off_px: Floats) -> Floats:
    """Sample an image (n, m) at distances along the normals of a ring."""
    import cv2

    at = ring[:, None, :] + off_px[None, :, None] * normal[:, None, :]
    x, y = at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def beside(stripes: Flags | None, ring: Floats, normal: Floats) -> Flags:
    """Say which points of a ring lie beside stripes, not on them; all, where that would leave too few."""
    if stripes is None:
        return np.ones(ring.shape[0], np.bool_)
    on = along_normals(stripes.astype(np.float32), ring, normal, np.array([-2.0, 0.0, 2.0])).max(axis=1)
    free: Flags = on < 0.5
    return free if free.mean() > _FREE_LEAST else np.ones(ring.shape[0], np.bool_)


def rounded(values: Floats, sigma: float) -> Floats:
    """Smooth (n, k) values around the ring."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, sigma, axis=0, mode="wrap"))


def normals_of(ring: Floats) -> Floats:
    """Give the outward unit normals (n, 2) of a ring."""
    along = np.roll(ring, -3, axis=0) - np.roll(ring, 3, axis=0)
    length = np.hypot(along[:, 0], along[:, 1])
    normal = np.column_stack([along[:, 1], -along[:, 0]]) * (np.sign(area_of(ring)) or 1.0)
    return np.asarray(normal / np.where(length > 0.0, length, 1.0)[:, None])
