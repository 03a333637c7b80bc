"""What tells, beside the volume, how much of a product is product: how high its widest line lies.

The visible volume counts the air below a rounded product. That air lies below the widest line, the rim: a
product whose rim is high has more of it, and one that arches over a gap has a rim that bows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roemetry.records import NOTHING, Product, Volume
from roemetry.records.arrays import Floats
from roemetry.records.units import mm3_to_cm3
from roemetry_volume.footprint import evenly
from roemetry_volume.rim import StripePoints, ends_of, rim_of
from roemetry_volume.surface_fit import points_of

VISIBLE = "visible_cm3"
_LEVEL = 0.8
_CONTOUR_POINTS = 200
_SLICES_MIN = 4
_POINTS_MIN = 4


def weight_features(product: Product, volume: Volume) -> dict[str, float]:
    """Give the features by name, units in the names; shares are of the mean height over the footprint.

    Returns
    -------
    dict
        `visible_cm3`; `end_share`, the height of the slices' ends at the product's middle; with an outline
        and a view also `rim_share`, the height of the rim at the middle, and `rim_bow_share`, how far it
        falls (negative) or rises from there to the ends. Empty but for the volume with fewer than four
        slices.
    """
    found = {VISIBLE: mm3_to_cm3(volume.visible_mm3.value)}
    points = points_of(_seen(product))
    if len(points.first) - 1 < _SLICES_MIN or np.diff(points.first).min(initial=99) < 1:
        return found
    return found | _by_ends(points) | _by_rim(product, points, volume)


def _seen(product: Product) -> Product:
    """Leave bridged points out: at its end a stripe is bridged down to the belt, which is no rim."""
    profiles = product.profiles
    mine = np.where(profiles.seen, profiles.product, NOTHING)
    return replace(product, profiles=replace(profiles, product=mine))


def _by_ends(points: StripePoints) -> dict[str, float]:
    """Fit a parabola along the product to the heights of the slices' ends."""
    places, ends, area, width = [], [], 0.0, 0.0
    for begin, stop in zip(points.first[:-1].tolist(), points.first[1:].tolist(), strict=True):
        if stop - begin < _POINTS_MIN:
            continue
        x, y, z = points.xyz_mm[begin:stop].T
        order = np.argsort(y, kind="stable")
        y, z = y[order], z[order]
        places.append(float(np.median(x)))
        ends.append((z[0], z[-1]))
        area += float((0.5 * (z[1:] + z[:-1]) * np.diff(y)).sum())
        width += float(y[-1] - y[0])
    if len(places) < _SLICES_MIN or not (area > 0.0 and width > 0.0):
        return {}
    at = np.array(places)
    at = (at - 0.5 * (at.min() + at.max())) / max(0.5 * float(np.ptp(at)), 1e-9)
    level = np.polyfit(np.concatenate([at, at]), np.array(ends).T.ravel(), 2)[2]
    return {"end_share": float(level / (area / width))}


def _by_rim(product: Product, points: StripePoints, volume: Volume) -> dict[str, float]:
    from roemetry_volume.footprint import inside_by

    if product.outline is None or product.view is None or not volume.visible_mm3.value > 0.0:
        return {}
    ends = ends_of(points, points.xyz_mm[:, 1])
    level = _LEVEL * float(np.median(points.xyz_mm[ends[0][ends[1]], 2]))
    xy = product.view.at_height(evenly(product.outline.xy_px, _CONTOUR_POINTS), level)[:, :2]
    if not np.isfinite(xy).all():
        return {}
    centre = xy.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((xy - centre).T))
    turn = np.column_stack([axes[:, 1], [-axes[1, 1], axes[0, 1]]])
    place = (points.xyz_mm[:, :2] - centre) @ turn
    contour = (xy - centre) @ turn
    rim = rim_of(points, ends, place, inside_by(contour, place[ends[0]]))
    mean_mm = volume.visible_mm3.value / _area(contour)
    return {
        "rim_share": float(rim.coefficients[0] / mean_mm),
        "rim_bow_share": float(rim.coefficients[2] / mean_mm),
    }


def _area(contour: Floats) -> float:
    x, y = contour.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
