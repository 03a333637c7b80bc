"""How much light a point gives back: texture, picture, planes of light, mirror-like part."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel

Floats = NDArray[np.float64]

_REACH = 5.0
"""Deviations from a plane's middle beyond which its light is left out."""


@kernel
def texture_at(maps: Floats, texture: Floats, point: Floats, layer: int) -> float:
    """Bilinear lookup in a layer of the maps over the belt."""
    rows, columns = texture.shape[0], texture.shape[1]
    u = min(max((point[0] - maps[0]) / maps[2], 0.0), columns - 1.0)
    v = min(max((point[1] - maps[1]) / maps[2], 0.0), rows - 1.0)
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - i, v - j
    low = texture[j, i, layer] * (1 - a) + texture[j, i + 1, layer] * a
    high = texture[j + 1, i, layer] * (1 - a) + texture[j + 1, i + 1, layer] * a
    return low * (1 - b) + high * b


@kernel
def gloss_at(albedo: Floats, maps: Floats, texture: Floats, point: Floats, on: int) -> float:
    """Share of mirror-like light at a point: of belt or product, or of a wet place on it."""
    if texture.shape[2] == 2:
        return albedo[2 + on]
    return max(albedo[2 + on], texture_at(maps, texture, point, 2 + on))


@kernel
def picture_at(picture: Floats, picture_from: Floats, point: Floats) -> float:
    """Bilinear lookup in a picture that is stuck on the product; 1 beside it."""
    u = picture_from[0, 3]
    v = picture_from[1, 3]
    for m in range(3):
        u += picture_from[0, m] * point[m]
        v += picture_from[1, m] * point[m]
    rows, columns = picture.shape[0], picture.shape[1]
    if u < 0.0 or v < 0.0 or u > columns - 1.0 or v > rows - 1.0:
        return 1.0
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - i, v - j
    low = picture[j, i] * (1.0 - a) + picture[j, i + 1] * a
    high = picture[j + 1, i] * (1.0 - a) + picture[j + 1, i + 1] * a
    return low * (1.0 - b) + high * b


@kernel
def width_at(fan: Floats, projector: Floats, point: Floats) -> float:
    """Return the planes' standard deviation (mm) at a point's distance from the projector."""
    if fan[3] == 0.0:
        return fan[0]
    away = 0.0
    for m in range(3):
        away += (point[m] - projector[m]) ** 2
    grown = fan[3] * (math.sqrt(away) - fan[2])
    return math.sqrt(fan[0] * fan[0] + grown * grown)


@kernel
def planes_light(planes: Floats, point: Floats, normal: Floats, depth_mm: float, sigma_mm: float) -> float:
    """Light of all planes at a depth below a point of the surface, before the angles are counted.

    The planes fan from one point and are in order, so the few that are near are found by halving.
    """
    x = point[0] - depth_mm * normal[0]
    y = point[1] - depth_mm * normal[1]
    z = point[2] - depth_mm * normal[2]
    reach = _REACH * sigma_mm
    low, high = 0, planes.shape[0]
    while low < high:
        middle = (low + high) // 2
        p = planes[middle]
        if p[0] * x + p[1] * y + p[2] * z - p[3] >= reach:
            low = middle + 1
        else:
            high = middle
    light = 0.0
    for i in range(low, planes.shape[0]):
        p = planes[i]
        away = p[0] * x + p[1] * y + p[2] * z - p[3]
        if away <= -reach:
            break
        away /= sigma_mm
        light += p[4] * math.exp(-0.5 * away * away)
    return light


@kernel
def shine(gloss: float, exponent: float, normal: Floats, beam: Floats, view: Floats) -> float:
    """Mirror-like part: a power of the cosine between the normal and the half-way direction."""
    if gloss == 0.0:
        return 0.0
    length, dot = 0.0, 0.0
    for m in range(3):
        half = beam[m] - view[m]
        length += half * half
        dot += half * normal[m]
    return gloss * max(dot / math.sqrt(length), 0.0) ** exponent
