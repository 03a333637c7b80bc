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
from roemetry_simulate.scene_rig import view_mm

Floats = NDArray[np.float64]

_COLUMNS, _ROWS = 57, 17
_SPACINGS = 2.5


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

    def maps(self) -> tuple[PlanMap, ...]:
        """Return millimetres of height per pixel and standard uncertainties of a height over X and Z."""
        rig = self.rig
        views = [view_mm(rig.camera, z) for z in (0.0, self.top_mm)]
        x = np.linspace(min(v[0] for v in views), max(v[1] for v in views), _COLUMNS)
        z = np.linspace(0.0, self.top_mm, _ROWS)
        points = np.stack(np.broadcast_arrays(x[None, :], self.y_mm, z[:, None]), axis=-1)
        seen = in_view(rig.camera, points)
        scale = scale_at(rig.camera, rig.laser, points)
        per_px = np.where(seen, 1.0 / np.abs(scale.height_px_per_mm), np.nan)
        bound, gravity = np.full(seen.shape, np.nan), np.full(seen.shape, np.nan)
        peak = np.full(int(seen.sum()), float(rig.laser.peak_grey.mean()))
        stds = [peak_std(s, rig.sensor) for s in stripes_at(rig, points[seen], self.albedo, peak)]
        bound[seen] = [1e3 * self.best_px(one) for one in stds]
        gravity[seen] = [1e3 * one.centre_of_gravity_px for one in stds]
        flat = (
            "On a level, matt surface of the product's albedo; for a plane of mean power through each place."
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
                "of the camera's full model within the light plane.",
                3,
            ),
            PlanMap(
                "height-std-bound",
                "Standard uncertainty, best possible",
                "µm",
                x,
                z,
                bound * per_px,
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
                gravity * per_px,
                "The same noise through a centre of gravity over ± 3 standard deviations of the stripe, in "
                f"whole pixels: hence the steps. {flat}",
                0,
            ),
        )
