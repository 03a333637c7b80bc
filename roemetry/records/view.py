"""The geometry of a calibrated rig: how the camera sees the belt, and where planes or cones of light stand.

A pinhole (or telecentric) camera with OpenCV's lens distortion: x′ = radial · x + tangential + thin prism,
then the sensor's tilt. Its inverse is found by Newton's method; beyond the fold of a strong distortion there
is none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError, DataError
from roemetry.records.arrays import Checker, Floats
from roemetry.records.cones import dot, half_on_belt, meet_cones
from roemetry.records.display import Shown


def distort(xy: Floats, distortion: Floats) -> Floats:
    """Distort places (n, 2) on the plane at distance 1 as the lens does.

    `distortion` (k,) stands in OpenCV's order k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, τx, τy.
    """
    if not distortion.any():
        return np.asarray(xy, np.float64)
    return np.column_stack(_distorted(xy[:, 0], xy[:, 1], distortion)[0])


def undistort(xy: Floats, distortion: Floats) -> Floats:
    """Take the lens's distortion out: the inverse of `distort`, by Newton's method to 1e-13.

    Places beyond the fold of a strong distortion have no inverse and come back NaN.
    """
    distorted = np.asarray(xy, np.float64)
    if not distortion.any():
        return distorted
    distorted_x, distorted_y = distorted.T
    x, y = np.array(distorted_x), np.array(distorted_y)
    for step in range(_NEWTON_STEPS + 1):
        (at_x, at_y), (a, b, c, d) = _distorted(x, y, distortion)
        wrong_x, wrong_y = at_x - distorted_x, at_y - distorted_y
        missed = np.maximum(np.abs(wrong_x), np.abs(wrong_y))
        determinant = a * d - b * c
        left = np.fmax.reduce(missed, initial=0.0)
        if step == _NEWTON_STEPS or not left > _NEWTON_RESIDUAL:
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            x -= (d * wrong_x - b * wrong_y) / determinant
            y -= (a * wrong_y - c * wrong_x) / determinant
        if left < _NEWTON_LAST:  # the step squares it: there is nothing left to see
            missed = np.where(np.isnan(missed), np.nan, 0.0)
            break
    # Beyond the fold the image is turned over: a root there fits, but no light takes that way.
    proper = (determinant > 0) & (a + d > 0)
    undistorted = np.column_stack([x, y])
    undistorted[~((missed < _MISSED_MAX) & proper)] = np.nan
    return undistorted


def distortion_jacobian(xy: Floats, distortion: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Give ∂x′/∂x, ∂x′/∂y, ∂y′/∂x, ∂y′/∂y of `distort` at places (n, 2), each (n,)."""
    return _distorted(xy[:, 0], xy[:, 1], distortion)[1]


def _distorted(
    x: Floats, y: Floats, distortion: Floats
) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats, Floats, Floats]]:
    """Give x′, y′ and ∂x′/∂x, ∂x′/∂y, ∂y′/∂x, ∂y′/∂y at places, each (n,)."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = (
        *map(float, distortion), *[0.0] * (14 - distortion.size),
    )  # fmt: skip
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    radial, rising = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + r2 * (3 * k3))
    if k4 or k5 or k6:
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = radial / below
        rising = (rising - radial * (k4 + r2 * (2 * k5 + r2 * (3 * k6)))) / below
    place = (
        x * radial + (2 * p1) * xy + p2 * (r2 + 2 * xx),
        y * radial + p1 * (r2 + 2 * yy) + (2 * p2) * xy,
    )
    cross = 2 * (xy * rising + p1 * x + p2 * y)
    slopes = (
        radial + 2 * (xx * rising + p1 * y + (3 * p2) * x),
        cross,
        cross,
        radial + 2 * (yy * rising + (3 * p1) * y + p2 * x),
    )
    if s1 or s2 or s3 or s4:
        prism_x, prism_y = 2 * (s1 + 2 * r2 * s2), 2 * (s3 + 2 * r2 * s4)
        place = place[0] + r2 * (s1 + r2 * s2), place[1] + r2 * (s3 + r2 * s4)
        a, b, c, d = slopes
        slopes = a + prism_x * x, b + prism_x * y, c + prism_y * x, d + prism_y * y
    return _tilted(place, slopes, _tilt(tau_x, tau_y)) if tau_x or tau_y else (place, slopes)


def _tilted(
    place: tuple[Floats, Floats], slopes: tuple[Floats, Floats, Floats, Floats], turn: Floats
) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats, Floats, Floats]]:
    """Take places and their slopes through a homography."""
    distorted = np.stack(place)
    ahead = turn[2, :2] @ distorted + turn[2, 2]
    tilted = (turn[:2, :2] @ distorted + turn[:2, 2:]) / ahead
    (a, c), (b, d) = (
        (turn[:2, :2] @ by - tilted * (turn[2, :2] @ by)) / ahead
        for by in (np.stack(slopes[::2]), np.stack(slopes[1::2]))
    )
    return (tilted[0], tilted[1]), (a, b, c, d)


STEEP_MAX = 1.7
"""Pixels a row, at which a circle is too steep to be told by the rows it crosses: 60° from upright. Beyond it
runs nearly the way in which heights move it, and says half as much of them and less."""

_NEWTON_STEPS = 30  # a place that is not found by then lies at the fold or beyond it
_NEWTON_RESIDUAL = 1e-13  # on the plane at distance 1: some 1e-10 px
_NEWTON_LAST = 1e-8  # a step squares the residual: from here one more is the last
_MISSED_MAX = 1e-9  # the same; a place that is missed by more lies beyond the fold


def _tilt(tau_x: float, tau_y: float) -> Floats:
    """Homography of a tilted sensor (OpenCV's model, τ in radians)."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    turn = about_y @ about_x
    return np.asarray(
        np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]) @ turn
    )


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class View(Shown):
    """Camera and light in the belt frame; what coder and outline need of any calibration."""

    image_size: tuple[int, int]
    """Rows and columns of the (turned) image."""
    camera_matrix: Floats
    """(3, 3) fx, 0, cx; 0, fy, cy; 0, 0, 1 in px; of a telecentric camera fx and fy are px/mm."""
    T_belt_camera: Floats
    """(4, 4) to the belt frame from the camera's (z forward, x right, y down), mm."""
    planes: Floats
    """(stripe, 4) nx, ny, nz, d with n·X = d (mm) in the belt frame, n of length 1."""
    distortion: Floats = field(default_factory=lambda: np.empty(0))
    """(k,) lens distortion in OpenCV's model and order: none, 4, 5, 8, 12 or 14 numbers."""
    projector_mm: Floats = field(default_factory=lambda: np.full(3, np.nan))
    """(3,) where the light comes from, belt frame, mm; NaN where that is not known."""
    telecentric: bool = False
    """True where all rays are parallel to the camera's z."""
    exact: bool = True
    """False where it is an approximation made for coding and outlines, not for measuring."""
    cones: Floats = field(default_factory=lambda: np.empty((0, 7)))
    """(stripe, 7) of circles, whose left and right halves the stripes then are: where the light comes from,
    mm, the axis, of length 1, and the half angle, rad, negative of left halves. Empty: light is in planes;
    else `planes` touch the cones in the middle of each half."""

    def __post_init__(self) -> None:
        check = Checker(self)
        matrix = check.array("camera_matrix", np.float64, (3, 3))
        pose = check.array("T_belt_camera", np.float64, (4, 4))
        planes = check.array("planes", np.float64, (None, 4))
        count = check.array("distortion", np.float64, (None,)).size
        check.array("projector_mm", np.float64, (3,))
        check.require(count in (0, 4, 5, 8, 12, 14), f"distortion has {count} numbers")
        check.require(not (self.telecentric and count), "a telecentric camera has no distortion model here")
        if matrix.shape == (3, 3):
            check.require(bool(matrix[0, 0] > 0 and matrix[1, 1] > 0), "focal lengths are not positive")
        if pose.shape == (4, 4):
            turn = pose[:3, :3]
            proper = np.abs(turn @ turn.T - np.eye(3)).max() < 1e-6 and np.linalg.det(turn) > 0
            check.require(bool(proper), "T_belt_camera is not a rotation with a shift")
        if planes.ndim == 2 and planes.shape[1] == 4 and planes.size:
            length = np.sqrt((planes[:, :3] ** 2).sum(axis=1))
            check.require(bool(np.abs(length - 1.0).max() < 1e-6), "plane normals are not of length 1")
        cones = check.array("cones", np.float64, (None, 7))
        check.require(len(cones) in (0, len(planes)), "cones and planes differ in number")
        check.finish()

    @property
    def camera_mm(self) -> Floats:
        """Centre of projection in the belt frame, mm (of a telecentric camera: a point on its axis)."""
        return np.asarray(self.T_belt_camera[:3, 3])

    def rays(self, xy_px: Floats) -> tuple[Floats, Floats]:
        """Give the lines of sight through (…, 2) places in the image, px.

        Of each: a point, mm, and the direction (length 1), both (…, 3) in the belt frame. NaN in, NaN out.
        """
        xy = np.asarray(xy_px, np.float64)
        turn, shift = self.T_belt_camera[:3, :3], self.T_belt_camera[:3, 3]
        flat = self._normalised(xy.reshape(-1, 2))
        if self.telecentric:
            start = np.column_stack([flat, np.zeros(len(flat))]) @ turn.T + shift
            way = np.tile(turn[:, 2], (len(start), 1))
        else:
            x, y = flat.T
            way = flat @ turn[:, :2].T + turn[:, 2]
            way /= np.sqrt(x * x + y * y + 1.0)[:, None]
            start = shift + 0.0 * way  # NaN where there is none
        shape = (*xy.shape[:-1], 3)
        return start.reshape(shape), way.reshape(shape)

    def project(self, xyz_mm: Floats) -> Floats:
        """Give (…, 2) where points (…, 3) of the belt frame appear, px; NaN behind the camera."""
        xyz = np.asarray(xyz_mm, np.float64)
        turn, shift = self.T_belt_camera[:3, :3], self.T_belt_camera[:3, 3]
        seen = (xyz.reshape(-1, 3) - shift) @ turn
        if self.telecentric:
            plane = seen[:, :2]
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                plane = np.where(seen[:, 2:] > 0, seen[:, :2] / seen[:, 2:], np.nan)
            plane = distort(plane, self.distortion)
        focal = np.diag(self.camera_matrix)[:2]
        return np.asarray(plane * focal + self.camera_matrix[:2, 2]).reshape((*xyz.shape[:-1], 2))

    def project_slopes(self, xyz_mm: Floats) -> tuple[Floats, Floats]:
        """Give what `project` does of points (n, 3), and (2, 3, n) how it moves with their coordinates."""
        turn, shift = self.T_belt_camera[:3, :3], self.T_belt_camera[:3, 3]
        focal_x, focal_y = self.camera_matrix[0, 0], self.camera_matrix[1, 1]
        u, v, ahead = turn.T @ (xyz_mm - shift).T
        by_u, by_v = turn[:, :1], turn[:, 1:2]
        if self.telecentric:
            x, y, by_x, by_y = u, v, by_u + 0.0 * u, by_v + 0.0 * v
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                near = np.where(ahead > 0, 1.0 / ahead, np.nan)
            x, y = u * near, v * near
            by_x, by_y = (by_u - x * turn[:, 2:]) * near, (by_v - y * turn[:, 2:]) * near
            if self.distortion.any():
                (x, y), (a, b, c, d) = _distorted(x, y, self.distortion)
                by_x, by_y = a * by_x + b * by_y, c * by_x + d * by_y
        at = np.stack([x, y], axis=1) * (focal_x, focal_y) + self.camera_matrix[:2, 2]
        return at, np.stack([focal_x * by_x, focal_y * by_y])

    def lift(self, xy_px: Floats, stripe: Any) -> Floats:
        """Give (…, 3) where rays of (…, 2) image places meet the light of stripes (…), belt frame, mm."""
        start, way = self.rays(xy_px)
        if len(self.cones):
            return meet_cones(start, way, self.cones[np.asarray(stripe)], self.T_belt_camera[:3, 0])
        plane = self.planes[np.asarray(stripe)]
        normal, distance = plane[..., :3], plane[..., 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (distance - dot(start, normal)) / dot(way, normal)
        return np.asarray(start + along[..., None] * way)

    def at_height(self, xy_px: Floats, z_mm: Any) -> Floats:
        """Give (…, 3) where the rays of (…, 2) image places are at a height, belt frame, mm."""
        start, way = self.rays(xy_px)
        along = (np.asarray(z_mm, np.float64) - start[..., 2]) / way[..., 2]
        return np.asarray(start + along[..., None] * way)

    def rest_of_cones_px(self, row_px: Floats) -> Floats:
        """Give (stripe, row) where halves of circles on the belt cross rows, px.

        Beyond the rows that a half crosses at less than `STEEP_MAX`, where it crosses the last of them.
        """
        row, found = np.asarray(row_px, np.float64), np.empty((len(self.cones), np.size(row_px)))
        for number, cone in enumerate(self.cones):
            x_px, y_px = self.project(half_on_belt(cone, self.T_belt_camera[:3, 0])).T
            steep = np.abs(np.gradient(x_px)) > STEEP_MAX * np.abs(np.gradient(y_px))
            order = np.argsort(y_px[~steep])
            found[number] = np.interp(row, y_px[~steep][order], x_px[~steep][order])
        return found

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as they stand in a file."""
        return {
            "camera_matrix": self.camera_matrix.tolist(),
            "distortion": self.distortion.tolist(),
            "T_belt_camera": self.T_belt_camera.tolist(),
            "planes": self.planes.tolist(),
            "projector_mm": self.projector_mm.tolist() if np.isfinite(self.projector_mm).all() else None,
            "telecentric": self.telecentric,
            "exact": self.exact,
            **({"cones": self.cones.tolist()} if len(self.cones) else {}),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], image_size: tuple[int, int]) -> View:
        """Read what `to_dict` wrote; KeyError, TypeError, ValueError or DataError where it is damaged."""
        projector = data["projector_mm"]
        return cls(
            image_size=image_size,
            camera_matrix=np.array(data["camera_matrix"], np.float64),
            T_belt_camera=np.array(data["T_belt_camera"], np.float64),
            planes=np.array(data["planes"], np.float64),
            distortion=np.array(data["distortion"], np.float64),
            projector_mm=np.full(3, np.nan) if projector is None else np.array(projector, np.float64),
            telecentric=bool(data["telecentric"]),
            exact=bool(data["exact"]),
            cones=np.array(data.get("cones", ()), np.float64).reshape(-1, 7),
        )

    def _normalised(self, xy_px: Floats) -> Floats:
        """From pixels to the plane at distance 1 (telecentric: to mm), without the lens's distortion."""
        focal = np.diag(self.camera_matrix)[:2]
        seen = (xy_px - self.camera_matrix[:2, 2]) / focal
        return undistort(seen, self.distortion)


SUFFIXES = (".yaml", ".yml", ".json", ".xml")
"""By them OpenCV knows what to write."""


def write_camera(path: Path, view: View) -> None:
    """Write a view's camera as OpenCV's `FileStorage` does: camera_matrix, distortion_coefficients, size.

    Planes of light are `laser_planes`, rows A, B, C, D of Ax + By + Cz + D = 0 in the camera's frame, mm, but
    those of circles, which are cones, are left out;
    `T_belt_camera` takes places from the camera's frame to the belt's. CalibrationError where the view is no
    camera that was calibrated, DataError where the file cannot be written.
    """
    if view.telecentric or not view.exact:
        raise CalibrationError(
            "this calibration knows no camera: its view is enough for coding, not for other programs",
            hint="calibrate with pinhole-plane",
        )
    import cv2

    storage = cv2.FileStorage()
    opened = path.suffix.lower() in SUFFIXES and path.parent.is_dir()
    if not (opened and storage.open(str(path), cv2.FILE_STORAGE_WRITE)):
        raise DataError(
            f"{path}: the file cannot be written",
            hint=f"a name in a folder that is there, that ends in {', '.join(SUFFIXES)}",
        )
    storage.write("image_width", int(view.image_size[1]))
    storage.write("image_height", int(view.image_size[0]))
    storage.write("camera_matrix", np.array(view.camera_matrix))
    storage.write("distortion_coefficients", np.array(view.distortion).reshape(1, -1))
    storage.write("T_belt_camera", np.array(view.T_belt_camera))
    pose, planes = np.array(view.T_belt_camera), np.array(view.planes)
    rows = np.column_stack([planes[:, :3] @ pose[:3, :3], planes[:, :3] @ pose[:3, 3] - planes[:, 3]])
    if not len(view.cones):  # planes that touch cones are not where the light is
        storage.write("laser_planes", rows)
    storage.release()
