"""How much of a defect stripes show: those that were there, and those that there might have been."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.coded import CodingRig
from benchmarks.traced.skeins import Traced
from roemetry.records.arrays import Floats
from roemetry_simulate.solid import Solid

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
    feet = one.rig.laser.x_mm(0.0, 0.0)
    spacing = float(np.abs(np.diff(feet)).mean())
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
