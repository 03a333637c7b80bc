"""Time of a simulated image on one core, by what is switched on, after warm-up.

``python -m benchmarks simulate [--scene recipes/herring_roe] [--repeats 3] [--set KEY=VALUE …]``

Processor time, not wall time: it does not depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

from roemetry.config.scene import Scene
from roemetry_simulate.population import product_of
from roemetry_simulate.render import laser_light, render
from roemetry_simulate.scene_rig import rig_of, surface_of
from roemetry_simulate.truth import stripe_centres

VARIANTS = {
    "matt": ["simulator.options.surface.gloss=0"],
    "gloss": [],
    "gloss, light below the surface": [
        "simulator.options.surface.below={share: 0.5, depth_mm: 0.3, blur_mm: 0.4}",
    ],
    "gloss, distortion, focus": [
        "simulator.options.camera.distortion={k1: -0.1}",
        "simulator.options.camera.focus={distance_mm: 315, f_number: 4}",
    ],
}


def main() -> None:
    """Print the median of each step for each variant."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="recipes/herring_roe")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--set", action="append", default=[], dest="sets")
    given = parser.parse_args()
    for name, sets in VARIANTS.items():
        options = Scene.load(f"{given.scene}/scene.yaml", sets=[*sets, *given.sets]).simulator.options
        rig = rig_of(options)  # type: ignore[arg-type]
        lying = product_of(options.product, rig, 0, 1)  # type: ignore[attr-defined]
        surface = surface_of(options, lying.seed)  # type: ignore[arg-type]
        solid, samples = lying.solid, options.samples  # type: ignore[attr-defined]
        steps: dict[str, Callable[[], object]] = {
            "light": lambda: laser_light(rig, solid, surface, samples),  # noqa: B023
            "image": lambda: render(rig, solid, surface, seed=1, samples=samples),  # noqa: B023
            "stripe truth": lambda: stripe_centres(rig.camera, rig.laser, solid),  # noqa: B023
        }
        said = [f"{step} {seconds(work, given.repeats):.2f} s" for step, work in steps.items()]
        size = f"{rig.camera.width_px} × {rig.camera.height_px}, {samples**2} samples a pixel"
        print(f"{name:32} {size}: {', '.join(said)}")


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Median processor time of some work."""
    work()
    taken = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
    return statistics.median(taken)


if __name__ == "__main__":
    main()
