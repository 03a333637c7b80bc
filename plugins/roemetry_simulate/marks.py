"""What spoils belt and product: dirt, dark patches, wet places; and the user's picture on the product."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.products import Drawn
from roemetry_simulate.render import Rig
from roemetry_simulate.scene_camera import view_mm
from roemetry_simulate.scene_file import RayCasterOptions
from roemetry_simulate.surface import Surface

Floats = NDArray[np.float64]


def marked(
    surface: Surface, scene: RayCasterOptions, rig: Rig, products: Sequence[Drawn], seed: int
) -> Surface:
    """Put the scene's marks on belt and products.

    Parameters
    ----------
    surface : Surface
        Clean belt and product.
    scene : RayCasterOptions
        Says what there is: `belt.dirt`, `belt.patches`, `surface.wet`, `surface.albedo_map`.
    rig : Rig
        Dirt lies anywhere in its view.
    products : sequence of Drawn
        Wet places lie over their footprints' extents, and so does the picture.
    seed : int
        Of the places and sizes.

    Returns
    -------
    Surface
        The same where the scene names none.
    """
    dirt, wet, patches = scene.belt.dirt, scene.surface.wet, scene.belt.patches
    texture = surface.texture
    x, y = _nodes(surface)
    if dirt.count or patches:
        belt = texture[..., 0].copy()
        spots = _spots(np.random.default_rng([seed, 61]), dirt.count, dirt.diameter_mm, view_mm(rig.camera))
        belt *= 1.0 - (1.0 - dirt.albedo) * _covered(spots, x, y, surface.step_mm)
        for patch in patches:
            away = np.maximum(
                np.maximum(patch.x_mm[0] - x, x - patch.x_mm[1])[None, :],
                np.maximum(patch.y_mm[0] - y, y - patch.y_mm[1])[:, None],
            )
            share = np.clip(0.5 - away / surface.step_mm, 0.0, 1.0)
            belt = belt * (1.0 - share) + share * patch.albedo * texture[..., 0]
        texture = np.stack([belt, texture[..., 1]], axis=-1)
    if wet.count and products:
        rng = np.random.default_rng([seed, 67])
        spots = np.concatenate(
            [_spots(rng, wet.count, wet.diameter_mm, one.solid.footprint_extent_mm()) for one in products]
        )
        gloss = wet.gloss * _covered(spots, x, y, surface.step_mm)
        texture = np.concatenate([texture, np.zeros_like(gloss)[..., None], gloss[..., None]], axis=-1)
    if texture is not surface.texture:
        surface = replace(surface, texture=np.ascontiguousarray(texture))
    if scene.surface.albedo_map is not None and products:
        from roemetry_simulate.albedo_map import laid_on

        # two nodes of the picture for each pixel of the image
        pitch_mm = 0.5 * rig.camera.centre_mm[2] / rig.camera.focal_length_px
        picture = laid_on(scene.surface.albedo_map, products, pitch_mm, scene.laser.wavelength_nm)
        surface = replace(surface, picture=picture)
    return surface


def _nodes(surface: Surface) -> tuple[Floats, Floats]:
    rows, columns = surface.texture.shape[:2]
    x = surface.x0_mm + surface.step_mm * np.arange(columns, dtype=np.float64)
    y = surface.y0_mm + surface.step_mm * np.arange(rows, dtype=np.float64)
    return x, y


def _spots(
    rng: np.random.Generator, count: int, diameter_mm: tuple[float, float], ends: tuple[float, ...]
) -> Floats:
    """Draw x, y and radius of spots, shape (count, 3), uniformly within (x_min, x_max, y_min, y_max)."""
    x, y = rng.uniform(ends[0], ends[1], count), rng.uniform(ends[2], ends[3], count)
    return np.column_stack([x, y, 0.5 * rng.uniform(*diameter_mm, count)])


def _covered(spots: Floats, x: Floats, y: Floats, step_mm: float) -> Floats:
    """Share of each node's surroundings that spots cover, shape (len(y), len(x))."""
    covered = np.zeros((y.size, x.size))
    for at_x, at_y, radius in spots:
        columns = np.flatnonzero(np.abs(x - at_x) <= radius + step_mm)
        rows = np.flatnonzero(np.abs(y - at_y) <= radius + step_mm)
        if not (columns.size and rows.size):
            continue
        here = np.ix_(rows, columns)
        away = np.hypot(x[columns] - at_x, (y[rows] - at_y)[:, None]) - radius
        covered[here] = np.maximum(covered[here], np.clip(0.5 - away / step_mm, 0.0, 1.0))
    return covered
