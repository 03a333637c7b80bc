"""Images of a scene: 4 × 4 samples a pixel, exact occlusion for camera and light."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.bodies import Body, ExactBody
from roemetry_simulate.camera import Camera
from roemetry_simulate.defocus import Focus, defocused, depths_mm
from roemetry_simulate.laser import LaserFan
from roemetry_simulate.lens import camera_ray
from roemetry_simulate.raycast import first_hit, normal_at, sees
from roemetry_simulate.sensor import Sensor, expose
from roemetry_simulate.solid import Solid
from roemetry_simulate.surface import Surface

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rig:
    """What is bolted to the line: camera, sensor, laser and lamps.

    Attributes
    ----------
    camera, sensor, laser
        See their classes.
    ambient_grey : float
        Grey level of a white, level surface with the laser on (stray light, straight from above).
    plain_grey : float
        Grey level of a white, level surface under the plain light with the laser off.
    lamp_height_mm, lamp_radius_mm : float
        The plain light is a ring of lamps about the optical axis.
    focus : Focus or None
        Where the lens is focused; None is sharp everywhere, up to the sensor's own blur.
    """

    camera: Camera
    sensor: Sensor
    laser: LaserFan
    ambient_grey: float = 14.0
    plain_grey: float = 210.0
    lamp_height_mm: float = 260.0
    lamp_radius_mm: float = 130.0
    focus: Focus | None = None


def laser_light(rig: Rig, solid: Solid, surface: Surface, samples: int = 4) -> tuple[Floats, Floats]:
    """Light that reaches the sensor with the laser on, without noise, blur, black level or clipping.

    Parameters
    ----------
    rig, solid, surface
        The scene.
    samples : int
        Samples along each side of a pixel.

    Returns
    -------
    laser, ambient : ndarray, shape (height, width)
        Grey levels.
    """
    camera, laser = rig.camera, rig.laser
    planes = np.column_stack([laser.normals, laser.offsets_mm, laser.peak_grey])
    image = _render_laser(
        solid.body(), camera.packed(), camera.rotation, laser.projector_mm, laser.line_axis, planes,
        laser.packed(), _maps(surface), surface.texture, _albedo(surface, surface.laser_albedo),
        np.array(surface.below, dtype=np.float64), *surface.decal_or_none(),
        (camera.height_px, camera.width_px), samples,
    )  # fmt: skip
    return image[..., 0], rig.ambient_grey * image[..., 1]


def plain_light(rig: Rig, solid: Solid, surface: Surface, samples: int = 4) -> Floats:
    """Light that reaches the sensor under the plain light, without noise, blur, black level or clipping.

    Parameters
    ----------
    rig, solid, surface
        The scene.
    samples : int
        Samples along each side of a pixel; each sample of a pixel sees another lamp of the ring, and the
        four pixels of a square see the lamps between.

    Returns
    -------
    ndarray, shape (height, width)
        Grey levels.
    """
    camera = rig.camera
    count = 4 * samples * samples
    angle = 2.0 * np.pi * np.arange(count) / count
    lamps = np.column_stack(
        [
            rig.lamp_radius_mm * np.cos(angle),
            rig.lamp_radius_mm * np.sin(angle),
            0 * angle + rig.lamp_height_mm,
        ]
    )
    # neighbouring samples see lamps far apart, so that a pixel's sub-areas are lit alike
    order = (np.arange(samples * samples) * 7) % (samples * samples)
    lamps = np.ascontiguousarray(lamps.reshape(samples * samples, 4, 3)[order])
    image: Floats = _render_plain(
        solid.body(), camera.packed(), camera.rotation, lamps, _maps(surface), surface.texture,
        _albedo(surface, surface.plain_albedo), *surface.decal_or_none(),
        (camera.height_px, camera.width_px), samples,
    )  # fmt: skip
    return rig.plain_grey * image


def render(
    rig: Rig, solid: Solid, surface: Surface, *, seed: int, plain: bool = False, samples: int = 4
) -> NDArray[Any]:
    """Take one image of a scene.

    Parameters
    ----------
    rig, solid, surface
        The scene.
    seed : int
        Of speckle and noise.
    plain : bool
        Laser off and plain light on.
    samples : int
        Samples along each side of a pixel.

    Returns
    -------
    ndarray of uint8 (uint16 over 8 bits), shape (height, width)
        The image; the same arguments give the same bytes.
    """
    lens = _lens(rig, solid)
    if plain:
        steady = plain_light(rig, solid, surface, samples)
        return expose(np.zeros_like(steady), steady, rig.sensor, seed, lens)
    laser, ambient = laser_light(rig, solid, surface, samples)
    return expose(laser, ambient, rig.sensor, seed, lens)


def _lens(rig: Rig, solid: Solid) -> Callable[[Floats], Floats] | None:
    """Give the blur of a lens that is not sharp everywhere."""
    focus = rig.focus
    if focus is None:
        return None
    depth_mm = depths_mm(rig.camera, solid)
    return lambda light: defocused(light, rig.camera, focus, depth_mm)


def _maps(surface: Surface) -> Floats:
    return np.array([surface.x0_mm, surface.y0_mm, surface.step_mm])


def _albedo(surface: Surface, mean: tuple[float, float]) -> Floats:
    return np.array([*mean, *surface.gloss, surface.gloss_exponent])


@kernel
def _texture(maps: Floats, texture: Floats, point: Floats, on: int) -> float:
    """Bilinear lookup of the belt's or the product's texture."""
    rows, columns = texture.shape[0], texture.shape[1]
    u = min(max((point[0] - maps[0]) / maps[2], 0.0), columns - 1.0)
    v = min(max((point[1] - maps[1]) / maps[2], 0.0), rows - 1.0)
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - i, v - j
    low = texture[j, i, on] * (1 - a) + texture[j, i + 1, on] * a
    high = texture[j + 1, i, on] * (1 - a) + texture[j + 1, i + 1, on] * a
    return low * (1 - b) + high * b


@kernel
def _render_laser(
    body: Body | ExactBody, pinhole: Floats, rotation: Floats, projector: Floats, axis: Floats,
    planes: Floats, fan: Floats, maps: Floats, texture: Floats, albedo: Floats, below: Floats, decal: Floats,
    decal_from: Floats, shape: tuple[int, int], samples: int,
) -> Floats:  # fmt: skip
    image = np.zeros((shape[0], shape[1], 2))
    point, normal, view = np.zeros(3), np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    origin = pinhole[:3].copy()
    share = 1.0 / (samples * samples)
    for row in range(shape[0]):
        for column in range(shape[1]):
            for k in range(samples * samples):
                x_px = column + (k % samples + 0.5) / samples - 0.5
                y_px = row + (k // samples + 0.5) / samples - 0.5
                camera_ray(pinhole, rotation, x_px, y_px, view)
                on = first_hit(body, origin, view, 1e-4, point)
                if on < 0:
                    continue
                normal_at(body, on, point, normal)
                grey = albedo[on] * _texture(maps, texture, point, on)
                if on == 1 and decal.size > 1:
                    grey *= _decal(decal, decal_from, point)
                image[row, column, 1] += share * grey * (0.5 + 0.5 * normal[2])
                wide = _width(fan, projector, point)
                light = _planes(planes, point, normal, 0.0, wide) * (fan[0] / wide)
                soft = 0.0
                if on == 1 and below[0] > 0.0:
                    spread = math.sqrt(wide * wide + below[2] * below[2])
                    soft = below[0] * _planes(planes, point, normal, below[1], spread) * (fan[0] / spread)
                if light == 0.0 and soft == 0.0:
                    continue
                cosine = sees(body, point, normal, projector, beam, scratch)
                if cosine == 0.0:
                    continue
                run = 0.0
                for m in range(3):
                    run -= beam[m] * axis[m]
                angle = math.asin(run) / fan[1]
                fall = math.exp(-0.5 * angle * angle)
                light *= fall
                if on == 1 and below[0] > 0.0:
                    shine = _shine(albedo[2 + on], albedo[4], normal, beam, view)
                    scattered = grey * cosine * ((1.0 - below[0]) * light + fall * soft)
                    image[row, column, 0] += share * (scattered + light * shine)
                    continue
                image[row, column, 0] += (
                    share * light * (grey * cosine + _shine(albedo[2 + on], albedo[4], normal, beam, view))
                )
    return image


@kernel
def _width(fan: Floats, projector: Floats, point: Floats) -> float:
    """Return the planes' standard deviation (mm) at a point's distance from the projector."""
    if fan[3] == 0.0:
        return fan[0]
    away = 0.0
    for m in range(3):
        away += (point[m] - projector[m]) ** 2
    grown = fan[3] * (math.sqrt(away) - fan[2])
    return math.sqrt(fan[0] * fan[0] + grown * grown)


@kernel
def _planes(planes: Floats, point: Floats, normal: Floats, depth_mm: float, sigma_mm: float) -> float:
    """Light of all planes at a depth below a point of the surface, before the angles are counted."""
    light = 0.0
    for i in range(planes.shape[0]):
        away = -planes[i, 3]
        for m in range(3):
            away += planes[i, m] * point[m]
        if depth_mm != 0.0:
            for m in range(3):
                away -= depth_mm * planes[i, m] * normal[m]
        away /= sigma_mm
        if abs(away) < 5.0:
            light += planes[i, 4] * math.exp(-0.5 * away * away)
    return light


@kernel
def _decal(decal: Floats, decal_from: Floats, point: Floats) -> float:
    """Bilinear lookup in a picture that is stuck on the product; 1 beside it."""
    u = decal_from[0, 3]
    v = decal_from[1, 3]
    for m in range(3):
        u += decal_from[0, m] * point[m]
        v += decal_from[1, m] * point[m]
    rows, columns = decal.shape[0], decal.shape[1]
    if u < 0.0 or v < 0.0 or u > columns - 1.0 or v > rows - 1.0:
        return 1.0
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - i, v - j
    low = decal[j, i] * (1.0 - a) + decal[j, i + 1] * a
    high = decal[j + 1, i] * (1.0 - a) + decal[j + 1, i + 1] * a
    return low * (1.0 - b) + high * b


@kernel
def _shine(gloss: float, exponent: float, normal: Floats, beam: Floats, view: Floats) -> float:
    """Mirror-like part: a power of the cosine between the normal and the half-way direction."""
    if gloss == 0.0:
        return 0.0
    length, dot = 0.0, 0.0
    for m in range(3):
        half = beam[m] - view[m]
        length += half * half
        dot += half * normal[m]
    return gloss * max(dot / math.sqrt(length), 0.0) ** exponent


@kernel
def _render_plain(
    body: Body | ExactBody, pinhole: Floats, rotation: Floats, lamps: Floats, maps: Floats, texture: Floats,
    albedo: Floats, decal: Floats, decal_from: Floats, shape: tuple[int, int], samples: int,
) -> Floats:  # fmt: skip
    image = np.zeros(shape)
    point, normal, view = np.zeros(3), np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    origin = pinhole[:3].copy()
    share = 1.0 / (samples * samples)
    first = lamps[0, 0]
    level = first[2] / math.sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    for row in range(shape[0]):
        for column in range(shape[1]):
            for k in range(samples * samples):
                x_px = column + (k % samples + 0.5) / samples - 0.5
                y_px = row + (k // samples + 0.5) / samples - 0.5
                camera_ray(pinhole, rotation, x_px, y_px, view)
                on = first_hit(body, origin, view, 1e-4, point)
                if on < 0:
                    continue
                normal_at(body, on, point, normal)
                lamp = lamps[k, 2 * (row % 2) + column % 2]
                cosine = sees(body, point, normal, lamp, beam, scratch)
                grey = albedo[on] * _texture(maps, texture, point, on)
                if on == 1 and decal.size > 1:
                    grey *= _decal(decal, decal_from, point)
                light = 0.25 * (0.5 + 0.5 * normal[2]) * grey
                if cosine > 0.0:
                    shine = _shine(0.5 * albedo[2 + on], albedo[4], normal, beam, view)
                    light += 0.75 * (grey * cosine / level + shine)
                image[row, column] += share * light
    return image
