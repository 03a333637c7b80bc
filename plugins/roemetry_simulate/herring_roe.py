"""The herring roe rig, its scenes, and the command that writes the shipped data set.

``python -m roemetry_simulate.herring_roe OUT [--seed N] [--count N]``
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.camera import looking_down
from roemetry_simulate.laser import fan_through
from roemetry_simulate.parameters import SkeinRecord, draw
from roemetry_simulate.render import Rig, render
from roemetry_simulate.sensor import Sensor
from roemetry_simulate.skein import Skein, build, moved
from roemetry_simulate.solid import Block, EmptyBelt, Solid
from roemetry_simulate.surface import Surface, textured
from roemetry_simulate.truth import StripeTruth, stripe_centres

SPACING_MM = 8.75
"""Mean spacing of the stripes on the belt."""

_VIEW_MM = 61.0
_MOST_OVERHANG = 1.2

CALIBRATION_BLOCK = Block(105.0, 40.0, 16.5, centre_x_mm=1.5, centre_y_mm=-1.0, yaw_deg=0.9)


@dataclass(frozen=True, eq=False)
class Scene:
    """All that makes an image.

    Attributes
    ----------
    rig : Rig
        Camera, sensor, laser, lamps.
    solid : Solid
        What lies on the belt.
    surface : Surface
        How bright belt and product are.
    seed : int
        Of the noise (and of all else, for a skein).
    skein : Skein or None
        The skein with its record and its reference, if it is one.
    """

    rig: Rig
    solid: Solid
    surface: Surface
    seed: int
    skein: Skein | None = None


def default_rig() -> Rig:
    """Return the rig: 640 × 480, 0.2 mm/px, 11 planes from the right, lines nearly along Y.

    Returns
    -------
    Rig
        Camera 320 mm over the belt and a degree off the vertical, projector 300 mm over it and 160 mm to
        the right: a block of 16.5 mm shifts a stripe by a little more than one stripe spacing.
    """
    camera = looking_down(
        640, 480, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0, tilt_x_deg=1.0, tilt_y_deg=-0.4
    )
    # made, not ideal: spacings from 8.6 to 8.9 mm, powers within a tenth
    spacings = np.array([8.62, 8.79, 8.71, 8.84, 8.68, 8.77, 8.90, 8.66, 8.81, 8.72])
    feet = np.concatenate([[0.0], np.cumsum(spacings)])
    feet += -3.0 - feet.mean()
    power = np.array([0.93, 1.02, 0.97, 1.05, 1.00, 1.06, 0.98, 1.03, 0.94, 1.01, 0.90])
    laser = fan_through(
        (160.0, -4.0, 300.0), feet, yaw_deg=0.6, pitch_deg=0.3, sigma_mm=0.31, peak_grey=370.0 * power
    )
    return Rig(camera, Sensor(), laser)


def scene(seed: int, kind: str | None = None) -> Scene:
    """Make a scene with one skein.

    Parameters
    ----------
    seed : int
        The same seed (and kind) gives the same scene.
    kind : str or None
        healthy, dented, bent, twisted, folded or broken; None draws that, too.

    Returns
    -------
    Scene
        The skein is moved along X where needed so that it stays in view and its ends lie no more than
        about 1.5 spacings beyond the outermost lit points.
    """
    rig = default_rig()
    skein = build(_in_reach(draw(seed, kind), rig))
    return Scene(rig, skein.solid, _surface(seed), seed, skein)


def block_scene(seed: int = 1) -> Scene:
    """Make the calibration scene: a matt block of 105 × 40 × 16.5 mm under all stripes."""
    matt = replace(_surface(seed), gloss=(0.0, 0.0), laser_albedo=(0.66, 0.60), plain_albedo=(0.34, 0.62))
    texture = 1.0 + 0.35 * (matt.texture - 1.0)
    return Scene(default_rig(), CALIBRATION_BLOCK, replace(matt, texture=texture), seed)


def belt_scene(seed: int = 2) -> Scene:
    """Make the scene of the empty belt."""
    return Scene(default_rig(), EmptyBelt(), _surface(seed), seed)


def render_scene(scene: Scene, plain: bool = False, samples: int = 4) -> NDArray[np.uint8]:
    """Take the scene's image.

    Parameters
    ----------
    scene : Scene
        What to see.
    plain : bool
        Laser off and plain light on.
    samples : int
        Samples along each side of a pixel.

    Returns
    -------
    ndarray of uint8, shape (height, width)
        The same scene gives the same bytes.
    """
    return render(scene.rig, scene.solid, scene.surface, seed=scene.seed, plain=plain, samples=samples)


def stripe_truth(scene: Scene) -> StripeTruth:
    """Find the exact centres of the scene's stripes; see `StripeTruth`."""
    return stripe_centres(scene.rig.camera, scene.rig.laser, scene.solid)


def _surface(seed: int) -> Surface:
    """Return belt and roe: roe is darker than the belt in the laser's red and brighter in plain light."""
    return textured(seed, laser_albedo=(0.66, 0.53), plain_albedo=(0.34, 0.62), gloss=(0.0, 0.10))


def _in_reach(record: SkeinRecord, rig: Rig) -> SkeinRecord:
    """Move a skein along X until its ends keep within the view and near the outer stripes."""
    # the ends stand about this high, and this is what the outer stripes reach there
    fan = rig.laser.x_mm(record.centre_y_mm, 0.8 * record.rim_height_mm)
    low = max(float(fan[0]) - _MOST_OVERHANG * SPACING_MM, -_VIEW_MM)
    high = min(float(fan[-1]) + _MOST_OVERHANG * SPACING_MM, _VIEW_MM)
    left, right, _, _ = build(record, step_mm=0.5).solid.footprint_extent_mm()
    shift = max(low - left, 0.0) + min(high - right, 0.0)
    return moved(record, record.centre_x_mm + shift, record.centre_y_mm)


def main(arguments: list[str] | None = None) -> None:
    """Write a data set; the command line's entry."""
    from roemetry_simulate.herring_dataset import SHIPPED, write

    parser = argparse.ArgumentParser(prog="python -m roemetry_simulate.herring_roe", description=__doc__)
    parser.add_argument("out", type=Path, help="folder to write into")
    parser.add_argument("--seed", type=int, help="first seed; left out: the shipped skeins")
    parser.add_argument("--count", type=int, help="number of skeins")
    options = parser.parse_args(arguments)
    skeins: list[tuple[int, str | None]] = list(SHIPPED)
    if options.seed is not None:
        count = len(SHIPPED) if options.count is None else options.count
        skeins = [(options.seed + k, None) for k in range(count)]
    elif options.count is not None:
        skeins = skeins[: options.count]
    write(options.out, skeins)


if __name__ == "__main__":
    main()
