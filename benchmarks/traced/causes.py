"""Why the paper's weight is off: the error taken apart, cause by cause, so that the parts add up."""

from __future__ import annotations

import numpy as np

from benchmarks.traced.skeins import Traced
from roemetry.errors import StageError
from roemetry.records import Product
from roemetry.records.arrays import Floats
from roemetry_paper.zero_order_hold import ZeroOrderHold

CAUSES = ("density", "underside", "ends", "between stripes", "points", "calibration")
PAPER_G_PER_CM3 = 1.1
DENSITY_STD_G_PER_CM3 = 0.02
"""Scatter of the density from skein to skein: an assumption, no measurement of roe stands behind it."""

_STEP_MM = 0.25


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
    return {
        **found,
        "paper_mm3": paper_mm3,
        "visible_mm3": visible_mm3,
        "paper_g": PAPER_G_PER_CM3 * paper_mm3 / 1000.0,
        "true_mm3": solid.true_volume_mm3,
        **parts,
    }


def density_of(seed: int) -> float:
    """Draw a skein's density, g/cm³."""
    return float(np.random.default_rng([seed, 88]).normal(PAPER_G_PER_CM3, DENSITY_STD_G_PER_CM3))


def _held(product: Product) -> float | None:
    try:
        return ZeroOrderHold().estimate(product).visible_mm3.value
    except StageError:
        return None


def _upright(one: Traced) -> tuple[float, float]:
    """Errors, mm³, of holding upright sections at the stripes' feet: between stripes, and at both ends."""
    assert one.exact is not None
    profiles = one.exact.profiles
    lit = np.flatnonzero(((profiles.product == one.exact.number) & profiles.seen).any(axis=1))
    x_min, x_max, y_min, y_max = one.drawn.solid.footprint_extent_mm()
    feet = one.rig.laser.x_mm(0.5 * (y_min + y_max), 0.0)
    # The last stripe of the fan has no next one, and its section is not counted.
    own = np.diff(feet, append=feet[-1])
    area = _areas(one, feet)
    first, last = int(lit[0]), int(lit[-1])
    held = float((area * own)[first:last].sum())
    inner = _volume(one, feet[first], feet[last])
    outer = _volume(one, x_min, feet[first]) + _volume(one, feet[last], x_max)
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
