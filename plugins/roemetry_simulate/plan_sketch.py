"""The rig from the side, to scale."""

from __future__ import annotations

import numpy as np

from roemetry.records import PlanShape
from roemetry_simulate.plan_volume import Space
from roemetry_simulate.scene_camera import view_mm


def sketch(space: Space) -> tuple[PlanShape, ...]:
    """Return the rig seen along the belt's Y: X and Z, mm."""
    rig, top = space.rig, space.top_mm
    camera, fan = rig.camera, rig.laser
    eye, light = camera.centre_mm[[0, 2]], fan.projector_mm[[0, 2]]
    low, high = view_mm(camera), view_mm(camera, top)
    feet = fan.x_mm(space.y_mm, 0.0)
    reach = 1.15 * max(
        abs(low[0]), abs(low[1]), abs(float(light[0])), abs(float(feet[0])), abs(float(feet[-1]))
    )
    row = 0.5 * (camera.height_px - 1)
    middle = np.array([0.5 * (camera.width_px - 1), row])
    axis = camera.ray(middle[0], middle[1])
    foot = camera.centre_mm - camera.centre_mm[2] / axis[2] * axis
    shapes = [
        PlanShape("view", np.array([[low[0], 0.0], [low[1], 0.0], eye])),
        PlanShape(
            "range",
            np.array([[low[0], 0.0], [low[1], 0.0], [high[1], top], [high[0], top]]),
            f"0 to {top:.0f} mm",
        ),
        PlanShape("belt", np.array([[-reach, 0.0], [reach, 0.0]]), "belt"),
        PlanShape("axis", np.array([eye, foot[[0, 2]]])),
        *(PlanShape("plane", np.array([light, [x, 0.0]])) for x in feet),
    ]
    if np.isfinite(space.spacing_height_mm):
        z = space.spacing_height_mm
        shapes.append(PlanShape("level", np.array([[low[0], z], [low[1], z]]), f"one spacing: {z:.1f} mm"))
    return (
        *shapes,
        PlanShape("camera", eye[None], "camera"),
        PlanShape("projector", light[None], "projector"),
    )
