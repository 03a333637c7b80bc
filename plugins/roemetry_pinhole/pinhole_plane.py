"""The calibration file's parameters, what follows from them, and triangulation by them.

Model (Hartley and Zisserman 2004, chapters 6 and 7). A peak's pixel, undistorted, is a ray of the camera; it
meets its stripe's plane of light p·X = 1 at X = ray / (p·ray), which goes to the belt's frame: Z up from the
belt b·X = 1, X along the camera's x as far as the belt allows, the origin where the optical axis meets the
belt. Rest lines are where planes of light and belt meet, as polynomials in the row.

A peak's noise moves its point along the plane of light; the calibration's own errors move all points
together. No point is given where the lens folds the image over.

It fails where a ray runs along its plane of light: depth is then 1/0, and noise grows without bounds before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.view import View
from roemetry.stages import Capabilities, StageOptions, Triangulator
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.lens import lens_from, undistorted_place
from roemetry_pinhole.geometry import ON_BELT, Geometry, StripePoints, Unknowns, rays, stripe_residuals

METHOD = "pinhole-plane"

_FAN_RMS_MAX_MM = 5.0  # planes that pass a common point by more than this come from no one projector, mm
_REST_DEGREE_MAX = 7  # of the polynomial of a rest line: higher ones swing between their supports
_REST_OFF_MAX_PX = 0.002
"""The lowest degree that stays this near to the exact line is taken: a tenth of the best peak's noise."""
_REST_ROUNDS = 30  # Newton steps to a rest line; a place that needs more is none
_PLANES_STD_MM = 0.05
"""How far planes that were calibrated pass their common point, as weighed against the next number."""
_PROJECTOR_Y_STD_MM = 20.0  # how far a projector stands beside the camera's own plane, as rigs are built


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
    return np.array([[*x, -x[2] * away], [*y, -y[2] * away], [u, v, w, -w * away], [0.0, 0.0, 0.0, 1.0]])


def camera_of(parameters: Mapping[str, Floats]) -> Floats:
    """Give (12,) focal lengths, principal point and the lens's coefficients."""
    return np.concatenate([parameters["focal_px"], parameters["principal_px"], parameters["distortion"]])


def camera_matrix(camera: Floats) -> Floats:
    """Give (3, 3) the matrix of a camera's focal lengths and principal point, its first four numbers."""
    return np.array([[camera[0], 0.0, camera[2]], [0.0, camera[1], camera[3]], [0.0, 0.0, 1.0]])


def view_of(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> View:
    """Give camera and planes of light in the belt frame."""
    pose = belt_pose(parameters["belt_per_mm"])
    planes = planes_in_belt_frame(parameters["planes_per_mm"], pose)
    camera = camera_of(parameters)
    return View(image_size, camera_matrix(camera), pose, planes, camera[4:], projector_of(planes))


def derived(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> dict[str, Any]:
    """Give a calibration's parameters, and what it holds beside them and follows from them."""
    return {
        "parameters": parameters,
        "rest_px": rest_polynomials(parameters, image_size),
        "displacement_px_per_mm": displacements(parameters, image_size),
        "view": view_of(parameters, image_size),
    }


def planes_in_belt_frame(planes: Floats, pose: Floats) -> Floats:
    """Give (stripe, 4) n, d with n·X = d, belt frame, mm, normals towards +X, from (stripe, 3) p·X = 1."""
    size = np.sqrt((planes**2).sum(axis=1))
    normal = (planes / size[:, None]) @ pose[:3, :3].T
    # 1/|p| is the distance from the camera's centre
    distance = 1.0 / size + normal @ pose[:3, 3]
    sign = np.where(normal[:, 0] < 0, -1.0, 1.0)
    return np.column_stack([normal, distance]) * sign[:, None]


def points_of(parameters: Mapping[str, Floats], stripe: Integers, x_px: Floats, row_px: Floats) -> Floats:
    """Give (point, 3) where peaks lie in the belt frame, mm."""
    ray = rays(camera_of(parameters), np.column_stack([x_px, row_px]))
    pose = belt_pose(parameters["belt_per_mm"])
    with np.errstate(divide="ignore"):
        # X = ray / (p·ray)
        depth = 1.0 / (ray * parameters["planes_per_mm"][stripe]).sum(axis=1)
    return np.asarray((ray * depth[:, None]) @ pose[:3, :3].T + pose[:3, 3])


def flat(parameters: Mapping[str, Floats]) -> Floats:
    """Give all parameters in the order of the covariance."""
    return np.concatenate([np.ravel(array) for array in parameters.values()])


def by_parameter(calibration: Calibration, of: Callable[[Mapping[str, Floats]], Floats]) -> Floats:
    """Give (n, …) central differences of what `of` says, by each of a calibration's uncertain parameters.

    Steps are a tenth of the parameter's standard uncertainty; of what is held fixed the derivative is 0.
    """
    std, known = np.sqrt(np.diag(calibration.covariance)), calibration.parameters
    ends = np.cumsum([array.size for array in known.values()])[:-1]

    def moved(number: int, by: float) -> Floats:
        """Give what `of` says of the calibration with one parameter moved."""
        values = flat(known)
        values[number] += by
        parts = zip(known.items(), np.split(values, ends), strict=True)
        return of({name: part.reshape(array.shape) for (name, array), part in parts})

    found = np.zeros((std.size, *np.shape(of(known))))
    for number in np.flatnonzero(std > 0).tolist():
        step = 0.1 * float(std[number])
        up, down = (moved(number, sign * step) for sign in (1.0, -1.0))
        found[number] = (up - down) / (0.2 * std[number])
    return found


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
    belt, planes = parameters["belt_per_mm"], parameters["planes_per_mm"]
    # the belt moved up by z: b·X = 1 − z |b|
    level = belt / (1.0 - z_mm * np.sqrt(belt @ belt))
    camera = camera_of(parameters)
    geometry = Geometry(camera, np.empty((0, 3, 3)), np.empty((0, 3)), planes, level)
    stripe, row = (index.ravel() for index in np.indices((len(planes), row_px.size)))
    # of the lens without distortion the place is in closed form: a start
    line = (planes - level)[stripe]
    y = (row_px[row] - camera[3]) / camera[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = camera[2] - camera[0] * (line[:, 1] * y + line[:, 2]) / line[:, 0]
    zero, pose = np.zeros(x.size), np.full(x.size, ON_BELT)
    for _ in range(_REST_ROUNDS):
        off = stripe_residuals(geometry, StripePoints(pose, stripe, x, row_px[row], zero + 1.0, zero))
        x = x - off
        if not np.nanmax(np.abs(off), initial=0.0) > 1e-10:
            break
    return np.where(np.abs(off) < 1e-6, x, np.nan).reshape(len(planes), -1)


def rest_polynomials(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> Floats:
    """Give (stripe, coefficient) rest lines as polynomials in the row from the middle one, px."""
    rows = np.linspace(0.0, image_size[0] - 1.0, 65)
    lines = lines_at_height(parameters, rows, 0.0)
    # far outside a polynomial would bend to what is not seen
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
        # from shares of half the rows to px
        found /= half ** np.arange(degree + 1)
        if worst <= _REST_OFF_MAX_PX:
            break
    return found


def displacements(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> Floats:
    """Give (stripe,) shift along +x per height at belt level in the middle row, px/mm."""
    middle = np.array([(image_size[0] - 1) / 2.0])
    step = 1e-3 / float(np.sqrt((parameters["belt_per_mm"] ** 2).sum()))
    # central difference over a thousandth of the distance
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


def check_size(stripes: StripeMap, calibration: Calibration, called: str = "stripes") -> None:
    """Refuse a map of another number of stripes or of rows than the calibration; StageError says which."""
    if stripes.stripe_count != calibration.stripe_count:
        raise StageError(
            f"{stripes.stripe_count} {called} are labelled, the calibration has {calibration.stripe_count}"
        )
    if stripes.rows != calibration.image_size[0]:
        raise StageError(
            f"the {called} have {stripes.rows} rows, the calibration's images {calibration.image_size[0]}"
        )


class PinholePlane(Triangulator[StageOptions]):
    """Each peak's ray, undistorted, meets its stripe's plane of light; the point goes to the belt frame.

    `height_std_mm` is what the peak's own noise does to Z. What the calibration contributes is common to all
    points: it is in the calibration's covariance, and a redrawn calibration moves all points together.
    """

    capabilities = Capabilities(
        height_tolerance_mm=0.01, fixture="roemetry_pinhole.conformance:calibration_of"
    )

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give a slice for each stripe, with a point for each image row; StageError as by `check_size`."""
        check_size(stripes, calibration)
        parameters = calibration.parameters
        pose = belt_pose(parameters["belt_per_mm"])
        planes = parameters["planes_per_mm"]
        xyz_mm, height_std_mm, lost = lift_stripes(
            stripes.x_px, stripes.x_std_px, camera_of(parameters), planes, pose[:3, :3], pose[:3, 3]
        )
        count, rows = stripes.x_px.shape
        product, seen = stripes.product, stripes.seen
        if lost:
            known = ~np.isnan(xyz_mm[..., 0])
            product, seen = np.where(known, product, -1).astype(np.int16), seen & known
        return Profiles(
            xyz_mm=xyz_mm,
            product=product,
            seen=seen,
            x_px=stripes.x_px,
            row_px=np.broadcast_to(np.arange(rows, dtype=np.float64), (count, rows)),
            height_std_mm=height_std_mm,
            stripe=np.arange(count),
            frame=np.zeros(count, np.int64),
            plane=planes_in_belt_frame(planes, pose),
        )

    def moved(self, calibration: Calibration, alignment: Alignment) -> Calibration:
        """Give the calibration of a camera turned and zoomed; the lens stays what it is.

        In the camera's frame, points turn by R: planes p·X = 1 become R p. A single plane that has been
        shifted is (1 + a) p. To the covariance is added that of the motion, by the parameters' numerical
        derivatives.
        """
        before, size = calibration.parameters, calibration.image_size
        parameters, covariance = turned(before, alignment.motion), calibration.covariance
        if alignment.covariance.any():
            covariance = covariance + by_motion(before, alignment.covariance)
        if alignment.planes_px.any():
            per_px = shifts_per_px(parameters, size)
            parameters, covariance = with_planes_shifted(
                parameters, covariance, "planes_per_mm", per_px, alignment.planes_px, alignment.planes_std_px
            )
        return replace(calibration, covariance=covariance, **derived(parameters, size))

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's own parameters, so that a redrawn one moves it."""
        return view_of(calibration.parameters, calibration.image_size)


_MOTION_STEPS = (1e-2, 1e-5, 1e-5, 1e-5)
"""Steps of numerical derivatives for shift (px), roll (rad), zoom and tilt (rad): all some 0.01 px."""
_PLANE_STEP = 1e-5  # the same of a plane's share: some 0.01 px


def turned(parameters: Mapping[str, Floats], motion: Floats) -> dict[str, Floats]:
    """Give the parameters of a camera that has moved; `motion` as in `Alignment`."""
    rotation = rotation_of(motion, parameters["focal_px"][0])
    ways = {name: parameters[name] @ rotation.T for name in _WAYS if name in parameters}
    return {**parameters, "focal_px": parameters["focal_px"] * (1.0 + motion[2]), **ways}


_WAYS = ("planes_per_mm", "across_planes_per_mm", "belt_per_mm", "travel_mm_per_count")
"""Parameters (…, 3) that turn with the camera."""


def rotation_of(motion: Floats, focal_px: float) -> Floats:
    """Give (3, 3) what the camera's turn does to what it looks at, in its own frame."""
    import cv2

    pan_px, roll, _, tilt = motion
    # a pan is a turn about y by its px over the focal length
    return np.asarray(cv2.Rodrigues(np.array([tilt, pan_px / focal_px, roll]))[0], np.float64)


def by_motion(parameters: Mapping[str, Floats], covariance: Floats) -> Floats:
    """Give what a motion's covariance (4, 4) adds to that of the parameters, by numerical derivatives."""
    steps = np.diag(_MOTION_STEPS)
    moves = np.array([(flat(turned(parameters, step)) - flat(parameters)) / step.sum() for step in steps])
    return np.asarray(moves.T @ covariance @ moves)


def shifts_per_px(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> Floats:
    """Give (stripe, 3) what each plane changes by when it is shifted so that its rest line moves by 1 px."""
    planes, middle = parameters["planes_per_mm"], np.array([0.5 * (image_size[0] - 1)])
    there, here = (
        lines_at_height({**parameters, "planes_per_mm": planes * (1.0 + step)}, middle, 0.0)
        for step in (_PLANE_STEP, 0.0)
    )
    # a plane's share, by how far a step of it moves the line
    return np.asarray(planes * _PLANE_STEP / (there - here))


def with_planes_shifted(
    parameters: Mapping[str, Floats], covariance: Floats, name: str, per_px: Floats, shift_px: Floats,
    std_px: float,
) -> tuple[dict[str, Floats], Floats]:  # fmt: skip
    """Give parameters and covariance with planes (stripe, 3) shifted by (stripe,) px; 0: they are left."""
    covariance = covariance.copy()
    names = list(parameters)
    first = sum(parameters[one].size for one in names[: names.index(name)])
    for stripe in np.flatnonzero(shift_px):
        own = np.s_[first + 3 * stripe : first + 3 * stripe + 3]
        covariance[own, own] += std_px**2 * np.outer(per_px[stripe], per_px[stripe])
    return {**parameters, name: parameters[name] + shift_px[:, None] * per_px}, covariance


_STEP_END = 3e-6
"""Over the focal length: Newton's next step would be some 1e-12, far below what a peak is known to."""


@float_kernel
def lift_stripes(
    x_px: Floats, x_std_px: Floats, camera: Floats, planes: Floats, rotation: Floats, shift: Floats
) -> tuple[Floats, Floats, int]:
    """Give points in the belt frame and what the peaks' noise does to their heights.

    Parameters
    ----------
    x_px, x_std_px
        (stripe, row) peaks and their standard uncertainty, px; NaN where there is none.
    camera
        (12,) fx, fy, cx, cy, px; k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's model.
    planes
        (stripe, 3) p with p·X = 1 in the camera's frame, 1/mm.
    rotation, shift
        (3, 3) and (3,) to the belt frame from the camera's, mm.

    Returns
    -------
    tuple
        (stripe, row, 3) points, mm, and (stripe, row) standard uncertainty of Z, mm; NaN where there is none
        or the ray has no place in the straight image; and how many have none.
    """
    stripes, rows = x_px.shape
    points = np.full((stripes, rows, 3), np.nan)
    height_std = np.full((stripes, rows), np.nan)
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    lens = lens_from(camera, 4)
    distorts, lost = False, 0
    for k in range(4, 12):
        distorts = distorts or camera[k] != 0.0
    for s in range(stripes):
        off_x = off_y = gain_x = gain_y = 0.0  # undistorted − distorted, and its change from row to row
        followed = 0
        for r in range(rows):
            seen = x_px[s, r]
            if math.isnan(seen):
                followed = 0
                continue
            bent_x, bent_y = (seen - cx) / fx, (r - cy) / fy
            x, y = bent_x, bent_y
            xx, xy, yy, determinant = 1.0, 0.0, 1.0, 1.0
            if distorts:
                # Newton's start: the row above, moved on as it moved
                if followed > 0:
                    x, y = x + off_x, y + off_y
                    if followed > 1:
                        x, y = x + gain_x, y + gain_y
                x, y, xx, xy, yy, good = undistorted_place(bent_x, bent_y, x, y, lens, _STEP_END)
                determinant = xx * yy - xy * xy
                # the lens folds the image there: two places are seen at one pixel
                if not (good and determinant > 0.0 and xx + yy > 0.0):
                    followed = 0
                    lost += 1
                    continue
                new_x, new_y = x - bent_x, y - bent_y
                gain_x, gain_y = new_x - off_x, new_y - off_y
                off_x, off_y = new_x, new_y
                followed += 1
            p, q, n = planes[s, 0], planes[s, 1], planes[s, 2]
            depth = 1.0 / (p * x + q * y + n)
            for k in range(3):
                points[s, r, k] = shift[k] + depth * (
                    rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2]
                )
            # the peak moves along the row: (x, y) by the inverse slope of the lens, then along the plane
            move_x, move_y = yy / (determinant * fx), -xy / (determinant * fx)
            move_z = -(p * move_x + q * move_y) * depth
            rise = rotation[2, 0] * (move_x + x * move_z) + rotation[2, 1] * (move_y + y * move_z)
            height_std[s, r] = abs(depth * (rise + rotation[2, 2] * move_z)) * x_std_px[s, r]
    return points, height_std, lost
