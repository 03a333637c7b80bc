"""A product's cross-sections on one grid: smoothed, and sampled evenly from edge to edge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records import Product
from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.shape.arcs import body_curves, smoothed

SAMPLES = 65
"""Samples across a section; an odd number, so that one is its middle."""

_POINTS_MIN = 12
_WIDTH_MIN_MM = 2.0
_SLIVER = 0.15
"""Of the largest height: whether a stripe still shows a lower outer section is a matter of light."""

_GAP_MAX = 2.0 / 3.0
"""Of a section's width: where more is missing in one piece, two slivers at the foot are no section."""


class Sections(NamedTuple):
    """Cross-sections in the order in which they lie along the product's long way.

    Attributes
    ----------
    stripe
        (section,) stripe index.
    along_mm
        (section,) place of each section's middle along the way through the middles, mm, from the first.
    middle_mm
        (section, 2) X and Y of the middle between its edges, mm.
    half_width_mm
        (section,) half the distance between its edges, mm.
    height_mm
        (section, SAMPLES) height over the belt at even steps from edge to edge, mm.
    across_mm
        (section, SAMPLES) distance from the middle along Y, mm.
    x_mm
        (section, SAMPLES) X of the same places: a plane of light leans, so a section's X changes with height.
    """

    stripe: Integers
    along_mm: Floats
    middle_mm: Floats
    half_width_mm: Floats
    height_mm: Floats
    across_mm: Floats
    x_mm: Floats

    @property
    def peak_mm(self) -> Floats:
        """(section,) largest height, mm."""
        return np.asarray(self.height_mm.max(axis=1))

    @property
    def area_mm2(self) -> Floats:
        """(section,) area between belt and surface, mm²."""
        step = 2.0 * self.half_width_mm / (SAMPLES - 1)
        inner = self.height_mm.sum(axis=1) - 0.5 * (self.height_mm[:, 0] + self.height_mm[:, -1])
        return np.asarray(inner * step)


def sections_of(product: Product, smoothing_mm: float) -> Sections:
    """Cut a product into its sections; those too short or too torn to have a shape are left out.

    So are outer ones lower than 15 % of it: one more or less of them would change what is said of the
    ends.

    Parameters
    ----------
    product
        Its slices must run along Y, as those of stripes that run from top to bottom do.
    smoothing_mm
        Length of the local quadratic that smooths each curve first, mm, so that a rig of other rows smooths
        as much; 0 smooths nothing.
    """
    curves = body_curves(product.profiles, product.number)
    xyz = product.profiles.xyz_mm[curves.slice, curves.point]
    if smoothing_mm and len(xyz) > 1:
        xyz = smoothed(curves, xyz, _window(xyz[:, 1], smoothing_mm))
    found = []
    for number in np.unique(curves.slice):
        mine = xyz[curves.slice == number]
        mine = mine[np.argsort(mine[:, 1], kind="stable")]
        y = mine[:, 1]
        keep = np.concatenate([[True], np.diff(y) > 0.0])
        y = y[keep]
        if len(y) < _POINTS_MIN or y[-1] - y[0] < _WIDTH_MIN_MM:
            continue
        if np.diff(y).max() > _GAP_MAX * (y[-1] - y[0]):
            continue
        grid = np.linspace(y[0], y[-1], SAMPLES)
        height = np.interp(grid, y, mine[keep, 2])
        x = np.sort(mine[:, 0])
        middle = np.array([0.5 * (x[(x.size - 1) // 2] + x[x.size // 2]), 0.5 * (y[0] + y[-1])])
        x_mm = np.interp(grid, y, mine[keep, 0])
        found.append(_Cut(int(product.profiles.stripe[number]), middle, 0.5 * (y[-1] - y[0]), height, x_mm))
    return _in_order(_without_slivers(found))


def _window(y_mm: Floats, smoothing_mm: float) -> int:
    """Odd number of points whose length is nearest to `smoothing_mm`."""
    step = float(np.median(np.abs(np.diff(y_mm))))
    return 2 * round(0.5 * (smoothing_mm / max(step, 1e-3) - 1.0)) + 1


class _Cut(NamedTuple):
    stripe: int
    middle_mm: Floats
    half_width_mm: float
    height_mm: Floats
    x_mm: Floats


def _without_slivers(found: list[_Cut]) -> list[_Cut]:
    found = sorted(found, key=lambda cut: float(cut.middle_mm[0]))
    peaks = [float(cut.height_mm.max()) for cut in found]
    high = [k for k, peak in enumerate(peaks) if peak >= _SLIVER * max(peaks)]
    return found[high[0] : high[-1] + 1] if high else found


def _in_order(found: list[_Cut]) -> Sections:
    if not found:
        nothing = np.empty((0, SAMPLES))
        empty = np.empty(0)
        return Sections(np.empty(0, np.int64), empty, np.empty((0, 2)), empty, nothing, nothing, nothing)
    middle = np.stack([cut.middle_mm for cut in found])
    half = np.array([cut.half_width_mm for cut in found])
    step = np.sqrt((np.diff(middle, axis=0) ** 2).sum(axis=1))
    return Sections(
        stripe=np.array([cut.stripe for cut in found], np.int64),
        along_mm=np.concatenate([[0.0], np.cumsum(step)]),
        middle_mm=middle,
        half_width_mm=half,
        height_mm=np.stack([cut.height_mm for cut in found]),
        across_mm=half[:, None] * np.linspace(-1.0, 1.0, SAMPLES),
        x_mm=np.stack([cut.x_mm for cut in found]),
    )
