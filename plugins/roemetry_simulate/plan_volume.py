"""The volume a plan is made over, and its maps over X and Z."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from roemetry.records import PlanMap
from roemetry_simulate.plan_geometry import (
    highest_in_view_mm,
    in_view,
    middle_y_mm,
    scale_at,
    spacing_heights_mm,
)
from roemetry_simulate.plan_uncertainty import PeakStd, peak_std, stripes_at
from roemetry_simulate.render import Rig
from roemetry_simulate.scene_camera import view_mm

Floats = NDArray[np.float64]

_COLUMNS, _ROWS = 57, 17
_SPACINGS = 2.5
_TO_BORDER = 0.9


@dataclass(frozen=True, eq=False)
class Space:
    """A rig, and over which Y and heights it is planned.

    Attributes
    ----------
    rig : Rig
        The rig.
    albedo : float
        Of the product, in the laser's light.
    speckle_limit_px : float
        Below which speckle lets no stripe's place be known; NaN where the scene gives no aperture.
    """

    rig: Rig
    albedo: float
    speckle_limit_px: float = math.nan

    @cached_property
    def y_mm(self) -> float:
        """Belt Y of the plan: where the image's middle sees the belt."""
        return middle_y_mm(self.rig.camera)

    @cached_property
    def in_view_mm(self) -> Floats:
        """Height up to which each stripe stays in the image, shape (N,); NaN for one that never is."""
        return highest_in_view_mm(self.rig.camera, self.rig.laser, self.y_mm)

    @cached_property
    def spacing_heights_mm(self) -> Floats:
        """Height of one spacing's displacement for each stripe, shape (N,)."""
        return spacing_heights_mm(self.rig.camera, self.rig.laser, self.y_mm)

    @property
    def highest_mm(self) -> float:
        """Height up to which every stripe that is seen on the belt stays in the image."""
        return float(np.nanmin(self.in_view_mm))

    @property
    def spacing_height_mm(self) -> float:
        """Height below which no stripe can be taken for its neighbour; NaN for one plane."""
        known = self.spacing_heights_mm[np.isfinite(self.spacing_heights_mm)]
        return float(known.min()) if known.size else np.nan

    @cached_property
    def top_mm(self) -> float:
        """Height up to which the plan is made: 2½ spacing heights, or as far as any stripe stays in view."""
        return float(np.fmin(np.nanmax(self.in_view_mm), _SPACINGS * self.spacing_height_mm))

    def best_px(self, std: PeakStd) -> float:
        """Return the least standard uncertainty of a stripe's place: the bound, or the speckle limit."""
        return float(np.fmax(std.bound_px, self.speckle_limit_px))

    @cached_property
    def ys_mm(self) -> tuple[float, float, float]:
        """Belt Y of the maps: the plan's own, and nine tenths of the way to the upper and lower border."""
        _, _, low, high = view_mm(self.rig.camera)
        y = self.y_mm
        return y + _TO_BORDER * (low - y), y, y + _TO_BORDER * (high - y)

    def _over_x_and_z(self, x: Floats, z: Floats, y_mm: float) -> Floats:
        """Height per pixel (mm), bound and centre of gravity (µm), shape (3, z, x); NaN out of view."""
        rig = self.rig
        points = np.stack(np.broadcast_arrays(x[None, :], y_mm, z[:, None]), axis=-1)
        seen = in_view(rig.camera, points)
        scale = scale_at(rig.camera, rig.laser, points)
        found = np.full((3, *seen.shape), np.nan)
        found[0] = np.where(seen, 1.0 / np.abs(scale.height_px_per_mm), np.nan)
        lit = rig.laser.peak_grey[rig.laser.peak_grey > 0.0]
        peak = np.full(int(seen.sum()), float(lit.mean()))
        stds = [peak_std(s, rig.sensor) for s in stripes_at(rig, points[seen], self.albedo, peak)]
        found[1][seen] = [1e3 * self.best_px(one) for one in stds]
        found[2][seen] = [1e3 * one.centre_of_gravity_px for one in stds]
        found[1:] *= found[0]
        return found

    def maps(self) -> tuple[PlanMap, ...]:
        """Return millimetres of height per pixel and standard uncertainties of a height over X and Z."""
        rig = self.rig
        views = [view_mm(rig.camera, z) for z in (0.0, self.top_mm)]
        x = np.linspace(min(v[0] for v in views), max(v[1] for v in views), _COLUMNS)
        z = np.linspace(0.0, self.top_mm, _ROWS)
        per_px, bound, gravity = np.fmax.reduce([self._over_x_and_z(x, z, y) for y in self.ys_mm])
        ys = ", ".join(f"{y:.1f}" for y in self.ys_mm)
        worst = f"The worst of Y = {ys} mm, where the place is in view."
        flat = (
            "On a level, matt surface of the product's albedo; for a plane of mean power through each place. "
            f"{worst}"
        )
        return (
            PlanMap(
                "height-per-px",
                "Height for one pixel of displacement",
                "mm/px",
                x,
                z,
                per_px,
                "Inverse of the displacement of a stripe along its row for a height: central differences "
                f"of the camera's full model within the light plane. {worst}",
                3,
            ),
            PlanMap(
                "height-std-bound",
                "Standard uncertainty, best possible",
                "µm",
                x,
                z,
                bound,
                "Cramér-Rao bound of the stripe's place in one row (shot noise, read noise, rounding, "
                "speckle), at least the speckle limit of the lens where the aperture is known, times height "
                f"per pixel. {flat}",
                0,
            ),
            PlanMap(
                "height-std-gravity",
                "Standard uncertainty, centre of gravity",
                "µm",
                x,
                z,
                gravity,
                "The same noise through a centre of gravity over ± 3 standard deviations of the stripe, in "
                f"whole pixels: hence the steps. {flat}",
                0,
            ),
        )
