"""``python -m benchmarks circles``: circles against their truth, on products and at the light of `patterns`.

Products that the ray-caster draws with the rig of `recipes/potato_circles`, measured with its calibration.
Rendered images are kept in a folder and used again, those in plain light together with `patterns`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.patterns import (
    DOTS,
    FAMILIES,
    NEAR_PX,
    PAGE,
    VOLUME_HEAD,
    Volumes,
    arguments,
    judged_lines,
    off_cells,
    rendered,
    tell,
)  # fmt: skip
from benchmarks.tables import table
from roemetry import Recipe
from roemetry.records import Simulated
from roemetry.run.pipeline import Pipeline

CIRCLES = Path("recipes/potato_circles")
_LIGHT = "simulator.options.laser.peak_e_per_ms=1250"
"""Circles are 2.83 m long in the view, the 15 lines of `patterns` 2.25 m at 1580, the grid 4.45 m at 800."""


def main() -> None:
    """Measure, print, and write the page's tables if wanted."""
    given = arguments(__doc__)
    parts = measured(given.seed, given.count, given.images)
    tell(parts, PAGE if given.write else None)


def measured(seed: int, count: int, folder: Path) -> dict[str, str]:
    """Write labels and heights, and volumes, of every family."""
    pipeline = Pipeline(Recipe.load(CIRCLES))
    labels, volumes = [], []
    for family in FAMILIES:
        found, counts = Volumes(pipeline, f"{family}, circles"), np.zeros(4, np.int64)
        errors, ratios = [np.empty(0)], [np.empty(0)]
        for number in range(count):
            item = item_of(family, seed, number, folder)
            trace, truth = found.trace(item, f"item_{number}"), item.truth.stripes
            if trace.peaks is None or trace.stripes is None or trace.profiles is None or truth is None:
                continue
            counts += judged_lines(trace, truth)
            off_px = trace.stripes.x_px - truth.x_px
            on = truth.on_product & trace.stripes.seen & (np.abs(off_px) < NEAR_PX)
            errors.append((trace.profiles.xyz_mm[..., 2] - truth.xyz_mm[..., 2])[on])
            ratios.append((off_px / trace.stripes.x_std_px)[on])
        right, wrong, missed, stray = counts.tolist()
        total = max(right + wrong + missed, 1)
        held, error_mm = np.abs(np.concatenate(ratios)) < 1.96, np.concatenate(errors)
        labels.append([
            family, f"{right / total:.2%} of {total}", f"{wrong}", f"{missed / total:.2%}", f"{stray}",
            f"{held.mean():.1%}" if held.size else "–",
            *off_cells(error_mm[np.isfinite(error_mm)] if error_mm.size else np.full(1, np.nan)),
        ])  # fmt: skip
        volumes.append([family, "11 circles", *found.cells()])
    head = [
        "product", "right", "wrong", "no label", "other light labelled", "95 % intervals of peaks hold",
        "height error, median", "rms",
    ]  # fmt: skip
    return {
        "circles-labels": table(head, labels),
        "circles-volumes": table(["product", "pattern", *VOLUME_HEAD], volumes),
    }


def item_of(family: str, seed: int, number: int, folder: Path) -> Simulated:
    """Render an item, or read it; its plain-light image is that of the other patterns."""
    lights = "simulator.options.light.images="
    path = folder / f"circles-{family}-{seed}-{number}.pickle"
    found = rendered(path, CIRCLES, family, seed, number, [f"{lights}[laser]", _LIGHT])
    path = folder / f"plain-{family}-{seed}-{number}.pickle"
    plain = rendered(path, DOTS, family, seed, number, [f"{lights}[plain]"])
    return replace(found, frames=(*found.frames, *plain.frames))
