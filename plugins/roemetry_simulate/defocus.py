"""Blur of the lens that grows away from the distance it is focused on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.camera import Camera, camera_ray
from roemetry_simulate.raycast import AnyBody, first_hit_in
from roemetry_simulate.sensor import blurred
from roemetry_simulate.solid import Solid

Floats = NDArray[np.float64]

_LEVELS = 8


@dataclass(frozen=True)
class Focus:
    """Where the lens is focused, and how wide it is open.

    Attributes
    ----------
    distance_mm : float
        From the pinhole along the optical axis.
    f_number : float
        Focal length over the aperture's diameter.
    """

    distance_mm: float
    f_number: float


def blur_sigma_px(camera: Camera, focus: Focus, depth_mm: Floats) -> Floats:
    """Return the standard deviation of the blur of points at given depths.

    Parameters
    ----------
    camera : Camera
        Its focal length and pixel size count.
    focus : Focus
        Of its lens.
    depth_mm : ndarray
        Distance along the optical axis.

    Returns
    -------
    ndarray, same shape
        A quarter of the thin lens's circle of confusion, px (the deviation of an evenly lit disc).
    """
    f = camera.focal_length_mm
    circle_mm = f / focus.f_number * f / (focus.distance_mm - f) * np.abs(depth_mm / focus.distance_mm - 1.0)
    sigma: Floats = 0.25 * circle_mm * (focus.distance_mm / depth_mm) / camera.pixel_size_mm
    return sigma


def defocused(light: Floats, camera: Camera, focus: Focus, depth_mm: Floats) -> Floats:
    """Blur an image as its depths ask for.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Light on the sensor of a lens that is sharp everywhere.
    camera, focus
        See `blur_sigma_px`.
    depth_mm : ndarray, shape (height, width)
        What `depths_mm` gives.

    Returns
    -------
    ndarray, shape (height, width)
        Each pixel from images blurred by the two nearest of eight amounts.
    """
    sigma = blur_sigma_px(camera, focus, depth_mm)
    low, high = float(sigma.min()), float(sigma.max())
    if high <= 0.0:
        return light
    amounts = np.linspace(low, high, _LEVELS if high - low > 1e-3 else 1)
    stack = np.stack([blurred(light, float(amount)) for amount in amounts])
    if len(amounts) == 1:
        return np.asarray(stack[0], np.float64)
    at = (sigma - low) / (high - low) * (_LEVELS - 1)
    level = np.minimum(at.astype(np.int64), _LEVELS - 2)
    part = at - level
    lower = np.take_along_axis(stack, level[None], axis=0)[0]
    upper = np.take_along_axis(stack, level[None] + 1, axis=0)[0]
    mixed: Floats = lower * (1.0 - part) + upper * part
    return mixed


def depths_mm(camera: Camera, solid: Solid) -> Floats:
    """Return how far along the optical axis each pixel's middle sees; the belt's where it sees nothing."""
    found: Floats = _depths(solid.body(), camera.packed(), camera.rotation, camera.height_px, camera.width_px)
    return np.where(np.isfinite(found), found, np.nanmax(found))


@kernel
def _depths(body: AnyBody, pinhole: Floats, rotation: Floats, rows: int, columns: int) -> Floats:
    depth = np.full((rows, columns), np.nan)
    view, point = np.zeros(3), np.zeros(3)
    reach = body.reach
    for row in range(rows):
        for column in range(columns):
            camera_ray(pinhole, rotation, column, row, view)
            if first_hit_in(body, reach, pinhole[:3], view, 1e-3, point) < 0:
                continue
            depth[row, column] = 0.0
            for k in range(3):
                depth[row, column] += rotation[k, 2] * (point[k] - pinhole[k])
    return depth
