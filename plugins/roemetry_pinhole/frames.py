"""What follows from a calibration's parameters: the belt frame, the view, and the rest lines."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from roemetry.records.arrays import Floats
from roemetry.records.view import View
from roemetry_pinhole.equations import ON_BELT, StripePoints, stripe_rows
from roemetry_pinhole.geometry import CAMERA, Geometry, Unknowns

METHOD = "pinhole-plane"

_FAN_RMS_MAX_MM = 5.0
_REST_DEGREE_MAX = 7
_REST_OFF_MAX_PX = 0.002
_REST_ROUNDS = 30
_PLANES_STD_MM = 0.05
_PROJECTOR_Y_STD_MM = 20.0
"""How far a projector stands beside the camera's own plane, as rigs are built."""


def belt_pose(belt: Floats) -> Floats:
    """Give T_belt_camera (4, 4) of the belt plane (3,) b·X = 1 in the camera's frame, 1/mm.

    Z is up from the belt; X lies along the camera's x, as far as the belt allows; the origin is where the
    optical axis meets the belt.
    """
    # in single numbers: this is done for every frame, and small arrays take twenty times as long
    a, b, c = belt.tolist()
    size = math.sqrt(a * a + b * b + c * c)
    u, v, w = -a / size, -b / size, -c / size
    across = math.sqrt(v * v + w * w)
    # X: (1, 0, 0) less its part along up; Y: up × X
    x = (across, -u * v / across, -u * w / across)
    y = (0.0, w / across, -v / across)
    away = 1.0 / c
    return np.array(
        [
            [*x, -x[2] * away],
            [*y, -y[2] * away],
            [u, v, w, -w * away],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def camera_of(parameters: Mapping[str, Floats]) -> Floats:
    """Give (12,) focal lengths, principal point and the lens's coefficients."""
    return np.concatenate([parameters["focal_px"], parameters["principal_px"], parameters["distortion"]])


def view_of(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> View:
    """Give camera and planes of light in the belt frame."""
    pose = belt_pose(parameters["belt_per_mm"])
    focal, middle = parameters["focal_px"], parameters["principal_px"]
    planes = planes_in_belt_frame(parameters["planes_per_mm"], pose)
    return View(
        image_size=image_size,
        camera_matrix=np.array([[focal[0], 0.0, middle[0]], [0.0, focal[1], middle[1]], [0.0, 0.0, 1.0]]),
        T_belt_camera=pose,
        planes=planes,
        distortion=parameters["distortion"],
        projector_mm=projector_of(planes),
    )


def planes_in_belt_frame(planes: Floats, pose: Floats) -> Floats:
    """Give (stripe, 4) n, d with n·X = d, belt frame, mm, normals towards +X, from (stripe, 3) p·X = 1."""
    size = np.sqrt((planes**2).sum(axis=1))
    normal = (planes / size[:, None]) @ pose[:3, :3].T
    distance = 1.0 / size + normal @ pose[:3, 3]
    sign = np.where(normal[:, 0] < 0, -1.0, 1.0)
    return np.column_stack([normal, distance]) * sign[:, None]


def parameters_of(geometry: Geometry, *, travel: bool) -> dict[str, Floats]:
    """Give the calibration file's parameters."""
    found = {
        "focal_px": geometry.camera[:2],
        "principal_px": geometry.camera[2:4],
        "distortion": geometry.camera[4:],
        "planes_per_mm": geometry.planes,
        "belt_per_mm": geometry.belt,
    }
    return found | ({"travel_mm_per_count": geometry.travel} if travel else {})


def covariance_of(covariance: Floats, unknowns: Unknowns, *, travel: bool) -> Floats:
    """Give the covariance of `parameters_of` from that of the unknowns; 0 for what was held fixed."""
    at = np.concatenate([unknowns.camera, unknowns.planes.ravel(), unknowns.belt])
    if travel:
        at = np.concatenate([at, unknowns.travel])
    known = covariance[np.ix_(np.maximum(at, 0), np.maximum(at, 0))]
    free = at >= 0
    return np.where(free[:, None] & free[None, :], known, 0.0)


def lines_at_height(parameters: Mapping[str, Floats], row_px: Floats, z_mm: float) -> Floats:
    """Give (stripe, row) where each stripe lies on a level z_mm above the belt, px; NaN outside the lens."""
    belt = parameters["belt_per_mm"]
    planes = parameters["planes_per_mm"]
    none = np.empty((0, 3))
    level = belt / (1.0 - z_mm * np.sqrt(belt @ belt))
    camera = camera_of(parameters)
    geometry = Geometry(camera, np.empty((0, 3, 3)), none, planes, level, np.zeros(3))
    fixed = np.full((len(planes), 3), -1)
    unknowns = Unknowns(np.full(CAMERA, -1), fixed, fixed[0], fixed[0], np.empty((0, 6), np.int64))
    stripe, row = np.indices((len(planes), row_px.size))
    rows = np.ravel(row_px[row])
    # of the lens without distortion the place is in closed form: a start
    line = (planes - level)[stripe.ravel()]
    y = (rows - camera[3]) / camera[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = camera[2] - camera[0] * (line[:, 1] * y + line[:, 2]) / line[:, 0]
    zero = np.zeros(x.size)
    pose = np.full(x.size, ON_BELT)
    for _ in range(_REST_ROUNDS):
        points = StripePoints(pose, stripe.ravel(), x, rows, zero + 1.0, zero)
        off = stripe_rows(geometry, unknowns, points).residual
        x = x - off
        if not np.nanmax(np.abs(off), initial=0.0) > 1e-10:
            break
    x = np.where(np.abs(off) < 1e-6, x, np.nan)
    return x.reshape(stripe.shape)


def rest_polynomials(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> Floats:
    """Give (stripe, coefficient) rest lines as polynomials in the row from the middle one, px."""
    rows = np.linspace(0.0, image_size[0] - 1.0, 65)
    lines = lines_at_height(parameters, rows, 0.0)
    inside = (lines > -0.1 * image_size[1]) & (lines < 1.1 * image_size[1])
    half = max((image_size[0] - 1) / 2.0, 1.0)
    at = (rows - half) / half
    found = np.zeros((len(lines), 2))
    for degree in range(1, _REST_DEGREE_MAX + 1):
        powers = at[:, None] ** np.arange(degree + 1)
        found = np.full((len(lines), degree + 1), np.nan)
        worst = 0.0
        for stripe, line in enumerate(lines):
            use = inside[stripe]
            if use.sum() <= degree + 1:
                continue
            found[stripe] = np.linalg.lstsq(powers[use], line[use], rcond=None)[0]
            worst = max(worst, float(np.abs(powers[use] @ found[stripe] - line[use]).max()))
        found /= half ** np.arange(degree + 1)
        if worst <= _REST_OFF_MAX_PX:
            break
    return found


def displacements(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> Floats:
    """Give (stripe,) shift along +x per height at belt level in the middle row, px/mm."""
    middle = np.array([(image_size[0] - 1) / 2.0])
    step = 1e-3 / float(np.sqrt((parameters["belt_per_mm"] ** 2).sum()))
    high, low = (lines_at_height(parameters, middle, z)[:, 0] for z in (step, -step))
    return np.asarray((high - low) / (2.0 * step))


def projector_of(planes: Floats) -> Floats:
    """Give the point that all planes share; NaN if there is none.

    Planes that fan out from a point meet very nearly in a line through it, and say nearly nothing of where on
    that line it is: noise alone would move it by hundreds of millimetres. So Y = 0, beside the optical axis,
    is one more observation; it decides only where the planes leave Y open.
    """
    if len(planes) < 3:
        return np.full(3, np.nan)
    rows = np.vstack([planes[:, :3], [[0.0, _PLANES_STD_MM / _PROJECTOR_Y_STD_MM, 0.0]]])
    point = np.linalg.lstsq(rows, np.append(planes[:, 3], 0.0), rcond=1e-12)[0]
    off = planes[:, :3] @ point - planes[:, 3]
    return point if np.sqrt((off**2).mean()) < _FAN_RMS_MAX_MM else np.full(3, np.nan)
