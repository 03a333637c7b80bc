"""Closed rings of points in the image: normals, samples along them, smoothing around them."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_volume.silhouette import area_of


def along_normals(image: Floats, ring: Floats, normal: Floats, off_px: Floats) -> Floats:
    """Sample an image (n, m) at distances along the normals of a ring."""
    import cv2

    at = ring[:, None, :] + off_px[None, :, None] * normal[:, None, :]
    x, y = at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


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
