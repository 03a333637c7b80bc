"""What camera and fan do to a height: scale, displacement, range, spacing heights, slopes. No noise here.

Every function takes belt-frame points (mm) and works on the fan's own plane through each of them: the one
that holds the projector and the lines' common axis. So a map over the volume needs no stripe to be there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.camera import Camera
from roemetry_simulate.laser import LaserFan

Floats = NDArray[np.float64]

_RELATIVE_STEP = 3e-5
_RANGE_STEPS = 4001


@dataclass(frozen=True, eq=False)
class Scale:
    """How belt-frame millimetres become pixels at points of one shape S.

    Attributes
    ----------
    x_mm_per_px, y_mm_per_px : ndarray, shape S
        On a level surface, for one pixel along the image row and along the column, mm.
    height_px_per_mm : ndarray, shape S
        Displacement of the stripe along its image row for one millimetre of height; signed.
    across_mm_per_px : ndarray, shape S
        Distance from the light plane, along its normal, for one pixel along the row on a level surface, mm.
    """

    x_mm_per_px: Floats
    y_mm_per_px: Floats
    height_px_per_mm: Floats
    across_mm_per_px: Floats


def scale_at(camera: Camera, fan: LaserFan, points_mm: Floats) -> Scale:
    """Return the local scales of projection.

    From central differences of the camera's full model (distortion too). With (u, v) the image point and n
    the light plane's normal, a step dz within the plane and within the row (dv = 0) moves the stripe by
    du/dz = U_z − U_y V_z / V_y, where U and V are derivatives along the plane. For a camera that looks
    straight down from height H with focal length f (px) and a projector at the same height and distance B
    beside it, this is f B / (H − z)².

    Parameters
    ----------
    camera, fan
        The rig.
    points_mm : ndarray, shape S + (3,)
        Belt frame.

    Returns
    -------
    Scale
        Of shape S.
    """
    depth = (points_mm - camera.centre_mm) @ camera.rotation[:, 2]
    step = _RELATIVE_STEP * depth[..., None]
    gradient = []
    for axis in np.eye(3):
        change = camera.project(points_mm + step * axis) - camera.project(points_mm - step * axis)
        gradient.append(change / (2.0 * step))
    (ux, vx), (uy, vy), (uz, vz) = ((g[..., 0], g[..., 1]) for g in gradient)
    n = plane_normals(fan, points_mm)
    ny, nz = n[..., 1] / n[..., 0], n[..., 2] / n[..., 0]
    along_y, row_y = uy - ux * ny, vy - vx * ny
    along_z, row_z = uz - ux * nz, vz - vx * nz
    area = ux * vy - uy * vx
    return Scale(
        np.hypot(vy, vx) / np.abs(area),
        np.hypot(uy, ux) / np.abs(area),
        along_z - along_y * row_z / row_y,
        np.abs((n[..., 0] * vy - n[..., 1] * vx) / area),
    )


def plane_normals(fan: LaserFan, points_mm: Floats) -> Floats:
    """Return unit normals, towards +X, of the fan's planes through points; shape of `points_mm`."""
    normals = np.cross(points_mm - fan.projector_mm, fan.line_axis)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    towards: Floats = normals * np.where(normals[..., :1] < 0.0, -1.0, 1.0)
    return towards


def middle_y_mm(camera: Camera) -> float:
    """Return the belt Y at which the plan is made: where the image's middle sees the belt."""
    ray = camera.ray(0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1))
    return float(camera.centre_mm[1] - camera.centre_mm[2] / ray[2] * ray[1])


def plane_points(fan: LaserFan, y_mm: float, z_mm: Floats) -> Floats:
    """Return where every plane is at one Y and some heights.

    Parameters
    ----------
    fan : LaserFan
        N planes.
    y_mm : float
        Belt Y.
    z_mm : ndarray, shape (M,)
        Heights.

    Returns
    -------
    ndarray, shape (M, N, 3)
        Belt frame, mm.
    """
    x = fan.x_mm(y_mm, z_mm)
    return np.stack([x, np.full_like(x, y_mm), np.broadcast_to(z_mm[:, None], x.shape)], axis=-1)


def in_view(camera: Camera, points_mm: Floats) -> NDArray[np.bool_]:
    """Say which points lie in the image."""
    pixels = camera.project(points_mm)
    size = np.array([camera.width_px, camera.height_px])
    with np.errstate(invalid="ignore"):
        inside = (pixels > -0.5) & (pixels < size - 0.5)
    return inside[..., 0] & inside[..., 1]


def highest_in_view_mm(camera: Camera, fan: LaserFan, y_mm: float) -> Floats:
    """Return for each plane the height up to which it stays in the image.

    Parameters
    ----------
    camera, fan
        The rig.
    y_mm : float
        Belt Y.

    Returns
    -------
    ndarray, shape (N,)
        mm; NaN for a plane that is not in view on the belt. At most 95 % of the way up to the lower one of
        camera and projector; found to 1/4000 of that.
    """
    ceiling = 0.95 * min(float(camera.centre_mm[2]), float(fan.projector_mm[2]))
    heights = np.linspace(0.0, ceiling, _RANGE_STEPS)
    seen = in_view(camera, plane_points(fan, y_mm, heights))
    leaves = np.argmin(np.vstack([seen, np.zeros((1, fan.count), dtype=bool)]), axis=0)
    return np.where(leaves > 0, heights[np.maximum(leaves, 1) - 1], np.nan)


def meeting_height_mm(
    camera: Camera, fan: LaserFan, own_x_mm: Floats, other_x_mm: Floats, y_mm: float
) -> Floats:
    """Return the height at which a stripe appears where another one lies on the belt.

    The camera's ray through the other stripe's place on the belt meets the stripe's own plane there. For a
    camera straight above and a projector beside it at the same height H and distance B, two stripes a
    spacing s apart on the belt: s H / (B + s).

    Parameters
    ----------
    camera, fan
        The rig.
    own_x_mm, other_x_mm : ndarray, shape S
        Belt X of both at `y_mm`.
    y_mm : float
        Belt Y.

    Returns
    -------
    ndarray, shape S
        mm; NaN where they meet nowhere between belt and camera.
    """
    own, other = (np.stack([x, np.full_like(x, y_mm), np.zeros_like(x)], -1) for x in (own_x_mm, other_x_mm))
    normals = plane_normals(fan, own)
    ray = other - camera.centre_mm
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.sum(normals * (fan.projector_mm - camera.centre_mm), -1) / np.sum(normals * ray, -1)
    height = camera.centre_mm[2] + reach * ray[..., 2]
    return np.where((height > 0.0) & (height < camera.centre_mm[2]), height, np.nan)


def spacing_heights_mm(camera: Camera, fan: LaserFan, y_mm: float) -> Floats:
    """Return for each stripe the height at which it appears on its neighbour's place on the belt.

    Below it, order alone tells the stripes apart even in a row that shows one of them. Shape (N,), mm; NaN
    for the last one on the side that heights displace to.
    """
    x = fan.x_mm(y_mm, 0.0)
    found = np.full(fan.count, np.nan)
    if fan.count > 1:
        up = meeting_height_mm(camera, fan, x[:-1], x[1:], y_mm)
        down = meeting_height_mm(camera, fan, x[1:], x[:-1], y_mm)
        found[:-1] = up
        found[1:] = np.fmin(found[1:], down)
    return found


def steepest_slopes_deg(camera: Camera, fan: LaserFan, points_mm: Floats) -> Floats:
    """Return the steepest slopes that are still lit and still seen.

    A surface that rises by the angle α towards a unit direction e on the belt has the normal
    (−e sin α, cos α); it faces a place that lies in the direction (h, z) from it while
    tan α < z / (h · e), and always where h · e ≤ 0. Both the projector and the camera must be faced. Holds
    for a slope by itself; what stands beside it may shade it as well.

    Parameters
    ----------
    camera, fan
        The rig.
    points_mm : ndarray, shape S + (3,)
        Belt frame.

    Returns
    -------
    ndarray, shape S + (4,)
        Degrees for surfaces that rise towards +X, −X, +Y, −Y; 90 where a wall is lit and seen.
    """
    limits = []
    for place in (camera.centre_mm, fan.projector_mm):
        to = place - points_mm
        towards = np.stack([to[..., 0], -to[..., 0], to[..., 1], -to[..., 1]], axis=-1)
        limits.append(np.rad2deg(np.arctan2(to[..., 2:], np.maximum(towards, 0.0))))
    return np.minimum(limits[0], limits[1])
