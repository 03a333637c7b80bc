"""How bright belt and product are: slowly varying albedo maps over the belt.

Model. Albedo at a place is the mean of its material times a map over X and Y, about 1: blotches of some
millimetres and a finer grain, both white noise through a Gaussian filter, clipped to 0.5 to 1.5. Maps are
looked up by X and Y alone, so a product's texture is projected from above. Gloss is a share of mirror-like
light, light below the surface a share that comes back from a mean depth, wider (`roemetry_simulate.render`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Picture = tuple[Floats, Floats, Floats]


@dataclass(frozen=True, eq=False)
class Surface:
    """Reflectance of everything in view.

    - `x0_mm`, `y0_mm`, `step_mm`: Belt position of node (0, 0) of the maps and their pitch; places outside
      take the border's value.
    - `texture`, shape (rows along Y, columns along X, 2 or 4): Relative brightness, about 1: layer 0 belt,
      layer 1 product. Where there are wet places, layers 2 and 3 hold the gloss of belt and product there,
      where it is more than `gloss`.
    - `laser_albedo`, `plain_albedo`: Mean albedo (belt, product) in the laser's colour and in plain light.
    - `gloss`: Share of mirror-like light (belt, product), spread about the mirror direction with
      `gloss_exponent`.
    - `below`: Light that goes on below the product's surface: its share (0–1), the mean depth it comes back
      from (mm, along the normal: it appears shifted away from the laser), and the standard deviation it is
      spread by (mm).
    - `picture`: A picture stuck on the product: (rows, columns) of factors of its albedo under the laser and
      in plain light, and the (2, 4) matrix that takes a point (x, y, z, 1), mm, to the picture's (column,
      row).
    """

    x0_mm: float
    y0_mm: float
    step_mm: float
    texture: Floats
    laser_albedo: tuple[float, float]
    plain_albedo: tuple[float, float]
    gloss: tuple[float, float] = (0.0, 0.0)
    gloss_exponent: float = 25.0
    below: tuple[float, float, float] = (0.0, 0.0, 0.0)
    picture: Picture | None = None

    def picture_in(self, light: Literal["laser", "plain"]) -> tuple[Floats, Floats]:
        """Return the picture in a light, and its matrix; a picture of one node where there is none."""
        if self.picture is None:
            return np.ones((1, 1)), np.zeros((2, 4))
        laser, plain, matrix = self.picture
        return (laser if light == "laser" else plain), matrix


def even(albedo: float = 1.0) -> Surface:
    """Return one matt albedo for all, without texture."""
    return Surface(0.0, 0.0, 1.0, np.ones((2, 2, 2)), (albedo, albedo), (albedo, albedo))


def textured(
    seed: int,
    view_mm: tuple[float, float, float, float] | None = None,
    *,
    laser_albedo: tuple[float, float],
    plain_albedo: tuple[float, float],
    belt_std: float = 0.04,
    product_std: float = 0.09,
    gloss: tuple[float, float] = (0.0, 0.0),
) -> Surface:
    """Return maps with blotches of a few millimetres and finer grain, drawn from a seed.

    They cover X within ±90 mm and Y within ±70 mm, and the view (X, then Y, from to) where that is larger;
    the deviations are relative. Albedos and gloss: see `Surface`.
    """
    half_x_mm, half_y_mm = 90.0, 70.0
    if view_mm is not None:
        half_x_mm = max(half_x_mm, -view_mm[0], view_mm[1])
        half_y_mm = max(half_y_mm, -view_mm[2], view_mm[3])
    # of a large view the grain gets coarser, not the map larger without end
    step_mm = max(0.5, half_x_mm / 1000.0, half_y_mm / 1000.0)
    half_columns, half_rows = math.ceil(half_x_mm / step_mm), math.ceil(half_y_mm / step_mm)
    shape = (2 * half_rows + 1, 2 * half_columns + 1)
    rng = np.random.default_rng([seed, 11])
    # blotches and grain: sums of two scales, with weights whose squares add to about 1
    belt = 0.6 * smooth_noise(rng, shape, 9.0 / step_mm) + 0.8 * smooth_noise(rng, shape, 0.8 / step_mm)
    product = 0.9 * smooth_noise(rng, shape, 3.5 / step_mm) + 0.45 * smooth_noise(rng, shape, 0.9 / step_mm)
    layers = np.stack([1.0 + belt_std * belt, 1.0 + product_std * product], axis=-1)
    texture = np.clip(layers, 0.5, 1.5)
    x0_mm, y0_mm = -step_mm * half_columns, -step_mm * half_rows
    return Surface(x0_mm, y0_mm, step_mm, texture, laser_albedo, plain_albedo, gloss)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], sigma_nodes: float) -> Floats:
    """Return Gaussian-filtered white noise of mean 0 and deviation 1; the filter's deviation is in nodes."""
    from scipy.ndimage import gaussian_filter

    # wider than the filter, so that the cut-out has no seam
    pad = int(np.ceil(3 * sigma_nodes))
    white = rng.standard_normal((shape[0] + 2 * pad, shape[1] + 2 * pad))
    smooth = gaussian_filter(white, sigma_nodes, mode="wrap")[pad : pad + shape[0], pad : pad + shape[1]]
    noise: Floats = (smooth - smooth.mean()) / max(float(smooth.std()), 1e-12)
    return noise
