"""Synthetic runs: eleven Gaussian stripes over domes, with the records a pipeline would give of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
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
    UNCODED,
    Acquisition,
    Coding,
    Estimate,
    Frame,
    Grade,
    Marks,
    Measurement,
    Peaks,
    Product,
    ProductTrace,
    Profiles,
    Reason,
    Shares,
    StripeMap,
    Trace,
    Volume,
    Weight,
)
from roemetry.records.calibration import Calibration
from roemetry.stages import Run

ROWS, COLUMNS, STRIPES = 480, 640, 11
PX_PER_MM = 2.2
MM_PER_PX = 0.16
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
    rows = np.arange(ROWS, dtype=np.float64)
    rest = 58.0 + 52.0 * np.arange(STRIPES)[:, None] + 0.012 * (rows - (ROWS - 1) / 2)[None, :]
    x = rest.copy()
    z = np.zeros_like(rest)
    product = np.full(rest.shape, BELT, np.int16)
    for number, dome in enumerate(scene.domes, 1):
        height = np.zeros_like(rest)
        for _ in range(30):
            height = dome.height(rest + PX_PER_MM * height, np.broadcast_to(rows, rest.shape))
        product[height > 0.4] = number
        z = np.maximum(z, height)
    x = rest + PX_PER_MM * z + rng.normal(0, 0.06, rest.shape)
    known = x < COLUMNS - 2
    seen = known.copy()
    for stripe, first, last in scene.gaps:
        seen[stripe, first:last] = False
    edge = (product > 0) & (z < 4.0) & (rows[None, :] < 240)  # the far flank is in the laser's shadow
    seen &= ~edge
    ambiguous = np.zeros(rest.shape, bool)
    for stripe, first, last in scene.ambiguous:
        ambiguous[stripe, first:last] = True
    image = _image(x, seen | ambiguous, rng)
    peaks, peak_stripe = _peaks(x, seen, ambiguous, scene.noise, rng)
    x = np.where(known & ~ambiguous, x, np.nan)
    product = np.where(np.isnan(x), NOTHING, product)
    stripes = StripeMap(
        x_px=x,
        x_std_px=np.full(x.shape, np.nan),
        product=product,
        seen=seen & ~np.isnan(x),
        margin=np.full(x.shape, np.nan),
        ambiguous=ambiguous,
        rest_px=rest,
        peak_stripe=peak_stripe,
    )
    pixels = (
        np.repeat(image[:, :, None], 3, axis=2) // np.array([4, 4, 1], np.uint8) if scene.colour else image
    )
    frame = Frame(image, name="synthetic", turn_deg=scene.turn_deg)
    taken = Frame(np.ascontiguousarray(np.rot90(pixels, -scene.turn_deg // 90)), name="synthetic")
    profiles = _profiles(x, z, product, stripes.seen, rest) if scene.calibrated else None
    products = (
        ()
        if profiles is None
        else tuple(_product(scene, profiles, n) for n in range(1, len(scene.domes) + 1))
    )
    return Trace(
        acquisition_id=scene.id,
        acquisition=Acquisition(scene.id, (taken,)),
        frame=frame,
        peaks=peaks,
        stripes=stripes,
        profiles=profiles,
        products=products,
        absent={} if scene.calibrated else {"triangulator": Reason("uncalibrated", "no calibration")},
        seconds={"source": 0.0004, "extractor": 0.0011, "coder": 0.0013, "volume": 0.0001},
    )


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
                coded=int((stripes.peak_stripe >= 0).sum()),
                ambiguous=int((stripes.peak_stripe == AMBIGUOUS).sum()),
                uncoded=int((stripes.peak_stripe == UNCODED).sum()),
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


def _image(x: np.ndarray, lit: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    columns = np.arange(COLUMNS)
    image = np.full((ROWS, COLUMNS), 9.0) + 14 * np.exp(-(((columns[None, :] - 320) / 400.0) ** 2))
    for stripe in range(STRIPES):
        power = 190 * np.where(lit[stripe], rng.normal(1, 0.06, ROWS), 0)
        image += power[:, None] * np.exp(-0.5 * ((columns[None, :] - x[stripe][:, None]) / 1.7) ** 2)
    return np.clip(image + rng.normal(0, 2.2, image.shape), 0, 255).round().astype(np.uint8)


def _peaks(
    x: np.ndarray, seen: np.ndarray, ambiguous: np.ndarray, noise: int, rng: np.random.Generator
) -> tuple[Peaks, np.ndarray]:
    stripe, row = np.nonzero(seen | ambiguous)
    place = x[stripe, row]
    label = np.where(ambiguous[stripe, row], AMBIGUOUS, stripe)
    row = np.concatenate([row, rng.integers(1, ROWS - 1, noise)])
    place = np.concatenate([place, rng.uniform(2, COLUMNS - 3, noise)])
    label = np.concatenate([label, np.full(noise, UNCODED)])
    order = np.lexsort((place, row))
    n = order.size
    peaks = Peaks(
        (ROWS, COLUMNS),
        row[order],
        place[order],
        np.full(n, np.nan),
        np.full(n, 180.0),
        np.full(n, 12.0),
        np.full(n, 4.0),
        np.zeros(n, np.uint8),
    )
    return peaks, label[order]


def _profiles(
    x: np.ndarray, z: np.ndarray, product: np.ndarray, seen: np.ndarray, rest: np.ndarray
) -> Profiles:
    rows = np.broadcast_to(np.arange(ROWS, dtype=np.float64), x.shape)
    xyz = np.stack([(x - 320) * MM_PER_PX, (240 - rows) * MM_PER_PX, (x - rest) / PX_PER_MM], axis=2)
    xyz[np.isnan(x)] = np.nan
    plane = np.tile([1.0, 0.0, 0.0, 0.0], (STRIPES, 1))
    return Profiles(
        xyz,
        product,
        seen,
        x,
        rows,
        np.full(x.shape, np.nan),
        np.arange(STRIPES),
        np.zeros(STRIPES, int),
        plane,
    )


def _product(scene: Scene, profiles: Profiles, number: int) -> ProductTrace:
    from roemetry.run.open_parts import split_products

    product = next(p for p in split_products(profiles, (), _calibration(), scene.id) if p.number == number)
    z = np.nan_to_num(product.profiles.xyz_mm[:, :, 2])
    area = z.sum(axis=1) * MM_PER_PX
    with_area = np.flatnonzero(area > 0)
    spacing = np.full(with_area.size, 52 * MM_PER_PX) + 0.2 * np.sin(with_area)
    visible = float((area[with_area] * spacing).sum())
    mine = product.profiles.product > 0
    seen = float(z[product.profiles.seen & mine].sum() / z[mine].sum())
    volume = Volume(
        Estimate(visible),
        None,
        Shares(0.97 * seen, 0.97 * (1 - seen), 0.03),
        with_area,
        area[with_area],
        spacing,
    )
    weight = Weight(Estimate(visible / 1000 * 1.1), (Reason("density", "weighed with 1.1 g/cm³"),))
    return ProductTrace(product, volume, weight, _grade(scene, product))


def _grade(scene: Scene, product: Product) -> Grade:
    profiles = product.profiles
    stripe, start, end, value = [], [], [], []
    for index in range(STRIPES):
        rows = np.flatnonzero(profiles.product[index] > 0)
        points = np.column_stack([profiles.x_px[index], profiles.row_px[index]])[rows[::14]]
        for a, b, c in zip(points, points[1:], points[2:], strict=False):
            m = 2 * np.array([b - a, c - a])
            if abs(np.linalg.det(m)) < 1e-6:
                continue
            centre = np.linalg.solve(m, [b @ b - a @ a, c @ c - a @ a])
            stripe.append(index)
            start.append(b)
            end.append(centre)
            value.append(math.copysign(float(np.hypot(*(centre - b))), b[0] - centre[0]))
    magnitude = np.array(value)
    flagged = (magnitude < -4) & (magnitude > -80) if scene.label != "good" else np.zeros(len(value), bool)
    marks = Marks("centre of arc", "px", np.array(stripe), np.array(start), np.array(end), magnitude, flagged)
    text = f"{int(flagged.sum())} of {flagged.size} arcs bow inwards with a radius between 4 and 80 px"
    reason = (
        Reason("dent", text)
        if flagged.any()
        else Reason("no-dent", f"none of {flagged.size} arcs bows inwards")
    )
    features = {"radius_min_px": float(np.abs(magnitude).min()), "arcs": float(flagged.size)}
    return Grade(scene.label, features=features, reasons=(reason,), marks=marks)


def _calibration() -> Calibration:
    return Calibration(
        method="block-linear",
        image_size=(ROWS, COLUMNS),
        turn_deg=0,
        rest_px=np.column_stack([58.0 + 52.0 * np.arange(STRIPES), np.full(STRIPES, 0.012)]),
        displacement_px_per_mm=np.full(STRIPES, PX_PER_MM),
        height_range_mm=(0.0, 30.0),
        parameters={},
        covariance=np.empty((0, 0)),
    )
