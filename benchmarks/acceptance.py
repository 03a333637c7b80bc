"""Acceptance tests of simulated instruments: good ones accepted, ones with a known fault refused.

``python -m benchmarks acceptance [--first 410000] [--count 100]``

Every instrument is a rig of its own. A sphere plate in ten positions and a block in six are traced exactly,
peaks moved by random errors of 0.1 px, and lifted by the calibration that the instrument believes in: its
own, or one with a fault. The limits are the same for all.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np

from benchmarks.volume_scenes import rig_of, view_of
from roemetry.config.target_file import read_sphere_plate, read_target
from roemetry.errors import RoemetryError
from roemetry.io.files import shipped
from roemetry.records import NOTHING, Profiles
from roemetry.records.observations import Block as BlockTarget
from roemetry.records.view import View
from roemetry.targets.solids import solid_triangles
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.mesh import Triangles, close, lay
from roemetry_simulate.render import Rig
from roemetry_simulate.solid import Block, Solid
from roemetry_simulate.truth import stripe_centres
from roemetry_study.acceptance import Artefact, Value, decide, measure, overall

LIMITS_MM = {"form": 0.45, "size": 0.10, "spacing": 0.05, "flatness": 0.40, "step": 0.03}
"""Maximum permissible errors: about twice what 0.1 px do on these rigs."""
NOISE_PX = 0.1
STD_MM = 0.001
"""Standard uncertainty of the artefacts' calibrated values."""
BLOCK = BlockTarget("block", 30.0, 30.0, 16.5, 0.005)
FAULTS = ("none", "planes turned by 0.2°", "scale 0.1 % off", "lens: k1 0.1 off")
_STEP_PX = 2.0


def main() -> None:
    """Print a line for each fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=410000, help="seed of the first rig")
    parser.add_argument("--count", type=int, default=100)
    given = parser.parse_args()
    found = {fault: Counter[str]() for fault in FAULTS}
    causes = {fault: Counter[str]() for fault in FAULTS}
    for seed in range(given.first, given.first + given.count):
        rig = rig_of(seed)
        traces = list(traced(rig, seed))
        for fault in FAULTS:
            view = faulty(view_of(rig), fault)
            try:
                values = [
                    v for artefact, points in traces for v in measure(lifted(points, view), artefact, view)
                ]
                outcomes = decide(values, LIMITS_MM)
                found[fault][overall(outcomes)] += 1
                causes[fault].update(o.characteristic for o in outcomes if o.decision == "rejected")
            except RoemetryError as error:
                found[fault][f"not measured: {error.message[:40]}"] += 1
    print(
        "| fault | accepted | rejected | undecided | not measured | rejected by |\n|---|---|---|---|---|---|"
    )
    for fault in FAULTS:
        told = [found[fault][name] for name in ("accepted", "rejected", "undecided")]
        by = ", ".join(f"{name} {n}" for name, n in causes[fault].most_common())
        print(f"| {fault} | {' | '.join(map(str, told))} | {given.count - sum(told)} | {by or '–'} |")


def traced(rig: Rig, seed: int) -> list[tuple[Artefact, Profiles]]:
    """Trace both artefacts in their positions, with noise; heights are not yet known."""
    rng = np.random.default_rng([seed, 71])
    described = read_target(shipped("calib_targets", "sphere-plate-3x2-30.yaml"))
    plate = read_sphere_plate(described, shipped("calib_targets", "sphere-plate-3x2-30.yaml").parent)  # type: ignore[arg-type]
    assert plate is not None
    corners = solid_triangles(described).reshape(-1, 3).round(9)
    points, number = np.unique(corners, axis=0, return_inverse=True)
    mesh = close(Triangles(points, number.reshape(-1, 3)))
    made = []
    for _ in range(10):
        pose = Pose(*rng.uniform(-4.0, 4.0, 2), float(rng.uniform(-8.0, 8.0)))
        made.append((Artefact(plate, STD_MM), noisy(rig, lay(mesh, pose), rng)))
    for _ in range(6):
        x, y = rng.uniform(-15.0, 15.0, 2)
        block = Block(BLOCK.length_mm, BLOCK.width_mm, BLOCK.height_mm, centre_x_mm=x, centre_y_mm=y)
        made.append((Artefact(BLOCK, STD_MM), noisy(rig, block, rng)))
    return made


def noisy(rig: Rig, solid: Solid, rng: np.random.Generator) -> Profiles:
    """Give the stripes' points with noise along their rows, not yet lifted."""
    truth = stripe_centres(rig.camera, rig.laser, solid, step_px=_STEP_PX)
    seen = np.isfinite(truth.x_px)
    x_px = truth.x_px + NOISE_PX * rng.standard_normal(seen.shape)
    stripes, rows = seen.shape
    return Profiles(
        xyz_mm=np.full((stripes, rows, 3), np.nan),
        product=np.where(seen, (truth.on_product == 1).astype(np.int64), NOTHING),
        seen=seen,
        x_px=np.where(seen, x_px, np.nan),
        row_px=np.where(seen, np.arange(rows, dtype=np.float64), np.nan),
        height_std_mm=np.full(seen.shape, np.nan),
        stripe=np.arange(stripes),
        frame=np.zeros(stripes, np.int64),
        plane=view_of(rig).planes,
    )


def lifted(points: Profiles, view: View) -> Profiles:
    """Put the points where a calibration says they are."""
    number = np.broadcast_to(points.stripe[:, None], points.x_px.shape)
    xyz = view.lift(np.stack([points.x_px, points.row_px], axis=-1), number)
    return replace(points, xyz_mm=xyz, plane=view.planes)


def faulty(view: View, fault: str) -> View:
    """Give the calibration an instrument with this fault believes in."""
    match fault:
        case "planes turned by 0.2°":
            turn = np.radians(0.2)
            rotation = np.array(
                [[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]]
            )
            normals = view.planes[:, :3] @ rotation.T
            feet = view.planes[:, 3] / view.planes[:, 0]  # turned about where they meet the belt
            return replace(view, planes=np.column_stack([normals, feet * normals[:, 0]]))
        case "scale 0.1 % off":
            pose = view.T_belt_camera.copy()
            pose[:3, 3] *= 1.001
            planes = view.planes.copy()
            planes[:, 3] *= 1.001
            return replace(view, T_belt_camera=pose, planes=planes)
        case "lens: k1 0.1 off":
            return replace(view, distortion=np.array([0.1, 0.0, 0.0, 0.0]))
    return view


def worst(values: list[Value]) -> dict[str, float]:
    """Give the largest error of each characteristic, mm."""
    return {name: max(abs(v.error_mm) for v in values if v.characteristic == name) for name in LIMITS_MM}


if __name__ == "__main__":
    main()
