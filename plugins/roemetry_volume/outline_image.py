"""The picture an outline is looked for in: how much brighter or darker than the empty belt each place is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Flags, Floats

_SMOOTH_PX = 5.0
SMOOTHED_PX = 2.5
"""Ambient light is dim: a grey level or two of noise would hide the body's edge otherwise."""
_STRIPE = 6.0
"""Times the noise: what the opening takes away that much is a stripe."""
_GRID_PX = 8
_ROUNDS = 6
_RIDGE = 1e-10


def over_belt(pixels: NDArray[Any], belt: NDArray[Any] | None, product: NDArray[np.bool_]) -> Floats:
    """Give log(image / empty belt), (row, column).

    Parameters
    ----------
    pixels
        (row, column) or (row, column, colour) grey levels; of colours the one is taken in which product and
        belt differ most.
    belt
        The empty belt in the same light, of the same shape; None: a polynomial of second order through the
        image's own belt.
    product
        (row, column) True where stripes show product, which is left out of that polynomial.
    """
    import cv2

    if pixels.ndim == 3:
        planes = [
            over_belt(pixels[..., k], None if belt is None else belt[..., k], product) for k in range(3)
        ]
        return max(planes, key=lambda plane: _contrast(plane, product))
    bright = np.log(pixels.astype(np.float64) + 1.0)
    if belt is not None:
        smooth = cv2.GaussianBlur(belt.astype(np.float64), (0, 0), _SMOOTH_PX)
        level = bright - np.log(smooth + 1.0)
        return np.asarray(level - np.median(level[~product]))
    return np.asarray(bright - _own_belt(bright, product))


def _own_belt(bright: Floats, product: NDArray[np.bool_]) -> Floats:
    """Fit the belt's brightness where it is not product, by least squares that drop what is far off."""
    rows, columns = bright.shape
    y, x = np.mgrid[0:rows:_GRID_PX, 0:columns:_GRID_PX]
    a, b = x.ravel() / columns - 0.5, y.ravel() / rows - 0.5

    def design(u: Floats, v: Floats) -> Floats:
        return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)

    terms, seen = design(a, b), bright[::_GRID_PX, ::_GRID_PX].ravel()
    use = ~product[::_GRID_PX, ::_GRID_PX].ravel()
    if use.sum() < terms.shape[1]:
        use[:] = True
    for _ in range(_ROUNDS):
        belt = terms[use]
        # of six terms within ±1 the normal equations lose nothing, and cost a tenth; the ridge is for slivers
        normal = belt.T @ belt + _RIDGE * len(belt) * np.eye(belt.shape[1])
        found = np.linalg.solve(normal, belt.T @ seen[use])
        off = seen - terms @ found
        middle = np.median(off[use])
        limit = max(3.0 * 1.4826 * float(np.median(np.abs(off[use] - middle))), 0.02)
        again = use & (np.abs(off - middle) < limit)
        if again.sum() < 4 * terms.shape[1]:
            break
        use = again
    v, u = (np.arange(rows) / rows - 0.5)[:, None], (np.arange(columns) / columns - 0.5)[None, :]
    c = found
    return np.asarray(c[0] + v * (c[2] + c[5] * v) + u * (c[1] + c[3] * u) + c[4] * (u * v))


def _contrast(plane: Floats, product: NDArray[np.bool_]) -> float:
    if not product.any() or product.all():
        return float(plane.std())
    inside, outside = plane[product], plane[~product]
    return abs(float(np.median(inside) - np.median(outside))) / (float(outside.std()) + 1e-6)


def ambient(pixels: NDArray[Any], spacing_px: float) -> tuple[NDArray[Any], Flags]:
    """Take the stripes out of a laser image.

    Parameters
    ----------
    pixels
        (row, column) grey levels.
    spacing_px
        Distance of neighbouring stripes.

    Returns
    -------
    light : ndarray
        Ambient light in 64ths of a grey level: grey opening along the rows by more than a stripe is wide and
        less than stripes are apart, then smoothed by `SMOOTHED_PX` against noise.
    stripes : ndarray of bool
        Where a stripe was taken out. What stands there comes from beside it.
    """
    import cv2

    width = max(int(0.6 * spacing_px) | 1, 9)
    opened = cv2.morphologyEx(pixels, cv2.MORPH_OPEN, np.ones((1, width), np.uint8))
    taken = pixels.astype(np.float64) - opened
    usual = float(np.median(taken))
    noise = 1.4826 * float(np.median(np.abs(taken - usual)))
    on = (taken > usual + _STRIPE * max(noise, 0.5)).astype(np.uint8)
    on = cv2.morphologyEx(on, cv2.MORPH_OPEN, np.ones((3, 1), np.uint8))  # single pixels are noise
    smooth = cv2.GaussianBlur(opened.astype(np.float32), (0, 0), SMOOTHED_PX)
    return np.asarray(np.rint(64.0 * smooth).astype(np.uint16)), on.astype(np.bool_)
