"""Numbers read off a product's outline and what lies within it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry_volume.silhouette import area_of

_CUTS = 41
_MARGIN = 0.06


def features_of(xy_px: Floats, pixels: NDArray[Any]) -> dict[str, float]:
    """Measure an outline in the image.

    Parameters
    ----------
    xy_px : ndarray, shape (n, 2)
        Closed contour.
    pixels
        (row, column) or (row, column, colour in the order blue, green, red) grey levels.

    Returns
    -------
    dict
        ``area_px2``, ``length_px`` (along its long axis), ``width_px`` (largest across that),
        ``convexity`` (area over that of its convex hull), ``bending_deg`` (turn of a cubic through the
        middles of cuts, within the inner 88 %; short of the true turn of strongly bent ones),
        ``sagitta_share`` (largest distance of the mid-line from the line between its ends, over that
        line), ``grey_mean`` and ``grey_std``, and in colour ``blue_mean``, ``green_mean``, ``red_mean``.
    """
    import cv2

    ring = xy_px.astype(np.float32).reshape(-1, 1, 2)
    area = abs(area_of(xy_px))
    hull = float(cv2.contourArea(cv2.convexHull(ring)))
    middle, width = _mid_line(xy_px)
    found = {
        "area_px2": area,
        "length_px": float(np.ptp(_along(xy_px)[0])),
        "width_px": width,
        "convexity": area / hull if hull > 0.0 else float("nan"),
        **_bending(middle),
    }
    mask = np.zeros(pixels.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint(xy_px).astype(np.int32).reshape(-1, 1, 2)], 1)
    inside = pixels[mask.astype(np.bool_)].astype(np.float64)
    if inside.size:
        grey = inside.mean(axis=1) if inside.ndim == 2 else inside
        found |= {"grey_mean": float(grey.mean()), "grey_std": float(grey.std())}
        if inside.ndim == 2:
            found |= {
                f"{name}_mean": float(inside[:, k].mean()) for k, name in enumerate(("blue", "green", "red"))
            }
    return found


def _along(xy: Floats) -> tuple[Floats, Floats]:
    """Places along and across the long axis."""
    off = xy - xy.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(off.T))
    return off @ axes[:, 1], off @ axes[:, 0]


def _mid_line(xy: Floats) -> tuple[Floats, float]:
    """Middles of cuts across the long axis, (m, 2) along and across; and the width of the widest."""
    s, v = _along(xy)
    after_s, after_v = np.roll(s, -1), np.roll(v, -1)
    low, high = float(s.min()), float(s.max())
    inset = _MARGIN * (high - low)
    middles, widest = [], 0.0
    for at in np.linspace(low + inset, high - inset, _CUTS):
        cut = (s <= at) != (after_s <= at)
        crossings = v[cut] + (at - s[cut]) / (after_s[cut] - s[cut]) * (after_v[cut] - v[cut])
        if crossings.size >= 2:
            middles.append((at, 0.5 * (float(crossings.min()) + float(crossings.max()))))
            widest = max(widest, float(np.ptp(crossings)))
    return np.array(middles).reshape(-1, 2), widest


def _bending(middle: Floats) -> dict[str, float]:
    if middle.shape[0] < 5:
        return {"bending_deg": float("nan"), "sagitta_share": float("nan")}
    s, v = middle.T
    half = 0.5 * float(np.ptp(s))
    x = (s - s.mean()) / half
    slope = np.polynomial.polynomial.polyder(np.polynomial.polynomial.polyfit(x, v / half, 3))
    at_ends = np.polynomial.polynomial.polyval(np.array([x[0], x[-1]]), slope)
    turn = np.rad2deg(np.arctan(at_ends[1]) - np.arctan(at_ends[0]))
    chord = v[0] + (v[-1] - v[0]) * (s - s[0]) / (s[-1] - s[0])
    return {
        "bending_deg": float(abs(turn)),
        "sagitta_share": float(np.abs(v - chord).max() / np.hypot(np.ptp(s), v[-1] - v[0])),
    }
