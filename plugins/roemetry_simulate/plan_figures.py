"""The plan's single numbers, what cannot be said, and the rig from the side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Reason
from roemetry.records.plan import PlanFigure, PlanShape
from roemetry_simulate.plan_geometry import in_view, plane_points, scale_at, steepest_slopes_deg
from roemetry_simulate.plan_tables import mean_spacing_mm
from roemetry_simulate.plan_uncertainty import peak_std, speckle_limit_px, stripes_at
from roemetry_simulate.plan_volume import Space
from roemetry_simulate.scene_file import RayCasterOptions
from roemetry_simulate.scene_rig import view_mm

Floats = NDArray[np.float64]

SHARP_SIGMA_PX = 0.5


def figures(scene: RayCasterOptions, space: Space) -> tuple[PlanFigure, ...]:
    """Return the plan's numbers; NaN where `reasons` says why."""
    rig, top = space.rig, space.top_mm
    middle = plane_points(rig.laser, space.y_mm, np.array([0.0, top]))[:, rig.laser.count // 2]
    scale = scale_at(rig.camera, rig.laser, middle)
    peak = rig.laser.peak_grey[[rig.laser.count // 2] * 2]
    stripes = stripes_at(rig, middle, space.albedo, peak)
    stds = [peak_std(stripe, rig.sensor) for stripe in stripes]
    per_px = 1.0 / np.abs(scale.height_px_per_mm)
    floor = limit_px(scene)
    to_camera = rig.camera.centre_mm - middle[0]
    to_light = rig.laser.projector_mm - middle[0]
    cosine = to_camera @ to_light / np.linalg.norm(to_camera) / np.linalg.norm(to_light)
    made = [
        PlanFigure(
            "spacing-height",
            "A stripe can be taken for its neighbour above",
            space.spacing_height_mm,
            "mm",
            "The lowest height at which a stripe appears at its neighbour's place on the belt; below it "
            "the order in a row is enough.",
            True,
        ),
        PlanFigure(
            "highest",
            "All stripes stay in view up to",
            space.highest_mm,
            "mm",
            "Of the stripes seen on the belt at the plan's Y, the first to leave the image.",
            True,
        ),
        PlanFigure(
            "plan-top",
            "The plan is made up to",
            top,
            "mm",
            "2½ times the height of one spacing, or as far as all stripes stay in view.",
        ),
        PlanFigure(
            "height-per-px-belt",
            "Height for one pixel, belt",
            per_px[0],
            "mm/px",
            "At the middle stripe, along its own plane.",
            True,
        ),
        PlanFigure(
            "height-per-px-top",
            "Height for one pixel, top",
            per_px[1],
            "mm/px",
            "At the middle stripe, along its own plane.",
        ),
        PlanFigure(
            "std-bound-belt",
            "Standard uncertainty of a height, best possible",
            1e3 * stds[0].bound_px * per_px[0],
            "µm",
            "Cramér-Rao bound of one row at the middle stripe on the belt, product's albedo.",
            True,
        ),
        PlanFigure(
            "std-gravity-belt",
            "Standard uncertainty of a height, centre of gravity",
            1e3 * stds[0].centre_of_gravity_px * per_px[0],
            "µm",
            "Centre of gravity of one row at the middle stripe on the belt, product's albedo.",
            True,
        ),
        PlanFigure(
            "std-noise-belt",
            "The bound without speckle",
            1e3 * stds[0].noise_bound_px * per_px[0],
            "µm",
            "As the best possible, with the sensor's noise alone.",
        ),
        PlanFigure(
            "speckle-limit",
            "Speckle limit of a height",
            1e3 * floor * per_px[0],
            "µm",
            "contrast · λ / (2π sin u) in the image (Dorsch, Häusler, Herrmann 1994), for a line as fine as "
            "the lens resolves, times height per pixel.",
        ),
        PlanFigure(
            "triangulation",
            "Triangulation angle",
            float(np.rad2deg(np.arccos(cosine))),
            "degrees",
            "Between the directions to camera and projector from the middle stripe on the belt.",
        ),
        PlanFigure(
            "slope",
            "Steepest slope lit and seen, worst",
            float(
                steepest_slopes_deg(
                    rig.camera, rig.laser, plane_points(rig.laser, space.y_mm, np.zeros(1))[0]
                ).min()
            ),
            "degrees",
            "Of all stripes and the four directions of rise; see the table.",
            True,
        ),
    ]
    return (*_views(space, scale.x_mm_per_px, scale.y_mm_per_px), *made, *_focus(scene, space, middle))


def limit_px(scene: RayCasterOptions) -> float:
    """Return the speckle limit in pixels; NaN where the scene gives no aperture."""
    from roemetry_simulate.scene_rig import rig_of

    focus, camera = rig_of(scene).focus, scene.camera
    if focus is None:
        return np.nan
    return speckle_limit_px(
        focus,
        focal_length_mm=camera.focal_length_mm,
        pixel_size_mm=1e-3 * camera.pixel_size_um,
        wavelength_nm=scene.laser.wavelength_nm,
        contrast=scene.laser.speckle_contrast,
    )


def reasons(scene: RayCasterOptions, space: Space) -> tuple[Reason, ...]:
    """Return what the plan cannot say, and what it warns of."""
    found = []
    rig = space.rig
    out = np.flatnonzero(np.isnan(space.in_view_mm))
    if out.size:
        words = ", ".join(str(i) for i in out)
        found.append(
            Reason(
                "stripe-out-of-view",
                f"stripe {words}: not in the image on the belt at Y = {space.y_mm:.1f} mm",
            )
        )
    if rig.focus is None:
        found.append(
            Reason(
                "depth-of-field",
                "depth of field and speckle limit: the scene gives no aperture; set "
                "simulator.options.camera.focus.distance_mm and .f_number",
            )
        )
    if rig.laser.count == 1:
        found.append(
            Reason(
                "spacing-height",
                "one plane: there is no neighbour to take it for, and the slices come from the belt's travel",
            )
        )
    stripes = stripes_at(
        rig, plane_points(rig.laser, space.y_mm, np.zeros(1))[0], space.albedo, rig.laser.peak_grey
    )
    stds = [peak_std(stripe, rig.sensor) for stripe in stripes]
    cut = [str(i) for i, one in enumerate(stds) if one.is_saturated]
    if cut:
        found.append(
            Reason(
                "saturated",
                f"stripe {', '.join(cut)}: saturated on a level surface of the product's "
                f"albedo ({space.albedo:g}) at belt height",
            )
        )
    narrow = min(stripe.width_px(rig.sensor) for stripe in stripes)
    if narrow < 0.7:
        found.append(
            Reason(
                "narrow",
                f"the thinnest stripe has a standard deviation of {narrow:.2f} px: below "
                "0.7 px the place within the pixel shows as a systematic error that is not counted",
            )
        )
    if scene.surface.gloss > 0.0 or scene.surface.below.share > 0.0:
        found.append(
            Reason(
                "matt",
                "uncertainties are those of a matt surface: gloss and light from below the "
                "surface, which the scene has, are not counted",
            )
        )
    return tuple(found)


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


def _views(space: Space, x_mm_per_px: Floats, y_mm_per_px: Floats) -> list[PlanFigure]:
    made = []
    for k, (word, z) in enumerate((("belt", 0.0), ("top", space.top_mm))):
        x_low, x_high, y_low, y_high = view_mm(space.rig.camera, z)
        where = f"the image's border on the level of {z:.1f} mm"
        made += [
            PlanFigure(
                f"view-x-{word}",
                f"Field of view in X, {word}",
                x_high - x_low,
                "mm",
                f"Extent of {where}.",
                word == "belt",
            ),
            PlanFigure(
                f"view-y-{word}",
                f"Field of view in Y, {word}",
                y_high - y_low,
                "mm",
                f"Extent of {where}.",
                word == "belt",
            ),
            PlanFigure(
                f"x-per-px-{word}",
                f"X for one pixel, {word}",
                float(x_mm_per_px[k]),
                "mm/px",
                "On a level surface at the middle stripe, along the row.",
                word == "belt",
            ),
            PlanFigure(
                f"y-per-px-{word}",
                f"Y for one pixel, {word}",
                float(y_mm_per_px[k]),
                "mm/px",
                "On a level surface at the middle stripe, along the column.",
            ),
        ]
    feet = plane_points(space.rig.laser, space.y_mm, np.zeros(1))[0]
    made += [
        PlanFigure(
            "stripes",
            "Stripes in view on the belt",
            float(in_view(space.rig.camera, feet).sum()),
            "1",
            f"At Y = {space.y_mm:.1f} mm.",
            True,
        ),
        PlanFigure(
            "spacing",
            "Mean spacing of the stripes on the belt",
            mean_spacing_mm(space),
            "mm",
            f"At Y = {space.y_mm:.1f} mm.",
        ),
    ]
    return made


def _focus(scene: RayCasterOptions, space: Space, middle: Floats) -> list[PlanFigure]:
    """Heights between which the lens blurs by at most half a pixel (thin lens)."""
    part, camera = scene.camera.focus, space.rig.camera
    low = high = np.nan
    if part is not None:
        f = camera.focal_length_mm
        strength = 0.25 * f**2 / part.f_number / (part.distance_mm - f) / camera.pixel_size_mm
        share = SHARP_SIGMA_PX / strength
        far = part.distance_mm / (1.0 - share) if share < 1.0 else np.inf
        depth = (middle[0] - camera.centre_mm) @ camera.rotation[:, 2]
        down = -camera.rotation[2, 2]
        low, high = (depth - far) * down, (depth - part.distance_mm / (1.0 + share)) * down
    basis = (
        f"Blur of at most {SHARP_SIGMA_PX} px (standard deviation; a circle of confusion of 2 px) by the thin "
        "lens, above the middle stripe."
    )
    return [
        PlanFigure("sharp-from", "In focus from", float(low), "mm", basis),
        PlanFigure("sharp-to", "In focus up to", float(high), "mm", basis),
    ]
