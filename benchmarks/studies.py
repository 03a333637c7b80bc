"""Studies judged: intervals that hold, instruments accepted and refused; and the example's readings.

``python -m benchmarks studies [--part intervals acceptance] [--first 410000] [--count 100] [--studies 1000]
[--jobs 1] [--cluster ADDRESS]``

Intervals: gauge studies and studies of agreement with known variances and rates, simulated. Acceptance:
every instrument is a rig of its own; a sphere plate in ten positions and a block in six are traced exactly,
peaks moved by random errors of 0.1 px, and lifted by the calibration that the instrument believes in: its
own, or one with a fault. The limits are the same for all. ``--part example`` writes
recipes/herring_roe/studies/heads.csv.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.command import add_sharing, parser_of, shared
from benchmarks.tables import table
from benchmarks.volume_scenes import HERRING_ROE, exact, profiles_of, rig_of, sphere_plate, view_of
from benchmarks.weight import disturbed
from roemetry.errors import RoemetryError
from roemetry.records import Profiles
from roemetry.records.observations import Block as BlockTarget
from roemetry.records.view import View
from roemetry_simulate.population import in_reach
from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.mesh import lay
from roemetry_simulate.ray_caster import stripe_centres
from roemetry_simulate.render import Rig
from roemetry_simulate.solid import Block, Solid
from roemetry_study.acceptance import Artefact, decide, measure, overall
from roemetry_study.agreement import Operator, agreement
from roemetry_study.gauge import simulated
from roemetry_study.table import Reading, StudyTable
from roemetry_study.variance import analyse
from roemetry_volume.outline_surface import OutlineSurface

LIMITS_MM = {"form": 0.45, "size": 0.10, "spacing": 0.05, "flatness": 0.40, "step": 0.03}
"""Maximum permissible errors: about twice what 0.1 px do on these rigs."""
NOISE_PX = 0.1
STD_MM = 0.001
"""Standard uncertainty of the artefacts' calibrated values."""
BLOCK = BlockTarget("block", 30.0, 30.0, 16.5, 0.005)
FAULTS = ("none", "planes turned by 0.2°", "scale 0.1 % off", "lens: k1 0.1 off")
_STEP_PX = 2.0


def main() -> None:
    """Print what is asked for."""
    parser = parser_of(__doc__)
    parts = {"intervals": intervals, "acceptance": acceptance, "example": example}
    parser.add_argument("--part", nargs="+", choices=parts, default=["intervals", "acceptance"])
    parser.add_argument("--first", type=int, default=410000, help="seed of the first rig")
    parser.add_argument("--count", type=int, default=100, help="rigs")
    parser.add_argument("--studies", type=int, default=1000, help="simulated for each design")
    add_sharing(parser)
    given = parser.parse_args()
    for part in given.part:
        parts[part](given)


def intervals(given: argparse.Namespace) -> None:
    """Print how many 95 % intervals hold the truth, by design of study and component."""
    names = ("repeatability", "operator", "interaction", "gauge", "part", "gauge_percent")
    rows = []
    for size, gaps in (((10, 3, 3), 0.0), ((10, 3, 3), 0.1), ((8, 4, 2), 0.0), ((20, 3, 2), 0.1)):
        std = {"part": 5.0, "repeatability": 1.0, "operator": 1.0, "interaction": 0.7}
        true = {**std, "gauge": math.sqrt(1.0 + 1.0 + 0.49)}
        true["gauge_percent"] = 100.0 * true["gauge"] / math.hypot(true["gauge"], 5.0)
        held = Counter[str]()
        for found in shared(given, partial, (_held, size, gaps, true), range(given.studies)):
            held.update(found)
        shown = [f"{held[name] / given.studies:.1%}" for name in names]
        rows.append([" × ".join(map(str, size)), f"{gaps:.0%}", *shown])
    print(f"\n{table(['parts × operators × trials', 'cells missing', *names], rows)}")
    rows = []
    for parts, trials, hard in ((50, 3, 0.4), (50, 2, 0.1), (100, 2, 0.4)):
        held = Counter[str]()
        for seed in range(given.studies):
            one, rate = agreed(np.random.default_rng([seed, parts, trials, 74]), parts, trials, hard)
            held["missed"] += one.missed.low <= rate <= one.missed.high
            held["false alarms"] += one.false_alarm.low <= rate <= one.false_alarm.high
            held["kappa"] += one.kappa.low <= 1.0 - 2.0 * rate <= one.kappa.high
        shown = [f"{held[name] / given.studies:.1%}" for name in ("missed", "false alarms", "kappa")]
        rows.append([f"{parts} parts × {trials}, hard parts wrong {hard:.0%}", *shown])
    print(table(["study of agreement", "missed", "false alarms", "kappa"], rows), end="")


def _held(size: tuple[int, int, int], gaps: float, true: dict[str, float], seed: int) -> list[str]:
    """Give the components whose interval holds the truth in one study."""
    rng = np.random.default_rng([seed, *size, 73])
    table = simulated(rng, size, 5.0, 1.0, 1.0, 0.7)
    table = replace(table, readings=tuple(r for r in table.readings if rng.random() >= gaps))
    found = analyse(table)
    drawn = {**found.draws, "gauge_percent": 100.0 * found.draws["gauge"] / found.draws["total"]}
    ends = {name: np.quantile(drawn[name], [0.025, 0.975]) for name in true if name in drawn}
    return [name for name, (low, high) in ends.items() if low <= true[name] <= high]


def agreed(rng: np.random.Generator, parts: int, trials: int, hard: float) -> tuple[Operator, float]:
    """Simulate one grader: every fifth part is hard, its readings wrong together; others 4 % wrong."""
    readings = []
    for part in range(parts):
        truth, other = ("good", "bad") if part % 2 else ("bad", "good")
        wrong = hard if rng.random() < 0.2 else 0.04
        readings += [
            Reading(f"{part}", "A", f"{trial}", other if rng.random() < wrong else truth, "simulated", truth)
            for trial in range(trials)
        ]
    found = agreement(StudyTable(tuple(readings), "grade", "simulated"), "good")
    return found.operators[0], 0.2 * hard + 0.8 * 0.04


def example(given: argparse.Namespace) -> None:
    """Write the example: ten skeins, three heads with scales of their own, three trials; volumes, cm³."""
    lines = ["part,head,trial,visible_cm3,std,reference"]
    rng = np.random.default_rng(83)
    heads = {name: (900_000 + k, 1.0 + 0.002 * float(rng.standard_normal())) for k, name in enumerate("ABC")}
    for number in range(10):
        family = PRODUCTS["herring-roe"]
        for head, (rig_seed, scale) in heads.items():
            rig = rig_of(rig_seed)
            drawn = in_reach(family.draw(910_000 + number, family.Options()), rig, 1.2)
            whole = exact(rig, drawn.solid)
            for trial in range(1, 4):
                product = disturbed(whole, 1000 * number + 10 * rig_seed + trial).product
                profiles = replace(product.profiles, xyz_mm=product.profiles.xyz_mm * [1.0, 1.0, scale])
                volume = OutlineSurface().estimate(replace(product, profiles=profiles)).visible_mm3
                lines.append(
                    f"skein {number + 1},{head},{trial},{1e-3 * volume.value:.4f},{1e-3 * volume.std:.4f},"
                    f"{1e-3 * whole.visible_mm3:.4f}"
                )
    path = HERRING_ROE / "studies" / "heads.csv"
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(path)


def acceptance(given: argparse.Namespace) -> None:
    """Print a line for each fault."""
    found = {fault: Counter[str]() for fault in FAULTS}
    causes = {fault: Counter[str]() for fault in FAULTS}
    seeds = range(given.first, given.first + given.count)
    for rig in shared(given, partial, (_decided,), seeds):
        for fault, (decision, rejected_by) in rig.items():
            found[fault][decision] += 1
            causes[fault].update(rejected_by)
    rows = []
    for fault in FAULTS:
        told = [found[fault][name] for name in ("accepted", "rejected", "undecided")]
        by = ", ".join(f"{name} {n}" for name, n in causes[fault].most_common())
        rows.append([fault, *map(str, told), f"{given.count - sum(told)}", by or "–"])
    head = ["fault", "accepted", "rejected", "undecided", "not measured", "rejected by"]
    print(f"\n{table(head, rows)}", end="")


def _decided(seed: int) -> dict[str, tuple[str, list[str]]]:
    """Give, by fault, the decision on a rig, or why there is none, and what rejected it."""
    rig = rig_of(seed)
    traces, decided = traced(rig, seed), {}
    for fault in FAULTS:
        view = faulty(view_of(rig), fault)
        try:
            values = [
                value
                for artefact, points in traces
                for value in measure(lifted(points, view), artefact, view)
            ]
            outcomes = decide(values, LIMITS_MM)
        except RoemetryError as error:
            decided[fault] = error.message, []
            continue
        rejected = [o.characteristic for o in outcomes if o.decision == "rejected"]
        decided[fault] = overall(outcomes), rejected
    return decided


def traced(rig: Rig, seed: int) -> list[tuple[Artefact, Profiles]]:
    """Trace both artefacts in their positions, with noise; heights are not yet known."""
    rng = np.random.default_rng([seed, 71])
    plate, mesh = sphere_plate()
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
    x_px = truth.x_px + NOISE_PX * rng.standard_normal(truth.x_px.shape)
    return profiles_of(x_px, truth.on_product == 1, np.full((*x_px.shape, 3), np.nan), view_of(rig))


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
            belt_x = view.planes[:, 3] / view.planes[:, 0]  # turned about where they meet the belt
            return replace(view, planes=np.column_stack([normals, belt_x * normals[:, 0]]))
        case "scale 0.1 % off":
            pose = view.T_belt_camera.copy()
            pose[:3, 3] *= 1.001
            planes = view.planes.copy()
            planes[:, 3] *= 1.001
            return replace(view, T_belt_camera=pose, planes=planes)
        case "lens: k1 0.1 off":
            return replace(view, distortion=np.array([0.1, 0.0, 0.0, 0.0]))
    return view
