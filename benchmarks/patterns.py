"""``python -m benchmarks patterns``: grids against their truth, and lines, a grid and dots at equal light.

Products that the ray-caster draws with the rig of `recipes/potato_grid`: its grid, its 15 lines
alone with twice the light each, and the dots of `recipes/potato_dots`. Rendered images are kept in a folder
and used again.
"""

from __future__ import annotations

import argparse
import pickle
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import parser_of
from benchmarks.tables import Against, put_into, table
from roemetry import Recipe
from roemetry.config.scene import Scene
from roemetry.records import Acquisition, Peaks, Simulated, StripeMap, StripeTruth, Trace
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.run.pipeline import Pipeline

GRID, DOTS = Path("recipes/potato_grid"), Path("recipes/potato_dots")
PAGE = Path("docs/measurements/patterns.md")
FAMILIES = ("herring-roe", "potato", "egg", "fillet")
PATTERNS = ("15 lines", "15 lines, dot-surface", "grid 15 × 11", "400 dots")
_LINES_LIGHT = "simulator.options.laser.peak_e_per_ms=1580"
_LINES_ALONE = "pattern={kind: lines, lines_x: 15, spacing_x_mm: 8}"
"""15 lines 150 mm long, and 11 of 200 mm, in the view: without the latter twice the light for each."""
NEAR_PX = 2.0
"""A peak nearer than this to a true line, or dot, is that one."""
VOLUME_HEAD = (
    "measured", "mean error", "mean absolute", "largest", "95 % hold", "median width", "processor time",
)  # fmt: skip


def main() -> None:
    """Measure, print, and write the page's tables if wanted."""
    given = arguments(__doc__)
    asked = given.seed, given.count, given.images
    tell({"labels": labels(*asked), "volumes": volumes(*asked)}, PAGE if given.write else None)


def arguments(description: str | None) -> argparse.Namespace:
    """Read the command line of a benchmark of patterns."""
    parser = parser_of(description)
    parser.add_argument("--seed", type=int, default=32000, help="first seed of products")
    parser.add_argument("--count", type=int, default=2, help="products of each family")
    parser.add_argument(
        "--images", type=Path, default=Path("build/patterns"), help="folder of rendered images"
    )
    parser.add_argument("--write", action="store_true", help=f"write the tables of {PAGE}")
    return parser.parse_args()


def tell(parts: dict[str, str], page: Path | None) -> None:
    """Print the tables, and put them into the page if one is given."""
    for name, part in parts.items():
        print(f"{name}\n{part}")
    if page is not None:
        put_into(page, parts)


def rendered(
    path: Path, recipe: Path, family: str, seed: int, number: int, sets: Sequence[str] = ()
) -> Simulated:
    """Render an item of a family with a recipe's rig, or read it from where it is kept."""
    if not path.exists():
        sets = [f"simulator.options.product={{family: {family}}}", *sets]
        path.parent.mkdir(parents=True, exist_ok=True)
        scene = Scene.load(recipe / "simulated.yaml", sets=sets)
        path.write_bytes(pickle.dumps(scene.make().simulate(number, seed)))
    found: Simulated = pickle.loads(path.read_bytes())
    return found


def item_of(pattern: str, family: str, seed: int, number: int, folder: Path) -> Simulated:
    """Render an item, or read it; all patterns share its plain-light image."""

    def one(name: str, recipe: Path, light: str, *sets: str) -> Simulated:
        path = folder / f"{name}-{family}-{seed}-{number}.pickle"
        lights = f"simulator.options.light.images=[{light}]"
        return rendered(path, recipe, family, seed, number, [lights, *sets])

    if pattern == PATTERNS[3]:
        found = one("dots", DOTS, "laser")
    elif pattern == PATTERNS[2]:
        found = one("grid", GRID, "laser")
    else:
        found = one("lines", GRID, "laser", _LINES_LIGHT, _LINES_ALONE)
    return replace(found, frames=(*found.frames, *one("plain", DOTS, "plain").frames))


def pipeline_of(pattern: str) -> Pipeline:
    """Give the pipeline that measures a pattern: the shipped recipe, of lines alone the usual stages."""
    if pattern not in PATTERNS[:2]:
        return Pipeline(Recipe.load(DOTS if pattern == PATTERNS[3] else GRID))
    volume = "dot-surface" if pattern == PATTERNS[1] else "outline-surface"
    path = Path("build/patterns/lines.yaml")
    path.parent.mkdir(parents=True, exist_ok=True)
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


class Volumes:
    """Volumes of one family, as one pipeline measures them, against their truth."""

    def __init__(self, pipeline: Pipeline | None, what: str) -> None:
        self._pipeline, self._what = pipeline, what
        self._found, self._seconds = Against(), list[float]()

    def trace(self, item: Simulated, name: str, pipeline: Pipeline | None = None) -> Trace:
        """Measure an item, with the family's pipeline or its own; its largest product counts."""
        pipeline = pipeline or self._pipeline
        assert pipeline is not None
        frames = tuple(replace(frame, name="item") for frame in item.frames)
        begin = time.process_time()
        trace = pipeline.trace(Acquisition(name, frames))
        self._seconds.append(time.process_time() - begin)
        found = max(
            trace.products, key=lambda one: int((one.product.profiles.product > 0).sum()), default=None
        )
        if found is not None and found.volume is not None:
            self._found.add(found.volume.visible_mm3, item.truth.products[0].visible_mm3)
        else:
            why = trace.absent if found is None else found.absent
            print(self._what, name, {kind: reason.text for kind, reason in why.items()})
        return trace

    def cells(self) -> list[str]:
        """Write the cells of `VOLUME_HEAD`."""
        found, off = self._found, 100.0 * self._found.off
        if not off.size:
            return [f"0 of {len(self._seconds)}", *["–"] * 6]
        return [
            f"{off.size} of {len(self._seconds)}", f"{off.mean():+.2f} %", f"{np.abs(off).mean():.2f} %",
            f"{np.abs(off).max():.2f} %", f"{found.held} of {off.size}", f"{100.0 * found.width:.1f} %",
            f"{1e3 * np.median(self._seconds):.0f} ms",
        ]  # fmt: skip


def off_cells(error_mm: Floats) -> list[str]:
    """Write the median and the root mean square of height errors."""
    return [f"{1e3 * np.median(np.abs(error_mm)):.0f} µm", f"{1e3 * np.sqrt((error_mm**2).mean()):.0f} µm"]


def volumes(seed: int, count: int, folder: Path) -> str:
    """Write volumes of every family under every pattern."""
    pipelines, rows = {pattern: pipeline_of(pattern) for pattern in PATTERNS}, []
    for family in FAMILIES:
        for pattern, pipeline in pipelines.items():
            found = Volumes(pipeline, f"{family}, {pattern}")
            for number in range(count):
                found.trace(item_of(pattern, family, seed, number, folder), f"item_{number}")
            rows.append([family, pattern, *found.cells()])
    return table(["product", "pattern", *VOLUME_HEAD], rows)


def labels(seed: int, count: int, folder: Path) -> str:
    """Write how many peaks on products get their line's label, and how far heights are off."""
    pipeline, rows = pipeline_of(PATTERNS[2]), []
    for family in FAMILIES:
        judged, errors, over = np.zeros(4, np.int64), [np.empty(0)], [np.empty(0)]
        for number in range(count):
            item = item_of(PATTERNS[2], family, seed, number, folder)
            trace = Volumes(pipeline, family).trace(item, f"item_{number}")
            if trace.peaks is None or trace.stripes is None or trace.profiles is None:
                continue
            truth = item.truth.stripes
            for peaks, stripes, true in (
                (trace.peaks, trace.stripes, truth),
                (trace.peaks.across, trace.stripes.across, truth.across if truth else None),
            ):
                assert peaks is not None and stripes is not None and true is not None
                over.append((_off_px(stripes, true) / stripes.x_std_px).ravel())
            judged += judged_lines(trace, truth)
            errors.append(_height_errors(trace.profiles.xyz_mm[..., 2], trace.stripes, truth))
        ratio = np.concatenate([one[np.isfinite(one)] for one in over])
        right, wrong, missed, stray = judged.tolist()
        total = max(right + wrong + missed, 1)
        rows.append([
            family, f"{right / total:.2%} of {total}", f"{wrong}", f"{missed / total:.2%}", f"{stray}",
            f"{np.mean(np.abs(ratio) < 1.96):.1%}", *off_cells(np.concatenate(errors)),
        ])  # fmt: skip
    return table(
        ["product", "right", "wrong", "no label", "other light labelled", "95 % intervals of peaks hold",
         "height error, median", "rms"], rows,
    )  # fmt: skip


def judged_lines(trace: Trace, truth: StripeTruth | None) -> Any:
    """Count peaks of all families on products, as `_judged` does; nothing where there is no map."""
    if trace.peaks is None or trace.stripes is None or truth is None:
        return np.zeros(4, np.int64)
    counts = _judged(trace.peaks, trace.stripes, truth)
    if trace.peaks.across is None:
        return counts
    assert trace.stripes.across is not None and truth.across is not None
    return counts + _judged(trace.peaks.across, trace.stripes.across, truth.across)


def _judged(peaks: Peaks, stripes: StripeMap, truth: StripeTruth) -> Any:
    """Count peaks on products: labelled rightly, wrongly, not; and what is no line there and has a label."""
    off = np.abs(np.where(truth.on_product, truth.x_px, np.inf)[:, peaks.row] - peaks.x_px)
    own, near = off.argmin(axis=0), off.min(axis=0, initial=np.inf) < NEAR_PX
    belt = np.abs(np.where(truth.on_product, np.inf, truth.x_px)[:, peaks.row] - peaks.x_px)
    # of a plane that is seen twice in a row the truth holds the higher place: the other is on the rest line
    rest = np.abs(stripes.rest_px[:, peaks.row] - peaks.x_px)
    elsewhere = np.fmin(belt, rest).min(axis=0, initial=np.inf) >= NEAR_PX
    label = stripes.peak_stripe
    labelled = (label >= 0) & np.isfinite(stripes.x_px[np.maximum(label, 0), peaks.row])
    right, stray = label == own, ~near & elsewhere & labelled
    parts = near & labelled & right, near & labelled & ~right, near & ~labelled, stray
    return np.array([part.sum() for part in parts])


def _off_px(stripes: StripeMap, truth: StripeTruth) -> Floats:
    """Give (stripe, row) errors of what was seen on products, px; NaN elsewhere."""
    off = stripes.x_px - truth.x_px
    return np.where(truth.on_product & stripes.seen & (np.abs(off) < NEAR_PX), off, np.nan)


def _height_errors(z_mm: Floats, stripes: StripeMap, truth: StripeTruth | None) -> Floats:
    """Give errors of the heights of what was seen on products, mm, lines of both families."""
    assert truth is not None and truth.across is not None and stripes.across is not None
    count, rows = stripes.x_px.shape
    parts = (z_mm[:count, :rows], stripes, truth), (
        z_mm[count:, : stripes.across.rows], stripes.across, truth.across
    )  # fmt: skip
    errors = [(z - true.xyz_mm[..., 2])[np.isfinite(_off_px(family, true))] for z, family, true in parts]
    return np.concatenate([one[np.isfinite(one)] for one in errors])
