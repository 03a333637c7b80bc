"""``python -m benchmarks patterns``: grids against their truth, and lines, a grid and dots at equal light.

Products that the ray-caster draws with the rig of `recipes/potato_grid`: its grid, its 15 lines
alone with twice the light each, and the dots of `recipes/potato_dots`. Rendered images are kept in a folder
and used again.
"""

from __future__ import annotations

import argparse
import pickle
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import put_into, table
from roemetry import Recipe
from roemetry.config.scene import Scene
from roemetry.records import Acquisition, Peaks, Simulated, StripeMap, StripeTruth
from roemetry.records.calibration import Calibration
from roemetry.run.pipeline import Pipeline

GRID, DOTS = Path("recipes/potato_grid"), Path("recipes/potato_dots")
PAGE = Path("docs/measurements/patterns.md")
FAMILIES = ("herring-roe", "potato", "egg", "fillet")
PATTERNS = ("15 lines", "15 lines, dot-surface", "grid 15 × 11", "400 dots")
_LINES_LIGHT = "simulator.options.laser.peak_e_per_ms=1580"
"""15 lines 150 mm long, and 11 of 200 mm, in the view: without the latter twice the light for each."""
_NEAR_PX = 2.0
"""A peak nearer than this to a true line is that line."""


def main() -> None:
    """Measure, print, and write the page's tables if wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=32000, help="first seed of products")
    parser.add_argument("--count", type=int, default=2, help="products of each family")
    parser.add_argument(
        "--images", type=Path, default=Path("build/patterns"), help="folder of rendered images"
    )
    parser.add_argument("--write", action="store_true", help=f"write the tables of {PAGE}")
    given = parser.parse_args()
    parts = {
        "labels": labels(given.seed, given.count, given.images),
        "volumes": volumes(given.seed, given.count, given.images),
    }
    for name, part in parts.items():
        print(f"{name}\n{part}")
    if given.write:
        put_into(PAGE, parts)


def rendered(pattern: str, family: str, seed: int, number: int, folder: Path) -> Simulated:
    """Render an item, or read it; all patterns share its plain-light image."""
    plain = _kept(folder / f"plain-{family}-{seed}-{number}.pickle", DOTS, family, seed, number, ["plain"])
    dots, lines = pattern == PATTERNS[3], pattern in PATTERNS[:2]
    sets = [_LINES_LIGHT, "simulator.options.laser.grid=null"] if lines else []
    path = folder / f"{'dots' if dots else 'lines' if lines else 'grid'}-{family}-{seed}-{number}.pickle"
    found = _kept(path, DOTS if dots else GRID, family, seed, number, ["laser"], sets)
    return replace(found, frames=(*found.frames, *plain.frames))


def _kept(
    path: Path, recipe: Path, family: str, seed: int, number: int, images: list[str], sets: Sequence[str] = ()
) -> Simulated:
    if not path.exists():
        of_family = f"simulator.options.product={{family: {family}}}"
        roles = f"simulator.options.light.images=[{', '.join(images)}]"
        scene = Scene.load(recipe / "simulated.yaml", sets=[of_family, roles, *sets])
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(scene.make().simulate(number, seed)))
    found: Simulated = pickle.loads(path.read_bytes())
    return found


def pipeline_of(pattern: str) -> Pipeline:
    """Give the pipeline that measures a pattern: the shipped recipe, of lines alone the usual stages."""
    if pattern not in PATTERNS[:2]:
        return Pipeline(Recipe.load(DOTS if pattern == PATTERNS[3] else GRID))
    volume = "dot-surface" if pattern == PATTERNS[1] else "outline-surface"
    path = Path("build/patterns/lines.yaml")
    upright_of(Calibration.load(GRID / "calibration.yaml")).save(path)
    stages = {"extractor": "gaussian", "coder": "planes", "triangulator": "pinhole-plane", "volume": volume}
    sets = [f"calibration={path.resolve()}", *(f"stages.{kind}={name}" for kind, name in stages.items())]
    return Pipeline(Recipe.load(GRID, sets=sets))


def upright_of(calibration: Calibration) -> Calibration:
    """Leave of a grid's calibration the lines that cross rows."""
    across = calibration.parameters["across_planes_per_mm"].size
    parameters = dict(calibration.parameters)
    del parameters["across_planes_per_mm"]
    kept = calibration.covariance[:-across, :-across]
    return replace(calibration, method="pinhole-plane", parameters=parameters, covariance=kept, across=None)


def labels(seed: int, count: int, folder: Path) -> str:
    """Write how many peaks on products get their line's label, and how far heights are off."""
    pipeline = pipeline_of(PATTERNS[2])
    rows = []
    for family in FAMILIES:
        judged, errors, over = np.zeros(4, np.int64), [np.empty(0)], [np.empty(0)]
        for number in range(count):
            item = rendered(PATTERNS[2], family, seed, number, folder)
            trace = pipeline.trace(_acquisition(item, number))
            if trace.peaks is None or trace.stripes is None or trace.profiles is None:
                continue
            truth = item.truth.stripes
            for peaks, stripes, true in (
                (trace.peaks, trace.stripes, truth),
                (trace.peaks.across, trace.stripes.across, truth.across if truth else None),
            ):
                assert peaks is not None and stripes is not None and true is not None
                judged += _judged(peaks, stripes, true)
                over.append((_off_px(stripes, true) / stripes.x_std_px).ravel())
            errors.append(_height_errors(trace.profiles.xyz_mm[..., 2], trace.stripes, truth))
        error, ratio = np.concatenate(errors), np.concatenate([one[np.isfinite(one)] for one in over])
        right, wrong, missed, stray = judged.tolist()
        total = max(right + wrong + missed, 1)
        rows.append(
            [
                family, f"{right / total:.2%} of {total}", f"{wrong}", f"{missed / total:.2%}", f"{stray}",
                f"{np.mean(np.abs(ratio) < 1.96):.1%}",
                f"{1e3 * np.median(np.abs(error)):.0f} µm", f"{1e3 * np.sqrt((error**2).mean()):.0f} µm",
            ]
        )  # fmt: skip
    return table(
        ["product", "right", "wrong", "no label", "other light labelled", "95 % intervals of peaks hold",
         "height error, median", "rms"], rows,
    )  # fmt: skip


def _acquisition(item: Simulated, number: int) -> Acquisition:
    return Acquisition(f"item_{number}", tuple(replace(frame, name="item") for frame in item.frames))


def _judged(peaks: Peaks, stripes: StripeMap, truth: StripeTruth) -> Any:
    """Count peaks on products: labelled rightly, wrongly, not; and what is no line there and has a label."""
    off = np.abs(np.where(truth.on_product, truth.x_px, np.inf)[:, peaks.row] - peaks.x_px)
    own, near = off.argmin(axis=0), off.min(axis=0, initial=np.inf) < _NEAR_PX
    belt = np.abs(np.where(truth.on_product, np.inf, truth.x_px)[:, peaks.row] - peaks.x_px)
    # of a plane that is seen twice in a row the truth holds the higher place: the other is on the rest line
    rest = np.abs(stripes.rest_px[:, peaks.row] - peaks.x_px)
    elsewhere = np.fmin(belt, rest).min(axis=0, initial=np.inf) >= _NEAR_PX
    label = stripes.peak_stripe
    labelled = (label >= 0) & np.isfinite(stripes.x_px[np.maximum(label, 0), peaks.row])
    return np.array(
        [
            (near & labelled & (label == own)).sum(),
            (near & labelled & (label != own)).sum(),
            (near & ~labelled).sum(),
            (~near & elsewhere & labelled).sum(),
        ]
    )


def _off_px(stripes: StripeMap, truth: StripeTruth) -> Any:
    """Give (stripe, row) errors of what was seen on products, px; NaN elsewhere."""
    off = stripes.x_px - truth.x_px
    return np.where(truth.on_product & stripes.seen & (np.abs(off) < _NEAR_PX), off, np.nan)


def _height_errors(z_mm: Any, stripes: StripeMap, truth: StripeTruth | None) -> Any:
    """Give errors of the heights of what was seen on products, mm, lines of both families."""
    assert truth is not None and truth.across is not None and stripes.across is not None
    count, rows = stripes.x_px.shape
    parts = (z_mm[:count, :rows], stripes, truth), (
        z_mm[count:, : stripes.across.rows], stripes.across, truth.across
    )  # fmt: skip
    errors = [(z - true.xyz_mm[..., 2])[np.isfinite(_off_px(family, true))] for z, family, true in parts]
    return np.concatenate([one[np.isfinite(one)] for one in errors])


def volumes(seed: int, count: int, folder: Path) -> str:
    """Write volumes of every family under every pattern."""
    rows = []
    pipelines = {pattern: pipeline_of(pattern) for pattern in PATTERNS}
    for family in FAMILIES:
        for pattern, pipeline in pipelines.items():
            rows.append([family, pattern, *_volumes(pipeline, pattern, family, seed, count, folder)])
    return table(
        ["product", "pattern", "measured", "mean error", "mean absolute", "largest", "95 % hold",
         "median width", "processor time"], rows,
    )  # fmt: skip


def _volumes(pipeline: Pipeline, pattern: str, family: str, seed: int, count: int, folder: Path) -> list[str]:
    share, widths, seconds, holds = [], [], [], 0
    why: Mapping[str, Any] = {}
    for number in range(count):
        item = rendered(pattern, family, seed, number, folder)
        acquisition, true = _acquisition(item, number), item.truth.products[0].visible_mm3
        begin = time.process_time()
        trace = pipeline.trace(acquisition)
        seconds.append(time.process_time() - begin)
        found = max(
            trace.products, key=lambda one: int((one.product.profiles.product > 0).sum()), default=None
        )
        if found is None or found.volume is None:
            why = trace.absent if found is None else found.absent
            print(family, pattern, number, {kind: reason.text for kind, reason in why.items()})
            continue
        estimate = found.volume.visible_mm3
        share.append(estimate.value / true - 1.0)
        holds += estimate.interval[0] <= true <= estimate.interval[1]
        widths.append((estimate.interval[1] - estimate.interval[0]) / true)
    if not share:
        return [f"0 of {count}", *["–"] * 6]
    off = 100.0 * np.array(share)
    return [
        f"{len(share)} of {count}", f"{off.mean():+.2f} %", f"{np.abs(off).mean():.2f} %",
        f"{np.abs(off).max():.2f} %", f"{holds} of {len(share)}", f"{100.0 * np.median(widths):.1f} %",
        f"{1e3 * np.median(seconds):.0f} ms",
    ]  # fmt: skip


if __name__ == "__main__":
    main()
