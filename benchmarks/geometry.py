"""The table of the page on geometry, from a scene's own rig.

``python -m benchmarks geometry [--scene recipes/herring_roe]``
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from roemetry.config.scene import Scene
from roemetry.records.arrays import Floats
from roemetry_simulate.render import Rig
from roemetry_simulate.scene import RayCasterOptions, rig_of

_MARKED_MM = 16.5
"""Height of the block by which the paper calibrates."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, default=Path("recipes/herring_roe"))
    given = parser.parse_args()
    options = Scene.load(given.scene).simulator.options
    assert isinstance(options, RayCasterOptions)
    rig = rig_of(options)
    stripe = rig.laser.count // 2
    at_block = _shift_px(rig, stripe, _MARKED_MM) / _MARKED_MM
    print("| height, mm | displacement, px | px/mm | linear model's height, mm | its error, % |")
    print("|---:|---:|---:|---:|---:|")
    for height_mm in (2.0, 5.0, 10.0, _MARKED_MM, 25.0):
        shift_px = _shift_px(rig, stripe, height_mm)
        told_mm = shift_px / at_block
        error = 100.0 * (told_mm / height_mm - 1.0)
        print(
            f"| {height_mm:g} | {shift_px:.2f} | {shift_px / height_mm:.3f} | {told_mm:.2f} | {error:+.1f} |"
        )


def _shift_px(rig: Rig, stripe: int, height_mm: float) -> float:
    """Displacement of a stripe's point at Y = 0, along the image row in which it is seen."""
    lit = _lit(rig, stripe, height_mm)
    seen = rig.camera.project(lit)
    # where the stripe lies on the belt in that very row of the image
    y_mm = np.linspace(-20.0, 20.0, 4001)
    belt = np.stack([rig.laser.x_mm(y_mm, 0.0)[:, stripe], y_mm, np.zeros_like(y_mm)], axis=-1)
    rest = rig.camera.project(belt)
    order = np.argsort(rest[:, 1])
    return abs(float(seen[0] - np.interp(seen[1], rest[order, 1], rest[order, 0])))


def _lit(rig: Rig, stripe: int, height_mm: float) -> Floats:
    return np.array([float(rig.laser.x_mm(0.0, height_mm)[stripe]), 0.0, height_mm])
