"""Synthetic runs: eleven Gaussian stripes over domes, with the records a pipeline would give of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roemetry.errors import DataError
from roemetry.records import (
    AMBIGUOUS,
    BELT,
    NOTHING,
    UNLABELLED,
    Acquisition,
    Coding,
    Estimate,
    Frame,
    Measurement,
    ProductTrace,
    Reason,
    Shares,
    StripeMap,
    Trace,
)
from roemetry.run.open_parts import split_products
from roemetry.stages import Run
from roemetry.testing.scenes import LinearRig, frame_of
from roemetry_paper.arc_curvature import ArcCurvature
from roemetry_paper.block_linear import BlockLinear
from roemetry_paper.density import Density
from roemetry_paper.zero_order_hold import ZeroOrderHold

ROWS, COLUMNS, STRIPES = 480, 640, 11
RIG = LinearRig(
    rows=ROWS, columns=COLUMNS, stripes=STRIPES, first_px=58.0, spacing_px=52.0, fan=0.0, px_per_mm=2.2,
    mm_per_px=0.16, sigma_px=1.7,
)  # fmt: skip
NOT_MODELLED = Reason("model-error-not-stated", "the error between the slices is not modelled")


@dataclass(frozen=True)
class Dome:
    """A product: an elliptic dome in image coordinates, with a dent if it is deformed."""

    x: float = 325.0
    y: float = 250.0
    half_length: float = 275.0
    half_width: float = 120.0
    height_mm: float = 17.0
    dent_mm: float = 0.0

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        r2 = ((x - self.x) / self.half_length) ** 2 + ((y - self.y) / self.half_width) ** 2
        z = self.height_mm * np.sqrt(np.clip(1 - r2, 0, None))
        dent = self.dent_mm * np.exp(-(((x - self.x - 40) / 60) ** 2 + ((y - self.y + 10) / 22) ** 2))
        return np.clip(z - dent, 0, None)


@dataclass(frozen=True)
class Scene:
    """One acquisition to be."""

    id: str
    domes: tuple[Dome, ...] = (Dome(),)
    calibrated: bool = True
    noise: int = 40
    gaps: tuple[tuple[int, int, int], ...] = ((4, 236, 250), (7, 205, 214))
    ambiguous: tuple[tuple[int, int, int], ...] = ()
    label: str = "good"
    turn_deg: int = 0
    seed: int = 1
    colour: bool = False


def trace_of(scene: Scene) -> Trace:
    rng = np.random.default_rng(scene.seed)
    rows, rest = np.arange(ROWS, dtype=np.float64), RIG.rest_px()
    z, product = np.zeros_like(rest), np.full(rest.shape, BELT, np.int16)
    for number, dome in enumerate(scene.domes, 1):
        height = np.zeros_like(rest)
        for _ in range(30):
            height = dome.height(rest + RIG.px_per_mm * height, np.broadcast_to(rows, rest.shape))
        product[height > 0.4] = number
        z = np.maximum(z, height)
    x = RIG.x_px(z) + rng.normal(0, 0.06, rest.shape)
    seen = x < COLUMNS - 2
    seen &= ~((product > 0) & (z < 4.0) & (rows[None, :] < 240))  # the far flank is in the laser's shadow
    for stripe, first, last in scene.gaps:
        seen[stripe, first:last] = False
    ambiguous = np.zeros(rest.shape, bool)
    for stripe, first, last in scene.ambiguous:
        ambiguous[stripe, first:last] = True
    lit = np.where(seen | ambiguous, x, np.nan)
    image = frame_of(RIG.light(lit, 190.0), noise=2.2).pixels
    strays, stray_row = np.full((scene.noise, ROWS), np.nan), rng.integers(1, ROWS - 1, scene.noise)
    strays[np.arange(scene.noise), stray_row] = rng.uniform(2, COLUMNS - 3, scene.noise)
    peaks, line = RIG.peaks(np.vstack([lit, strays]))
    refused = (line < STRIPES) & ambiguous[np.minimum(line, STRIPES - 1), peaks.row]
    peak_stripe = np.where(refused, AMBIGUOUS, np.where(line < STRIPES, line, UNLABELLED)).astype(np.int16)
    nothing = np.full(x.shape, np.nan)
    x = np.where((x < COLUMNS - 2) & ~ambiguous, x, np.nan)
    product = np.where(np.isnan(x), NOTHING, product)
    stripes = StripeMap(x, nothing, product, seen & ~np.isnan(x), nothing, ambiguous, rest, peak_stripe)
    colours = np.repeat(image[:, :, None], 3, axis=2) // np.array([4, 4, 1], np.uint8)
    pixels = colours if scene.colour else image
    taken = Frame(np.ascontiguousarray(np.rot90(pixels, -scene.turn_deg // 90)), name="synthetic")
    profiles = BlockLinear().triangulate(stripes, RIG.calibration()) if scene.calibrated else None
    found = split_products(profiles, (), RIG.calibration(), scene.id) if profiles else ()
    return Trace(
        acquisition_id=scene.id,
        acquisition=Acquisition(scene.id, (taken,)),
        frame=Frame(image, name="synthetic", turn_deg=scene.turn_deg),
        peaks=peaks,
        stripes=stripes,
        profiles=profiles,
        products=tuple(_traced(scene, one) for one in found if one.number <= len(scene.domes)),
        absent={} if scene.calibrated else {"triangulator": Reason("uncalibrated", "no calibration")},
        seconds={"source": 0.0004, "extractor": 0.0011, "coder": 0.0013, "volume": 0.0001},
    )


def _traced(scene: Scene, product: Any) -> ProductTrace:
    """The paper's results; the last slice is held, too, and a share is said to be assumed."""
    volume = ZeroOrderHold().estimate(product)
    held = np.full(volume.slice_stripe.size, RIG.spacing_px * RIG.mm_per_px)
    shares = Shares(0.97 * volume.shares.seen, 0.97 * volume.shares.interpolated, 0.03)
    volume = replace(volume, slice_spacing_mm=held, shares=shares)
    grade = replace(ArcCurvature().classify(product), label=scene.label)
    return ProductTrace(product, volume, Density().weigh(product, volume), grade)


def measurements_of(scene: Scene, **changes: Any) -> tuple[Measurement, ...]:
    trace = trace_of(scene)
    stripes, peaks = trace.stripes, trace.peaks
    found = []
    for number in range(1, len(scene.domes) + 1):
        mine = stripes.product == number
        traced = next((p for p in trace.products if p.product.number == number), None)
        heights = None if traced is None else traced.product.profiles.xyz_mm[:, :, 2]
        given = {
            "id": f"{scene.id}#{number}",
            "acquisition": scene.id,
            "product": number,
            "status": "measured",
            "coding": Coding(
                stripes=STRIPES,
                stripes_seen=STRIPES,
                peaks=len(peaks),
                labelled=int((stripes.peak_stripe >= 0).sum()),
                ambiguous=int((stripes.peak_stripe == AMBIGUOUS).sum()),
                unlabelled=int((stripes.peak_stripe == UNLABELLED).sum()),
                rows_seen=int((mine & stripes.seen).sum()),
                rows_interpolated=int((mine & ~stripes.seen).sum()),
                saturated_share=0.0213,
                displacement_max_px=float(np.nanmax(np.where(mine, stripes.x_px - stripes.rest_px, np.nan))),
            ),
            "height_max_mm": Estimate(math.nan if heights is None else float(np.nanmax(heights))),
            "volume": None if traced is None else traced.volume,
            "weight": None if traced is None else traced.weight,
            "grade": None if traced is None else traced.grade,
            "absent": dict(trace.absent),
            "reasons": (NOT_MODELLED,)
            if scene.calibrated
            else (Reason("uncalibrated", "no calibration: results are in pixels"),),
        }
        found.append(Measurement(**(given | changes)))
    return tuple(found)


def failed(name: str, text: str = "the file is truncated at byte 1024\n  → take it again") -> Measurement:
    why = Reason("unreadable", text)
    return Measurement(f"{name}#0", name, 0, "failed", absent={"source": why}, reasons=(why,))


def empty(name: str) -> Measurement:
    coding = Coding(STRIPES, STRIPES, 5271, 5270, 0, 1, 0, 0, 0.0, math.nan)
    why = Reason("no-product", "every stripe lies on the belt: there is no product")
    return Measurement(f"{name}#0", name, 0, "empty", coding=coding, reasons=(why,))


def run_of(
    folder: Path,
    measurements: Iterable[Measurement],
    traces: Callable[[str], Trace] | dict[str, Trace],
    title: str = "Herring roe",
    provenance: dict[str, Any] | None = None,
) -> Run:
    rows = [Measurement.from_json(row.to_json()) for row in measurements]

    def replay(name: str) -> Trace:
        if callable(traces):
            return traces(name)
        if name not in traces:
            raise DataError(f"{name}: the image is gone")
        return traces[name]

    return Run(folder, title, lambda: iter(rows), replay, PROVENANCE if provenance is None else provenance)


PROVENANCE = {
    "roemetry_version": "0.1.0",
    "started": "2025-11-21T05:50:00+00:00",
    "finished": "2025-11-21T05:50:03+00:00",
    "recipe": "recipes/herring_roe/recipe.yaml",
    "recipe_sha256": "3f" * 32,
    "calibration": "recipes/herring_roe/calibration.yaml",
    "calibration_sha256": "a7" * 32,
    "plugins": {"extractor dominant-peak": "roemetry 0.1.0", "coder window-tracking": "roemetry 0.1.0"},
    "counts": {"measured": 4, "empty": 0, "failed": 0},
    "seconds_median": {"source": 0.00041, "extractor": 0.00112, "coder": 0.00131},
    "resolved_recipe": {
        "roemetry": 1,
        "product": "Herring roe",
        "stages": {"extractor": {"use": "dominant-peak", "options": {"threshold": 100, "start": "literal"}}},
    },
}
UNCALIBRATED = PROVENANCE | {"calibration": None, "calibration_sha256": None}


@pytest.fixture(scope="session")
def synthetic() -> SimpleNamespace:
    """All of the above for tests (test folders are not packages)."""
    return SimpleNamespace(**{name: thing for name, thing in globals().items() if not name.startswith("_")})
