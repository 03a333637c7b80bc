"""The simulator stage: a scene file's options in, images and their truth out.

Model of the truth. A stripe's centre in an image row is where the surface that the camera sees there changes
from one side of the plane of light (or of the cone) to the other, n·X − d = 0, and is lit as well. Each row
is looked at every eighth of a pixel, and each change of side is halved down to 1e-7 px; a change that ends in
a jump, as at an edge, is no crossing. Of dots it is where the middle of a ray meets a surface that is seen.
What the stripes show of a defect is the difference from the same product without it, at lit and seen points.

Assumed: rays of light are lines, planes are thin. Two crossings within one step of the search are missed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Frame, ProductTruth, Role, Simulated, StripeTruth, Truth
from roemetry.stages import Turn
from roemetry_kernels.compiling import kernel
from roemetry_simulate.optics import Camera, LaserFan, camera_ray, turned
from roemetry_simulate.population import Group, draw_item
from roemetry_simulate.products import Drawn
from roemetry_simulate.raycast import AnyBody, first_hit, normal_at, sees
from roemetry_simulate.render import as_stored, render
from roemetry_simulate.scene import RayCasterOptions, contaminate, surface_of
from roemetry_simulate.solid import Reach, Solid
from roemetry_simulate.targets import RigSimulator

Floats = NDArray[np.float64]

_TOLERANCE_PX = 1e-7
"""Width of the bracket at which the search for a crossing ends: far below any extractor's error."""
_MAX_RESIDUAL_MM = 1e-4
"""A crossing is a jump to another surface where the plane is farther than this from the point found."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """Every stripe's centre in every pixel row. S stripes from left to right, R rows.

    - `x_px`, shape (S, R): Sub-pixel position in the row, NaN where no point of the plane is both lit and
      seen.
    - `xyz_mm`, shape (S, R, 3): That point in the belt frame, millimetres, NaN alike.
    - `on_product`, shape (S, R): 1 on the product, 0 on the belt, -1 nothing.
    - `hits`, shape (S, R): How many lit and seen points the plane has in the row; above 1 the one kept is on
      the product rather than the belt, and the highest of these.
    """

    x_px: Floats
    xyz_mm: Floats
    on_product: NDArray[np.int8]
    hits: NDArray[np.int8]
    y_px: Floats = field(default_factory=lambda: np.empty((0, 0)))
    """(S, R) of dots: where down the rows each is, px; empty: the stripes are lines."""


def dot_centres(camera: Camera, laser: LaserFan, solid: Solid) -> Crossings:
    """Find where the middle of every dot's ray is seen, each in the row that it lies in.

    Where rays of one plane come to lie in one row, the first of them is kept.
    """
    ways = laser.rays()
    lit = _meet_rays(solid.body(), laser.projector_mm, camera.centre_mm, ways)
    shape = laser.count, camera.height_px
    x, y, xyz = np.full(shape, np.nan), np.full(shape, np.nan), np.full((*shape, 3), np.nan)
    on = np.full(shape, -1, np.int8)
    hits = np.zeros(shape, np.int8)
    seen = camera.project(lit[..., :3])
    # the row in which a dot is seen is the pixel row nearest to its middle
    row = np.rint(np.nan_to_num(seen[..., 1], nan=-1.0)).astype(np.int64)
    inside = (
        (row >= 0)
        & (row < shape[1])
        & (np.abs(seen[..., 0] - 0.5 * (camera.width_px - 1)) < 0.5 * camera.width_px)
    )
    # a plane without light has no dots
    for stripe, line in np.argwhere(inside & (laser.peak_grey > 0.0)[:, None]):
        at = stripe, row[stripe, line]
        hits[at] += 1
        if hits[at] == 1:
            (x[at], y[at]), xyz[at], on[at] = seen[stripe, line], lit[stripe, line, :3], lit[stripe, line, 3]
    return Crossings(x, xyz, on, hits, y)


@kernel
def _meet_rays(body: AnyBody, projector: Floats, camera: Floats, ways: Floats) -> Floats:
    """Give (…, 4) the point each ray meets that the camera sees, NaN if it does not, and on what it lies."""
    reach = body.reach
    found = np.full((ways.shape[0], ways.shape[1], 4), np.nan)
    point, normal = np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    for i in range(ways.shape[0]):
        for j in range(ways.shape[1]):
            # from the projector: where the ray's dot falls
            on = first_hit(body, reach, projector, ways[i, j], 1e-4, point)
            if on < 0:
                continue
            normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
            normal_at(body, on, point, normal)
            # and is it seen from the camera
            if sees(body, reach, point, normal, camera, beam, scratch) == 0.0:
                continue
            for m in range(3):
                found[i, j, m] = point[m]
            found[i, j, 3] = on
    return found


def stripe_centres(camera: Camera, laser: LaserFan, solid: Solid, *, step_px: float = 0.125) -> Crossings:
    """Find all stripe centres to better than 1e-6 px.

    A row is searched for changes of side at a pitch of `step_px`; two crossings closer than this may be
    missed.
    """
    # a dead plane lights nothing
    planes = np.column_stack([laser.normals, laser.offsets_mm, laser.peak_grey])
    if len(laser.halves):
        planes = np.column_stack([planes, laser.halves])
    found = _search(
        solid.body(), camera.packed(), camera.rotation, laser.projector_mm, planes, camera.height_px,
        camera.width_px, step_px,
    )  # fmt: skip
    for array in found:
        array.flags.writeable = False
    return Crossings(*found)


@kernel
def _side(
    body: AnyBody, reach: Reach, pinhole: Floats, rotation: Floats, projector: Floats, plane: Floats,
    x_px: float, y_px: float, view: Floats, point: Floats,
) -> tuple[float, int]:  # fmt: skip
    """Signed distance to the plane of what the camera sees at an image point; also on what it lies."""
    camera_ray(pinhole, rotation, x_px, y_px, view)
    on = first_hit(body, reach, pinhole[:3], view, 1e-12, point)
    if on < 0:
        return np.nan, on
    off = plane[0] * point[0] + plane[1] * point[1] + plane[2] * point[2] - plane[3]
    return off - _bend(projector, plane, point), on


@kernel
def _bend(projector: Floats, plane: Floats, point: Floats) -> float:
    """By how much a cone's distance is less than that of the plane with its normal; 0 of a plane."""
    if plane.shape[0] == 5:
        return 0.0
    away = 0.0
    for m in range(3):
        away += (point[m] - projector[m]) ** 2
    return plane[5] * math.sqrt(away)


@kernel
def _on_half(projector: Floats, plane: Floats, point: Floats) -> bool:
    """Say whether a point of a cone lies on its half; of a plane all do."""
    if plane.shape[0] == 5:
        return True
    along = 0.0
    for m in range(3):
        along += plane[6 + m] * (point[m] - projector[m])
    return along > 0.0


@kernel
def _search(
    body: AnyBody, pinhole: Floats, rotation: Floats, projector: Floats, planes: Floats,
    rows: int, columns: int, step_px: float,
) -> tuple[Floats, Floats, NDArray[np.int8], NDArray[np.int8]]:  # fmt: skip
    count = planes.shape[0]
    x_out = np.full((count, rows), np.nan)
    xyz_out = np.full((count, rows, 3), np.nan)
    on_out = np.full((count, rows), -1, dtype=np.int8)
    hits_out = np.zeros((count, rows), dtype=np.int8)
    point, normal, view = np.zeros(3), np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    reach = body.reach
    steps = int(np.ceil(columns / step_px))
    sides = np.empty((steps + 1, count))
    for row in range(rows):
        for k in range(steps + 1):
            # every sample of the row once, for all planes: sight is what costs
            camera_ray(pinhole, rotation, -0.5 + k * step_px, row, view)
            on = first_hit(body, reach, pinhole[:3], view, 1e-4, point)
            for i in range(count):
                sides[k, i] = np.nan
                if on >= 0:
                    # signed distance of what is seen there from each plane
                    sides[k, i] = -planes[i, 3]
                    for m in range(3):
                        sides[k, i] += planes[i, m] * point[m]
                    sides[k, i] -= _bend(projector, planes[i], point)
        for i in range(count):
            if planes[i, 4] == 0.0:
                continue
            for k in range(steps):
                # no change of side between two samples: no crossing, or two
                if (sides[k, i] <= 0.0) == (sides[k + 1, i] <= 0.0):
                    continue
                low, high = -0.5 + k * step_px, -0.5 + (k + 1) * step_px
                low_negative = sides[k, i] <= 0.0
                # halving, and not false position: over an edge the distance jumps
                while high - low > _TOLERANCE_PX:
                    middle = 0.5 * (low + high)
                    f, on = _side(
                        body, reach, pinhole, rotation, projector, planes[i], middle, row, view, point
                    )
                    if (f <= 0.0) == low_negative:
                        low = middle
                    else:
                        high = middle
                x_px = 0.5 * (low + high)
                f, on = _side(body, reach, pinhole, rotation, projector, planes[i], x_px, row, view, point)
                if not _on_half(projector, planes[i], point):
                    continue
                # the plane is not where the search ended: it jumped over an edge
                if not abs(f) < _MAX_RESIDUAL_MM or x_px > columns - 0.5:
                    continue  # a jump from one surface to another, not a crossing
                normal_at(body, on, point, normal)
                # seen, and lit as well
                if sees(body, reach, point, normal, projector, beam, scratch) == 0.0:
                    continue
                hits_out[i, row] += 1
                # the product rather than the belt, then the higher one
                if on < on_out[i, row] or (on == on_out[i, row] and point[2] <= xyz_out[i, row, 2]):
                    continue
                x_out[i, row] = x_px
                xyz_out[i, row] = point
                on_out[i, row] = on
    return x_out, xyz_out, on_out, hits_out


def stripes_show(
    solid: Solid, reference: Solid | None, truth: Crossings, *, step_mm: float = 0.25
) -> dict[str, float]:
    """Find what the stripes show of a product, and how much of its defect, which a reference lacks.

    `left_stripe`, `right_stripe`: outermost stripes (1 is leftmost) with lit and seen points on the
    product, 0 where there is none; `overhang_left_mm`, `overhang_right_mm`: belt X from the outermost lit
    stripe (median of its points) to the end of the footprint; `defect_depth_mm`: largest height missing
    from the reference anywhere on the footprint, looked for `step_mm` apart, 0 without a reference;
    `defect_seen_mm`: the same at the lit and seen points alone; `hollow_seen_mm`: largest depth of a lit
    stripe's height over Y below its own upper convex hull. NaN where no stripe lies on the product.
    """
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    depth = 0.0
    if reference is not None and reference is not solid:
        # on the whole footprint, also where no stripe lies
        x, y = np.meshgrid(np.arange(x_min, x_max, step_mm), np.arange(y_min, y_max, step_mm))
        depth = _most_mm(reference.heights_mm(x, y)[0] - solid.heights_mm(x, y)[0])
    found = dict.fromkeys(
        ("overhang_left_mm", "overhang_right_mm", "defect_seen_mm", "hollow_seen_mm"), float("nan")
    )
    found |= {"left_stripe": 0.0, "right_stripe": 0.0, "defect_depth_mm": depth}
    lit = truth.on_product == 1
    stripes = np.flatnonzero(lit.any(axis=1))
    if not stripes.size:
        return found
    left, right, points = int(stripes[0]), int(stripes[-1]), truth.xyz_mm[lit]
    whole = solid if reference is None else reference
    return found | {
        "left_stripe": left + 1.0,
        "right_stripe": right + 1.0,
        "overhang_left_mm": float(np.median(truth.xyz_mm[left, lit[left], 0])) - x_min,
        "overhang_right_mm": x_max - float(np.median(truth.xyz_mm[right, lit[right], 0])),
        "defect_seen_mm": _most_mm(whole.heights_mm(points[:, 0], points[:, 1])[0] - points[:, 2]),
        "hollow_seen_mm": max(_hollow_mm(truth.xyz_mm[i, lit[i], 1:]) for i in stripes),
    }


def _most_mm(missing_mm: Floats) -> float:
    """Largest of what is not NaN, at least 0."""
    known = missing_mm[np.isfinite(missing_mm)]
    return max(float(known.max()), 0.0) if known.size else 0.0


def _hollow_mm(profile_mm: Floats) -> float:
    """Depth of a profile, shape (n, 2) of (y, z), below its upper convex hull."""
    points = profile_mm[np.argsort(profile_mm[:, 0])]
    hull: list[Floats] = []
    for point in points:
        # upper hull from left to right, as in Andrew's monotone chain
        while len(hull) > 1:
            (ay, az), (by, bz) = hull[-2], hull[-1]
            if (by - ay) * (point[1] - az) < (bz - az) * (point[0] - ay):
                break
            hull.pop()
        hull.append(point)
    corners = np.array(hull)
    return float((np.interp(points[:, 0], corners[:, 0], corners[:, 1]) - points[:, 1]).max())


class RayCaster(RigSimulator[RayCasterOptions]):
    """Casts float64 rays: at least 4 × 4 a pixel, occlusion exact for camera and laser.

    The item of number k has the seed (first seed + k), so a longer set of the same seed begins with the
    shorter one. Light that is scattered between surfaces is left out, and the belt stands still during the
    exposure.
    """

    def __init__(self, options: RayCasterOptions | None = None) -> None:
        super().__init__(options)
        # a product that cannot be, or does not fit, is told before anything is rendered
        draw_item(self.options.product, self.rig, 0, 0)

    def simulate(self, number: int, seed: int) -> Simulated:
        """Make the item of this number; raise StageError where its product does not fit into the view."""
        lying = draw_item(self.options.product, self.rig, number, seed)
        solid = lying.solid
        surface = surface_of(self.options, lying.seed)
        surface = contaminate(surface, self.options, self.rig, lying.products, lying.seed)
        pitch: Any = {"step_px": 0.5} if self.options.draft else {}
        camera, laser = self.rig.camera, self.rig.laser
        if len(laser.rows):
            crossings = dot_centres(camera, laser, solid)
        else:
            crossings = stripe_centres(camera, laser, solid, **pitch)
        stripes = stripes_of(crossings, solid)
        if laser.across is not None:
            across = stripe_centres(turned(camera), laser.across, solid, **pitch)
            stripes = replace(stripes, across=stripes_of(across, solid))
        frames = []
        for role in self.options.light.images:
            rig = self.rig
            if role == "dark":
                off = replace(laser, peak_grey=np.zeros_like(laser.peak_grey), across=None)
                rig = replace(rig, laser=off)
            # a dark image has a noise of its own
            # seeds of products count up; this is far beyond them
            noise_seed = lying.seed if role != "dark" else lying.seed + 2**32
            given: Any = {"samples": self.options.samples, "draft": self.options.draft}
            pixels = render(rig, solid, surface, seed=noise_seed, plain=role == "plain", **given)
            frames.append(self._frame(pixels, role, number))
        # each product's figures from its own points: to the others it is belt
        products = tuple(
            _truth_of(
                one, lying.seed, replace(crossings, on_product=(stripes.product == place).astype(np.int8))
            )
            for place, one in enumerate(lying.products, start=1)
        )
        return Simulated(tuple(frames), Truth(products, stripes))

    def turn_deg(self) -> Turn:
        """Give the turn that rights its images."""
        return self.options.turn_deg

    def _frame(self, pixels: NDArray[Any], role: Role, number: int) -> Frame:
        belt = self.options.belt
        travel_mm = number * belt.pitch_mm
        return Frame(
            as_stored(pixels, self.options.turn_deg),
            role=role,
            bit_depth=self.options.camera.bit_depth,
            time_s=travel_mm / belt.speed_mm_per_s if belt.speed_mm_per_s > 0.0 else math.nan,
            sensor=self.sensor(),
            encoder_count=float(math.floor(travel_mm / belt.encoder_step_mm + 1e-9)),
        )


def stripes_of(crossings: Crossings, solid: Solid | None = None) -> StripeTruth:
    """Return the record of what is known of the stripes; `solid` says which of a group is where."""
    on_product = crossings.on_product == 1
    label = np.where(np.isfinite(crossings.x_px), on_product.astype(np.int16), np.int16(-1))
    if isinstance(solid, Group):
        label[on_product] = solid.member_at(crossings.xyz_mm[on_product])
    x_px, y_px, xyz_mm = (one.copy() for one in (crossings.x_px, crossings.y_px, crossings.xyz_mm))
    return StripeTruth(x_px, on_product, xyz_mm, label, y_px)


def _truth_of(one: Drawn, seed: int, crossings: Crossings) -> ProductTruth:
    figures = stripes_show(one.solid, one.reference, crossings)
    return replace(one.truth, figures={"seed": float(seed), **one.truth.figures, **figures})
