"""The planner stage: a scene file's rig in, what it will give out; short simulations can stand beside it.

Figures, tables and maps follow from the geometry of camera and projector and from the simulator's own model
of light and sensor (`roemetry_simulate.plan_model`), along the image's middle row and for level, matt
surfaces. The check renders flat plates and measures how the centre of gravity of each stripe scatters.

The expected standard uncertainty of the volume is the root of the sum of three squares:

- sampling: spacing × sum of slice areas against the whole, RMS over where the product lies, of the scene's
  own products as they are drawn, times what an estimator was measured to make of it;
- noise: that of single rows by a centre of gravity at half the product's height, over all rows and stripes;
- calibration: an error that all heights share, of a place in the image that boards leave.

The weight adds the underside, which no camera above sees. Changes are found by working the same out for other
numbers of stripes, each with the projector as far aside as leaves the product below the unambiguous height.
Assumed: level light, an albedo as the scene's, no contact between products.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import RoemetryError, StageError
from roemetry.records import Plan, PlanAnswer, PlanColumn, PlanFigure, PlanShape, PlanTable, Reason
from roemetry.stages import Planner
from roemetry_simulate import plan_tables
from roemetry_simulate.optics import Camera, view_mm
from roemetry_simulate.plan_model import (
    WINDOW_SIGMAS,
    PeakStd,
    Stripe,
    in_view,
    peak_std,
    plane_points,
    scale_at,
    speckle_limit_px,
    steepest_slopes_deg,
    stripes_at,
)
from roemetry_simulate.plan_tables import Bodies, Space, mean_spacing_mm
from roemetry_simulate.population import draw_item
from roemetry_simulate.render import Rig, render
from roemetry_simulate.scene import RayCasterOptions, rig_of
from roemetry_simulate.solid import Block, EmptyBelt, Solid
from roemetry_simulate.surface import even

Floats = NDArray[np.float64]

SHARP_SIGMA_PX = 0.5
"""Blur that counts as sharp, px (standard deviation): that of a good lens; a circle of confusion of 2 px."""
_LEAST_PX_PER_MM = 1e-3
"""Displacement below which a height does not show: a pixel a metre."""
_LEAN_MOST = 6.0
"""Columns over rows of a stripe's run beyond which it lies along the rows (10 degrees off them)."""
_SEEN_SIGMAS = 5.0
"""Light over noise below which a stripe is called dark: noise alone reaches it once in 3 million pixels."""
_MOST_CONTRAST = 0.4
"""Speckle beyond which it is no small noise about a mean: its intensity is then markedly skewed."""
_NARROW_PX = 0.7
"""Deviation of a stripe below which the place within the pixel shows as a systematic error."""
_ROWS_MAX = 64
"""Rows of the simulated plates: enough for a scatter right to 3 % with ten stripes."""
_PLATE_MM = 4000.0
"""Sides of the simulated plates: beyond any view."""


class RigPlanner(Planner[RayCasterOptions]):
    """Works a rig out from its geometry, its light and its sensor; short simulations can stand beside it.

    Of the scene the camera, the laser, the stray light, the product's albedo and, for the answer, its shape
    and size count. The plan is made along the image's middle row.
    """

    def plan(self, *, simulate: bool) -> Plan:
        """Plan the rig; raise StageError where heights do not show in its image."""
        scene, pattern = as_lines(self.options)
        space = space_of(scene)
        _refuse(space)
        bodies = bodies_of(scene, space.rig)
        answer = None
        if bodies is not None and space.rig.laser.count > 1:
            space = replace(space, product_mm=bodies.height_mm)
            # what to change of a rig is worked out for lines alone
            answer = None if pattern else answer_of(scene, space, bodies)
        tables, curves = plan_tables.tables_and_curves(space, bodies)
        # the product's height is known now: maps and tables reach up to it
        if simulate:
            tables.append(_check_table(space))
        figures, reasons = _figures(scene, space), (*pattern, *_reasons(scene, space))
        return Plan(figures, space.maps(), tuple(tables), tuple(curves), _sketch(space), reasons, answer)


def as_lines(scene: RayCasterOptions) -> tuple[RayCasterOptions, tuple[Reason, ...]]:
    """Give a scene with lines where the middle row sees other light, and what a plan of these leaves open.

    The plan is made along that row. There the columns of dots and the lines of a grid that cross it are what
    lines are, and so are the halves of circles, which cross it upright.
    """
    laser = scene.laser
    if laser.circles is not None:
        rig = rig_of(scene)
        row = 0.5 * (rig.camera.height_px - 1)
        # where the middle row sees the belt
        middle = rig.camera.ray(0.5 * (rig.camera.width_px - 1), row)
        y_mm = rig.camera.centre_mm[1] - rig.camera.centre_mm[2] / middle[2] * middle[1]
        lines_x = rig.laser.x_mm(y_mm, 0.0)
        # halves that the row does not reach have no place on it
        reached = lines_x[np.isfinite(lines_x)].tolist()
        lines: dict[str, Any] = {"circles": None, "belt_x_mm": reached, "yaw_deg": 0.0}
        text = "circles: planned where the middle row crosses them; nothing is said of their tops and bottoms"
    elif laser.grid is not None:
        lines, text = {"grid": None}, "a grid: its lines that cross rows are planned, those across are not"
    elif laser.dots is not None:
        lines, text = {"dots": None}, "dots: a column is planned as a line, of which dots show places alone"
    else:
        return scene, ()
    same = scene.model_copy(update={"laser": laser.model_copy(update=lines)})
    return same, (Reason("pattern-as-lines", text),)


def space_of(scene: RayCasterOptions) -> Space:
    """Return what a scene's plan is made over."""
    rig = rig_of(scene)
    limit = speckle_limit_px(rig, scene.laser.wavelength_nm, scene.laser.speckle_contrast)
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
    # how a stripe leans in the image: its place at two Y a millimetre apart
    x = np.vstack([rig.laser.x_mm(float(one), 0.0) for one in y[:, 0]])
    pixels = rig.camera.project(np.stack([x, np.broadcast_to(y, x.shape), np.zeros_like(x)], axis=-1))
    lean = np.abs(np.diff(pixels, axis=0))[0]
    if (lean[:, 0] > _LEAN_MOST * lean[:, 1]).any():
        raise StageError(
            "simulator.options.camera: the stripes run along the image rows; a plan is made for stripes "
            "across them",
            hint="turn the camera by 90° in T_belt_camera, or the lines by laser.yaw_deg",
        )
    shown = np.abs(scale_at(rig.camera, rig.laser, space.belt_points_mm).height_px_per_mm)
    if not shown.max() > _LEAST_PX_PER_MM:
        raise StageError(
            f"simulator.options.laser.projector_mm: a height of 1 mm moves no stripe by more than "
            f"{shown.max():.1g} px: the light planes hold the camera",
            hint="move the projector aside, across the stripes",
        )


def _figures(scene: RayCasterOptions, space: Space) -> tuple[PlanFigure, ...]:
    """The plan's numbers; NaN where `_reasons` says why."""
    rig, top = space.rig, space.top_mm
    camera, y_mm = rig.camera, space.y_mm
    index = rig.laser.count // 2
    # the middle stripe, on the belt and at the plan's top
    middle = plane_points(rig.laser, y_mm, np.array([0.0, top]))[:, index]
    scale = scale_at(camera, rig.laser, middle)
    stripes = stripes_at(rig, middle, space.albedo, rig.laser.peak_grey[[index] * 2])
    belt = peak_std(stripes[0], rig.sensor)
    per_px = 1.0 / np.abs(scale.height_px_per_mm)
    um = 1e3 * per_px[0]
    made = []
    for k, (at, z) in enumerate((("belt", 0.0), ("top", top))):
        x_low, x_high, y_low, y_high = view_mm(camera, z)
        where, on_belt = f"Extent of the image's border on the level of {z:.1f} mm.", at == "belt"
        level = "On a level surface at the middle stripe, along the"
        x_px, y_px = float(scale.x_mm_per_px[k]), float(scale.y_mm_per_px[k])
        made += [
            (f"view-x-{at}", f"Field of view in X, {at}", x_high - x_low, "mm", where, on_belt),
            (f"view-y-{at}", f"Field of view in Y, {at}", y_high - y_low, "mm", where, on_belt),
            (f"x-per-px-{at}", f"X for one pixel, {at}", x_px, "mm/px", f"{level} row.", on_belt),
            (f"y-per-px-{at}", f"Y for one pixel, {at}", y_px, "mm/px", f"{level} column.", False),
        ]
    stripe_count = float(in_view(camera, space.belt_points_mm).sum())
    slope = float(steepest_slopes_deg(camera, rig.laser, space.belt_points_mm).min())
    at_y, at_middle = f"At Y = {y_mm:.1f} mm.", "At the middle stripe, along its own plane."
    row = "of one row at the middle stripe on the belt, product's albedo."
    made += [
        ("stripes", "Stripes in view on the belt", stripe_count, "1", at_y, True),
        ("spacing", "Mean spacing of the stripes on the belt", mean_spacing_mm(space), "mm", at_y, False),
        ("spacing-height", "A stripe can be taken for its neighbour above", space.spacing_height_mm, "mm",
         "The lowest height at which a stripe appears at its neighbour's place on the belt; below it "
         "the order in a row is enough.", True),
        ("highest", "All stripes stay in view up to", space.highest_mm, "mm",
         "Of the stripes seen on the belt at the plan's Y, the first to leave the image.", True),
        ("plan-top", "The plan is made up to", top, "mm",
         "The highest product of the scene, else 2½ times the unambiguous height range; at most as far as "
         "any stripe stays in view.", False),
        ("height-per-px-belt", "Height for one pixel, belt", per_px[0], "mm/px", at_middle, True),
        ("height-per-px-top", "Height for one pixel, top", per_px[1], "mm/px", at_middle, False),
        ("std-bound-belt", "Standard uncertainty of a height, best possible", um * space.best_px(belt), "µm",
         f"Cramér-Rao bound {row}", True),
        ("std-gravity-belt", "Standard uncertainty of a height, centre of gravity",
         um * belt.centre_of_gravity_px, "µm", f"Centre of gravity {row}", True),
        ("std-noise-belt", "The bound without speckle", um * belt.noise_bound_px, "µm",
         "As the best possible, with the sensor's noise alone.", False),
        ("speckle-limit", "Speckle limit of a height", um * space.speckle_limit_px, "µm",
         "contrast · λ / (2π sin u) in the image (Dorsch, Häusler, Herrmann 1994), for a line as fine as "
         "the lens resolves, times height per pixel.", False),
        ("triangulation", "Triangulation angle", angle_deg(space), "degrees",
         "Between the directions to camera and projector from the middle stripe on the belt.", False),
        ("slope", "Steepest slope lit and seen, worst", slope, "degrees",
         "Of all stripes and the four directions of rise; see the table.", True),
    ]  # fmt: skip
    low, high = _sharp_mm(scene, camera, middle[0])
    blur = (
        f"Blur of at most {SHARP_SIGMA_PX} px (standard deviation; a circle of confusion of 2 px) by the "
        "thin lens, above the middle stripe."
    )
    made += [
        ("sharp-from", "In focus from", low, "mm", blur, False),
        ("sharp-to", "In focus up to", high, "mm", blur, False),
    ]
    return tuple(PlanFigure(*each) for each in made)


def _sharp_mm(scene: RayCasterOptions, camera: Camera, foot_mm: Floats) -> tuple[float, float]:
    """Heights between which the lens blurs by at most half a pixel (thin lens); NaN without an aperture."""
    part = scene.camera.focus
    if part is None:
        return np.nan, np.nan
    # blur at a depth z is `strength` · |z − s| / z: solved for the two depths at which it is half a pixel
    f = camera.focal_length_mm
    strength = 0.25 * f**2 / part.f_number / (part.distance_mm - f) / camera.pixel_size_mm
    share = SHARP_SIGMA_PX / strength
    # blurred by less than that however far away
    far = part.distance_mm / (1.0 - share) if share < 1.0 else np.inf
    depth = (foot_mm - camera.centre_mm) @ camera.rotation[:, 2]
    # depths along the axis to heights over the belt
    down = -camera.rotation[2, 2]
    return float((depth - far) * down), float((depth - part.distance_mm / (1.0 + share)) * down)


def _dark(space: Space) -> list[str]:
    """Number the stripes that are dead, or hardly stand above the noise somewhere along Y."""
    rig, dark = space.rig, set(np.flatnonzero(space.rig.laser.peak_grey == 0.0).tolist())
    for y in space.ys_mm:
        points = plane_points(rig.laser, y, np.zeros(1))[0]
        seen = in_view(rig.camera, points)
        for i, one in enumerate(stripes_at(rig, points, space.albedo, rig.laser.peak_grey)):
            # noise of the background: what the middle must stand above
            gain, read = rig.sensor.grey_per_electron, rig.sensor.read_noise_grey
            noise = np.sqrt(gain * one.background_grey + read**2 + 1.0 / 12.0)
            # what blur leaves of the middle
            # a blurred stripe is lower by the ratio of its widths
            middle = one.peak_grey * one.line_sigma_px / one.width_px(rig.sensor)
            if seen[i] and middle < _SEEN_SIGMAS * noise:
                dark.add(i)
    return [str(i + 1) for i in sorted(dark)]


def _reasons(scene: RayCasterOptions, space: Space) -> list[Reason]:
    """What the plan cannot say, and what it warns of."""
    rig = space.rig
    stripes = stripes_at(rig, space.belt_points_mm, space.albedo, rig.laser.peak_grey)
    cut = [str(i + 1) for i, one in enumerate(stripes) if peak_std(one, rig.sensor).is_saturated]
    out, dark = [str(i + 1) for i in np.flatnonzero(np.isnan(space.in_view_mm))], _dark(space)
    widths = [stripe.width_px(rig.sensor) for stripe in stripes]
    apart = np.abs(np.diff(rig.camera.project(space.belt_points_mm)[:, 0]))
    level = f"on a level surface of the product's albedo ({space.albedo:g}) at belt height"
    found = []
    if out:
        where = f"not in the image on the belt at Y = {space.y_mm:.1f} mm"
        found.append(Reason("stripe-out-of-view", f"stripe {', '.join(out)}: {where}"))
    if rig.focus is None:
        text = (
            "depth of field and speckle limit: the scene gives no aperture; set "
            "simulator.options.camera.focus.distance_mm and .f_number"
        )
        found.append(Reason("depth-of-field", text))
    if rig.laser.count == 1:
        text = "one plane: there is no neighbour to take it for, and the slices come from the belt's travel"
        found.append(Reason("spacing-height", text))
    if cut:
        found.append(Reason("saturated", f"stripe {', '.join(cut)}: saturated {level}"))
    if dark:
        text = (
            f"stripe {', '.join(dark)}: dead, or less than {_SEEN_SIGMAS:g} times the noise above its "
            f"background {level}, somewhere in view"
        )
        found.append(Reason("dark-stripe", text))
    if scene.laser.speckle_contrast > _MOST_CONTRAST:
        text = (
            f"speckle of contrast {scene.laser.speckle_contrast:g}: the nearer to fully developed (1), "
            "the less it is noise about a mean; the stated uncertainties hold up to a contrast of "
            f"{_MOST_CONTRAST:g}"
        )
        found.append(Reason("speckle", text))
    if min(widths) < _NARROW_PX:
        text = (
            f"the thinnest stripe has a standard deviation of {min(widths):.2f} px: below "
            f"{_NARROW_PX:g} px the place within the pixel shows as a systematic error that is not counted"
        )
        found.append(Reason("narrow", text))
    # windows of neighbours overlap
    if apart.size and float(apart.min()) < 2.0 * WINDOW_SIGMAS * max(widths):
        text = (
            f"stripes come as near as {apart.min():.1f} px at a standard deviation of {max(widths):.1f} px: "
            "they overlap, and the uncertainties of single stripes do not hold"
        )
        found.append(Reason("crowded", text))
    if scene.surface.gloss > 0.0 or scene.surface.below.share > 0.0:
        text = (
            "uncertainties are those of a matt surface: gloss and light from below the "
            "surface, which the scene has, are not counted"
        )
        found.append(Reason("matt", text))
    return found


def _sketch(space: Space) -> tuple[PlanShape, ...]:
    """The rig seen along the belt's Y, to scale: X and Z, mm."""
    camera, fan, top = space.rig.camera, space.rig.laser, space.top_mm
    eye, light = camera.centre_mm[[0, 2]], fan.projector_mm[[0, 2]]
    low, high = view_mm(camera), view_mm(camera, top)
    lines_x = fan.x_mm(space.y_mm, 0.0)
    ends = (low[0], low[1], float(light[0]), float(lines_x[0]), float(lines_x[-1]))
    reach = 1.15 * max(abs(x) for x in ends)
    axis = camera.ray(0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1))
    axis_on_belt = camera.centre_mm - camera.centre_mm[2] / axis[2] * axis
    corners = np.array([[low[0], 0.0], [low[1], 0.0], [high[1], top], [high[0], top]])
    shapes = [
        PlanShape("view", np.array([[low[0], 0.0], [low[1], 0.0], eye])),
        PlanShape("range", corners, f"0 to {top:.0f} mm"),
        PlanShape("belt", np.array([[-reach, 0.0], [reach, 0.0]]), "belt"),
        PlanShape("axis", np.array([eye, axis_on_belt[[0, 2]]])),
        *(PlanShape("plane", np.array([light, [x, 0.0]])) for x in lines_x),
    ]
    if np.isfinite(space.spacing_height_mm):
        z = space.spacing_height_mm
        shapes.append(
            PlanShape("level", np.array([[low[0], z], [low[1], z]]), f"unambiguous below {z:.1f} mm")
        )
    return (
        *shapes,
        PlanShape("camera", eye[None], "camera"),
        PlanShape("projector", light[None], "projector"),
    )


class Scatter(NamedTuple):
    """What a simulated plate showed, over all stripes and rows, and what was predicted of it.

    `measured_px` and `predicted_px` are the root mean square scatter of the centre of gravity about its mean
    along each stripe, `measured_um` and `predicted_um` the same as heights; `bound_px` is the Cramér-Rao
    bound, `offset_px` the mean difference from the true place.
    """

    height_mm: float
    centres: int
    measured_px: float
    predicted_px: float
    bound_px: float
    offset_px: float
    measured_um: float
    predicted_um: float


def _check_table(space: Space) -> PlanTable:
    """Simulate plates at belt, middle and top, and put their scatter beside the prediction."""
    found = [simulated_scatter(space, z) for z in (0.0, 0.5 * space.top_mm, space.top_mm)]

    def column(name: str, title: str, unit: str, digits: int) -> PlanColumn:
        values = np.array([float(getattr(one, name)) for one in found])
        return PlanColumn(name.replace("_", "-"), title, unit, values, digits)

    ratio = np.array([one.measured_um / one.predicted_um for one in found])
    return PlanTable(
        "check",
        "Predicted and simulated",
        (
            column("height_mm", "plate at", "mm", 1),
            column("centres", "centres", "1", 0),
            column("predicted_um", "predicted", "µm", 1),
            column("measured_um", "simulated", "µm", 1),
            PlanColumn("ratio", "simulated / predicted", "1", ratio, 3),
            column("predicted_px", "predicted", "px", 4),
            column("measured_px", "simulated", "px", 4),
            column("bound_px", "best possible", "px", 4),
            column("offset_px", "mean offset", "px", 4),
        ),
        f"Images of {min(_ROWS_MAX, space.rig.camera.height_px)} rows of matt, even plates of the product's "
        "albedo, with noise and speckle; standard deviation of the centre of gravity from the true place, "
        "each stripe's mean taken out.",
    )


def simulated_scatter(space: Space, height_mm: float, seed: int = 5) -> Scatter:
    """Render a plate and measure how its stripes' centres of gravity scatter.

    A height of 0 is a belt of the product's albedo. Of stripes that lie in the image with room for the
    window; NaN where there is none.
    """
    rig = replace(space.rig, camera=_strip(space.rig.camera))
    plate = Block(_PLATE_MM, _PLATE_MM, height_mm, 0.0, space.y_mm) if height_mm > 0.0 else EmptyBelt()
    image = render(rig, plate, even(space.albedo), seed=seed).astype(np.float64)
    points = _points(rig, height_mm, space.y_mm)
    # at the row's middle, as the plan has it
    middle = points[:, rig.camera.height_px // 2]
    stripes = stripes_at(rig, middle, space.albedo, rig.laser.peak_grey)
    stds = [peak_std(stripe, rig.sensor) for stripe in stripes]
    scale = np.abs(scale_at(rig.camera, rig.laser, middle).height_px_per_mm)
    true_px = rig.camera.project(points)[..., 0]
    kept: list[tuple[PeakStd, float, Floats]] = []
    for i, stripe in enumerate(stripes):
        # empty where the stripe's window does not fit into the image
        off = _offsets(image, true_px[i], stripe, rig)
        if off.size:
            kept.append((stds[i], float(scale[i]), off))
    if not kept:
        return Scatter(height_mm, 0, *([np.nan] * 6))
    # about each stripe's own mean: a place within the pixel shifts all rows alike
    spread = np.array([off.std(ddof=1) for _, _, off in kept])
    expected = np.array([one.centre_of_gravity_px for one, _, _ in kept])
    per_mm = np.array([each for _, each, _ in kept])
    return Scatter(
        height_mm,
        sum(off.size for _, _, off in kept),
        _rms(spread),
        _rms(expected),
        _rms(np.array([one.bound_px for one, _, _ in kept])),
        float(np.mean([off.mean() for _, _, off in kept])),
        1e3 * _rms(spread / per_mm),
        1e3 * _rms(expected / per_mm),
    )


def _strip(camera: Camera) -> Camera:
    """The camera's middle rows alone; the optical axis stays where it is."""
    rows = min(_ROWS_MAX, camera.height_px)
    first = (camera.height_px - rows) // 2
    x, y = camera.principal_px
    return replace(camera, height_px=rows, principal_point_px=(float(x), float(y) - first))


def _points(rig: Rig, height_mm: float, y_mm: float) -> Floats:
    """Where each plane meets a level in the middle of each row, shape (N, rows, 3)."""
    fan, camera = rig.laser, rig.camera
    rows = np.arange(camera.height_px, dtype=np.float64)
    y = np.full((fan.count, rows.size), y_mm)

    def at(y: Floats) -> Floats:
        n = fan.normals
        # X on the plane at Y and height
        x = (fan.offsets_mm[:, None] - y * n[:, 1:2] - height_mm * n[:, 2:3]) / n[:, :1]
        return np.stack([x, y, np.full_like(x, height_mm)], axis=-1)

    for _ in range(8):  # Newton's method; rows are nearly even in Y
        # the row of a place one hundredth of a millimetre farther on: a numerical derivative
        here = camera.project(at(y))[..., 1]
        slope = (camera.project(at(y + 0.01))[..., 1] - here) / 0.01
        y = y + (rows - here) / slope
    return at(y)


def _offsets(image: Floats, true_px: Floats, stripe: Stripe, rig: Rig) -> Floats:
    """Centre of gravity minus true place for one stripe in all rows; empty where it has no room."""
    reach = int(np.ceil(WINDOW_SIGMAS * stripe.width_px(rig.sensor)))
    middle = np.rint(true_px).astype(np.int64)
    if not np.isfinite(true_px).all() or middle.min() < reach or middle.max() >= image.shape[1] - reach:
        return np.empty(0)
    columns = middle[:, None] + np.arange(-reach, reach + 1)
    light = image[np.arange(len(image))[:, None], columns]
    light = light - rig.sensor.black_level_grey - stripe.background_grey
    # background and black level are known here, as the prediction assumes
    centres: Floats = (light * columns).sum(axis=1) / light.sum(axis=1)
    return centres - true_px


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


_DRAWN = 4
"""Products that are drawn: enough to know the highest of a population to a tenth."""
_SLICES, _OUTLINE = 2.0, 0.4
"""Error of a volume over that of exact slices' sampling, from slices alone and with an outline: skeins, whose
sampling errs by 0.8 %, came out 1.2 to 1.9 and 0.2 to 0.4 % off (docs/measurements/outside.md)."""
CALIBRATION_PX = 0.03
"""Error in the image that a calibration by boards leaves common to all heights: 5 to 13 µm on rigs with 0.2
to 0.5 mm of height for a pixel."""
UNDERSIDE_PCT = 100.0 * 0.2 / math.sqrt(12.0) / 0.9
"""Of the weight before it is fitted: true over visible volume lies anywhere between 0.8 (a ball) and 1."""
_SPACINGS = 2.5
"""Heights beyond so many spacings' displacement are told apart by no coder."""
_SHARE = 0.85
"""Share of the unambiguous height range that a proposed rig uses for the highest product."""
_SMALL_DEG, _STEEP = 12.0, 0.5
"""Triangulation angle below which the plan says so; tangent up to which a projector is proposed."""
_SPACING_LEAST_PX = 14.0
"""About three widths of a stripe in focus: nearer ones are not told apart."""
_WORTH = 0.75
"""A change that leaves more than this of the uncertainty is not proposed."""


def bodies_of(scene: RayCasterOptions, rig: Rig) -> Bodies | None:
    """Draw a few of the scene's products; None where there is none, or none that fits into the view."""
    try:
        # the first few items, as the simulator would draw them
        drawn = [one.solid for k in range(_DRAWN) for one in draw_item(scene.product, rig, k, 0).products]
    except RoemetryError:
        return None
    return bodies_from(drawn) if drawn else None


def bodies_from(solids: Sequence[Solid]) -> Bodies:
    """Give sizes and sections of some products."""
    sizes, areas = zip(*(_sections(solid) for solid in solids), strict=True)
    lengths, widths, heights, means = np.array(sizes).T
    return Bodies(lengths.max(), widths.max(), heights.max(), means.mean(), lengths, np.array(areas))


def _sections(solid: Solid, count: int = 200) -> tuple[tuple[float, float, float, float], Floats]:
    """Length, width, height and mean height, mm, and section areas at places along X, mm²."""
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    # middles of equal steps: sums are integrals by the midpoint rule
    x = x_min + (np.arange(count) + 0.5) / count * (x_max - x_min)
    y = y_min + (np.arange(count) + 0.5) / count * (y_max - y_min)
    heights = np.nan_to_num(solid.heights_mm(*np.meshgrid(x, y))[0])
    areas = heights.mean(axis=0) * (y_max - y_min)
    # over the footprint alone, or empty corners would lower the mean
    mean = float(heights[heights > 0.0].mean())
    return (x_max - x_min, y_max - y_min, float(heights.max()), mean), areas


def answer_of(scene: RayCasterOptions, space: Space, bodies: Bodies) -> PlanAnswer:
    """Say whether the rig measures the products, how well, what limits it, and what would be better."""
    faults = list(_faults(space, bodies))
    has_outline = "plain" in scene.light.images
    causes = _causes(space, bodies, has_outline)
    total = math.hypot(*causes.values())
    weight = math.hypot(total, UNDERSIDE_PCT)
    # a fault counts before any uncertainty: then there is no measurement
    limiting = faults[0] if faults else max(causes, key=causes.__getitem__)
    rigs = _other_rigs(scene, space, bodies)
    now = angle_deg(space)
    # never shallower than now, but for angles that are steep enough anyway
    good = min((one for one in rigs if one.angle_deg >= min(now - 0.5, _SMALL_DEG)), default=None)
    changes = []
    if good is not None and (faults or good.volume_pct < _WORTH * total):
        changes.append(good.said(now))
    with_one = math.hypot(*_causes(space, bodies, True).values())
    # an outline is only proposed where it is worth its second image
    if not (faults or with_one > _WORTH * total):
        changes.append(f"a second image in plain light, for an outline: volume ± {with_one:.1f} %")
    steeper = [one for one in rigs if one.stripes < space.rig.laser.count and one.angle_deg > now + 2.0]
    if now < _SMALL_DEG and steeper:
        finer = max(steeper, key=lambda one: one.stripes)
        coarser = "" if finer.volume_pct <= total else ", at the cost of the volume"
        changes.append(f"for finer heights{coarser}, {finer.said(now)}")
    changes.append("weigh twenty products and fit the weight, which takes the underside out")
    return PlanAnswer(not faults, total, weight, limiting, tuple(changes))


def _faults(space: Space, bodies: Bodies) -> Iterator[str]:
    """Say why the rig cannot measure the products."""
    spacing, count = mean_spacing_mm(space), space.rig.laser.count
    high = bodies.height_mm
    if bodies.length_mm / spacing < 3.0:
        yield f"fewer than three stripes on a product {bodies.length_mm:.0f} mm long"
    if bodies.length_mm > spacing * (count + 1.0):
        yield f"the stripes span {spacing * (count - 1.0):.0f} mm, the product {bodies.length_mm:.0f} mm"
    x_low, x_high, y_low, y_high = view_mm(space.rig.camera, high)
    if bodies.length_mm > x_high - x_low or bodies.width_mm > y_high - y_low:
        yield f"{high:.0f} mm above the belt the camera sees {x_high - x_low:.0f} × {y_high - y_low:.0f} mm"
    # stripes that can lie on a product
    lines_x = space.belt_points_mm[:, 0]
    under = np.abs(lines_x - lines_x.mean()) < 0.5 * bodies.length_mm
    if (space.in_view_mm[under] < high).any():
        yield f"stripes on a product {high:.0f} mm high leave the image above {space.highest_mm:.0f} mm"
    if high > _SPACINGS * space.spacing_height_mm:
        yield (
            f"a product {high:.0f} mm high displaces a stripe by more than {_SPACINGS:g} spacings "
            f"({space.spacing_height_mm:.1f} mm of height each)"
        )


def _causes(space: Space, bodies: Bodies, has_outline: bool) -> dict[str, float]:
    """Standard uncertainties of the volume by cause, %; in words that end `limited by`."""
    rig, spacing = space.rig, mean_spacing_mm(space)
    # at half the product's height, as a mean
    middle = plane_points(rig.laser, space.y_mm, np.array([0.5 * bodies.height_mm]))[0]
    index = rig.laser.count // 2
    scale = scale_at(rig.camera, rig.laser, middle[[index]])
    per_px = float(1.0 / np.abs(scale.height_px_per_mm[0]))
    stripe = stripes_at(rig, middle[[index]], space.albedo, rig.laser.peak_grey[[index]])[0]
    # all rows of all stripes on the product are averaged
    rows = bodies.width_mm / float(scale.y_mm_per_px[0]) * bodies.length_mm / spacing
    noise = peak_std(stripe, rig.sensor).centre_of_gravity_px / math.sqrt(max(rows, 1.0))
    sampling = bodies.sampling_pct(spacing) * (_OUTLINE if has_outline else _SLICES)
    return {
        f"the {bodies.length_mm / spacing:.0f} stripes on a product": sampling,
        "noise of the stripes": 100.0 * noise * per_px / bodies.mean_height_mm,
        f"{per_px:.2f} mm of height for a pixel": 100.0 * CALIBRATION_PX * per_px / bodies.mean_height_mm,
    }


class _Proposal(NamedTuple):
    """Another rig: what volume to expect, and its light."""

    volume_pct: float
    angle_deg: float
    stripes: int
    spacing_mm: float
    beside_mm: float

    def said(self, now_deg: float) -> str:
        """Put it into words, beside the angle that there is now."""
        angle = self.angle_deg
        turned = f" (triangulation {angle:.0f}°, now {now_deg:.0f}°)" if abs(angle - now_deg) >= 1.0 else ""
        return (
            f"{self.stripes} stripes {self.spacing_mm:.1f} mm apart, projector {self.beside_mm:.0f} mm "
            f"beside the camera{turned}: volume ± {self.volume_pct:.1f} %"
        )


def _other_rigs(scene: RayCasterOptions, space: Space, bodies: Bodies) -> list[_Proposal]:
    """Try other numbers of stripes, each with the projector as far aside as the product allows."""
    laser, camera = scene.laser, space.rig.camera
    across = max(mean_spacing_mm(space) * (space.rig.laser.count - 1), 1.1 * bodies.length_mm)
    distance = float(camera.centre_mm[2])
    middle = space.belt_points_mm[[space.rig.laser.count // 2]]
    least_mm = _SPACING_LEAST_PX * float(scale_at(camera, space.rig.laser, middle).x_mm_per_px[0])
    # on the side on which the projector is now
    way = math.copysign(1.0, float(space.rig.laser.projector_mm[0] - camera.centre_mm[0]))
    found = []
    for count in range(5, 30, 2):
        spacing = across / (count - 1)
        # as far aside as the product stays below the unambiguous height, and not too steep
        beside = min(spacing * (_SHARE * distance / bodies.height_mm - 1.0), _STEEP * distance)
        if spacing < least_mm or beside <= 0.0:
            continue
        place = (float(camera.centre_mm[0] + way * beside), laser.projector_mm[1], laser.projector_mm[2])
        fan = {"planes": count, "spacing_mm": spacing, "projector_mm": place}
        changed = laser.model_copy(update={**fan, "belt_x_mm": None, "power": None})
        try:
            other = space_of(scene.model_copy(update={"laser": changed}))
            if next(_faults(other, bodies), None) is not None:
                continue
        except RoemetryError:
            continue
        pct = math.hypot(*_causes(other, bodies, "plain" in scene.light.images).values())
        found.append(_Proposal(pct, angle_deg(other), count, spacing, beside))
    return found


def angle_deg(space: Space) -> float:
    """Angle between the directions to camera and projector from the middle stripe on the belt, degrees."""
    middle = space.belt_points_mm[space.rig.laser.count // 2]
    ways: Sequence[Floats] = (space.rig.camera.centre_mm - middle, space.rig.laser.projector_mm - middle)
    # rounding may pass ±1
    cosine = float(ways[0] @ ways[1] / np.linalg.norm(ways[0]) / np.linalg.norm(ways[1]))
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
