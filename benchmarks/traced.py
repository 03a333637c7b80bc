"""Skeins measured without a rendered image: rays are traced, peaks drawn, then labelled and triangulated.

What the light planes meet is exact; each peak has noise, faint ones are lost, neighbours merge, and the coder
must find the stripes' numbers: all that stands between a product and its grade but the image itself. A skein
takes about half a second, where a rendered image takes some seconds of two cores. `shown_mm` says how much of
a defect stripes show; `rows_of` makes a row of each skein.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.coded import (
    CodingRig,
    Crossings,
    crossings_of,
    dense_rig,
    easy_rig,
    in_view,
    sample_from,
)
from benchmarks.tables import kept_rows
from benchmarks.volume_scenes import lifted, rig_of
from roemetry.errors import StageError
from roemetry.records import Peaks, Product
from roemetry.records.calibration import Calibration
from roemetry.run.open_parts import split_products
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions
from roemetry_paper.block_linear import BlockLinear
from roemetry_paper.window_tracking import WindowTracking
from roemetry_shape.features import shape_of
from roemetry_simulate.population import moved_to
from roemetry_simulate.products import PRODUCTS, Drawn

_NOISE_PX = 0.08
_HEIGHTS_MM = (-1.0, 26.0)


def _farther(seed: int) -> CodingRig:
    """Another design: camera 270 to 420 mm above the belt, other lenses, tilts, and projector places."""
    rig = rig_of(seed)
    return CodingRig("farther", rig.camera, rig.laser, _NOISE_PX, _HEIGHTS_MM)


RIGS: Mapping[str, Callable[[int], CodingRig]] = {
    "recipe-like": easy_rig,
    "farther": _farther,
    "dense": dense_rig,
}
"""Families of rigs, each seed its own: about that of the recipe `herring_roe` (300 to 340 mm, laser on either
side); another design; 21 stripes 5 mm apart, wide angle, near, with three times the noise."""

_GRID_MM = 0.25
_BLOCK_MM = 16.5
_PAPER_NOISE_PX = 0.22
"""Before peaks are taken to whole pixels; then rest lines scatter by 0.37 px, as on rendered images."""


@dataclass(frozen=True, eq=False)
class Traced:
    """A skein and what was measured of it."""

    seed: int
    """Of skein and rig."""
    rig: CodingRig
    """The rig."""
    drawn: Drawn
    """The skein where it lies, with its truth and its reference."""
    crossings: Crossings
    """Every true place of a stripe."""
    exact: Product | None
    """Measured with sub-pixel peaks and the true planes of light; None where the coder refused."""
    paper: Product | None
    """Measured with peaks at whole pixels and one coefficient a stripe; None alike."""
    refused: str
    """Why one of them is missing; "" where none is."""


def traced(
    seed: int, rig: str = "recipe-like", kind: str = "", family: str = "herring-roe",
    options: Mapping[str, Any] | None = None,
) -> Traced:  # fmt: skip
    """Trace a skein on one of `RIGS`, or a product of another family with its options.

    `seed` is that of product and rig; `kind` one of skeins, "" draws one as the population has them.
    """
    made, on = PRODUCTS[family], RIGS[rig](seed)
    given: dict[str, Any] = {**(options or {}), **({"kinds": {kind: 1.0}} if kind else {})}
    if "grid_step_mm" in made.Options.model_fields:
        given["grid_step_mm"] = _GRID_MM
    drawn = made.draw(seed, made.Options(**given))
    shift = in_view(drawn.solid, on).footprint_extent_mm()[0] - drawn.solid.footprint_extent_mm()[0]
    drawn = drawn if shift == 0.0 else moved_to(drawn, shift, 0.0)
    crossings = crossings_of(on.camera, on.laser, drawn.solid)
    refused, found = "", []
    calibration, by_block = on.calibration(), block_calibration(on)
    for noise_px, whole_pixels, known, lift in (
        (on.noise_px, False, calibration, lifted),
        (_PAPER_NOISE_PX, True, by_block, BlockLinear().triangulate),
    ):
        peaks = sample_from(replace(on, noise_px=noise_px), crossings, seed=seed).peaks
        peaks = _at_whole_pixels(peaks) if whole_pixels else peaks
        try:
            products = split_products(lift(WindowTracking().code(peaks, known), known), (), known, str(seed))
        except StageError as error:
            refused, products = refused or str(error), ()
        found.append(max(products, key=lambda one: (one.profiles.product == one.number).sum(), default=None))
    return Traced(seed, on, drawn, crossings, found[0], found[1], refused)


def block_calibration(rig: CodingRig) -> Calibration:
    """Give what the paper's block, read without error, says of a rig: one coefficient a stripe."""
    middle = rig.rows // 2
    offset_px = rig.line_px(_BLOCK_MM)[:, middle] - rig.line_px(0.0)[:, middle]
    exact, omega = rig.calibration(), _BLOCK_MM / offset_px
    parameters = {**exact.parameters, "omega_mm_per_px": omega}
    return replace(exact, parameters=parameters, displacement_px_per_mm=1.0 / omega)


def _at_whole_pixels(peaks: Peaks) -> Peaks:
    """Take peaks to whole pixels, as the paper's extractor gives them; two that meet become one."""
    x_px = np.round(peaks.x_px)
    keep = np.ones(x_px.size, np.bool_)
    keep[1:] = (np.diff(peaks.row) != 0) | (np.diff(x_px) != 0)
    return peaks.some(keep, x_px=x_px[keep])


def shown_mm(one: Traced) -> float:
    """Give the most that the defect takes from the sound skein's height at a lit and seen point, mm."""
    whole = one.drawn.reference
    if whole is None or one.drawn.truth.defect == "none":
        return 0.0
    points = one.crossings.xyz_mm[one.crossings.on_product]
    missing = whole.heights_mm(points[:, 0], points[:, 1])[0] - points[:, 2]
    return max(float(np.nanmax(missing, initial=0.0)), 0.0)


SMOOTHING_MM = 3.0
LEARNING_MIX = (
    *("healthy",) * 6,
    *("dented", "dented", "several-dents", "bent", "s-bent"),
    *("twisted", "twisted", "folded", "folded", "broken"),
)
"""Kinds by turns, for learning: every defect often enough, whatever the population has of it."""

NAMED = {
    "none": "good", "dented": "dent", "several-dents": "dent", "bent": "bend", "s-bent": "bend",
    "twisted": "twist", "folded": "fold", "broken": "broken",
}  # fmt: skip
"""The name a grader would give each kind: one dent or several, one bend or an S are told alike."""

BEST_OPTIONS: dict[str, Any] = {"smoothing_rows": 31, "radius_max_px": 160.0, "delta_samples": 10}
"""Of `arc-curvature`, chosen on rendered skeins of seeds 5000 to 5059."""


class Row(NamedTuple):
    """One skein."""

    seed: int
    rig: str
    kind: str
    """seed, rig, kind: what it is; `kind` is ``none`` for a healthy one."""
    refused: str
    """Why nothing was measured; "" where it was."""
    features: dict[str, float]
    """Of `shape_of`; empty where they could not be measured."""
    grades: dict[str, str]
    """Paper's rule as it is (``paper``), and with other options (``best options``)."""
    shown_mm: float
    """Largest height that the defect takes from a lit point; 0 for a healthy one."""

    @property
    def name(self) -> str:
        """What it should be called."""
        return NAMED[self.kind]


def rows_of(seeds: Sequence[int], rig: str, cache: Path) -> list[Row]:
    """Measure skeins, one of each seed, its kind by turns, or take them from the folder `cache`."""

    def make(seed: int) -> dict[str, Any]:
        return _row(traced(seed, rig, LEARNING_MIX[seed % len(LEARNING_MIX)]), rig)._asdict()

    known = kept_rows(cache / f"mix_{rig}.jsonl", seeds, make)
    return [Row(**known[seed]) for seed in seeds]


def _row(one: Traced, rig: str) -> Row:
    features = {} if one.exact is None else shape_of(one.exact, SMOOTHING_MM).features
    grades = {} if one.paper is None else papers_grades(one.paper)
    return Row(one.seed, rig, one.drawn.truth.defect, one.refused, features, grades, shown_mm(one))


def papers_grades(product: Product) -> dict[str, str]:
    """Grade by the paper's rule, as it is and with other options."""
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    return {"paper": ArcCurvature().classify(product).label, "best options": best.classify(product).label}
