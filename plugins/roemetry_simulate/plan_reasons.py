"""What a plan cannot say, and what it warns of."""

from __future__ import annotations

import numpy as np

from roemetry.records import Reason
from roemetry_simulate.plan_geometry import in_view, plane_points
from roemetry_simulate.plan_uncertainty import WINDOW_SIGMAS, peak_std, stripes_at
from roemetry_simulate.plan_volume import Space
from roemetry_simulate.scene_file import RayCasterOptions

_SEEN_SIGMAS = 5.0
_MOST_CONTRAST = 0.4


def _dim(space: Space) -> list[str]:
    """Number the stripes that are dead, or hardly stand above the noise somewhere along Y."""
    rig, dim = space.rig, set(np.flatnonzero(space.rig.laser.peak_grey == 0.0).tolist())
    for y in space.ys_mm:
        points = plane_points(rig.laser, y, np.zeros(1))[0]
        seen = in_view(rig.camera, points)
        for i, one in enumerate(stripes_at(rig, points, space.albedo, rig.laser.peak_grey)):
            gain, read = rig.sensor.grey_per_electron, rig.sensor.read_noise_grey
            noise = np.sqrt(gain * one.background_grey + read**2 + 1.0 / 12.0)
            # what blur leaves of the middle
            middle = one.peak_grey * one.line_sigma_px / one.width_px(rig.sensor)
            if seen[i] and middle < _SEEN_SIGMAS * noise:
                dim.add(i)
    return [str(i) for i in sorted(dim)]


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
    dim = _dim(space)
    if dim:
        found.append(
            Reason(
                "dark-stripe",
                f"stripe {', '.join(dim)}: dead, or less than {_SEEN_SIGMAS:g} times the noise above its "
                f"background on a level surface of the product's albedo ({space.albedo:g}) at belt height, "
                "somewhere in view",
            )
        )
    if scene.laser.speckle_contrast > _MOST_CONTRAST:
        found.append(
            Reason(
                "speckle",
                f"speckle of contrast {scene.laser.speckle_contrast:g}: the nearer to fully developed (1), "
                "the less it is noise about a mean; the stated uncertainties hold up to a contrast of "
                f"{_MOST_CONTRAST:g}",
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
    feet_px = rig.camera.project(plane_points(rig.laser, space.y_mm, np.zeros(1))[0])[:, 0]
    apart = np.abs(np.diff(feet_px))
    widest = max(stripe.width_px(rig.sensor) for stripe in stripes)
    if apart.size and float(apart.min()) < 2.0 * WINDOW_SIGMAS * widest:
        found.append(
            Reason(
                "crowded",
                f"stripes come as near as {apart.min():.1f} px at a standard deviation of {widest:.1f} px: "
                "they overlap, and the uncertainties of single stripes do not hold",
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
