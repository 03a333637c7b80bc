"""From the words of a scene file to the rig and the surfaces that are rendered."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.render import Rig
from roemetry_simulate.scene_camera import camera_of, laser_of, view_mm
from roemetry_simulate.scene_file import RayCasterOptions
from roemetry_simulate.scene_optics import CameraPart, LaserPart
from roemetry_simulate.sensor import Sensor
from roemetry_simulate.surface import Surface, textured

Floats = NDArray[np.float64]


def rig_of(scene: RayCasterOptions) -> Rig:
    """Return the rig that a scene describes.

    Parameters
    ----------
    scene : RayCasterOptions
        The scene.

    Returns
    -------
    Rig
        Light in grey levels of the scene's exposure and gain.
    """
    from roemetry_simulate.defocus import Focus

    camera, laser, light = scene.camera, scene.laser, scene.light
    grey = camera.exposure_ms * camera.gain_dn_per_e
    focus = camera.focus
    return Rig(
        camera_of(camera),
        Sensor(
            grey_per_electron=camera.gain_dn_per_e,
            read_noise_grey=camera.read_noise_e * camera.gain_dn_per_e,
            black_level_grey=camera.black_level_dn,
            psf_sigma_px=camera.blur_sigma_px,
            speckle_contrast=laser.speckle_contrast,
            speckle_sigma_px=_grain_px(camera, laser),
            full_well_e=math.inf if camera.full_well_e is None else camera.full_well_e,
            bit_depth=camera.bit_depth,
        ),
        laser_of(laser, grey),
        ambient_grey=light.ambient_e_per_ms * grey,
        plain_grey=light.plain_e_per_ms * grey,
        lamp_height_mm=light.lamp_height_mm,
        lamp_radius_mm=light.lamp_radius_mm,
        stray_mm=None if light.stray is None else light.stray.position_mm,
        stray_grey=0.0 if light.stray is None else light.stray.e_per_ms * grey,
        focus=None if focus is None else Focus(focus.distance_mm, focus.f_number),
    )


def surface_of(scene: RayCasterOptions, seed: int) -> Surface:
    """Return how bright belt and product are; the texture is drawn from the seed."""
    from dataclasses import replace

    belt, product = scene.belt, scene.surface
    drawn = textured(
        seed,
        view_mm(camera_of(scene.camera)),
        laser_albedo=(belt.albedo_laser, product.albedo_laser),
        plain_albedo=(belt.albedo_plain, product.albedo_plain),
        belt_std=belt.texture,
        product_std=product.texture,
        gloss=(belt.gloss, product.gloss),
    )
    below = product.below
    return replace(
        drawn,
        gloss_exponent=product.gloss_exponent,
        below=(below.share, below.depth_mm, below.blur_mm),
    )


def _grain_px(camera: CameraPart, laser: LaserPart) -> float:
    """Deviation of the speckle's grain: as given, or of the diffraction pattern of the lens."""
    if laser.speckle_sigma_px is not None:
        return laser.speckle_sigma_px
    f_number = 8.0 if camera.focus is None else camera.focus.f_number
    away_mm = camera.distance_mm if camera.focus is None else camera.focus.distance_mm
    magnified = camera.focal_length_mm / max(away_mm - camera.focal_length_mm, 1.0)
    grain_um = 1e-3 * laser.wavelength_nm * f_number * (1.0 + magnified)
    return grain_um / camera.pixel_size_um / 2.355
