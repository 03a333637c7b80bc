"""One skein on one rig: traced, labelled, and triangulated exactly and by the paper's model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.coded import CodingRig, dense_rig, easy_rig, sample_from
from benchmarks.coded.crossings import Crossings, crossings_of
from benchmarks.coded.products import in_view
from benchmarks.volume_scenes import lifted, rig_of
from roemetry.errors import StageError
from roemetry.records import Peaks, Product
from roemetry.records.calibration import Calibration
from roemetry.run.open_parts import split_products
from roemetry_paper.block_linear import BlockLinear
from roemetry_paper.window_tracking import WindowTracking
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
    seed: int,
    rig: str = "recipe-like",
    kind: str = "",
    family: str = "herring-roe",
    options: Mapping[str, Any] | None = None,
) -> Traced:
    """Trace a skein, or a product of another family.

    Parameters
    ----------
    seed
        Of the skein and of its rig.
    rig
        One of `RIGS`.
    kind
        A kind of skein; "" draws one as the population has them.
    family
        Of products; one without a grid is drawn as it is.
    options
        Of the family.
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
        found.append(max(products, key=_points, default=None))
    return Traced(seed, on, drawn, crossings, found[0], found[1], refused)


def block_calibration(rig: CodingRig) -> Calibration:
    """Give what the paper's block, read without error, says of a rig: one coefficient a stripe."""
    middle = rig.rows // 2
    offset_px = rig.line_px(_BLOCK_MM)[:, middle] - rig.line_px(0.0)[:, middle]
    exact, omega = rig.calibration(), _BLOCK_MM / offset_px
    parameters = {**exact.parameters, "omega_mm_per_px": omega}
    return replace(exact, parameters=parameters, displacement_px_per_mm=1.0 / omega)


def _points(product: Product) -> int:
    return int((product.profiles.product == product.number).sum())


def _at_whole_pixels(peaks: Peaks) -> Peaks:
    """Take peaks to whole pixels, as the paper's extractor gives them; two that meet become one."""
    x_px = np.round(peaks.x_px)
    keep = np.ones(x_px.size, np.bool_)
    keep[1:] = (np.diff(peaks.row) != 0) | (np.diff(x_px) != 0)
    names = ("row", "x_std_px", "amplitude", "background", "width_px", "flags")
    kept = {name: getattr(peaks, name)[keep] for name in names}
    return replace(peaks, x_px=x_px[keep], **kept)
