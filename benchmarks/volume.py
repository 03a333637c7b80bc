"""Error of every volume estimator on simulated skeins; writes docs/explanation/volume.md.

``python -m benchmarks volume [--first 30000] [--count 500] [--images 60] [--cache DIR] [--page FILE]``

Every skein has a rig of its own. Stripes are traced exactly, 41 at a time, and thinned to fewer; outlines are
exact silhouettes. The images are rendered anew (10 s each and more) and kept in the cache.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.volume_images import image_rows, is_rendered
from benchmarks.volume_page import page
from benchmarks.volume_scenes import Exact, exact_skein, thinned
from roemetry.errors import RoemetryError
from roemetry.records import Product, Volume
from roemetry.stages import VolumeEstimator
from roemetry_paper.zero_order_hold import ZeroOrderHold
from roemetry_volume.outline_surface import OutlineSurface
from roemetry_volume.slice_estimators import (
    SlicePchip,
    SliceSimpson,
    SliceSpline,
    SliceSum,
    SliceTrapezoid,
)
from roemetry_volume.slice_options import SliceOptions

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
    parser.add_argument("--first", type=int, default=30000, help="first seed of skein and rig")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--images", type=int, default=60, help="skeins to render, from seed + 10000")
    parser.add_argument("--no-render", action="store_true", help="only those images that the cache holds")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-volume")
    parser.add_argument("--page", type=Path, default=Path("docs/explanation/volume.md"))
    given = parser.parse_args()
    rows = [
        row for seed in range(given.first, given.first + given.count) for row in rows_of(seed, given.cache)
    ]
    seeds = range(given.first + 10000, given.first + 10000 + given.images)
    rendered = [seed for seed in seeds if not given.no_render or is_rendered(seed, given.cache)]
    pictures = image_rows(rendered, given.cache, ESTIMATORS)
    text = page(rows, pictures, given.first, given.count)
    given.page.write_text(text, encoding="utf-8")
    print(text)


def rows_of(seed: int, cache: Path) -> list[Row]:
    """Measure one skein under every number of stripes."""
    whole = exact_skein(seed, 41, cache)
    rows = []
    for stripes, step in STEPS.items():
        one = thinned(whole, step)
        for name, estimator in ESTIMATORS.items():
            if stripes != 11 and name in ("slice-sum", "slice-pchip, ends: none"):
                continue
            volume, milliseconds = timed(estimator, one.product)
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


def timed(estimator: VolumeEstimator[Any], product: Product) -> tuple[Volume | None, float]:
    """Estimate, three times over; the volume, or None where it was refused, and the median processor time."""
    seconds, volume = [], None
    for _ in range(3):
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
