"""The plan's single numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.records import PlanFigure
from roemetry_simulate.plan_geometry import in_view, plane_points, scale_at, steepest_slopes_deg
from roemetry_simulate.plan_tables import mean_spacing_mm
from roemetry_simulate.plan_uncertainty import peak_std, stripes_at
from roemetry_simulate.plan_volume import Space
from roemetry_simulate.scene_camera import view_mm
from roemetry_simulate.scene_file import RayCasterOptions

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
    floor = space.speckle_limit_px
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
            "2½ times the height of one spacing, or as far as any stripe stays in view.",
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
            1e3 * space.best_px(stds[0]) * per_px[0],
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
        f"Blur of at most {SHARP_SIGMA_PX} px (standard deviation; a circle of confusion of 2 px) by the "
        "thin lens, above the middle stripe."
    )
    return [
        PlanFigure("sharp-from", "In focus from", float(low), "mm", basis),
        PlanFigure("sharp-to", "In focus up to", float(high), "mm", basis),
    ]
