"""A user's picture on the products: read, and laid on from straight above over each one's footprint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.picture_file import read_picture
from roemetry_simulate.products import Drawn
from roemetry_simulate.scene_file import AlbedoMapPart
from roemetry_simulate.surface import Picture

Floats = NDArray[np.float64]

_LUMA = np.array([0.114, 0.587, 0.299])  # ITU-R BT.601, in the order blue, green, red
_BLUE_TO_NM, _GREEN_TO_NM = 500.0, 590.0
_EXTENT_STEP_MM = 0.25


def laid_on(part: AlbedoMapPart, products: Sequence[Drawn], pitch_mm: float, wavelength_nm: float) -> Picture:
    """Lay the picture on every product.

    Parameters
    ----------
    part : AlbedoMapPart
        The file, and what black and white mean.
    products : sequence of Drawn
        What lies on the belt, at least one. The picture's left edge lies at the smallest, its right edge at
        the largest place of the footprint along the product's own x axis (belt X turned by the product's
        yaw), its bottom and top edges likewise along its own y axis.
    pitch_mm : float
        Of the raster that is handed to the renderer.
    wavelength_nm : float
        The laser sees the picture's blue, green or red, whichever is its own.

    Returns
    -------
    Picture
        Factors of the albedo under the laser and in plain light over the belt; 1 beside the products.
    """
    image = read_picture(part.file)
    assert image is not None, "the scene has been checked"
    white = float(np.iinfo(image.dtype).max)
    grey = part.black + (part.white - part.black) * image.astype(np.float64) / white
    ends = np.array([one.solid.footprint_extent_mm() for one in products])
    x = np.arange(ends[:, 0].min() - 1.0, ends[:, 1].max() + 1.0, pitch_mm)
    y = np.arange(ends[:, 2].min() - 1.0, ends[:, 3].max() + 1.0, pitch_mm)
    xx, yy = np.meshgrid(x, y)
    laser, plain = np.ones(xx.shape), np.ones(xx.shape)
    # beside the footprints first, so that no product's surroundings lie on its neighbour
    tops = [one.solid.heights_mm(xx, yy)[0] for one in products]
    for on_it in (False, True):
        for one, top in zip(products, tops, strict=True):
            at_x, at_y = _in_picture(one, xx, yy)
            inside = np.isfinite(top) if on_it else (np.abs(at_x - 0.5) < 0.6) & (np.abs(at_y - 0.5) < 0.6)
            for layer, channel in ((laser, _laser_channel(grey, wavelength_nm)), (plain, _plain(grey))):
                layer[inside] = _looked_up(channel, at_x[inside], at_y[inside])
    matrix = np.zeros((2, 4))
    matrix[0, 0], matrix[1, 1] = 1.0 / pitch_mm, 1.0 / pitch_mm
    matrix[:, 3] = -x[0] / pitch_mm, -y[0] / pitch_mm
    return laser, plain, matrix


def _laser_channel(grey: Floats, wavelength_nm: float) -> Floats:
    if grey.ndim == 2:
        return grey
    channel = 0 if wavelength_nm < _BLUE_TO_NM else 1 if wavelength_nm < _GREEN_TO_NM else 2
    return np.ascontiguousarray(grey[..., channel])


def _plain(grey: Floats) -> Floats:
    return grey if grey.ndim == 2 else np.asarray(grey @ _LUMA, np.float64)


def _in_picture(one: Drawn, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Places along and across a product's own footprint, 0 to 1, of belt positions."""
    turn = np.deg2rad(one.truth.figures.get("yaw_deg", 0.0))
    c, s = np.cos(turn), np.sin(turn)
    x_min, x_max, y_min, y_max = one.solid.footprint_extent_mm()
    there = np.meshgrid(np.arange(x_min, x_max, _EXTENT_STEP_MM), np.arange(y_min, y_max, _EXTENT_STEP_MM))
    on_it = np.isfinite(one.solid.heights_mm(*there)[0])
    along = (c * there[0] + s * there[1])[on_it]
    across = (c * there[1] - s * there[0])[on_it]
    at_x = (c * x + s * y - along.min()) / np.ptp(along)
    at_y = (c * y - s * x - across.min()) / np.ptp(across)
    return at_x, at_y


def _looked_up(channel: Floats, at_x: Floats, at_y: Floats) -> Floats:
    from scipy.ndimage import map_coordinates

    rows, columns = channel.shape
    # the outer edge of the outermost pixels lies at 0 and 1; rows count from the top
    places = [(1.0 - at_y) * rows - 0.5, at_x * columns - 0.5]
    found: Floats = map_coordinates(channel, places, order=1, mode="nearest")
    return found
