"""``python -m benchmarks two_colours``: lines of two colours in turn, against as many lines of one colour.

Products that the ray-caster draws with the rig of `recipes/potato_two_colours`, its lines in two colours and,
with the same planes and the same light, in one. Both are measured with the recipe's calibration. Rendered
images are kept in a folder and used again, those in plain light together with `patterns`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.patterns import (
    DOTS,
    FAMILIES,
    VOLUME_HEAD,
    Volumes,
    arguments,
    judged_lines,
    rendered,
    tell,
)
from benchmarks.pictures import curves
from benchmarks.tables import table
from benchmarks.volume_scenes import calibration_of
from roemetry import Recipe
from roemetry.config.scene import Scene
from roemetry.errors import StageError
from roemetry.records import Acquisition, Simulated, StripeTruth, Trace
from roemetry.records.calibration import Calibration
from roemetry.run.pipeline import Pipeline
from roemetry.run.preprocess import prepare
from roemetry_coding.planes import Planes
from roemetry_coding.two_families import TwoFamilies, part_of
from roemetry_peaks.gaussian import Gaussian
from roemetry_peaks.two_channels import TwoChannels
from roemetry_simulate.ray_caster import RayCaster

RECIPE = Path("recipes/potato_two_colours")
PAGE = Path("docs/measurements/patterns.md")
_ONE_COLOUR = "pattern={kind: lines, lines_x: 20, spacing_x_mm: 6.5}"
_WAYS = ("two colours", "one colour")
_DENSER = ((20, 6.5), (30, 4.3), (40, 3.25), (50, 2.6))
"""Lines over the same 130 mm; the 40 mm of a potato move a line by as much as 7 mm on the belt."""
_POTATOES = 5
PICTURE = Path("docs/images/two-colours.svg")


def main() -> None:
    """Measure, print, and write the page's tables if wanted."""
    given = arguments(__doc__)
    parts = measured(given.seed, given.count, given.images)
    parts["colours-density"] = by_density(given.seed + 100, given.images, PICTURE if given.write else None)
    tell(parts, PAGE if given.write else None)


def measured(seed: int, count: int, folder: Path) -> dict[str, str]:
    """Write labels and volumes of every family, in two colours and in one."""
    pipelines = dict(zip(_WAYS, (_pipeline(two=True), _pipeline(two=False)), strict=True))
    labels, volumes = [], []
    for family in FAMILIES:
        for way, pipeline in pipelines.items():
            found, counts = Volumes(pipeline, f"{family}, {way}"), np.zeros(4, np.int64)
            for number in range(count):
                item = item_of(way, family, seed, number, folder)
                counts += _judged(found.trace(item, f"item_{number}"), item.truth.stripes)
            right, wrong, missed, stray = counts.tolist()
            total = max(right + wrong + missed, 1)
            shares = ["refused", "–", "–", "–"]
            if counts.any():
                shares = [f"{right / total:.2%} of {total}", f"{wrong}", f"{missed / total:.2%}", f"{stray}"]
            labels.append([family, f"20 lines, {way}", *shares])
            volumes.append([family, f"20 lines, {way}", *found.cells()])
    head = ["product", "pattern", "right", "wrong", "no label", "other light labelled"]
    return {
        "colours-labels": table(head, labels),
        "colours-volumes": table(["product", "pattern", *VOLUME_HEAD], volumes),
    }


def by_density(seed: int, folder: Path, picture: Path | None) -> str:
    """Write labels of more and more lines on potatoes, in two colours and in one, with the true geometry."""
    rows: list[list[str]] = []
    shares: dict[str, list[tuple[float, float]]] = {way: [] for way in _WAYS}
    for lines, spacing_mm in _DENSER:
        for colours, way in ((2, _WAYS[0]), (1, _WAYS[1])):
            pattern = (
                f"pattern={{kind: lines, lines_x: {lines}, colours: {colours}, spacing_x_mm: {spacing_mm}}}"
            )
            sets = [pattern, "simulator.options.light.images=[laser]"]
            scene = Scene.load(RECIPE / "simulated.yaml", sets=sets).make()
            assert isinstance(scene, RayCaster)
            calibration = replace(calibration_of(scene.rig), height_range_mm=(0.0, 60.0))
            counts, refused = np.zeros(4, np.int64), 0
            for number in range(_POTATOES):
                name = f"dense-{lines}-{colours}-{seed}-{number}.pickle"
                item = rendered(folder / name, RECIPE, "potato", seed, number, sets)
                try:
                    counts += _coded(item, calibration, two=colours == 2)
                except StageError as error:
                    print(f"{lines} lines, {way}: {error.message}")
                    refused += 1
            right, wrong, missed, _ = counts.tolist()
            total = max(right + wrong + missed, 1)
            rows.append([
                f"{lines}, every {spacing_mm:g} mm", way, f"{right / total:.2%} of {total}",
                f"{wrong / total:.2%}", f"{missed / total:.2%}", f"{refused} of {_POTATOES}",
            ])  # fmt: skip
            shares[way].append((float(lines), right / total))
    if picture is not None:
        curves(picture, shares, "lines over 130 mm", "share of peaks labelled rightly")
    return table(["lines", "in", "right", "wrong", "no label", "refused"], rows)


def _coded(item: Simulated, calibration: Calibration, *, two: bool) -> NDArray[np.int64]:
    channels: dict[str, Any] = {"channel": "red", "second_channel": "green"} if two else {}
    frame = prepare(Acquisition("item", item.frames), turn_deg=0, subtract="none", **channels)
    extractor, coder = (TwoChannels(), TwoFamilies()) if two else (Gaussian(), Planes())
    peaks = extractor.extract(frame)
    trace = Trace("item", peaks=peaks, stripes=coder.code(peaks, calibration))
    return _judged(trace, item.truth.stripes)


def _judged(trace: Trace, truth: StripeTruth | None) -> NDArray[np.int64]:
    """Count as `judged_lines` does, each colour's peaks among the lines of that colour."""
    peaks, stripes = trace.peaks, trace.stripes
    if peaks is None or stripes is None or truth is None or peaks.family is None:
        return np.asarray(judged_lines(trace, truth), np.int64)
    counts, turn = np.zeros(4, np.int64), np.arange(stripes.stripe_count)[:, None] % 2
    for family in (0, 1):
        mine = np.flatnonzero(peaks.family == family)
        part = replace(stripes, peak_stripe=stripes.peak_stripe[mine])
        own = turn == family
        lines = replace(
            truth,
            x_px=np.where(own, truth.x_px, np.nan),
            on_product=truth.on_product & own,
            xyz_mm=np.where(own[..., None], truth.xyz_mm, np.nan),
            product=np.where(own, truth.product, -1).astype(truth.product.dtype),
        )
        counts += judged_lines(Trace("item", peaks=part_of(peaks, mine), stripes=part), lines)
    return counts


def _pipeline(*, two: bool) -> Pipeline:
    stages = () if two else ("stages.extractor=gaussian", "stages.coder=planes")
    one = () if two else ("source.channel=grey", "source.second_channel=null")
    return Pipeline(Recipe.load(RECIPE, sets=[*stages, *one]))


def item_of(way: str, family: str, seed: int, number: int, folder: Path) -> Simulated:
    """Render an item, or read it; its plain-light image is that of the other patterns."""
    lights = "simulator.options.light.images="
    sets = [f"{lights}[laser]", *(() if way == _WAYS[0] else (_ONE_COLOUR,))]
    name = way.replace(" ", "-")
    found = rendered(folder / f"{name}-{family}-{seed}-{number}.pickle", RECIPE, family, seed, number, sets)
    path = folder / f"plain-{family}-{seed}-{number}.pickle"
    plain = rendered(path, DOTS, family, seed, number, [f"{lights}[plain]"])
    return replace(found, frames=(*found.frames, *plain.frames))
