"""The shipped sphere plate in rendered images: its size by `pinhole-plane`, over the true one.

``python -m benchmarks calibrate_plate [--rig narrow] [--seed 1] [--plates 1] [--out DIR]`` renders the boards
and calibrates as `calibrate_images` does (the same DIR serves both), lays the plate's STL under the stripes
in other places and turns, and measures it with the calibration; shadows and steep flanks with it.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.calibrate_averages import frame_of, matt
from benchmarks.calibrate_images import RIGS, calibrated, render_targets, scene_of
from roemetry.config.target_file import SpherePlateFile, read_sphere_plate, read_target
from roemetry.io.shipped import shipped
from roemetry.stages.registry import discover
from roemetry.targets.solids import solid_triangles
from roemetry_pinhole.plates import plate_scale
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.mesh import Triangles, close, lay
from roemetry_simulate.render import render
from roemetry_simulate.scene import rig_of


def main() -> None:
    """Print a line for each plate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rig", choices=sorted(RIGS), default="narrow")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plates", type=int, default=1)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    scene, extractor = scene_of(given.rig, None), "centre-of-gravity"
    rig, registry = rig_of(scene), discover()
    stage = registry.load(registry.find("extractor", extractor))()
    with tempfile.TemporaryDirectory() as made:
        folder = given.out or Path(made)
        render_targets(scene, folder, given.seed)
        calibration, _ = calibrated(scene, folder, "pinhole-plane", extractor)
    described = read_target(shipped("calib_targets", "sphere-plate-3x2-30.yaml"))
    plate = read_sphere_plate(described if isinstance(described, SpherePlateFile) else None, Path())
    if plate is None or not isinstance(described, SpherePlateFile):
        raise AssertionError("the shipped description is that of a sphere plate")
    corners = solid_triangles(described).reshape(-1, 3).round(9)
    points, number = np.unique(corners, axis=0, return_inverse=True)
    mesh = close(Triangles(points, number.reshape(-1, 3)))
    rng = np.random.default_rng(given.seed)
    for count in range(given.plates):
        pose = Pose(*rng.uniform(-4.0, 4.0, 2), float(rng.uniform(-8.0, 8.0)))
        seed = 1000 * (given.seed + 1) + count
        pixels = render(rig, lay(mesh, pose), matt(scene, seed), seed=seed, samples=scene.samples)
        found = plate_scale(calibration, [stage.extract(frame_of(rig, pixels))], plate)
        if found is None:
            print(f"plate {count + 1}: not seen")
            continue
        common = float(found.by_parameter @ calibration.covariance @ found.by_parameter)
        std = float(np.hypot(found.own_std, np.sqrt(common)))
        print(f"plate {count + 1}: size {found.ratio:.5f} ± {std:.5f} of the true one; {found.said}")


if __name__ == "__main__":
    main()
