"""Error of every volume estimator on simulated skeins; writes docs/measurements/volume.md.

``python -m benchmarks volume [--first 80000] [--count 500] [--meshes 20] [--images 100] [--page FILE]``

Every skein has a rig of its own. Stripes are traced exactly, 41 at a time, and thinned to fewer; outlines are
exact silhouettes. The images are rendered anew (10 s each and more) and kept in the cache, as are each
skein's results, for as long as no estimator changes: a run that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import statistics
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.volume_bodies import body_rows
from benchmarks.volume_images import image_rows, is_rendered
from benchmarks.volume_page import IN_IMAGES, Pictures, Seeds, page
from benchmarks.volume_scenes import Exact, exact_skein, thinned
from roemetry.errors import RoemetryError
from roemetry.io.files import write_whole
from roemetry.records import Product, Volume
from roemetry.stages import VolumeEstimator
from roemetry_open3d.surface_mesh import MeshOptions, SurfaceMesh
from roemetry_paper.zero_order_hold import ZeroOrderHold
from roemetry_volume.outline_surface import OutlineSurface
from roemetry_volume.slice_estimators import (
    SliceOptions,
    SlicePchip,
    SliceSimpson,
    SliceSpline,
    SliceSum,
    SliceTrapezoid,
)

ESTIMATORS: Mapping[str, VolumeEstimator[Any]] = {
    "zero-order-hold": ZeroOrderHold(),
    "slice-sum": SliceSum(),
    "slice-trapezoid": SliceTrapezoid(),
    "slice-simpson": SliceSimpson(),
    "slice-pchip": SlicePchip(),
    "slice-spline": SliceSpline(),
    "slice-pchip, ends: none": SlicePchip(SliceOptions(ends="none")),
    "outline-surface": OutlineSurface(),
}
MESHES: Mapping[str, VolumeEstimator[Any]] = {
    f"surface-mesh, {method}": SurfaceMesh(MeshOptions(method=method))
    for method in ("poisson", "ball-pivoting", "alpha-shape")
}
"""Hundreds of times as slow: measured on the first skeins only."""
_ONLY_ELEVEN = ("slice-pchip, ends: none", "surface-mesh, ball-pivoting", "surface-mesh, alpha-shape")
_SOURCES = ("roemetry_volume", "roemetry_open3d", "roemetry_paper", "roemetry_kernels", "roemetry_peaks")
_OF_BODIES = ("outline-surface", "slice-pchip")
_LOOKED_AT = (range(70000, 70060), range(90000, 90060), range(110000, 110060))
"""Skeins whose images the intervals' widths were chosen on: shown by themselves, where the cache has them."""
STEPS = {41: 1, 21: 2, 11: 4, 9: 5, 6: 8, 5: 10, 3: 20}
"""How many stripes remain when each so many of 41 is kept."""


class Row(NamedTuple):
    """One estimate against the truth; errors and uncertainty relative to the true visible volume."""

    seed: int
    stripes: int
    estimator: str
    error: float
    std: float
    milliseconds: float
    defect: str
    overhang: float
    bend_deg: float
    true_share: float


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=80000, help="first seed of skein and rig")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--meshes", type=int, default=20, help="skeins to lay meshes through, the first ones")
    parser.add_argument("--images", type=int, default=100, help="skeins to render")
    parser.add_argument("--images-from", type=int, default=120000, help="first seed of those")
    parser.add_argument("--draws", type=int, default=50, help="of each skein from images")
    parser.add_argument("--bodies", type=int, default=99001, help="first seed of the known bodies' rigs")
    parser.add_argument("--no-render", action="store_true", help="only those images that the cache holds")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-volume")
    parser.add_argument("--page", type=Path, default=Path("docs/measurements/volume.md"))
    given = parser.parse_args()
    code = code_hash()
    rows = [
        row
        for number, seed in enumerate(range(given.first, given.first + given.count))
        for row in kept_rows(seed, given.cache, meshes=number < given.meshes, code=code)
    ]
    seeds = range(given.images_from, given.images_from + given.images)
    rendered = [seed for seed in seeds if not given.no_render or is_rendered(seed, given.cache)]
    unseen, refusals = image_rows(rendered, given.cache, ESTIMATORS, draws=given.draws, code=code)
    kept = [seed for span in _LOOKED_AT for seed in span if is_rendered(seed, given.cache)]
    few = {name: ESTIMATORS[name] for name in IN_IMAGES}
    looked_at, _ = image_rows(kept, given.cache, few, draws=given.draws, code=code, lights=("plain",))
    known = body_rows(given.bodies, given.cache, {name: ESTIMATORS[name] for name in _OF_BODIES}, code)
    asked = Seeds(
        given.first, given.count, given.meshes, given.images, given.images_from, given.draws, given.bodies
    )
    pictures = Pictures(unseen, looked_at, refusals)
    text = page(rows, pictures, known, asked, given.page.parent.parent / "images")
    given.page.write_text(text, encoding="utf-8")
    print(text)


def code_hash() -> str:
    """Give a hash of the sources that results depend on."""
    plugins = Path(__file__).parents[1] / "plugins"
    text = hashlib.sha256()
    for path in sorted(path for name in _SOURCES for path in (plugins / name).rglob("*.py")):
        text.update(path.read_bytes())
    return text.hexdigest()[:12]


def kept_rows(seed: int, cache: Path, *, meshes: bool, code: str) -> list[Row]:
    """Measure one skein, or take what was measured with the same code."""
    path = cache / f"{seed}_{code}_{'meshes' if meshes else 'slices'}.json"
    if not path.exists():
        write_whole(path, json.dumps(rows_of(seed, cache, meshes=meshes)))
    return [Row(*row) for row in json.loads(path.read_text("utf-8"))]


def rows_of(seed: int, cache: Path, *, meshes: bool = False) -> list[Row]:
    """Measure one skein under every number of stripes, the slower estimators under eleven only."""
    whole = exact_skein(seed, 41, cache)
    rows = []
    for stripes, step in STEPS.items():
        one = thinned(whole, step)
        for name, estimator in {**ESTIMATORS, **(MESHES if meshes else {})}.items():
            if stripes != 11 and name in _ONLY_ELEVEN:
                continue
            volume, milliseconds = timed(estimator, one.product, 3 if stripes == 11 else 1)
            error, std = against(volume, one)
            rows.append(
                Row(
                    seed,
                    stripes,
                    name,
                    error,
                    std,
                    milliseconds,
                    whole.defect,
                    overhang_of(one),
                    abs(whole.figures.get("bend_deg", 0.0)),
                    whole.true_mm3 / whole.visible_mm3,
                )
            )
    return rows


def timed(estimator: VolumeEstimator[Any], product: Product, repeats: int) -> tuple[Volume | None, float]:
    """Give the volume, None where it was refused, and the median processor time of some calls, ms."""
    seconds, volume = [], None
    for _ in range(1 if isinstance(estimator, SurfaceMesh) else repeats):
        begin = time.process_time()
        try:
            volume = estimator.estimate(product)
        except RoemetryError:
            return None, float("nan")
        seconds.append(time.process_time() - begin)
    return volume, 1e3 * statistics.median(seconds)


def against(volume: Volume | None, one: Exact) -> tuple[float, float]:
    """Error and standard uncertainty of the visible volume, relative to the truth."""
    if volume is None:
        return float("nan"), float("nan")
    return volume.visible_mm3.value / one.visible_mm3 - 1.0, volume.visible_mm3.std / one.visible_mm3


def overhang_of(one: Exact) -> float:
    """How far the product reaches beyond the outermost lit points, at its worse end, in spacings."""
    x = one.product.profiles.xyz_mm[..., 0]
    planes = one.product.profiles.plane
    spacing = float(np.diff(planes[:, 3] / planes[:, 0]).mean())
    return max(float(np.nanmin(x)) - one.extent_mm[0], one.extent_mm[1] - float(np.nanmax(x))) / spacing


if __name__ == "__main__":
    main()
