"""Rendering: light on every sample of a pixel, its reflection by the surface, and the sensor's grey levels.

A pixel is the mean of `samples`² rays. Where a ray meets a surface of albedo ρ, a plane of light adds

    ρ · P · exp(−a² / 2σ²) · σ₀/σ · exp(−θ² / 2f²) · cos i     if the point is lit,

with a the distance from the plane, σ the light's width there (σ₀ at its waist), θ the angle along the line,
f its fall and i the angle of incidence; a power of the half-way cosine adds gloss. Light below the surface of
translucent food is the same at a mean depth along the normal, wider. Steady light comes from straight above,
plain light from a ring of lamps. The sensor then multiplies the laser's light by log-normal speckle, blurs,
draws shot noise (Poisson electrons), cuts at the full well, adds read noise and rounds. Left out: light that
is scattered between surfaces, motion, and planes that are cones.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.optics import Camera, Focus, LaserFan, blurred, camera_ray, defocused, depths_mm
from roemetry_simulate.raycast import AnyBody, first_hit, normal_at, sees
from roemetry_simulate.solid import Solid
from roemetry_simulate.surface import Surface

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Sensor:
    """What the camera does to the light.

    - `grey_per_electron`: Gain; shot noise has the variance `grey_per_electron` × grey level.
    - `read_noise_grey`: Standard deviation of the noise that is there without light.
    - `black_level_grey`: Grey level without light.
    - `psf_sigma_px`: Gaussian blur of the lens on the sensor.
    - `speckle_contrast`: Standard deviation over mean of the laser light's speckle as the camera sees it.
    - `speckle_sigma_px`: Gaussian filter that sets the grain of the speckle.
    - `full_well_e`: Electrons a pixel holds; what comes beyond is lost.
    - `bit_depth`: 8 to 16: the highest grey level is 2**bit_depth − 1.
    """

    grey_per_electron: float = 0.0255
    read_noise_grey: float = 1.0
    black_level_grey: float = 4.0
    psf_sigma_px: float = 0.5
    speckle_contrast: float = 0.10
    speckle_sigma_px: float = 0.7
    full_well_e: float = math.inf
    bit_depth: int = 8


@dataclass(frozen=True)
class Rig:
    """What is bolted to the line: camera, sensor, laser and lamps.

    - `camera`, `sensor`, `laser`: See their classes.
    - `ambient_grey`: Grey level of a white, level surface with the laser on (stray light, straight from
      above).
    - `plain_grey`: Grey level of a white, level surface under the plain light with the laser off.
    - `lamp_height_mm`, `lamp_radius_mm`: The plain light is a ring of lamps about the optical axis.
    - `stray_mm`: Where a lamp is that is always on, which glossy places mirror; None is none.
    - `stray_grey`: Grey level of a white surface that faces this lamp.
    - `focus`: Where the lens is focused; None is sharp everywhere, up to the sensor's own blur.
    - `colour_leak`: The planes are of two colours in turn, red first, and each of the camera's channels also
      passes so much of the other colour; None is one colour, and a grey image.
    """

    camera: Camera
    sensor: Sensor
    laser: LaserFan
    ambient_grey: float = 14.0
    plain_grey: float = 210.0
    lamp_height_mm: float = 260.0
    lamp_radius_mm: float = 130.0
    stray_mm: tuple[float, float, float] | None = None
    stray_grey: float = 0.0
    focus: Focus | None = None
    colour_leak: float | None = None


def laser_light(
    rig: Rig, solid: Solid, surface: Surface, samples: int = 4, *, draft: bool = False
) -> tuple[Floats, Floats]:
    """Light of the laser and of all else, grey levels over black, without noise, blur or clipping."""
    laser, steady = _fan_light(rig, solid, surface, samples, draft=draft)
    if rig.laser.across is not None:
        # light adds: both families fall on the same surface without regard to each other
        laser += _fan_light(replace(rig, laser=rig.laser.across), solid, surface, samples, draft=draft)[0]
    return laser, steady


def _fan_light(
    rig: Rig, solid: Solid, surface: Surface, samples: int, *, draft: bool
) -> tuple[Floats, Floats]:
    """Light of one family of planes and of all else."""
    image = np.zeros((rig.camera.height_px, rig.camera.width_px, 3))
    if draft:
        _light(rig, solid, surface, 1, image, step=_DRAFT_STEP)
        # laser, ambient and stray in grey levels, so that one limit says where an image is uneven
        grey = _rays_of(image) @ np.array([1.0, rig.ambient_grey, rig.stray_grey])
        _fill_between(image)
        _light(rig, solid, surface, _DRAFT_SAMPLES, image, _around(_uneven(grey), image.shape))
    else:
        _light(rig, solid, surface, samples, image)
    return image[..., 0], rig.ambient_grey * image[..., 1] + rig.stray_grey * image[..., 2]


def _light(
    rig: Rig, solid: Solid, surface: Surface, samples: int, image: Floats, where: Flags | None = None,
    *, step: int = 1,
) -> None:  # fmt: skip
    """Write light of the laser, light from straight above and light of the stray lamp, (height, width, 3).

    Only into the pixels of `where`, shape (height, width), of every `step` rows and columns.
    """
    camera, laser = rig.camera, rig.laser
    planes = np.column_stack([laser.normals, laser.offsets_mm, laser.peak_grey])
    # n·X = d, and the grey level in the plane's middle
    if len(laser.halves):  # one half stands for the whole circle
        # halves are in order from the left ones inwards; those of the right half alone are each circle once
        planes = np.column_stack([planes, laser.halves[:, 0]])[laser.count // 2 :]
    stray = np.zeros(4) if rig.stray_mm is None else np.array([*rig.stray_mm, 1.0])
    _render_laser(
        solid.body(), camera.packed(), camera.rotation, laser.projector_mm, laser.line_axis, planes,
        laser.rows, laser.packed(), stray, _maps(surface), surface.texture,
        _albedo(surface, surface.laser_albedo),
        np.array(surface.below, dtype=np.float64), *surface.picture_in("laser"),
        image, np.ones(image.shape[:2], bool) if where is None else where, samples, step,
    )  # fmt: skip


def plain_light(rig: Rig, solid: Solid, surface: Surface, samples: int = 4, *, draft: bool = False) -> Floats:
    """Light of an image under the plain light, grey levels, without noise, blur, black level or clipping.

    Each sample of a pixel sees another lamp of the ring, and the four pixels of a square see the lamps
    between. A draft's rays see one lamp of sixteen each: of the light, not of what it falls on, the mean over
    neighbours is taken, which see all of them.
    """
    camera = rig.camera
    image = np.zeros((camera.height_px, camera.width_px))
    if draft:
        from scipy.ndimage import convolve1d, maximum_filter

        look = np.zeros((camera.height_px, camera.width_px, 2))
        _under_lamps(rig, solid, surface, 1, look, square=4, step=_DRAFT_STEP)
        albedo, light = np.moveaxis(_rays_of(look), 2, 0)
        for axis in (0, 1):  # takes out what alternates over four rays, and keeps what is even
            light = convolve1d(light, [0.125, 0.25, 0.25, 0.25, 0.125], axis, mode="mirror")
        _rays_of(image)[...] = albedo * light
        _fill_between(image)
        uneven = _uneven(rig.plain_grey * albedo * light)
        # within what the mean makes of a shadow's edge its middle has no bend
        uneven |= maximum_filter(_uneven(rig.plain_grey * light), 5)
        _under_lamps(rig, solid, surface, _DRAFT_SAMPLES, image[..., None], _around(uneven, image.shape))
    else:
        _under_lamps(rig, solid, surface, samples, image[..., None])
    if rig.stray_mm is None:
        return rig.plain_grey * image
    # the stray lamp needs the laser's renderer: the same, with dark planes
    dark = replace(rig, laser=replace(rig.laser, peak_grey=np.zeros(rig.laser.count)))
    stray = np.zeros((*image.shape, 3))
    _light(dark, solid, surface, samples, stray)
    return rig.plain_grey * image + rig.stray_grey * stray[..., 2]


def _under_lamps(
    rig: Rig, solid: Solid, surface: Surface, samples: int, image: Floats, where: Flags | None = None,
    *, square: int = 2, step: int = 1,
) -> None:  # fmt: skip
    """Write the light of the ring of lamps into the pixels of `where`, of every `step` rows and columns.

    `image` is (height, width, 1); or (height, width, 2) for albedo, and light over albedo. `square` is the
    side, in `step` px, of the squares within which each pixel sees other lamps.
    """
    camera = rig.camera
    count = square**2 * samples * samples
    # as many lamps as samples in a square of pixels: each sample sees one, the square all of them
    angle = 2.0 * np.pi * np.arange(count) / count
    x, y = rig.lamp_radius_mm * np.cos(angle), rig.lamp_radius_mm * np.sin(angle)
    lamps = np.column_stack([x, y, np.full(count, rig.lamp_height_mm)])
    # neighbouring samples see lamps far apart, so that a pixel's sub-areas are lit alike
    order = (np.arange(samples * samples) * 7) % (samples * samples)
    lamps = np.ascontiguousarray(lamps.reshape(samples * samples, square**2, 3)[order])
    _render_plain(
        solid.body(), camera.packed(), camera.rotation, lamps, _maps(surface), surface.texture,
        _albedo(surface, surface.plain_albedo), *surface.picture_in("plain"),
        image, np.ones(image.shape[:2], bool) if where is None else where, samples, step,
    )  # fmt: skip


_DRAFT_STEP = 2
"""A draft's first look casts one ray into every second pixel of every second row."""
_DRAFT_SAMPLES = 2
"""Along each side of an uneven pixel in a draft: an edge is right to half a pixel, and the lens blurs it."""
_BEND_GREY = 6.0
"""Sum of second differences, grey levels, above which one ray is not enough for a pixel: the mean over a
pixel differs from its middle by a 24th of it, here by a quarter of a grey level; noise is one or more."""


def _rays_of(image: NDArray[Any]) -> NDArray[Any]:
    """Give the pixels of a first look that rays were cast into, as a view."""
    return image[::_DRAFT_STEP, ::_DRAFT_STEP]


def _fill_between(image: Floats) -> None:
    """Fill the pixels between the rays of a first look, (height, width, …), straight from one to the next."""
    # first along the columns of the rows that were cast, then whole rows between these
    for whole in (np.swapaxes(image[::_DRAFT_STEP], 0, 1), image):
        whole[1:-1:2] = 0.5 * (whole[:-2:2] + whole[2::2])
        # an even length has no ray at its end
        if len(whole) % 2 == 0:
            whole[-1] = whole[-2]


def _uneven(grey: Floats) -> Flags:
    """Find the rays of a first look, (row, column), whose neighbours do not tell them: edges, stripes."""
    from scipy.ndimage import laplace

    return np.asarray(np.abs(laplace(grey, mode="nearest")) > _BEND_GREY)


def _around(rays: Flags, shape: tuple[int, ...]) -> Flags:
    """Give the pixels, (height, width), of these rays and next to them."""
    from scipy.ndimage import maximum_filter

    pixels = np.zeros(shape[:2], np.bool_)
    _rays_of(pixels)[...] = rays
    return np.asarray(maximum_filter(pixels, 2 * _DRAFT_STEP - 1))


def render(
    rig: Rig, solid: Solid, surface: Surface, *, seed: int, plain: bool = False, samples: int = 4,
    draft: bool = False,
) -> NDArray[Any]:  # fmt: skip
    """Take one image of a scene: uint8, or uint16 over 8 bits; the same arguments give the same bytes.

    The seed is that of speckle and noise; `plain` is laser off and plain light on; `samples` stand along
    each side of a pixel. A draft casts a ray into each fourth pixel, and four into each where these show
    edges or stripes.
    """
    lens = None
    # the depth tells how far out of focus each pixel is
    if (focus := rig.focus) is not None:
        lens = partial(defocused, camera=rig.camera, focus=focus, depth_mm=depths_mm(rig.camera, solid))
    if plain:
        steady = plain_light(rig, solid, surface, samples, draft=draft)
        grey = expose(np.zeros_like(steady), steady, rig.sensor, seed, lens, draft=draft)
        # white light: a camera with colours has the same picture in each
        return grey if rig.colour_leak is None else np.repeat(grey[..., None], 3, axis=2)
    if rig.colour_leak is not None:
        return _in_colours(rig, rig.colour_leak, solid, surface, seed, samples, lens, draft=draft)
    laser, ambient = laser_light(rig, solid, surface, samples, draft=draft)
    return expose(laser, ambient, rig.sensor, seed, lens, draft=draft)


def _in_colours(
    rig: Rig, leak: float, solid: Solid, surface: Surface, seed: int, samples: int,
    lens: Callable[[Floats], Floats] | None, *, draft: bool,
) -> NDArray[Any]:  # fmt: skip
    """Take an image of planes that are red and green in turn, (row, column, colour): blue, green, red."""
    # planes in turn: even numbers are red, odd ones green
    turn = np.arange(rig.laser.count) % 2
    families = (
        replace(rig.laser, peak_grey=np.where(turn == one, rig.laser.peak_grey, 0.0)) for one in (0, 1)
    )
    (red, steady), (green, _) = (
        laser_light(replace(rig, laser=family), solid, surface, samples, draft=draft) for family in families
    )
    # blue sees nothing of either
    channels = np.zeros_like(red), green + leak * red, red + leak * green
    # far apart from the seeds of other items
    seeds = (seed + one * 2**33 for one in (2, 1, 0))  # each channel has a noise of its own
    return np.stack(
        [
            expose(light, steady, rig.sensor, one, lens, draft=draft)
            for light, one in zip(channels, seeds, strict=True)
        ],
        axis=2,
    )


def as_stored(pixels: NDArray[Any], turn_deg: int) -> NDArray[Any]:
    """Return an image as it is stored: a counter-clockwise turn by `turn_deg` rights it."""
    return np.ascontiguousarray(np.rot90(pixels, -turn_deg // 90))


def _maps(surface: Surface) -> Floats:
    return np.array([surface.x0_mm, surface.y0_mm, surface.step_mm])


def _albedo(surface: Surface, mean: tuple[float, float]) -> Floats:
    return np.array([*mean, *surface.gloss, surface.gloss_exponent])


def expose(
    laser: Floats, steady: Floats, sensor: Sensor, seed: int, lens: Callable[[Floats], Floats] | None = None,
    *, draft: bool = False,
) -> NDArray[Any]:  # fmt: skip
    """Take a picture of light in grey levels without noise: uint8, or uint16 over 8 bits.

    The same seed gives the same bytes; `lens` blurs the image before the sensor's own blur. A draft's shot
    noise is normal, with the variance of Poisson's: of 20 electrons and read noise, a skewness below 0.2.
    """
    rng = np.random.default_rng([seed, 29])
    kind: Any = np.float32 if draft else np.float64
    # speckle is the laser's alone; in a draft without laser no field is drawn
    light = steady.astype(kind)
    if sensor.speckle_contrast > 0.0 and (not draft or laser.any()):
        light += _speckle(rng, laser.shape, sensor, kind) * laser
    else:
        light += laser
    # the lens's blur comes after speckle and before shot noise: photons are counted on the sensor
    light = blurred(light if lens is None else lens(light), sensor.psf_sigma_px)
    # blur may leave tiny negative values
    electrons = np.maximum(light, 0.0) / kind(sensor.grey_per_electron)
    if draft:
        electrons += np.sqrt(electrons) * rng.standard_normal(light.shape, kind)
    else:
        electrons = rng.poisson(electrons)
    # what does not fit into the well is lost, before the read noise
    if math.isfinite(sensor.full_well_e):
        electrons = np.minimum(electrons, int(sensor.full_well_e))
    grey = electrons * kind(sensor.grey_per_electron) + kind(sensor.black_level_grey)
    # read noise does not depend on the light
    grey += kind(sensor.read_noise_grey) * rng.standard_normal(laser.shape, kind)
    white = 2**sensor.bit_depth - 1
    return np.clip(np.floor(grey + 0.5), 0, white).astype(np.uint8 if sensor.bit_depth <= 8 else np.uint16)


def _speckle(rng: np.random.Generator, shape: tuple[int, ...], sensor: Sensor, kind: Any) -> Floats:
    """Return a positive field of mean 1 (log-normal) with the sensor's speckle contrast."""
    noise = rng.standard_normal(shape, kind)
    if sensor.speckle_sigma_px > 0.0:
        noise = blurred(noise, sensor.speckle_sigma_px)
        # blurring has made the noise smaller; contrast is set on the blurred grain
        noise /= noise.std()
    # log-normal: exp of a normal number with variance ln(1 + contrast²) and the mean that makes its own 1
    spread = kind(np.sqrt(np.log1p(sensor.speckle_contrast**2)))
    grain: Floats = np.exp(spread * noise - kind(0.5) * spread**2)
    return grain


@kernel
def _render_laser(
    body: AnyBody, pinhole: Floats, rotation: Floats, projector: Floats, axis: Floats, planes: Floats,
    rows: Floats, fan: Floats, stray: Floats, maps: Floats, texture: Floats, albedo: Floats, below: Floats,
    picture: Floats, picture_from: Floats, image: Floats, where: Flags, samples: int,
    step: int,
) -> None:  # fmt: skip
    point, normal, view = np.zeros(3), np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    origin, reach = pinhole[:3].copy(), body.reach
    share = 1.0 / (samples * samples)
    for row in range(0, where.shape[0], step):
        for column in range(0, where.shape[1], step):
            if not where[row, column]:
                continue
            image[row, column] = 0.0
            # samples stand in the middles of equal squares of the pixel, whose middle is its coordinate
            for k in range(samples * samples):
                x_px = column + (k % samples + 0.5) / samples - 0.5
                y_px = row + (k // samples + 0.5) / samples - 0.5
                camera_ray(pinhole, rotation, x_px, y_px, view)
                # beside belt and product nothing comes back
                on = first_hit(body, reach, origin, view, 1e-4, point)
                if on < 0:
                    continue
                normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
                grey = albedo[on] * texture_at(maps, texture, point, on)
                if on == 1:
                    normal_at(body, on, point, normal)
                    if picture.size > 1:
                        grey *= picture_at(picture, picture_from, point)
                # as of a bright sky: all of it on a level surface, half on a wall
                image[row, column, 1] += share * grey * (0.5 + 0.5 * normal[2])
                if stray[3] > 0.0:
                    # 0 where the lamp is behind the surface or hidden
                    cosine = sees(body, reach, point, normal, stray[:3], beam, scratch)
                    if cosine > 0.0:
                        gloss = gloss_at(albedo, maps, texture, point, on)
                        mirrored = specular(gloss, albedo[4], normal, beam, view)
                        image[row, column, 2] += share * (grey * cosine + mirrored)
                wide = width_at(fan, projector, point)
                # where the beam is wide its light is spread: the peak falls as the width grows
                light = pattern_light(planes, rows, projector, point, normal, 0.0, wide) * (fan[0] / wide)
                soft = 0.0
                if on == 1 and below[0] > 0.0:
                    # below the surface the light is wider by the scattering, as independent deviations add
                    spread = math.sqrt(wide * wide + below[2] * below[2])
                    soft = below[0] * pattern_light(planes, rows, projector, point, normal, below[1], spread)
                    soft *= fan[0] / spread
                # far from every plane: no shadow ray is cast, which most samples are spared
                if light == 0.0 and soft == 0.0:
                    continue
                cosine = sees(body, reach, point, normal, projector, beam, scratch)
                if cosine == 0.0:
                    continue
                # sine of the angle between beam and the plane across the lines: where along the line the
                # point lies
                run = 0.0
                for m in range(3):
                    run -= beam[m] * axis[m]
                angle = math.asin(run) / fan[1]
                fall = math.exp(-0.5 * angle * angle)
                light *= fall
                mirrored = specular(gloss_at(albedo, maps, texture, point, on), albedo[4], normal, beam, view)
                if on == 1 and below[0] > 0.0:
                    # what goes below the surface is not reflected at it; gloss is not scattered
                    scattered = grey * cosine * ((1.0 - below[0]) * light + fall * soft)
                    image[row, column, 0] += share * (scattered + light * mirrored)
                else:
                    image[row, column, 0] += share * light * (grey * cosine + mirrored)


@kernel
def _render_plain(
    body: AnyBody, pinhole: Floats, rotation: Floats, lamps: Floats, maps: Floats, texture: Floats,
    albedo: Floats, picture: Floats, picture_from: Floats, image: Floats, where: Flags, samples: int,
    step: int,
) -> None:  # fmt: skip
    point, normal, view = np.zeros(3), np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    origin, reach = pinhole[:3].copy(), body.reach
    share = 1.0 / (samples * samples)
    apart = image.shape[2] == 2
    first = lamps[0, 0]
    # cosine at which a lamp of the ring lights a level surface at the origin: what `plain_grey` is meant for
    level = first[2] / math.sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    square = round(math.sqrt(lamps.shape[1]))
    for row in range(0, where.shape[0], step):
        for column in range(0, where.shape[1], step):
            if not where[row, column]:
                continue
            for m in range(image.shape[2]):
                image[row, column, m] = 0.0
            for k in range(samples * samples):
                x_px = column + (k % samples + 0.5) / samples - 0.5
                y_px = row + (k // samples + 0.5) / samples - 0.5
                camera_ray(pinhole, rotation, x_px, y_px, view)
                on = first_hit(body, reach, origin, view, 1e-4, point)
                if on < 0:
                    continue
                normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
                grey = albedo[on] * texture_at(maps, texture, point, on)
                if on == 1:
                    normal_at(body, on, point, normal)
                    if picture.size > 1:
                        grey *= picture_at(picture, picture_from, point)
                # neighbouring pixels see neighbouring lamps of the ring
                lamp = lamps[k, square * (row // step % square) + column // step % square]
                cosine = sees(body, reach, point, normal, lamp, beam, scratch)
                # a quarter of the light is diffuse, from all sides
                light = 0.25 * (0.5 + 0.5 * normal[2]) * grey
                if cosine > 0.0:
                    gloss = 0.5 * gloss_at(albedo, maps, texture, point, on)
                    light += 0.75 * (grey * cosine / level + specular(gloss, albedo[4], normal, beam, view))
                if apart:
                    image[row, column, 0] += share * grey
                    if grey > _BLACKEST:
                        image[row, column, 1] += share * light / grey
                else:
                    image[row, column, 0] += share * light


_BLACKEST = 1e-6
"""Albedo below which light over albedo is not told: such a place gives back none."""
_REACH = 5.0
"""Deviations from a plane's middle beyond which its light is left out."""


@kernel
def texture_at(maps: Floats, texture: Floats, point: Floats, layer: int) -> float:
    """Bilinear lookup in a layer of the maps over the belt."""
    rows, columns = texture.shape[0], texture.shape[1]
    # beyond the map its border's value holds
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
    # without wet places a surface has one gloss
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
    # beside the picture the product has its own albedo
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
    # light that does not diverge has one width everywhere
    if fan[3] == 0.0:
        return fan[0]
    away = 0.0
    for m in range(3):
        away += (point[m] - projector[m]) ** 2
    # Gaussian beam far from its waist: the deviation grows in proportion to the distance
    grown = fan[3] * (math.sqrt(away) - fan[2])
    return math.sqrt(fan[0] * fan[0] + grown * grown)


@kernel
def pattern_light(
    planes: Floats, rows: Floats, projector: Floats, point: Floats, normal: Floats, depth_mm: float,
    sigma_mm: float,
) -> float:  # fmt: skip
    """Light of all lines or circles, or of the dots that rows leave of them, before angles are counted."""
    # a dot is where two planes meet: the product of both profiles
    light = planes_light(planes, projector, point, normal, depth_mm, sigma_mm)
    if rows.shape[0] > 0 and light > 0.0:
        light *= planes_light(rows, projector, point, normal, depth_mm, sigma_mm)
    return light


@kernel
def planes_light(
    planes: Floats, projector: Floats, point: Floats, normal: Floats, depth_mm: float, sigma_mm: float
) -> float:
    """Light of all planes at a depth below a point of the surface, before the angles are counted.

    The planes fan from one point and are in order, so the few that are near are found by halving. Cones,
    which have a sixth number, are in order, too.
    """
    # the point that lit the surface lies that deep below it, along the normal
    x = point[0] - depth_mm * normal[0]
    y = point[1] - depth_mm * normal[1]
    z = point[2] - depth_mm * normal[2]
    reach = _REACH * sigma_mm
    cones, away_mm = planes.shape[1] > 5, 0.0
    if cones:
        away_mm = math.sqrt((x - projector[0]) ** 2 + (y - projector[1]) ** 2 + (z - projector[2]) ** 2)
    # halving: the first plane whose distance is below the reach; distances fall with the number
    low, high = 0, planes.shape[0]
    while low < high:
        middle = (low + high) // 2
        p = planes[middle]
        bend = p[5] * away_mm if cones else 0.0
        if p[0] * x + p[1] * y + p[2] * z - p[3] - bend >= reach:
            low = middle + 1
        else:
            high = middle
    light = 0.0
    for i in range(low, planes.shape[0]):
        p = planes[i]
        # beyond the last that reaches here the others are farther still
        away = p[0] * x + p[1] * y + p[2] * z - p[3] - (p[5] * away_mm if cones else 0.0)
        if away <= -reach:
            break
        away /= sigma_mm
        light += p[4] * math.exp(-0.5 * away * away)
    return light


@kernel
def specular(gloss: float, exponent: float, normal: Floats, beam: Floats, view: Floats) -> float:
    """Mirror-like part: a power of the cosine between the normal and the half-way direction."""
    if gloss == 0.0:
        return 0.0
    length, dot = 0.0, 0.0
    for m in range(3):
        # half-way between the directions to the lamp and to the camera
        half = beam[m] - view[m]
        length += half * half
        dot += half * normal[m]
    return gloss * max(dot / math.sqrt(length), 0.0) ** exponent
