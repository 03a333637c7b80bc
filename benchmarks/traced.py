"""Skeins measured without a rendered image: rays are traced, peaks drawn, then labelled and triangulated.

What the light planes meet is exact; each peak has noise, faint ones are lost, neighbours merge, and the coder
must find the stripes' numbers: all that stands between a product and its grade but the image itself. A skein
takes about half a second, where a rendered image takes some seconds of two cores. `defect_figures` say how
much of a defect stripes show; `weight_figures` take the error of the paper's weight apart, cause by cause, so
that the parts add up; `rows_of` makes a row of each skein.
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
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.run.open_parts import split_products
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions
from roemetry_paper.block_linear import BlockLinear
from roemetry_paper.window_tracking import WindowTracking
from roemetry_paper.zero_order_hold import ZeroOrderHold
from roemetry_shape.features import shape_of
from roemetry_simulate.population import moved_to
from roemetry_simulate.products import PRODUCTS, Drawn
from roemetry_simulate.solid import Solid

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
    names = ("row", "x_std_px", "amplitude", "background", "width_px", "flags")
    kept = {name: getattr(peaks, name)[keep] for name in names}
    return replace(peaks, x_px=x_px[keep], **kept)


STRIPES = (6, 8, 11, 16, 21, 31, 41)
"""Numbers of stripes over the width of the rig's own fan."""

_STEP_MM = 0.25
_LEAST_MM = 1.0


def defect_figures(one: Traced, lines: Sequence[int] = STRIPES) -> dict[str, float]:
    """Give sizes of a skein's defect, and what stripes show of it, mm.

    ``depth_mm``
        Largest height that is missing from the skein without the defect.
    ``extent_mm``
        How far along X the places reach where a millimetre or more is missing, and ``spacings``, the same
        in spacings of the stripes.
    ``shown_mm``
        Largest height missing at a lit and seen point.
    ``shown_N_mm``
        The same on N ideal lines over the same width, for each N of `lines`: what hides behind the product
        counts as seen.
    """
    solid, whole = one.drawn.solid, one.drawn.reference
    lines_x = one.rig.laser.x_mm(0.0, 0.0)
    spacing = float(np.abs(np.diff(lines_x)).mean())
    if whole is None or one.drawn.truth.defect == "none":
        zero = {"depth_mm": 0.0, "extent_mm": 0.0, "spacings": 0.0, "shown_mm": 0.0}
        return {**zero, **{f"shown_{n}_mm": 0.0 for n in lines}}
    x_min, x_max, y_min, y_max = whole.footprint_extent_mm()
    x, y = np.meshgrid(np.arange(x_min, x_max, _STEP_MM), np.arange(y_min, y_max, _STEP_MM))
    missing = _missing(solid, whole, x, y)
    columns = np.flatnonzero((missing >= _LEAST_MM).any(axis=0))
    extent = _STEP_MM * float(np.ptp(columns) + 1) if columns.size else 0.0
    points = one.crossings.xyz_mm[one.crossings.on_product]
    at = whole.heights_mm(points[:, 0], points[:, 1])[0] - points[:, 2]
    return {
        "depth_mm": _most(missing),
        "extent_mm": extent,
        "spacings": extent / spacing,
        "shown_mm": _most(at),
        **{f"shown_{n}_mm": _on_lines(one.rig, solid, whole, n, (y_min, y_max)) for n in lines},
    }


def _missing(solid: Solid, whole: Solid, x_mm: Floats, y_mm: Floats) -> Floats:
    return np.asarray(whole.heights_mm(x_mm, y_mm)[0] - solid.heights_mm(x_mm, y_mm)[0])


def _on_lines(
    rig: CodingRig, solid: Solid, whole: Solid, count: int, y_range_mm: tuple[float, float]
) -> float:
    """Most that is missing on the lines where evenly spaced planes of light meet the skein."""
    y = np.arange(*y_range_mm, _STEP_MM)
    place = np.linspace(0.0, rig.laser.count - 1.0, count)
    z = np.zeros((y.size, count))
    x = z
    for _ in range(8):  # where the plane's X at this height is, the height is looked up again
        x = _between(rig, y, z, place)
        z = 0.5 * (z + np.nan_to_num(solid.heights_mm(x, np.broadcast_to(y[:, None], x.shape))[0]))
    return _most(_missing(solid, whole, x, np.broadcast_to(y[:, None], x.shape)))


def _between(rig: CodingRig, y_mm: Floats, z_mm: Floats, place: Floats) -> Floats:
    """X of planes that stand between the rig's own; `place` counts these, and may be a fraction."""
    low = np.minimum(place.astype(np.int64), rig.laser.count - 2)
    share = place - low
    found = np.empty_like(z_mm)
    for k, (i, part) in enumerate(zip(low, share, strict=True)):
        at = rig.laser.x_mm(y_mm, z_mm[:, k])
        found[:, k] = (1.0 - part) * at[:, i] + part * at[:, i + 1]
    return found


def _most(missing_mm: Floats) -> float:
    known = missing_mm[np.isfinite(missing_mm)]
    return max(float(known.max()), 0.0) if known.size else 0.0


CAUSES = ("density", "underside", "ends", "between stripes", "points", "calibration")
PAPER_G_PER_CM3 = 1.1
DENSITY_STD_G_PER_CM3 = 0.02
"""Scatter of the density from skein to skein: an assumption, no measurement of roe stands behind it."""


def weight_figures(one: Traced) -> dict[str, float]:
    """Give true and estimated mass, g, and the parts of the relative error, by cause; empty without weight.

    density
        The skein's own density is not the paper's.
    underside
        Visible volume stands for the true one.
    ends
        Before the first lit stripe nothing is counted, after the last its section is held to the next.
    between stripes
        Each section is held to the next stripe.
    points
        Light planes lean and draw together upwards, flanks are hidden or lost, peaks scatter: the sections
        are not the upright ones.
    calibration
        One scale for all heights, one coefficient a stripe, peaks at whole pixels.
    """
    density = density_of(one.seed)
    solid = one.drawn.solid
    true_g = density * solid.true_volume_mm3 / 1000.0
    found = {"true_g": true_g, "density_g_per_cm3": density}
    if one.exact is None or one.paper is None:
        return found
    exact_mm3, paper_mm3 = _held(one.exact), _held(one.paper)
    if exact_mm3 is None or paper_mm3 is None:
        return found
    between_mm3, ends_mm3 = _upright(one)
    visible_mm3 = solid.visible_volume_mm3
    steps = {
        "density": (PAPER_G_PER_CM3 - density) / PAPER_G_PER_CM3 * solid.true_volume_mm3,
        "underside": visible_mm3 - solid.true_volume_mm3,
        "ends": ends_mm3,
        "between stripes": between_mm3,
        "points": exact_mm3 - (visible_mm3 + ends_mm3 + between_mm3),
        "calibration": paper_mm3 - exact_mm3,
    }
    parts = {f"error: {cause}": PAPER_G_PER_CM3 * steps[cause] / 1000.0 / true_g for cause in CAUSES}
    return found | {
        "paper_mm3": paper_mm3, "visible_mm3": visible_mm3, "true_mm3": solid.true_volume_mm3,
        "paper_g": PAPER_G_PER_CM3 * paper_mm3 / 1000.0, **parts,
    }  # fmt: skip


def density_of(seed: int) -> float:
    """Draw a skein's density, g/cm³."""
    return float(np.random.default_rng([seed, 88]).normal(PAPER_G_PER_CM3, DENSITY_STD_G_PER_CM3))


def _held(product: Product) -> float | None:
    try:
        return ZeroOrderHold().estimate(product).visible_mm3.value
    except StageError:
        return None


def _upright(one: Traced) -> tuple[float, float]:
    """Errors, mm³, of upright sections held where stripes meet the belt: between them, and at both ends."""
    assert one.exact is not None
    profiles = one.exact.profiles
    lit = np.flatnonzero(((profiles.product == one.exact.number) & profiles.seen).any(axis=1))
    x_min, x_max, y_min, y_max = one.drawn.solid.footprint_extent_mm()
    lines_x = one.rig.laser.x_mm(0.5 * (y_min + y_max), 0.0)
    # The last stripe of the fan has no next one, and its section is not counted.
    own = np.diff(lines_x, append=lines_x[-1])
    area = _areas(one, lines_x)
    first, last = int(lit[0]), int(lit[-1])
    held = float((area * own)[first:last].sum())
    inner = _volume(one, lines_x[first], lines_x[last])
    outer = _volume(one, x_min, lines_x[first]) + _volume(one, lines_x[last], x_max)
    return held - inner, float(area[last] * own[last]) - outer


def _areas(one: Traced, x_mm: Floats) -> Floats:
    """(place,) areas of upright sections, mm²."""
    _, _, y_min, y_max = one.drawn.solid.footprint_extent_mm()
    x, y = np.meshgrid(x_mm, np.arange(y_min, y_max + _STEP_MM, _STEP_MM), indexing="ij")
    return np.asarray(np.nan_to_num(one.drawn.solid.heights_mm(x, y)[0]).sum(axis=1) * _STEP_MM)


def _volume(one: Traced, low_mm: float, high_mm: float) -> float:
    if high_mm <= low_mm:
        return 0.0
    steps = max(int((high_mm - low_mm) / _STEP_MM), 1)
    edges = np.linspace(low_mm, high_mm, steps + 1)
    return float(_areas(one, 0.5 * (edges[1:] + edges[:-1])).sum() * (high_mm - low_mm) / steps)


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
    defect: dict[str, float]
    """Of `defect_figures`; of the population also on other numbers of lines."""
    weight: dict[str, float]
    """Of `weight_figures`; of the population alone."""

    @property
    def name(self) -> str:
        """What it should be called."""
        return NAMED[self.kind]


def rows_of(seeds: Sequence[int], rig: str, cache: Path, *, mix: Sequence[str] = ()) -> list[Row]:
    """Measure skeins, one of each seed, or take them from the folder `cache`.

    `mix` are kinds by turns; without it, as the population has them.
    """

    def make(seed: int) -> dict[str, Any]:
        return _row(traced(seed, rig, mix[seed % len(mix)] if mix else ""), rig, whole=not mix)._asdict()

    name = f"{'mix' if mix else 'population'}_{rig}.jsonl"
    known = kept_rows(cache / name, seeds, make)
    return [Row(**known[seed]) for seed in seeds]


def _row(one: Traced, rig: str, *, whole: bool) -> Row:
    features = {} if one.exact is None else shape_of(one.exact, SMOOTHING_MM).features
    grades = {} if one.paper is None else papers_grades(one.paper)
    defect = defect_figures(one) if whole else defect_figures(one, ())
    weight = weight_figures(one) if whole else {}
    return Row(one.seed, rig, one.drawn.truth.defect, one.refused, features, grades, defect, weight)


def papers_grades(product: Product) -> dict[str, str]:
    """Grade by the paper's rule, as it is and with other options."""
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    return {"paper": ArcCurvature().classify(product).label, "best options": best.classify(product).label}
