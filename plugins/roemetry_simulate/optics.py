"""Camera, projector and lens: pixels to rays and back, planes of light, the blur beside the focus.

The camera is a pinhole with OpenCV's distortion x' = x r + 2 p1 x y + p2 (r² + 2 x²), y' alike, with the
radial factor r = 1 + k1 r² + k2 r⁴ + k3 r⁶, undone by Newton's method. The projector is a fan of planes
n·X = d through one point; across a plane the light is a Gaussian whose width grows beside its waist. Away
from its focus a thin lens blurs by a disc of the diameter

    c(z) = f² / (N (s − f)) · |z − s| / z

for the focal length f, f-number N, focus s and depth z; here a Gaussian of a quarter of it, the deviation of
an evenly lit disc. Left out: planes that are bent, vignetting, aberrations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roemetry.records.cones import meet_cones
from roemetry.records.view import distort, undistort
from roemetry_kernels.compiling import kernel
from roemetry_kernels.lens import lens_from, undistorted_place
from roemetry_simulate.raycast import AnyBody, first_hit
from roemetry_simulate.solid import Solid

Floats = NDArray[np.float64]

_LEVELS = 8
"""Amounts of blur between the least and the largest of an image; between two of them it is interpolated."""
_EDGE_STEPS = 33
"""Points along each border of the image at which the view is looked at."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera whose lens may distort.

    - `width_px`, `height_px`: Image size.
    - `pixel_size_mm`: Pitch of the square pixels on the sensor.
    - `focal_length_mm`: Distance from the pinhole to the sensor.
    - `T_belt_camera`, shape (4, 4): Pose "to belt from camera", millimetres. Camera axes: x right, y down, z
      forward.
    - `principal_point_px`: Where the optical axis meets the image; None is the image centre
      ((w - 1)/2, (h - 1)/2).
    - `distortion`: k1, k2, p1, p2, k3 of OpenCV's model; all zero is a perfect lens.
    """

    width_px: int
    height_px: int
    pixel_size_mm: float
    focal_length_mm: float
    T_belt_camera: Floats
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if min(self.width_px, self.height_px) < 1 or min(self.pixel_size_mm, self.focal_length_mm) <= 0:
            raise ValueError("a camera needs a positive image size, pixel size and focal length")
        pose = np.array(self.T_belt_camera, dtype=np.float64)
        if pose.shape != (4, 4):
            raise ValueError(f"T_belt_camera must have shape (4, 4), not {pose.shape}")
        if not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9):
            raise ValueError("T_belt_camera does not hold a rotation")
        pose.flags.writeable = False
        object.__setattr__(self, "T_belt_camera", pose)
        if self.principal_point_px is None:
            centre = ((self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0)
            object.__setattr__(self, "principal_point_px", centre)

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels."""
        return self.focal_length_mm / self.pixel_size_mm

    @property
    def centre_mm(self) -> Floats:
        """Pinhole in the belt frame, shape (3,), millimetres."""
        return self.T_belt_camera[:3, 3]

    @property
    def rotation(self) -> Floats:
        """Rotation "to belt from camera", shape (3, 3)."""
        return self.T_belt_camera[:3, :3]

    @property
    def principal_px(self) -> Floats:
        """Principal point, shape (2,), pixels."""
        return np.asarray(self.principal_point_px, dtype=np.float64)

    @property
    def distorts(self) -> bool:
        """Whether the lens distorts at all."""
        return any(value != 0.0 for value in self.distortion)

    def packed(self) -> Floats:
        """Return what the kernels take: pinhole, principal point, focal length (px), 1 or 0, lens (8,)."""
        lens = [float(self.distorts), *self.distortion, 0.0, 0.0, 0.0]
        return np.array([*self.centre_mm, *self.principal_px, self.focal_length_px, *lens])

    def ray(self, x_px: ArrayLike, y_px: ArrayLike) -> Floats:
        """Unit directions in the belt frame, S + (3,), of the rays through image points (px) of shape S."""
        x, y = np.broadcast_arrays(np.asarray(x_px, dtype=np.float64), np.asarray(y_px, dtype=np.float64))
        cx, cy = self.principal_px
        # pinhole coordinates: (x − cx) / f, (y − cy) / f, at depth 1
        x, y = (x - cx) / self.focal_length_px, (y - cy) / self.focal_length_px
        if self.distorts:
            places = undistort(np.stack([x.ravel(), y.ravel()], axis=1), np.array(self.distortion))
            x, y = places[:, 0].reshape(x.shape), places[:, 1].reshape(y.shape)
        direction = np.stack([x, y, np.ones_like(x)], axis=-1)
        direction = direction @ self.rotation.T
        unit: Floats = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        return unit

    def project(self, points_mm: ArrayLike) -> Floats:
        """Image points (px), shape (..., 2), of belt points (mm), shape (..., 3); NaN behind the camera."""
        points = (np.asarray(points_mm, dtype=np.float64) - self.centre_mm) @ self.rotation
        # behind the camera a projection would come out mirrored
        depth = np.where(points[..., 2:] > 0.0, points[..., 2:], np.nan)
        plane = points[..., :2] / depth
        if self.distorts:
            plane = distort(plane.reshape(-1, 2), np.array(self.distortion)).reshape(plane.shape)
        pixels: Floats = plane * self.focal_length_px + self.principal_px
        return pixels


def looking_down(
    width_px: int, height_px: int, *, pixel_size_mm: float, focal_length_mm: float, distance_mm: float,
    tilt_x_deg: float = 0.0, tilt_y_deg: float = 0.0,
) -> Camera:  # fmt: skip
    """Return a camera above the belt whose optical axis meets the belt at the origin.

    The tilts turn it about its own x axis, then about its own y axis; zero looks straight down, with image
    x along belt X and image y against belt Y.
    """
    # image y runs against belt Y, so the camera looks down without mirroring
    down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    ax, ay = np.deg2rad([tilt_x_deg, tilt_y_deg])
    about_x = np.array([[1, 0, 0], [0, np.cos(ax), -np.sin(ax)], [0, np.sin(ax), np.cos(ax)]])
    about_y = np.array([[np.cos(ay), 0, np.sin(ay)], [0, 1, 0], [-np.sin(ay), 0, np.cos(ay)]])
    rotation = down @ about_x @ about_y
    pose = np.eye(4)
    pose[:3, :3] = rotation
    # back along its own axis from the origin
    pose[:3, 3] = -distance_mm * rotation[:, 2]
    return Camera(width_px, height_px, pixel_size_mm, focal_length_mm, pose)


@dataclass(frozen=True, eq=False)
class LaserFan:
    """N planes of light through one projector point.

    - `projector_mm`, shape (3,): Where the light comes from, belt frame, millimetres.
    - `normals`, shape (N, 3): Unit normals n of the planes n·X = d in the belt frame, stripes ordered along
      belt X.
    - `offsets_mm`, shape (N,): Their d, millimetres.
    - `line_axis`, shape (3,): Unit direction which all planes share (the lines' run), belt frame.
    - `sigma_mm`: Standard deviation of the light's Gaussian profile across a plane, where it is thinnest.
    - `peak_grey`, shape (N,): Grey levels in a plane's middle on a white (albedo 1) surface that faces the
      projector.
    - `line_sigma_deg`: Gaussian fall of the power with the angle along the line.
    - `waist_distance_mm`, `divergence_mrad`: Where the planes are thinnest, from the projector, and how the
      standard deviation grows away from there: sqrt(sigma² + (divergence · (distance − waist))²). A plane
      that is wider is less bright.
    - `rows`, shape (M, 5): Planes n·X = d across the others, (n, d, 1), ordered along belt Y. Where there are
      any, light is a dot where two planes meet, the product of both profiles; (0, 5): the light is lines.
    - `across`: The second family of a grid, whose light adds to this one's; ordered against belt Y, as the
      image turned by 90° counter-clockwise shows it from left to right.
    - `halves`, shape (N, 4): Of circles, whose halves stand for planes: b of n·X = d + b |X − projector|,
      with an n that makes both sides' difference a distance, and the direction (3,) from axis to half.
      (0, 4): the light is in planes.
    """

    projector_mm: Floats
    normals: Floats
    offsets_mm: Floats
    line_axis: Floats
    sigma_mm: float
    peak_grey: Floats
    line_sigma_deg: float = 25.0
    waist_distance_mm: float = 0.0
    divergence_mrad: float = 0.0
    rows: Floats = field(default_factory=lambda: np.empty((0, 5)))
    across: LaserFan | None = None
    halves: Floats = field(default_factory=lambda: np.empty((0, 4)))

    def __post_init__(self) -> None:
        if self.sigma_mm <= 0.0 or self.line_sigma_deg <= 0.0:
            raise ValueError("a laser line needs a positive width and a positive fan angle")
        for name in ("projector_mm", "normals", "offsets_mm", "line_axis", "peak_grey"):
            value = np.array(getattr(self, name), dtype=np.float64)
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        count = len(self.normals)
        if self.normals.shape != (count, 3) or {self.offsets_mm.shape, self.peak_grey.shape} != {(count,)}:
            raise ValueError("normals must be (N, 3), offsets_mm and peak_grey (N,)")

    def packed(self) -> Floats:
        """Return what the kernels take: waist (mm), fall (rad), its distance (mm), divergence (rad)."""
        # tangents of small angles: mrad to rad
        fall, grows = np.deg2rad(self.line_sigma_deg), 1e-3 * self.divergence_mrad
        return np.array([self.sigma_mm, fall, self.waist_distance_mm, grows])

    @property
    def count(self) -> int:
        """Number of planes."""
        return len(self.normals)

    def rays(self) -> Floats:
        """Unit directions (N, M, 3) of the rays in whose middle dots are, away from the projector."""
        # the line in which two planes meet is square to both normals
        ways = np.cross(self.normals[:, None], self.rows[None, :, :3])
        # away from the projector, that is downwards
        ways *= -np.sign(ways[..., 2:])
        unit: Floats = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
        return unit

    def cones(self) -> Floats:
        """Give (N, 7) the halves of circles as `View.cones` has them."""
        # n is as long as 1 / sin of the half angle
        size = np.linalg.norm(self.normals, axis=1)
        side = np.sign(self.halves[:, 1:] @ self.halves[-1, 1:])
        angle = side * np.arcsin(1.0 / size)
        apex = np.broadcast_to(self.projector_mm, self.normals.shape)
        return np.column_stack([apex, -self.normals / size[:, None], angle])

    def distance_mm(self, points_mm: ArrayLike) -> Floats:
        """Signed distances n·X − d (mm), shape (..., N), of belt points, shape (..., 3), to all planes."""
        points = np.asarray(points_mm, dtype=np.float64)
        # distance from the cone, to first order: what |X − apex| takes off n·X
        distances: Floats = points @ self.normals.T - self.offsets_mm
        if len(self.halves):
            away = np.linalg.norm(points - self.projector_mm, axis=-1)
            distances = distances - away[..., None] * self.halves[:, 0]
        return distances

    def x_mm(self, y_mm: ArrayLike, z_mm: ArrayLike) -> Floats:
        """X of each plane (mm), shape S + (N,), at belt Y and Z (mm) that broadcast to one shape S."""
        y, z = np.broadcast_arrays(np.asarray(y_mm, dtype=np.float64), np.asarray(z_mm, dtype=np.float64))
        if len(self.halves):
            start = np.stack([np.zeros_like(y), y, z], axis=-1)[..., None, :]
            along = np.array([1.0, 0.0, 0.0])
            return np.asarray(meet_cones(start, along, self.cones(), self.halves[-1, 1:])[..., 0])
        rest = self.offsets_mm - y[..., None] * self.normals[:, 1] - z[..., None] * self.normals[:, 2]
        x: Floats = rest / self.normals[:, 0]
        return x


def fan_through(
    projector_mm: ArrayLike, belt_x_mm: ArrayLike, *, yaw_deg: float = 0.0, pitch_deg: float = 0.0,
    sigma_mm: float, peak_grey: ArrayLike, line_sigma_deg: float = 25.0,
) -> LaserFan:  # fmt: skip
    """Return the fan whose planes meet the belt's X axis at given places, increasing.

    The yaw turns the lines about Z, counter-clockwise seen from above (0 is parallel to Y), the pitch lifts
    their common direction out of the belt plane. Normals point towards +X; one `peak_grey` serves all
    planes.
    """
    projector = np.asarray(projector_mm, dtype=np.float64)
    lines_x = np.atleast_1d(np.asarray(belt_x_mm, dtype=np.float64))
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    axis = np.array([-np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    towards = np.stack([lines_x, np.zeros_like(lines_x), np.zeros_like(lines_x)], axis=-1) - projector
    # a plane holds the projector, the place on the belt and the lines' direction
    normals = np.cross(towards, axis)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    # towards +X, so that distances rise from left to right
    normals *= np.sign(normals[:, :1])
    peak = np.broadcast_to(np.asarray(peak_grey, dtype=np.float64), lines_x.shape)
    return LaserFan(projector, normals, normals @ projector, axis, sigma_mm, peak, line_sigma_deg)


def rows_through(fan: LaserFan, lines_y_mm: ArrayLike) -> Floats:
    """Return the `rows` of a fan: planes across its lines, level, that cross their run through the origin.

    `lines_y_mm`, increasing, are the crossings' distances from the origin along the run: Y of a fan that is
    not turned about Z.
    """
    axis = fan.line_axis
    # level direction of the lines on the belt, and the one square to it
    along = np.array([axis[0], axis[1], 0.0]) / np.hypot(axis[0], axis[1])
    across = np.array([along[1], -along[0], 0.0])
    normals = np.cross(across, np.outer(np.atleast_1d(lines_y_mm), along) - fan.projector_mm)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals *= np.sign(normals @ along)[:, None]
    return np.column_stack([normals, normals @ fan.projector_mm, np.ones(len(normals))])


def with_across(fan: LaserFan, lines_y_mm: ArrayLike) -> LaserFan:
    """Return the grid of a fan and of lines across it, which cross its lines' run at `lines_y_mm`."""
    # normals point the way in which the planes are ordered, as those of the fan itself do
    planes = -rows_through(fan, np.sort(np.atleast_1d(lines_y_mm))[::-1])
    axis = np.array([fan.line_axis[1], -fan.line_axis[0], 0.0])
    axis /= np.linalg.norm(axis)
    # one brightness for all: the lines across are the same light
    grey = np.full(len(planes), float(np.mean(fan.peak_grey)))
    across = replace(fan, normals=planes[:, :3], offsets_mm=planes[:, 3], line_axis=axis, peak_grey=grey)
    return replace(fan, across=across)


def turned(camera: Camera) -> Camera:
    """Return the camera whose image is this one's turned by 90° counter-clockwise."""
    (cx, cy), (k1, k2, p1, p2, k3) = camera.principal_px.tolist(), camera.distortion
    pose = camera.T_belt_camera.copy()
    # turned by 90°: new x is old y, new y is old −x
    pose[:3, :3] = np.column_stack([pose[:3, 1], -pose[:3, 0], pose[:3, 2]])
    # tangential coefficients turn with the axes; radial ones do not
    middle, lens = (cy, camera.width_px - 1.0 - cx), (k1, k2, -p2, p1, k3)
    sensor = camera.height_px, camera.width_px, camera.pixel_size_mm
    return Camera(*sensor, camera.focal_length_mm, pose, middle, lens)


def view_mm(camera: Camera, height_mm: float = 0.0) -> tuple[float, float, float, float]:
    """Return smallest and largest X, smallest and largest Y of the view at a height, along its border."""
    points = border_points_mm(camera, height_mm)
    x, y = points[:, 0], points[:, 1]
    return float(x.min()), float(x.max()), float(y.min()), float(y.max())


def border_px(camera: Camera) -> tuple[Floats, Floats]:
    """Return x and y of points along the image's border, px, shape (4 · steps,)."""
    # the border lies half a pixel outside the outermost pixels' middles
    along = np.linspace(0.0, 1.0, _EDGE_STEPS)
    x, y = along * camera.width_px - 0.5, along * camera.height_px - 0.5
    left, right = np.full_like(y, x[0]), np.full_like(y, x[-1])
    top, bottom = np.full_like(x, y[0]), np.full_like(x, y[-1])
    return np.concatenate([left, right, x, x]), np.concatenate([y, y, top, bottom])


def border_points_mm(camera: Camera, height_mm: float) -> Floats:
    """Where the rays of the image's border meet a level, shape (4 · steps, 3)."""
    rays = camera.ray(*border_px(camera))
    # along each ray to the level
    reach = (height_mm - camera.centre_mm[2]) / rays[:, 2]
    points: Floats = camera.centre_mm + reach[:, None] * rays
    return points


@dataclass(frozen=True)
class Focus:
    """Where the lens is focused (mm from the pinhole along the axis), and focal length over aperture."""

    distance_mm: float
    f_number: float


def blur_sigma_px(camera: Camera, focus: Focus, depth_mm: Floats) -> Floats:
    """Return the blur (deviation, px) at depths along the axis: a quarter of the disc's diameter."""
    f = camera.focal_length_mm
    # disc of the thin lens at the sensor, for the pinhole model's focal length
    circle_mm = f / focus.f_number * f / (focus.distance_mm - f) * np.abs(depth_mm / focus.distance_mm - 1.0)
    sigma: Floats = 0.25 * circle_mm * (focus.distance_mm / depth_mm) / camera.pixel_size_mm
    return sigma


def defocused(light: Floats, camera: Camera, focus: Focus, depth_mm: Floats) -> Floats:
    """Blur an image, shape (height, width), as its depths of the same shape ask for.

    Each pixel comes from images blurred by the two nearest of eight amounts.
    """
    sigma = blur_sigma_px(camera, focus, depth_mm)
    low, high = float(sigma.min()), float(sigma.max())
    # sharp everywhere
    if high <= 0.0:
        return light
    amounts = np.linspace(low, high, _LEVELS if high - low > 1e-3 else 1)
    stack = np.stack([blurred(light, float(amount)) for amount in amounts])
    if len(amounts) == 1:
        return np.asarray(stack[0], np.float64)
    # which of the amounts, and how far towards the next
    at = (sigma - low) / (high - low) * (_LEVELS - 1)
    level = np.minimum(at.astype(np.int64), _LEVELS - 2)
    part = at - level
    lower = np.take_along_axis(stack, level[None], axis=0)[0]
    upper = np.take_along_axis(stack, level[None] + 1, axis=0)[0]
    mixed: Floats = lower * (1.0 - part) + upper * part
    return mixed


def depths_mm(camera: Camera, solid: Solid) -> Floats:
    """Return how far along the optical axis each pixel's middle sees; the belt's where it sees nothing."""
    found: Floats = _depths(solid.body(), camera.packed(), camera.rotation, camera.height_px, camera.width_px)
    # beside everything: as far as the farthest thing, so that edges have a depth
    return np.where(np.isfinite(found), found, np.nanmax(found))


def blurred(light: Floats, sigma_px: float) -> Floats:
    """Blur an image by a Gaussian of `sigma_px` pixels; 0 leaves it as it is."""
    if sigma_px <= 0.0:
        return light
    from scipy.ndimage import gaussian_filter

    soft: Floats = gaussian_filter(light, sigma_px, mode="nearest")
    return soft


@kernel
def camera_ray(pinhole: Floats, rotation: Floats, x_px: float, y_px: float, d: Floats) -> None:
    """Write the unit direction, belt frame, of the ray through an image point."""
    cx = (x_px - pinhole[3]) / pinhole[5]
    cy = (y_px - pinhole[4]) / pinhole[5]
    if pinhole[6] != 0.0:
        # distortion is undone as precisely as float64 allows: truth must be better than what is tested
        cx, cy, _, _, _, _ = undistorted_place(cx, cy, cx, cy, lens_from(pinhole, 7), 1e-15)
    length = math.sqrt(cx * cx + cy * cy + 1.0)
    for k in range(3):
        d[k] = (rotation[k, 0] * cx + rotation[k, 1] * cy + rotation[k, 2]) / length


@kernel
def _depths(body: AnyBody, pinhole: Floats, rotation: Floats, rows: int, columns: int) -> Floats:
    depth = np.full((rows, columns), np.nan)
    view, point = np.zeros(3), np.zeros(3)
    reach = body.reach
    for row in range(rows):
        for column in range(columns):
            camera_ray(pinhole, rotation, column, row, view)
            if first_hit(body, reach, pinhole[:3], view, 1e-3, point) < 0:
                continue
            depth[row, column] = 0.0
            # the depth along the optical axis, not along the ray
            for k in range(3):
                depth[row, column] += rotation[k, 2] * (point[k] - pinhole[k])
    return depth


def circles_through(
    projector_mm: ArrayLike, centre_mm: ArrayLike, radii_mm: ArrayLike, right: ArrayLike, *,
    sigma_mm: float, peak_grey: float,
) -> LaserFan:  # fmt: skip
    """Return circles round a centre on the belt, of these radii there across the axis, increasing.

    The halves of each cone of light stand where planes of light stand in a fan: a point X lies on the cone
    with apex A, axis a and half angle α where n·X = d + b |X − A| for n = −a / sin α, d = n·A and
    b = −cot α; beside it the two sides differ by the distance to the cone, to first order. Halves come
    from left to right: the left ones from the largest circle inwards, the right ones outwards. `right`
    is the direction that tells them, the camera's x.
    """
    projector = np.asarray(projector_mm, dtype=np.float64)
    axis = np.asarray(centre_mm, dtype=np.float64) - projector
    away = float(np.linalg.norm(axis))
    axis = axis / away
    across = np.asarray(right, dtype=np.float64)
    across = across - (axis @ across) * axis
    across = across / np.linalg.norm(across)
    radii = np.atleast_1d(np.asarray(radii_mm, dtype=np.float64))
    angle = np.arctan(np.concatenate([radii[::-1], radii]) / away)
    side = np.repeat([-1.0, 1.0], len(radii))
    normals = -axis / np.sin(angle)[:, None]
    halves = np.column_stack([-1.0 / np.tan(angle), side[:, None] * across])
    # no angle along a line is counted: a circle's light is even all round
    return LaserFan(
        projector, normals, normals @ projector, np.zeros(3), sigma_mm, np.full(len(angle), peak_grey),
        halves=halves,
    )  # fmt: skip
