"""Each rule and cost term of the coder `planes` taken away in turn: right and wrong on two makers' scenes.

Skeins (whole and damaged) and level bodies traced by our simulator, and, for every rig folder given, exact
crossings and the images of a renderer that shares no line with it. What is counted: peaks on products with
their true stripe, of those within 3 px of a true crossing; and peaks anywhere with another stripe's number.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import cv2
import numpy as np

from benchmarks import coded
from benchmarks.outside.reading import Crossings, read_crossings, read_rig, rig_folders, true_calibration
from roemetry.errors import StageError
from roemetry.records import Frame, Peaks
from roemetry.records.calibration import Calibration
from roemetry_coding.planes import Planes, decide, graph, shifts, solve
from roemetry_peaks.maximum_likelihood import MaximumLikelihood
from roemetry_tools.compare.stripes import nearest

SEED = 41_000_000
HEIGHT_MAX_MM = 45.0
GROUPS = ("easy skeins", "dense skeins", "easy level", "dense level", "rendered exact", "rendered images")
Integers = np.ndarray


class Scene(NamedTuple):
    """Peaks with their (peak,) true stripe, −1 for none, and whether that is on a product."""

    group: str
    peaks: Peaks
    calibration: Calibration
    stripe: Integers
    product: Integers


def nothing(size_of: int) -> Any:
    """Give a veto that marks no peak; `size_of` is the argument that has a value for each peak."""
    return lambda *given: np.zeros(np.shape(given[size_of]), np.bool_)


def without_term(name: str) -> list[tuple[Any, str, Any]]:
    """Give the weights without one term: next to nothing of it, for shares of a term are taken too."""
    weights = graph.WEIGHTS._replace(**{name: 1e-9})
    return [(solve, "WEIGHTS", weights), (decide, "WEIGHTS", weights)]


RULES: dict[str, list[tuple[Any, str, Any]]] = {
    "all rules": [],
    "veto ends_settled": [(decide, "ends_settled", lambda pieces, stripe: np.ones(stripe.size))],
    "veto out_of_order": [(decide, "out_of_order", nothing(3))],
    "veto claimed": [(decide, "_CONTESTED_PEAKS", 10**9)],
    "veto may_be_level": [(decide, "may_be_level", nothing(-1))],
    "veto unexplained gaps": [
        (decide, "refuse_unexplained_gaps", lambda peaks, stripe, *_, **__: (stripe, []))
    ],
    "veto denies_belt": [(decide, "denies_belt", nothing(2))],
    "veto going_on": [(decide, "going_on", nothing(0))],
    "veto left_over": [(decide, "left_over", nothing(0))],
    "evidence: few labels of a trace count less": [(decide, "_SMALL_COUNT", 1.0)],
    "evidence: belt that became a body": [(decide, "_STRANGE_COUNT", 1.0)],
    "evidence: again without doubtful labels": [(decide, "_DOUBT_ROUNDS", 0)],
    "pieces: rest line by means": [(solve, "on_rest_line", lambda row, x, trace, line, *_: line)],
    "pieces: belt between bare lines": [(solve, "between_bare", nothing(0))],
    "pieces: ends cut off": [(solve, "_END_ROWS", 0)],
    "pieces: belt that is lost": [(solve, "_END_LINES", 10**6)],
    "solve: pieces agree": [
        (solve, "agreed", lambda entries, candidates, pieces, cost: solve.argmin_labels(candidates, cost))
    ],
    "solve: second sweeps": [(solve, "_ROUNDS", 0)],
    "shifts: single runs first": [
        (shifts, "single_shifts", lambda runs, gain: np.zeros(runs.own.shape[0], np.int64))
    ],
    "shifts: whole bodies": [
        (solve, "whole_body_shifts", lambda *of: (np.full(of[4].stripe.size, np.inf), 0 * of[4].stripe))
    ],
    "cost unseen: by how often a stripe is found": [
        (solve, "found_share", lambda row, line, stripes, *_: np.ones(stripes))
    ],
    "ties over gaps": [(solve, "_GAP_LINES", 0)],
    **{f"cost {name}": without_term(name) for name in (
        "surface", "unseen", "faint", "on_rest", "anchor", "on_end", "film", "absent", "tie_cut",
    )},
}  # fmt: skip


def traced(count: int) -> Iterator[Scene]:
    """Trace skeins, every other one damaged, and blocks and wedges."""
    damages = list(coded.DAMAGES.values())
    for name, rig_of in (("easy", coded.easy_rig), ("dense", coded.dense_rig)):
        for k in range(count):
            seed = SEED + k
            damage = damages[(k // 2) % len(damages)] if k % 2 else None
            skein = coded.skein(seed, coded.KINDS[k % len(coded.KINDS)])
            yield _scene(f"{name} skeins", coded.sample_of(rig_of(seed), skein, damage, seed=seed))
            seed = SEED + 600_000 + k
            level = coded.shape(seed, "block" if k % 3 else "wedge")
            yield _scene(f"{name} level", coded.sample_of(rig_of(seed), level, seed=seed))


def rendered(folders: list[Path]) -> Iterator[Scene]:
    """Take the exact crossings, with noise of 0.05 px, and the peaks of the images, of each rig's bodies."""
    extractor = MaximumLikelihood()
    for folder in rig_folders(folders):
        rig = read_rig(folder)
        calibration = true_calibration(rig.truth, HEIGHT_MAX_MM)
        rng = np.random.default_rng(SEED)
        for body in rig.bodies:
            true = read_crossings(folder / body.truth, rig.image_size)
            exact = _exact(true, rig.image_size, rng)
            yield _known("rendered exact", exact, calibration, true)
            image = cv2.imread(str(folder / body.laser), cv2.IMREAD_UNCHANGED)
            if image is not None:
                yield _known("rendered images", extractor.extract(Frame(image)), calibration, true)


def _scene(group: str, sample: coded.Sample) -> Scene:
    true, peaks = sample.crossings, sample.peaks
    at = nearest(peaks.row, peaks.x_px, true.row, true.x_px)
    stripe = np.where(at >= 0, true.stripe[at], -1)
    return Scene(group, peaks, sample.calibration, stripe, (at >= 0) & true.on_product[at])


def _known(group: str, peaks: Peaks, calibration: Calibration, true: Crossings) -> Scene:
    at = nearest(peaks.row, peaks.x_px, true.row, true.x_px)
    stripe = np.where(at >= 0, true.stripe[at], -1)
    return Scene(group, peaks, calibration, stripe, (at >= 0) & true.on_body[at] & true.sure[at])


def _exact(true: Crossings, image_size: tuple[int, int], rng: np.random.Generator) -> Peaks:
    x_px = true.x_px + 0.05 * rng.standard_normal(true.x_px.size)
    inside = np.flatnonzero((x_px > 0.0) & (x_px < image_size[1] - 1.0))
    order = inside[np.lexsort((x_px[inside], true.row[inside]))]
    row, x_px = true.row[order], x_px[order]
    apart = np.concatenate([[True], (np.diff(row) > 0) | (np.diff(x_px) > 0.01)])
    row, x_px = row[apart], x_px[apart]
    one = np.ones(row.size)
    return Peaks(
        image_size=image_size, row=row, x_px=x_px, x_std_px=0.05 * one, amplitude=100.0 * one,
        background=10.0 * one, width_px=4.0 * one, flags=np.zeros(row.size, np.uint8),
    )  # fmt: skip


def counts(scenes: list[Scene]) -> dict[str, list[int]]:
    """Give points, right, and wrong labels by group."""
    found = {group: [0, 0, 0] for group in GROUPS}
    for scene in scenes:
        try:
            said = Planes().code(scene.peaks, scene.calibration).peak_stripe
        except StageError:
            said = np.full(scene.stripe.size, -1)
        points = scene.product & (scene.stripe >= 0)
        wrong = (said >= 0) & (scene.stripe >= 0) & (said != scene.stripe)
        for k, part in enumerate((points, points & (said == scene.stripe), wrong)):
            found[scene.group][k] += int(np.count_nonzero(part))
    return found


def page(found: dict[str, dict[str, list[int]]]) -> str:
    """Write the table as Markdown: right in per cent, and wrong."""
    groups = [group for group in GROUPS if found["all rules"][group][0]]
    points = found["all rules"]
    lines = [
        "# Ablation of the coder `planes`",
        "",
        "Made by `python -m benchmarks coding_ablation RIGS --out docs/measurements`. Each line omits one",
        "rule or cost term. Each cell: correctly labelled product points, %, and number of wrong labels.",
        "",
        "| without | " + " | ".join(f"{group} ({points[group][0]:,} points)" for group in groups) + " |",
        "|---" * (len(groups) + 1) + "|",
    ]
    for rule, by_group in found.items():
        cells = (f"{100.0 * by_group[g][1] / by_group[g][0]:.2f} / {by_group[g][2]}" for g in groups)
        lines.append(f"| {'—' if rule == 'all rules' else rule} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Leave each rule away, one at a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rigs", nargs="*", type=Path, help="folders of rendered rigs with truth")
    parser.add_argument("--count", type=int, default=20, help="skeins, and level bodies, on each traced rig")
    parser.add_argument("--rules", nargs="*", default=list(RULES), choices=list(RULES), help="only these")
    parser.add_argument("--out", type=Path, help="folder for coding-ablation.json and .md")
    given = parser.parse_args()
    scenes = [*traced(given.count), *rendered(given.rigs)]
    found = {}
    for rule in dict.fromkeys(["all rules", *given.rules]):
        with ExitStack() as patched:
            for module, name, value in RULES[rule]:
                patched.enter_context(mock.patch.object(module, name, value))
            found[rule] = counts(scenes)
        print(rule, *(f"{group} {right / max(points, 1):.4f} {wrong}; " for group, (points, right, wrong)
                      in found[rule].items()), flush=True)  # fmt: skip
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        content = {"seed": SEED, "count": given.count, "rigs": [str(rig.name) for rig in given.rigs]}
        text = json.dumps(content | {"rules": found}, indent=1)
        (given.out / "coding-ablation.json").write_text(text + "\n", encoding="utf-8")
        (given.out / "coding-ablation.md").write_text(page(found), encoding="utf-8")
