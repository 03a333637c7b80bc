"""Bodies whose volume is known in closed form, sliced by the tilted planes of a linear rig."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from roemetry.records import BELT, NOTHING, Outline, Product, Profiles
from roemetry.records.arrays import Floats
from roemetry.testing.scenes import LinearRig

DENSE = LinearRig(rows=240, columns=480, stripes=61, first_px=59.5, spacing_px=6.0, fan=0.0)
"""A rig whose stripes lie so close that a slice more or less hardly counts: 1.5 mm apart, 90 mm wide."""

_LEVELS = 160  # at which a body is looked for along a ray
_HALVINGS = 40  # of the interval in which it is met: 1e-12 of it is left
_ON_SURFACE_MM = 1e-6  # a ray that ends so near has met the surface


@dataclass(frozen=True, slots=True)
class Solid:
    """A body on the belt, its middle at X = Y = 0, mm."""

    shape: Literal["box", "half-cylinder", "spherical-cap", "half-ellipsoid"]
    """``box``; ``half-cylinder`` (its axis on the belt along X, `width_mm` its diameter); ``spherical-cap``
    (`length_mm` the diameter of its foot); ``half-ellipsoid`` (with dents, if any)."""
    length_mm: float
    width_mm: float
    height_mm: float
    """length_mm, width_mm, height_mm: extent along X, Y and Z."""
    skew: float = 0.0
    """Makes the left half of a half-ellipsoid shorter and the right one longer by this share."""
    dent_mm: float = 0.0
    """Depth of a trough across the ridge of a half-ellipsoid, mm. With one, its volume is not known."""
    flipped: bool = False

    @property
    def volume_mm3(self) -> float:
        """Volume in closed form, mm³; visible and true are the same for these. NaN with a dent."""
        length, width, height = self.length_mm, self.width_mm, self.height_mm
        if self.dent_mm:
            return math.nan
        if self.shape == "box":
            return length * width * height
        if self.shape == "half-cylinder":
            return math.pi / 4.0 * width * height * length
        if self.shape == "spherical-cap":
            return math.pi * height / 6.0 * (3.0 * (length / 2.0) ** 2 + height**2)
        return math.pi / 6.0 * length * width * height

    def mirrored(self) -> Solid:
        """Give the body with left and right exchanged."""
        return replace(self, flipped=not self.flipped)

    def scaled(self, factor: float) -> Solid:
        """Give the body `factor` times as large."""
        return replace(
            self,
            length_mm=self.length_mm * factor,
            width_mm=self.width_mm * factor,
            height_mm=self.height_mm * factor,
            dent_mm=self.dent_mm * factor,
        )

    def surface_mm(self, x_mm: Floats, y_mm: Floats) -> Floats:
        """Height of the surface over belt points, mm; 0 outside the foot."""
        x = (-x_mm if self.flipped else x_mm) / (self.length_mm / 2.0)
        y = y_mm / (self.width_mm / 2.0)
        if self.shape == "box":
            return np.where((np.abs(x) < 1.0) & (np.abs(y) < 1.0), self.height_mm, 0.0)
        if self.shape == "half-cylinder":
            return np.where(np.abs(x) < 1.0, self.height_mm * np.sqrt(np.clip(1.0 - y**2, 0.0, None)), 0.0)
        if self.shape == "spherical-cap":
            foot = self.length_mm / 2.0
            radius = (foot**2 + self.height_mm**2) / (2.0 * self.height_mm)
            below = np.clip(radius**2 - x_mm**2 - y_mm**2, 0.0, None)
            return np.clip(np.sqrt(below) - (radius - self.height_mm), 0.0, None)
        x = np.where(x < 0.0, x / (1.0 - self.skew), x / (1.0 + self.skew))
        whole = self.height_mm * np.sqrt(np.clip(1.0 - x**2 - y**2, 0.0, None))
        dent = self.dent_mm * np.exp(-0.5 * (y / 0.2) ** 2)
        return np.clip(whole - np.where(whole > 0.0, dent, 0.0), 0.0, None)


BOX = Solid("box", 60.0, 30.0, 10.0)
HALF_CYLINDER = Solid("half-cylinder", 60.0, 30.0, 15.0)
SPHERICAL_CAP = Solid("spherical-cap", 50.0, 50.0, 10.0)
HALF_ELLIPSOID = Solid("half-ellipsoid", 60.0, 30.0, 12.0, skew=0.2)
DENTED = Solid("half-ellipsoid", 60.0, 40.0, 14.0, skew=0.2, dent_mm=5.0)


@lru_cache(maxsize=64)
def product_of(solid: Solid, rig: LinearRig = DENSE) -> Product:
    """Slice a body by the rig's planes: what a perfect extractor, coder and triangulator give.

    A point is the first that the light meets on its way down in its plane. Steep walls that the light strikes
    cannot be seen from above, and have no points.
    """
    heights = _first_met_mm(solid, rig)
    points = rig.xyz_mm(heights)
    surface = solid.surface_mm(points[..., 0], points[..., 1])
    heights = np.where(np.abs(surface - heights) < _ON_SURFACE_MM, heights, np.nan)
    return product_from(heights, rig)


def outlined(solid: Solid) -> Product:
    """Give the product with the outline of a half-ellipsoid's foot, as the rig's camera sees it."""
    product = product_of(solid)
    view = product.calibration.view
    assert view is not None
    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    x = 0.5 * solid.length_mm * np.cos(angle)
    x *= np.where(x > 0.0, 1.0 + solid.skew, 1.0 - solid.skew)
    foot = np.column_stack([x, 0.5 * solid.width_mm * np.sin(angle), np.zeros_like(x)])
    return replace(product, view=view, outline=Outline(1, view.project(foot)))


def product_from(height_mm: Floats, rig: LinearRig = DENSE) -> Product:
    """Make product 1 from (stripe, row) heights, mm; belt (0) and what is not seen (NaN) are not in it."""
    profiles = profiles_with_belt(np.where(height_mm > 1e-9, height_mm, np.nan), rig)
    return Product(1, profiles, rig.calibration(), ("scene",))


def profiles_with_belt(height_mm: Floats, rig: LinearRig) -> Profiles:
    """Give exact slices of a whole scene, belt points included, of (stripe, row) heights, mm."""
    seen = np.isfinite(height_mm)
    x_px = rig.x_px(height_mm)
    return Profiles(
        xyz_mm=rig.xyz_mm(height_mm),
        product=np.where(seen, np.where(height_mm > 0.0, 1, BELT), NOTHING),
        seen=seen,
        x_px=x_px,
        row_px=np.where(seen, np.arange(rig.rows, dtype=np.float64), np.nan),
        height_std_mm=np.full(x_px.shape, np.nan),
        stripe=np.arange(rig.stripes),
        frame=np.zeros(rig.stripes, np.int64),
        plane=rig.planes(),
    )


def reordered(product: Product) -> Product:
    """Give the product with its slices in another order."""
    profiles = product.profiles
    order = np.random.default_rng(3).permutation(profiles.slice_count)
    arrays = ("xyz_mm", "product", "seen", "x_px", "row_px", "height_std_mm", "stripe", "frame", "plane")
    return replace(
        product, profiles=replace(profiles, **{name: getattr(profiles, name)[order] for name in arrays})
    )


def _first_met_mm(solid: Solid, rig: LinearRig) -> Floats:
    """(stripe, row) largest height at which each ray of light is on or below the surface, mm."""
    foot = rig.xyz_mm(rig.belt())
    x, y = foot[..., 0], foot[..., 1]
    lean = rig.mm_per_px * rig.px_per_mm

    def inside(height: Floats) -> np.ndarray:
        return np.asarray(solid.surface_mm(x + lean * height, y) >= height)

    above = np.full(x.shape, solid.height_mm * 1.001)
    below = np.zeros(x.shape)
    found = np.zeros(x.shape, np.bool_)
    for level in np.linspace(solid.height_mm, 0.0, _LEVELS):
        meets = ~found & inside(np.full(x.shape, level))
        below = np.where(meets, level, below)
        found |= meets
        above = np.where(found, above, level)
    for _ in range(_HALVINGS):
        middle = 0.5 * (above + below)
        lower = inside(middle)
        below = np.where(lower, middle, below)
        above = np.where(lower, above, middle)
    return below
