"""Heights of levels by `pinhole-plane`, averaged over many rendered images of each.

``python -m benchmarks calibrate_averages [--rig narrow] [--seed 1] [--images 200] [--out DIR]`` renders the
boards and calibrates as `calibrate_images` does (the same DIR serves both), renders a level at each of five
heights, exposes it again and again with fresh speckle and noise, and takes the recipe's way: extractor,
triangulator. Peaks go to the stripe they are next to. The light of a still scene is the same in every image:
it is cast once a height.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.calibrate_images import (
    GRID_MM,
    RIGS,
    calibrated,
    exact_lines,
    print_cells,
    render_targets,
    scene_of,
)
from roemetry.records import Frame, StripeMap
from roemetry.records import Sensor as Noise
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages.registry import discover
from roemetry_simulate.render import Rig, expose, laser_light
from roemetry_simulate.scene import RayCasterOptions, rig_of, surface_of
from roemetry_simulate.solid import Block
from roemetry_simulate.surface import Surface

_WIDE_MM = 2000.0
_NEAR_PX = 4.0


def main() -> None:
    """Print the cells' errors after one image and after all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rig", choices=sorted(RIGS), default="narrow")
    parser.add_argument("--poses", type=int, help="left out: narrow 30, wide 24, dense 16")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--extractor", default="centre-of-gravity")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    scene = scene_of(given.rig, given.poses)
    with tempfile.TemporaryDirectory() as made:
        folder = given.out or Path(made)
        render_targets(scene, folder, given.seed)
        calibration, _ = calibrated(scene, folder, "pinhole-plane", given.extractor)
    for count in (1, given.images):
        errors, seen = {}, []
        for number, height in enumerate(GRID_MM):
            first = 1_000_000 * (given.seed + 1) + 10_000 * number
            mean_px = averaged(scene, height, given.extractor, first, count)
            errors[height] = _heights(calibration, mean_px) - height
            seen.append(float(np.isfinite(mean_px).mean()))
        print(
            f"rig {given.rig}, seed {given.seed}, {count} images of each level; seen {min(seen):.1%} at least"
        )
        print_cells(errors)


def averaged(scene: RayCasterOptions, height_mm: float, extractor: str, seed: int, images: int) -> Floats:
    """Give (stripe, row) mean place, px, of each stripe on a level over many images; NaN where never seen."""
    rig = rig_of(scene)
    registry = discover()
    stage = registry.load(registry.find("extractor", extractor))()
    lines = exact_lines(rig, height_mm, np.arange(rig.camera.height_px, dtype=np.float64))
    laser, ambient = laser_light(rig, Block(_WIDE_MM, _WIDE_MM, height_mm), matt(scene, seed), scene.samples)
    total, many = np.zeros(lines.shape), np.zeros(lines.shape)
    for number in range(images):
        peaks = stage.extract(frame_of(rig, expose(laser, ambient, rig.sensor, seed + number)))
        off = np.abs(lines[:, peaks.row] - peaks.x_px)
        off[np.isnan(off)] = np.inf
        stripe = off.argmin(axis=0)
        near = off[stripe, np.arange(len(peaks))] < _NEAR_PX
        at = stripe[near], peaks.row[near]
        np.add.at(total, at, peaks.x_px[near])
        np.add.at(many, at, 1.0)
    return np.where(many > 0, total / np.maximum(many, 1.0), np.nan)


def _heights(calibration: Calibration, x_px: Floats) -> Floats:
    """(stripe, row) heights, mm, by the triangulator."""
    registry = discover()
    stage = registry.load(registry.find("triangulator", calibration.method))()
    seen = np.isfinite(x_px)
    row_px = np.arange(x_px.shape[1], dtype=np.float64)
    stripes = StripeMap(
        x_px=x_px,
        x_std_px=np.where(seen, 0.1, np.nan),
        product=np.where(seen, 1, -1).astype(np.int16),
        seen=seen,
        margin=np.where(seen, 1.0, np.nan),
        ambiguous=np.zeros(x_px.shape, np.bool_),
        rest_px=calibration.rest_line_px(row_px),
        peak_stripe=np.empty(0, np.int16),
    )
    return np.asarray(stage.triangulate(stripes, calibration).xyz_mm[..., 2])


def frame_of(rig: Rig, pixels: np.ndarray) -> Frame:
    """Give a rendered image with the sensor's noise as its owner knows it."""
    sensor = rig.sensor
    noise = Noise(sensor.grey_per_electron, sensor.read_noise_grey)
    return Frame(pixels, name="level", bit_depth=sensor.bit_depth, sensor=noise)


def matt(scene: RayCasterOptions, seed: int) -> Surface:
    """The simulated targets' material: matt, with a third of the product's texture."""
    surface = surface_of(scene, seed)
    return replace(
        surface,
        texture=1.0 + 0.35 * (surface.texture - 1.0),
        laser_albedo=(surface.laser_albedo[0], 0.60),
        gloss=(0.0, 0.0),
        below=(0.0, 0.0, 0.0),
    )


if __name__ == "__main__":
    main()
