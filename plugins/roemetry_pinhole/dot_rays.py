"""Rays of a matrix of dots, and triangulation by them.

A dot on a board in a known pose is a point of its ray; a line through the points of many boards is the ray.
The marks of the boards and all dots are adjusted together: with u what marks tell (camera, poses, belt;
covariance C from their own adjustment) and r a ray's four numbers, the squares of the dots' residuals over
their covariance and of u's step over C are made smallest by Gauss and Newton's method. Each ray depends on
u alone, so it is eliminated (Triggs, McLauchlan, Hartley and Fitzgibbon 2000, section 6).

What rays err by together is kept as what it depends on: the camera and the belt, and a few directions of
the rest (poses that all rays were found on). What is left is each ray's own. So a matrix of 400 dots needs
some twenty parameters with a covariance, not 1,600.

In triangulation the point is the place on the dot's ray whose image lies nearest the dot, by the
covariances of dot and ray (`roemetry.records.light`).

It assumes that a dot's light runs along one straight line, and noise that dots do not share. It fails for
dots seen on few surfaces: these rays are filled in from their neighbours', or unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from roemetry.errors import CalibrationError, StageError
from roemetry.records import Profiles, Rays, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.light import at_height
from roemetry.records.view import View
from roemetry.stages import Capabilities, StageOptions, Triangulator
from roemetry_kernels.rays import meet_rays
from roemetry_pinhole.bundle import Adjusted
from roemetry_pinhole.dot_lattice import nearest_point
from roemetry_pinhole.geometry import ON_BELT, Geometry, Unknowns, distort
from roemetry_pinhole.geometry import rays as sight
from roemetry_pinhole.pinhole_plane import belt_pose, camera_matrix, camera_of, check_size, flat, rotation_of

METHOD = "pinhole-dots"
MOTION = "camera_motion"
"""Parameter of a calibration whose camera has moved since it was made."""
_REST_DEGREE = 3
"""Of the polynomial along the rows that a column of dots on the belt gets: it bends as lenses bend lines."""
_ROUNDS = 3  # Gauss–Newton steps: the marks' adjustment is the start, and near
_OFF_MAX = 5.0  # standard deviations beyond which a dot is left out: print under it, or another dot's light
_OFF_LEAST_PX = 0.3  # nearer than this a dot is never left out, px
_SURFACES_MIN = 3  # surfaces that a ray is seen on: two determine it, a third shows whether they agree
_SHARED = 6  # directions in which rays err together beside camera and belt
_AROUND, _AROUND_MIN = 3, 12
"""Columns and lines around a ray, and least number of known rays there, by which it is filled in where it is
not known: twice the numbers of a quadratic."""
_LEVERAGE_MAX = 0.5
"""Variance of what is filled in over that of one ray."""
_UP_MM = 30.0  # height at which a slope's error is compared with a place's, mm: half of what is measured


@dataclass(frozen=True, eq=False, slots=True)
class DotPoints:
    """Dots on boards and on the belt."""

    pose: Integers
    """(point,) pose of the board, or `ON_BELT`."""
    ray: Integers
    """(point,) which dot: stripe · lines + line."""
    xy_px: Floats
    covariance_px2: Floats
    """xy_px, covariance_px2: (point, 2), (point, 2, 2) where it is seen."""


@dataclass(frozen=True, eq=False, slots=True)
class FoundRays:
    """What the adjustment of dots gives."""

    geometry: Geometry
    """Camera, poses and belt, moved by what dots tell."""
    lines: Floats
    """(ray, 4) in the belt frame; NaN of rays that are seen on too few surfaces."""
    covariance: Floats
    own: Floats
    by_unknown: Floats
    """covariance, own, by_unknown: (unknown, unknown) of the marks' unknowns; (ray, 4, 4) of rays with those
    held fixed; (ray, 4, unknown) how rays follow them."""
    residual_px: Floats
    used: Flags
    """residual_px, used: (point, 2), (point,)"""
    factor: float
    """Noise of the dots over what their covariance states."""


def adjusted_rays(marks: Adjusted, points: DotPoints, count: int) -> FoundRays:
    """Adjust rays, and with them camera, poses and belt.

    Raises
    ------
    CalibrationError
        No ray is seen on enough surfaces.
    """
    geometry, unknowns = marks.geometry, marks.unknowns
    information = np.linalg.inv(marks.covariance)
    stated: Floats = np.asarray(np.linalg.inv(points.covariance_px2), np.float64)
    used = np.ones(points.ray.size, np.bool_)
    total = np.zeros(unknowns.count)
    for step in range(_ROUNDS):
        # a ray needs its surfaces whatever was left out before
        used &= _often(points, used, count)
        if not used.any():
            raise CalibrationError(
                f"no dot is seen on {_SURFACES_MIN} surfaces",
                hint="hold the board under all of the pattern, in ten poses and more",
            )
        lines = _lines_through(geometry, points, used, count)
        # rays twice before they are judged: residuals must not be the start's
        for _ in range(2):
            residual, by_ray = _by_ray(geometry, lines, points)
            lines = lines + _eliminated(by_ray, stated, residual, points.ray, used, count)[0]
        residual, by_ray = _by_ray(geometry, lines, points)
        used, factor = _judged(residual, points, stated, used)
        used &= _often(points, used, count)
        weight = np.where(used[:, None, None], stated / factor**2, 0.0)
        by_unknown = _by_unknown(geometry, unknowns, marks.covariance, lines, points)
        change, own, follow = _eliminated(by_ray, weight, residual, points.ray, used, count, by_unknown)
        # what is left of a dot's residual, and of its derivatives, once its ray has followed
        rest = np.where(used[:, None], residual - np.einsum("nij,nj->ni", by_ray, change[points.ray]), 0.0)
        apart = np.where(used[:, None, None], by_unknown + by_ray @ follow[points.ray], 0.0)
        normal = information + np.einsum("nia,nij,njb->ab", apart, weight, apart, optimize=True)
        covariance = np.linalg.inv(normal)
        if step < _ROUNDS - 1:
            # u's step is weighed from the marks' own place, so what was moved already counts
            right = np.einsum("nia,nij,nj->a", apart, weight, rest, optimize=True) - information @ total
            total = total + covariance @ right
            geometry = unknowns.moved(geometry, covariance @ right)
    return FoundRays(geometry, lines, covariance, own, follow, residual, used, factor)


def rays_of(found: FoundRays, unknowns: Unknowns, stripes: int) -> tuple[Rays, dict[str, Floats], Floats]:
    """Give rays, the calibration's parameters and their covariance."""
    at = np.concatenate([unknowns.camera, unknowns.belt])
    free = at[at >= 0]
    known = found.covariance[np.ix_(free, free)]
    # what the rays do if camera and belt are told, and what they err by if these are
    gain = found.covariance[:, free] @ np.linalg.pinv(known, hermitian=True)
    rest = found.covariance - gain @ found.covariance[free]
    size, turned = np.linalg.eigh(0.5 * (rest + rest.T))
    moves = found.by_unknown @ (turned * np.sqrt(np.maximum(size, 0.0)))
    seen = np.isfinite(moves[:, 0, 0])
    weights = np.array([1.0, 1.0, _UP_MM, _UP_MM])
    alike = (moves[seen] * weights[:, None]).reshape(-1, moves.shape[2])
    # at the belt and 30 mm up, so that places and slopes compare
    shared = np.linalg.svd(alike, full_matrices=False)[2][:_SHARED].T
    by_shared = moves @ shared
    # beyond the shared directions: each ray's own
    left = moves - by_shared @ shared.T
    own = found.own + left @ left.transpose(0, 2, 1)
    by_parameter = np.zeros((len(found.lines), 4, at.size + _SHARED))
    by_parameter[:, :, : at.size][:, :, at >= 0] = found.by_unknown @ gain
    by_parameter[:, :, at.size :] = by_shared
    # the file is three quarters of it: more digits than seven say nothing of a derivative
    by_parameter = np.array([float(f"{one:.7g}") for one in by_parameter.ravel()]).reshape(by_parameter.shape)
    covariance = np.eye(at.size + _SHARED)
    covariance[: at.size, : at.size] = 0.0
    covariance[np.ix_(np.flatnonzero(at >= 0), np.flatnonzero(at >= 0))] = known
    camera = found.geometry.camera
    parameters = {
        "focal_px": camera[:2],
        "principal_px": camera[2:4],
        "distortion": camera[4:],
        "belt_per_mm": found.geometry.belt,
        "shared_by_rays": np.zeros(_SHARED),
    }
    shape = (stripes, len(found.lines) // stripes)
    every = _between_neighbours(
        found.lines.reshape(*shape, 4), own.reshape(*shape, 4, 4), by_parameter.reshape(*shape, 4, -1)
    )
    return Rays(*every, flat(parameters)), parameters, covariance


def _between_neighbours(lines: Floats, own: Floats, by_parameter: Floats) -> tuple[Floats, Floats, Floats]:
    """Fill in rays that are not known from those around them: a projector's pattern is smooth.

    Each is the value of a quadratic over column and line through the known ones around it. How far such a
    value lies off is told by the rays that are known, each taken from its neighbours alike.
    """
    known = np.isfinite(lines[..., 0])
    weights = {place: _around(known, place) for place in zip(*map(list, np.nonzero(known)), strict=True)}
    asked = [(place, *found) for place, found in weights.items() if found is not None]
    missing = [(place, _around(known, place)) for place in zip(*map(list, np.nonzero(~known)), strict=True)]
    if not asked or not missing:
        return lines, own, by_parameter
    # each known ray from its neighbours: how far off tells the error of filling in
    off = np.array([weight @ lines[at] - lines[place] for place, at, weight in asked])
    lines, own, by_parameter = lines.copy(), own.copy(), by_parameter.copy()
    for place, found in missing:
        if found is not None:
            at, weight = found
            lines[place] = weight @ lines[at]
            by_parameter[place] = np.tensordot(weight, by_parameter[at], axes=1)
            own[place] = off.T @ off / len(off)
    return lines, own, by_parameter


def _around(known: Flags, place: tuple[int, int]) -> tuple[tuple[Integers, Integers], Floats] | None:
    """Give the known rays around one, and how much each counts for it; None where they are too few."""
    column, line = np.nonzero(known)
    across, down = column - place[0], line - place[1]
    near = (np.maximum(np.abs(across), np.abs(down)) <= _AROUND) & ((across != 0) | (down != 0))
    if near.sum() < _AROUND_MIN:
        return None
    x, y = across[near].astype(np.float64), down[near].astype(np.float64)
    powers = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    # the first coefficient is the value at the place itself, as weights of the neighbours
    weight: Floats = np.asarray(np.linalg.pinv(powers)[0], np.float64)
    # at a corner they say less of the ray than one seen on a few boards would
    return ((column[near], line[near]), weight) if weight @ weight < _LEVERAGE_MAX else None


def view_of(
    parameters: Mapping[str, Floats], lines: Floats, image_size: tuple[int, int], *, light: bool = True
) -> View:
    """Give the camera, a plane through the rays of each column, normal towards +X, and the rays' point.

    Without `light` the point, which triangulation does not ask for, is left out.
    """
    camera, pose = camera_of(parameters), belt_pose(parameters["belt_per_mm"])
    if MOTION in parameters:
        motion = parameters[MOTION]
        pose = pose.copy()
        pose[:3, :3] = pose[:3, :3] @ rotation_of(motion, camera[0]).T
        camera[:2] = camera[:2] * (1.0 + motion[2])
    # a plane through points of every ray, those that are not known at the others' middle
    points = np.concatenate([_at_height(lines, 0.0), _at_height(lines, _UP_MM)], axis=1)
    there = np.isfinite(points).all(axis=2, keepdims=True)
    middle = points.sum(axis=1, keepdims=True, where=there) / np.maximum(there.sum(axis=1, keepdims=True), 1)
    off = np.nan_to_num(points - middle)
    # smallest eigenvector: the normal of the plane through the column's points
    normal = np.linalg.eigh(off.transpose(0, 2, 1) @ off)[1][:, :, 0]
    normal *= np.where(normal[:, :1] >= 0.0, 1.0, -1.0)
    planes = np.column_stack([normal, (normal * middle[:, 0]).sum(axis=1)])
    every = lines.reshape(-1, 4)
    every = every[np.isfinite(every[:, 0])]
    if not light:
        return View(image_size, camera_matrix(camera), pose, planes, camera[4:])
    light_mm = nearest_point(at_height(every, 0.0), np.column_stack([every[:, 2:], np.ones(len(every))]))[0]
    return View(image_size, camera_matrix(camera), pose, planes, camera[4:], light_mm)


def _at_height(lines: Floats, z_mm: float) -> Floats:
    """Give (stripe, line, 3) the points of rays at a height."""
    return at_height(lines.reshape(-1, 4), z_mm).reshape(*lines.shape[:2], 3)


def rest_lines(view: View, lines: Floats) -> tuple[Floats, Floats]:
    """Give rest lines through each column's dots on the belt, as polynomials in the row, and px per mm."""
    rows = view.image_size[0]
    found, per_mm = np.zeros((len(lines), _REST_DEGREE + 1)), np.zeros(len(lines))
    half = 0.5 * (rows - 1)
    for column, mine in enumerate(lines):
        mine = mine[np.isfinite(mine[:, 0])]
        low, high = (view.project(at_height(mine, z)) for z in (0.0, 1.0))
        # rows from −1 to 1; the division below brings px back
        powers = ((low[:, 1:] - half) / half) ** np.arange(_REST_DEGREE + 1)
        found[column] = np.linalg.lstsq(powers, low[:, 0], rcond=None)[0] / half ** np.arange(
            _REST_DEGREE + 1
        )
        per_mm[column] = float(np.mean(high[:, 0] - low[:, 0]))
    return found, per_mm


class PinholeDots(Triangulator[StageOptions]):
    """Each dot's place on its ray, nearest to the dot in the image, by the covariances of both."""

    capabilities = Capabilities(pattern="dots", fixture="roemetry_pinhole.conformance:dots_of")

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give a slice for each column of dots, each point in the row its dot lies in.

        Raises
        ------
        StageError
            The calibration has no rays, the map no dots, or they are of another number of stripes or
            rows.
        """
        rays, dots = calibration.rays, stripes.dots
        if rays is None or dots is None:
            what = "the calibration has no rays" if rays is None else "the stripes are lines, not dots"
            raise StageError(f"{what}: pinhole-dots triangulates dots", hint="calibrate with pinhole-dots")
        check_size(stripes, calibration, "columns of dots")
        lines = rays.moved(calibration.parameters)
        view = view_of(calibration.parameters, lines, calibration.image_size, light=False)
        stripe, row = np.nonzero(np.isfinite(stripes.x_px) & (dots.line >= 0))
        at = dots.line[stripe, row]
        xy_px = np.column_stack([stripes.x_px[stripe, row], dots.y_px[stripe, row]])
        own = dots.covariance_px2[stripe, row]
        met = meet_rays(view, lines[stripe, at], xy_px, own, rays.covariance[stripe, at])
        shape = stripes.x_px.shape
        xyz_mm, height_std_mm = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
        points = at_height(lines[stripe, at], met.z_mm)
        points[~np.isfinite(points).all(axis=1)] = np.nan
        xyz_mm[stripe, row], height_std_mm[stripe, row] = points, met.z_std_mm
        known = np.isfinite(xyz_mm[..., 2])
        return Profiles(
            xyz_mm=xyz_mm,
            product=np.where(known, stripes.product, -1).astype(np.int16),
            seen=stripes.seen & known,
            x_px=np.where(known, stripes.x_px, np.nan),
            row_px=np.where(known, dots.y_px, np.nan),
            height_std_mm=height_std_mm,
            stripe=np.arange(shape[0]),
            frame=np.zeros(shape[0], np.int64),
            plane=view.planes,
        )

    def moved(self, calibration: Calibration, alignment: Alignment) -> Calibration:
        """Give the calibration of a camera turned and zoomed over belt and projector, which stay.

        The motion joins the parameters with its covariance: `camera_motion`, as in `Alignment`. The rays stay
        what they are in the belt frame, and do not follow it.
        """
        rays = calibration.rays
        assert rays is not None
        parameters = {**calibration.parameters, MOTION: alignment.motion}
        size, count = len(calibration.covariance), len(alignment.motion)
        covariance = np.zeros((size + count, size + count))
        covariance[:size, :size], covariance[size:, size:] = calibration.covariance, alignment.covariance
        followed = np.concatenate([rays.by_parameter, np.zeros((*rays.lines.shape, count))], axis=3)
        view = view_of(parameters, rays.lines, calibration.image_size)
        rest_px, displacement = rest_lines(view, rays.lines)
        return replace(
            calibration,
            parameters=parameters,
            covariance=covariance,
            rays=Rays(rays.lines, rays.covariance, followed, flat(parameters)),
            view=view,
            rest_px=rest_px,
            displacement_px_per_mm=displacement,
        )

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's own parameters, so that a redrawn one moves it."""
        if calibration.rays is None:
            return calibration.view
        lines = calibration.rays.moved(calibration.parameters)
        return view_of(calibration.parameters, lines, calibration.image_size)


def surface_of(geometry: Geometry, pose: Integers) -> Floats:
    """Give (n, 3) p·X = 1 in the camera's frame of the surfaces of poses, or the belt."""
    normal = geometry.rotation[:, :, 2]
    boards = normal / (normal * geometry.shift).sum(axis=1)[:, None]
    return np.where((pose == ON_BELT)[:, None], geometry.belt, boards[np.maximum(pose, 0)])


def places_of(geometry: Geometry, points: DotPoints) -> Floats:
    """Give (n, 3) where the dots lie, belt frame, mm."""
    ray = sight(geometry.camera, points.xy_px)
    depth = 1.0 / (ray * surface_of(geometry, points.pose)).sum(axis=1)
    pose = belt_pose(geometry.belt)
    return np.asarray((ray * depth[:, None]) @ pose[:3, :3].T + pose[:3, 3])


def _predicted(geometry: Geometry, lines: Floats, points: DotPoints) -> Floats:
    """Give (n, 2) where rays (ray, 4) meet the surfaces, px."""
    pose = belt_pose(geometry.belt)
    mine = lines[points.ray]
    # from the belt's frame back to the camera's
    start = (at_height(mine, 0.0) - pose[:3, 3]) @ pose[:3, :3]
    way = np.column_stack([mine[:, 2:], np.ones(len(mine))]) @ pose[:3, :3]
    surface = surface_of(geometry, points.pose)
    along = (1.0 - (start * surface).sum(axis=1)) / (way * surface).sum(axis=1)
    place = start + along[:, None] * way
    distorted = distort(place[:, :2] / place[:, 2:], geometry.camera[4:]).xy
    return np.asarray(distorted * geometry.camera[:2] + geometry.camera[2:4])


_RAY_STEPS = np.diag([1e-3, 1e-3, 1e-5, 1e-5])  # steps of a ray's numbers for derivatives: all some 0.003 px


def _by_ray(geometry: Geometry, lines: Floats, points: DotPoints) -> tuple[Floats, Floats]:
    """Give (n, 2) seen less predicted, px, and (n, 2, 4) the prediction's derivatives by the ray."""
    here = _predicted(geometry, lines, points)
    columns = [(_predicted(geometry, lines + step, points) - here) / step.sum() for step in _RAY_STEPS]
    return points.xy_px - here, np.stack(columns, axis=2)


def _by_unknown(
    geometry: Geometry, unknowns: Unknowns, covariance: Floats, lines: Floats, points: DotPoints
) -> Floats:
    """Give (n, 2, unknown) the prediction's derivatives by what marks tell; steps of a tenth of its error."""
    found = np.zeros((points.ray.size, 2, unknowns.count))
    for number, std in enumerate(np.sqrt(np.diag(covariance)).tolist()):
        step = np.zeros(unknowns.count)
        step[number] = 0.1 * std
        above, below = (
            _predicted(unknowns.moved(geometry, sign * step), lines, points) for sign in (1.0, -1.0)
        )
        found[:, :, number] = (above - below) / (0.2 * std)
    return np.nan_to_num(found)


def _often(points: DotPoints, used: Flags, count: int) -> Flags:
    """Say which points are of rays that are seen on enough surfaces."""
    pairs = np.unique(np.column_stack([points.ray[used], points.pose[used]]), axis=0)
    return np.asarray(np.bincount(pairs[:, 0], minlength=count)[points.ray] >= _SURFACES_MIN)


def _lines_through(geometry: Geometry, points: DotPoints, used: Flags, count: int) -> Floats:
    """Give (ray, 4) lines through the points of each ray, by least squares over Z."""
    place, ray = places_of(geometry, points)[used], points.ray[used]

    def summed(values: Floats) -> Floats:
        return np.asarray(np.bincount(ray, values, minlength=count), np.float64)

    x, y, z = place.T
    n, sz, szz = summed(np.ones_like(z)), summed(z), summed(z * z)
    with np.errstate(divide="ignore", invalid="ignore"):
        # least squares of x and y over z, ray by ray, in sums
        below = n * szz - sz * sz
        slopes = [(n * summed(v * z) - summed(v) * sz) / below for v in (x, y)]
        on_belt = [(summed(v) - slope * sz) / n for v, slope in zip((x, y), slopes, strict=True)]
        found = np.column_stack([*on_belt, *slopes])
    return np.where(n[:, None] >= _SURFACES_MIN, found, np.nan)


def _eliminated(
    by_ray: Floats,
    weight: Floats,
    residual: Floats,
    ray: Integers,
    used: Flags,
    count: int,
    by_unknown: Floats | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Solve each ray alone: its (ray, 4) step, its covariance, and how it follows the unknowns."""
    pull = np.einsum("nia,nij->naj", by_ray, np.where(used[:, None, None], weight, 0.0))
    normal, right = np.zeros((count, 4, 4)), np.zeros((count, 4))
    usable = used & np.isfinite(pull).all(axis=(1, 2))
    np.add.at(normal, ray[usable], (pull @ by_ray)[usable])
    np.add.at(right, ray[usable], np.einsum("naj,nj->na", pull, residual)[usable])
    sound = np.linalg.cond(normal + 0.0) < 1e14
    sound &= np.abs(normal).max(axis=(1, 2)) > 0.0
    # rays whose equations are singular stay NaN
    covariance = np.full((count, 4, 4), np.nan)
    covariance[sound] = np.linalg.inv(normal[sound])
    step = np.einsum("nab,nb->na", covariance, right)
    if by_unknown is None:
        return step, covariance, np.empty(0)
    follow = np.zeros((count, 4, by_unknown.shape[2]))
    np.add.at(follow, ray[usable], (pull @ by_unknown)[usable])
    # a ray's answer to u: −N⁻¹ Jᵀ W J_u
    return step, covariance, -covariance @ follow


def _judged(residual: Floats, points: DotPoints, stated: Floats, used: Flags) -> tuple[Flags, float]:
    """Say which dots are not far off, and how much more they scatter than their covariance says."""
    off = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", residual, stated, residual), 0.0))
    known = used & np.isfinite(off)
    # the median of the length of a plane normal error is √(2 ln 2); four numbers of each ray are fitted
    free = max(1.0 - 2.0 * np.unique(points.ray[known]).size / max(known.sum(), 1), 0.1)
    factor = max(float(np.median(off[known])) / np.sqrt(2.0 * np.log(2.0) * free), 1.0)
    near = np.hypot(residual[:, 0], residual[:, 1]) < _OFF_LEAST_PX
    return known & ((off < _OFF_MAX * factor) | near), factor
