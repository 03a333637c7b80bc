"""Belt scans of the other simulator: volumes and their intervals where lines look as light makes them.

    python -m benchmarks rendered_scans --count 6 --seed 500 --frames /tmp/frames

Rigs, calibrations and motion are drawn as in `scans`; products, their surfaces (film, light below, texture),
speckle and blur are drawn here and rendered by `mitsuba-belt`. Rendering takes most of the time: `--frames`
keeps the frames and reads them again.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import parser_of
from benchmarks.scans import (
    FRUSTUM,
    PYRAMID,
    drawn_calibration,
    drawn_rig,
    measured,
    recipe_of,
    scene,
    stripes_of,
    tell,
    told_scene,
)
from benchmarks.tables import Against
from roemetry.records import Frame, ProductTruth, ScanLines
from roemetry_mitsuba.moving_belt import MitsubaBelt, MitsubaBeltOptions
from roemetry_pinhole.pinhole_plane import PinholePlane
from roemetry_scan.placing import BeltMotion

BODIES: dict[str, dict[str, Any]] = {
    "ball": {"diameter_mm": [28, 40]},
    "superquadric": {"length_mm": [50, 75], "width_mm": [36, 50], "height_mm": [20, 34]},
    "supershape": {"length_mm": [50, 75], "width_mm": [36, 50], "height_mm": [24, 34]},
    "rod": {"diameter_mm": [20, 32], "length_mm": [50, 65]},
    "box": {"length_mm": [45, 65], "width_mm": [24, 40], "height_mm": [12, 24]},
    "lofted-skein": {"kinds": {"none": 1}},
}


def drawn_scene(family: str, rig: dict[str, Any], rng: np.random.Generator) -> MitsubaBelt:
    """Draw what a product looks like, and the camera's blur and speckle; the rig is given."""
    told = told_scene(family=family, product=BODIES[family], lead_mm=35.0, **rig)
    depth_mm = float(rng.uniform(0.3, 0.7))
    told["camera"]["blur_sigma_px"] = float(rng.uniform(0.5, 0.9))
    told["laser"]["speckle_contrast"] = float(rng.uniform(0.03, 0.10))
    told["surface"] = {
        "gloss": float(rng.uniform(0.02, 0.12)), "gloss_exponent": float(rng.uniform(10, 60)),
        "texture": float(rng.uniform(0.03, 0.12)),
        "below": {"share": float(rng.uniform(0.0, 0.5)), "depth_mm": depth_mm, "blur_mm": 1.6 * depth_mm},
    }  # fmt: skip
    return MitsubaBelt(MitsubaBeltOptions.model_validate(told))


def lines_of(sim: MitsubaBelt, seed: int, kept: Path | None) -> tuple[ScanLines, ProductTruth]:
    """Give a scan's lines with their frames in memory, and what is true of its product."""
    placed = sim.placed(0, seed)
    counts, _ = sim.belt(placed, seed)
    if kept is not None and kept.exists():
        frames = np.load(kept)["frames"]
    else:
        frames = np.stack(list(sim.frames(placed, seed)))
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(kept, frames=frames)
    lines = ScanLines(
        lambda k: Frame(frames[k], sensor=sim.sensor()), sim.options.scan.shown(counts).astype(np.float64),
        np.arange(len(frames)), (0, len(frames)),
    )  # fmt: skip
    return lines, placed[0].truth


def main() -> None:
    """Say how far volumes are off, and how often their intervals hold the truth."""
    parser = parser_of(__doc__)
    parser.add_argument("--families", default=",".join(BODIES))
    parser.add_argument("--count", type=int, default=6)
    parser.add_argument("--seed", type=int, default=500)
    parser.add_argument("--frames", type=Path, help="a folder that keeps rendered frames")
    asked = parser.parse_args()
    for family in asked.families.split(","):
        found = Against()
        for k in range(asked.count):
            rng = np.random.default_rng([asked.seed, k, 3])
            rig = drawn_rig(rng)
            # rendering takes its time line by line: pitches from the upper end of what rigs are drawn with
            rig["counts_per_line"] = math.ceil(rng.uniform(0.5, 0.7) / rig["mm_per_count"][0])
            with_pyramid = scene(family="truncated-pyramid", product=FRUSTUM, **rig)
            calibration = drawn_calibration(with_pyramid, rng)
            stripes, pyramid = stripes_of(with_pyramid, asked.seed + k, 0.05)
            moves, _ = BeltMotion().motion(stripes, pyramid, calibration, PinholePlane(), PYRAMID)
            sim = drawn_scene(family, rig, np.random.default_rng([asked.seed, k, *family.encode()]))
            kept = None if asked.frames is None else asked.frames / f"{family}_{asked.seed}_{k}.npz"
            lines, truth = lines_of(sim, asked.seed + k, kept)
            with tempfile.TemporaryDirectory() as folder:
                known = replace(calibration, motion=moves)

                recipe = recipe_of(known, Path(folder), uncertainty="linear")
                trace = measured(recipe, lines)
            volume = trace.products[0].volume if len(trace.products) == 1 else None
            if volume is None:
                said = trace.absent or [one.absent for one in trace.products]
                print(f"  {family} of seed {asked.seed + k}: {said}")
                continue
            value = volume.visible_mm3
            found.add(value, truth.visible_mm3)
            print(
                f"  {family} {asked.seed + k}: {value.value / truth.visible_mm3 - 1.0:+.3%} ± "
                f"{value.std / value.value:.3%}, tilt {rig['tilt_deg']:.0f}°",
                flush=True,
            )
        if found.off.size:
            tell("rendered", family, found)
