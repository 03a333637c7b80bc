"""The planner stage: a scene file's rig in, what it will give out."""

from __future__ import annotations

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Plan
from roemetry.stages import Planner
from roemetry_simulate import plan_tables
from roemetry_simulate.plan_check import check_table
from roemetry_simulate.plan_figures import figures
from roemetry_simulate.plan_geometry import plane_points, scale_at
from roemetry_simulate.plan_reasons import reasons
from roemetry_simulate.plan_sketch import sketch
from roemetry_simulate.plan_uncertainty import speckle_limit_px
from roemetry_simulate.plan_volume import Space
from roemetry_simulate.scene_file import RayCasterOptions
from roemetry_simulate.scene_rig import rig_of

_LEAST_PX_PER_MM = 1e-3
_LEAN_MOST = 6.0


class RigPlanner(Planner[RayCasterOptions]):
    """Works a rig out from its geometry, its light and its sensor; short simulations can stand beside it.

    Of the scene the camera, the laser, the stray light and the product's albedo count; what lies on the belt
    does not. The plan is made along the image's middle row.
    """

    Options = RayCasterOptions

    def plan(self, *, simulate: bool) -> Plan:
        """Plan the rig; raise StageError where heights do not show in its image."""
        space = space_of(self.options)
        _refuse(space)
        tables = [
            plan_tables.stripe_geometry(space),
            plan_tables.stripe_light(space),
            plan_tables.stripe_slopes(space),
        ]
        curves = []
        if space.rig.laser.count > 1:
            more, error, price = plan_tables.numbers(space)
            tables += [plan_tables.products(space), more]
            curves += [error, price, plan_tables.over_x(space)]
        focus = plan_tables.focus_over_height(space)
        if focus is not None:
            curves.append(focus)
        if simulate:
            tables.append(check_table(space))
        return Plan(
            figures(self.options, space),
            space.maps(),
            tuple(tables),
            tuple(curves),
            sketch(space),
            reasons(self.options, space),
        )


def space_of(scene: RayCasterOptions) -> Space:
    """Return what a scene's plan is made over."""
    rig = rig_of(scene)
    limit = np.nan
    if rig.focus is not None:
        limit = speckle_limit_px(
            rig.focus,
            focal_length_mm=scene.camera.focal_length_mm,
            pixel_size_mm=1e-3 * scene.camera.pixel_size_um,
            wavelength_nm=scene.laser.wavelength_nm,
            contrast=scene.laser.speckle_contrast,
        )
    return Space(rig, scene.surface.albedo_laser, limit)


def _refuse(space: Space) -> None:
    """Raise StageError for a rig that cannot measure a height."""
    rig = space.rig
    if np.isnan(space.in_view_mm).all():
        x = rig.laser.x_mm(space.y_mm, 0.0)
        raise StageError(
            f"simulator.options.laser: no stripe lies in the image's middle row, at Y = {space.y_mm:.1f} mm, "
            f"where the stripes are at X = {x.min():.1f} to {x.max():.1f} mm",
            hint="move the fan by belt_x_mm or centre_x_mm, or turn it by yaw_deg",
        )
    if not space.top_mm > 0.0:
        raise StageError(
            "simulator.options.laser: every stripe leaves the image with the first fraction of a "
            "millimetre of height",
            hint="move the fan by belt_x_mm or centre_x_mm away from the edge that heights displace to",
        )
    y = space.y_mm + np.array([[0.0], [1.0]])
    x = np.vstack([rig.laser.x_mm(float(one), 0.0) for one in y[:, 0]])
    pixels = rig.camera.project(np.stack([x, np.broadcast_to(y, x.shape), np.zeros_like(x)], axis=-1))
    lean = np.abs(np.diff(pixels, axis=0))[0]
    if (lean[:, 0] > _LEAN_MOST * lean[:, 1]).any():
        raise StageError(
            "simulator.options.camera: the stripes run along the image rows; a plan is made for stripes "
            "across them",
            hint="turn the camera by 90° in T_belt_camera, or the lines by laser.yaw_deg",
        )
    points = plane_points(rig.laser, space.y_mm, np.zeros(1))[0]
    shown = np.abs(scale_at(rig.camera, rig.laser, points).height_px_per_mm)
    if not shown.max() > _LEAST_PX_PER_MM:
        raise StageError(
            f"simulator.options.laser.projector_mm: a height of 1 mm moves no stripe by more than "
            f"{shown.max():.1g} px: the light planes hold the camera",
            hint="move the projector aside, across the stripes",
        )
