"""Belt scans of the other simulator: volumes and their intervals where lines look as light makes them.

    python -m benchmarks rendered_scans --count 6 --seed 500 --frames /tmp/frames
    python -m benchmarks rendered_scans --heads --count 4 --seed 500

Rigs, calibrations and motion are drawn as in `scans`; products, their surfaces (film, light below, texture),
speckle and blur are drawn here and rendered by `mitsuba-belt`. Rendering takes most of the time: `--frames`
keeps the frames and reads them again. With `--heads`, bodies between the two heads of `recipes/two_heads` are
rendered from both sides, and their true volumes are compared.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import parser_of
from benchmarks.scans import calibrated_volume, drawn_rig, measured, tell, told_scene
from benchmarks.tables import Against
from roemetry.config.recipe import Recipe
from roemetry.config.scene import Scene
from roemetry.errors import StageError
from roemetry.records import Frame, ProductTruth, Profiles, ScanLines
from roemetry_mitsuba.moving_belt import MitsubaBelt, MitsubaBeltOptions
from roemetry_scan.closed import closed_volume
from roemetry_scan.commands import read_registration

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


HEADS = Path(__file__).parents[1] / "recipes" / "two_heads"
BETWEEN: dict[str, dict[str, Any]] = {
    "superquadric": {"length_mm": [46, 56], "width_mm": [34, 40], "height_mm": [24, 34]},
    "supershape": {"length_mm": [46, 56], "width_mm": [34, 40], "height_mm": [24, 34]},
    "ball": {"diameter_mm": [28, 36]},
}
"""Bodies that both heads' views hold."""


def between_heads(count: int, seed: int, kept: Path | None) -> None:
    """Say how far the true volumes of bodies between two heads are off."""
    registered = read_registration(HEADS / "registration.yaml", "T_top_bottom")
    sides = ("top", "bottom")
    recipes = [Recipe.load(HEADS / "heads" / f"{side}.yaml") for side in sides]
    for family, size in BETWEEN.items():
        found = Against()
        product = {"family": family, "options": {**size, "turn_range_deg": 10, "offset_range_y_mm": 2}}
        for k in range(count):
            profiles: list[Profiles] = []
            for side, recipe in zip(sides, recipes, strict=True):
                scene_file = HEADS / f"potatoes_{side}_scene.yaml"
                sets = ["simulator.use=mitsuba-belt", f"simulator.options.product={json.dumps(product)}"]
                sim = Scene.load(scene_file, sets=sets).simulator.make()
                stored = None if kept is None else kept / f"{family}_{side}_{seed}_{k}.npz"
                lines, truth = lines_of(sim, seed + k, stored)
                trace = measured(recipe, lines)
                if trace.profiles is None:
                    print(f"  {family} {seed + k}, {side}: {[one.text for one in trace.absent.values()]}")
                else:
                    profiles.append(trace.profiles)
            if len(profiles) < len(sides):
                continue
            try:
                volume = closed_volume(profiles[0], profiles[1], registered)
            except StageError as error:
                print(f"  {family} {seed + k}: {error.message}")
                continue
            found.add(volume, truth.true_mm3)
            off = volume.value / truth.true_mm3 - 1.0
            print(f"  {family} {seed + k}: {off:+.3%} ± {volume.std / volume.value:.3%}", flush=True)
        if found.off.size:
            tell("between two heads", family, found)


def main() -> None:
    """Say how far volumes are off, and how often their intervals hold the truth."""
    parser = parser_of(__doc__)
    parser.add_argument("--families", default=",".join(BODIES))
    parser.add_argument("--count", type=int, default=6)
    parser.add_argument("--seed", type=int, default=500)
    parser.add_argument("--frames", type=Path, help="a folder that keeps rendered frames")
    parser.add_argument("--heads", action="store_true", help="true volumes between two heads instead")
    asked = parser.parse_args()
    if asked.heads:
        between_heads(asked.count, asked.seed, asked.frames)
        return
    for family in asked.families.split(","):
        found = Against()
        for k in range(asked.count):
            rng = np.random.default_rng([asked.seed, k, 3])
            rig = drawn_rig(rng)
            # rendering takes its time line by line: pitches from the upper end of what rigs are drawn with
            rig["counts_per_line"] = math.ceil(rng.uniform(0.5, 0.7) / rig["mm_per_count"][0])
            sim = drawn_scene(family, rig, np.random.default_rng([asked.seed, k, *family.encode()]))
            stored = None if asked.frames is None else asked.frames / f"{family}_{asked.seed}_{k}.npz"
            lines, truth = lines_of(sim, asked.seed + k, stored)
            value = calibrated_volume(rig, rng, asked.seed + k, lines, f"{family} of seed {asked.seed + k}")
            if value is None:
                continue
            found.add(value, truth.visible_mm3)
            print(
                f"  {family} {asked.seed + k}: {value.value / truth.visible_mm3 - 1.0:+.3%} ± "
                f"{value.std / value.value:.3%}, tilt {rig['tilt_deg']:.0f}°",
                flush=True,
            )
        if found.off.size:
            tell("rendered", family, found)
