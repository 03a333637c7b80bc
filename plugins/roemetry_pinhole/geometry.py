"""Unknowns of a calibration, and what they say the images show, with derivatives.

Model. The camera is a pinhole with OpenCV's lens (roemetry_kernels.lens); the board has a pose in each view
and may be warped (a polynomial of the fourth order); a plane of light is p·X = 1 in the camera's frame, which
no plane through the camera's centre can be, and such a plane would measure nothing; the belt is the same.

Observed are, each with its own residual and its analytic derivatives by all unknowns:
- marks: predicted less seen place in the image, px;
- stripe peaks: the way along the image row to where plane of light and surface meet, px. Both planes meet in
  a line whose rays m keep (δ p − n)·m = 0, n·X = δ being the surface; its left side over its slope along the
  row is that way. Derivatives are taken at the predicted place: at the noisy one they would share its noise;
- belt contacts: heights over the belt of board corners that lie on it, mm;
- edges of solids: the distance in the image from the line in which two of its faces meet, px.

It fails where a ray runs along a plane: the slope along the row is then 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.lens import distort_places, undistort_places

COEFFICIENTS = 8
"""k1, k2, p1, p2, k3, k4, k5, k6: OpenCV's order."""


class Distorted(NamedTuple):
    """Distorted places (n, 2) on the plane at distance 1, and derivatives (n, 2, 2) and (n, 2, 8)."""

    xy: Floats
    by_place: Floats
    by_coefficient: Floats


def distort(xy: Floats, coefficients: Floats) -> Distorted:
    """Distort places (n, 2) by eight coefficients."""
    return Distorted(*distort_places(np.ascontiguousarray(xy), np.ascontiguousarray(coefficients)))


def undistort(places: Floats, coefficients: Floats, start: Floats | None = None) -> Floats:
    """Undistort places (n, 2) by Newton's method."""
    if not coefficients.any():
        return places
    places = np.ascontiguousarray(places)
    begin = places if start is None else np.ascontiguousarray(start)
    return np.asarray(undistort_places(places, np.ascontiguousarray(coefficients), begin))


def rays(camera: Floats, xy_px: Floats) -> Floats:
    """Give (n, 3) rays, z = 1, of places (n, 2) in the image, px, by a camera (12,)."""
    xy = undistort((xy_px - camera[2:4]) / camera[:2], camera[4:])
    return np.column_stack([xy, np.ones(len(xy))])


_POWERS = np.array([(i, degree - i) for degree in (2, 3, 4) for i in range(degree, -1, -1)])
"""Of x and y in each coefficient: what is of lower order is the pose's."""
WARP_COEFFICIENTS = len(_POWERS)
"""Number of coefficients."""


@dataclass(frozen=True, eq=False, slots=True)
class BoardWarp:
    """Heights of the print over the board's plane, away from the camera."""

    middle_mm: Floats
    reach_mm: float
    """middle_mm, reach_mm: (2,) where the powers of x and y are counted from, on the board, and the length of
    which they are taken."""
    coefficients_mm: Floats
    """(12,) of x², xy, y², x³, … y⁴."""

    @classmethod
    def none(cls, width_mm: float, height_mm: float) -> BoardWarp:
        """Give that of a flat board of this size."""
        return cls(
            0.5 * np.array([width_mm, height_mm]), 0.5 * max(width_mm, height_mm), np.zeros(WARP_COEFFICIENTS)
        )

    def moved(self, step_mm: Floats) -> BoardWarp:
        """Give it with other coefficients."""
        return replace(self, coefficients_mm=self.coefficients_mm + step_mm)

    def by_coefficient(self, place_mm: Floats) -> Floats:
        """Give (n, 12) what each coefficient adds at places (n, 2)."""
        x, y = self._powers(place_mm)
        return np.asarray((x[_POWERS[:, 0]] * y[_POWERS[:, 1]]).T)

    def height_mm(self, place_mm: Floats) -> Floats:
        """Give (n,) how far the print lies off the plane at places (n, 2)."""
        return np.asarray(self.by_coefficient(place_mm) @ self.coefficients_mm)

    def slopes(self, place_mm: Floats) -> Floats:
        """Give (n, 2) the derivatives of the height along x and y."""
        x, y = self._powers(place_mm)
        i, j = _POWERS.T
        along = (self.coefficients_mm * i) @ (x[np.maximum(i - 1, 0)] * y[j])
        down = (self.coefficients_mm * j) @ (x[i] * y[np.maximum(j - 1, 0)])
        return np.column_stack([along, down]) / self.reach_mm

    def range_mm(self) -> float:
        """Give the range of heights over the board's best plane."""
        x, y = np.meshgrid(*(middle + np.linspace(-1.0, 1.0, 21) * middle for middle in self.middle_mm))
        places = np.column_stack([x.ravel(), y.ravel()])
        height = self.height_mm(places)
        flat = np.column_stack([places, np.ones(len(places))])
        return float(np.ptp(height - flat @ np.linalg.lstsq(flat, height, rcond=None)[0]))

    def _powers(self, place_mm: Floats) -> Floats:
        """(2, 5, n) of x and of y, the powers 0 to 4."""
        from_middle = ((place_mm - self.middle_mm) / self.reach_mm).T
        return np.cumprod([np.ones_like(from_middle), *[from_middle] * 4], axis=0).swapaxes(0, 1)


CAMERA = 4 + COEFFICIENTS
"""fx, fy, cx, cy (px), then the lens's coefficients."""


@dataclass(frozen=True, eq=False, slots=True)
class Geometry:
    """Everything the adjustment finds. Lengths in mm, all in the camera's frame."""

    camera: Floats
    """(12,) fx, fy, cx, cy, px; k1, k2, p1, p2, k3, k4, k5, k6."""
    rotation: Floats
    shift: Floats
    """rotation, shift: (pose, 3, 3) and (pose, 3): to the camera's frame from the board's."""
    planes: Floats = field(default_factory=lambda: np.empty((0, 3)))
    """(stripe, 3) p with p·X = 1, 1/mm: normal over distance."""
    belt: Floats = field(default_factory=lambda: np.full(3, np.nan))
    """(3,) the same of the belt; NaN where it is not asked for."""
    travel: Floats = field(default_factory=lambda: np.zeros(3))
    """(3,) way of the belt per encoder count, mm; 0 where it is not asked for."""
    warp: BoardWarp | None = None
    """Shape of the board's print; None where it is taken to be flat."""
    prints: Floats = field(default_factory=lambda: np.empty((0, 2)))
    """(board, 2) natural logarithms of how much larger each print is than described, and of how much more so
    along its y; (0, 2) where one board is as it is described."""

    @property
    def stripe_count(self) -> int:
        """Number of planes of light."""
        return int(self.planes.shape[0])


@dataclass(frozen=True, eq=False, slots=True)
class Unknowns:
    """Where each unknown stands in the vector of parameters; −1 for what is held fixed."""

    camera: Integers
    """(12,)"""
    planes: Integers
    """(stripe, 3)"""
    belt: Integers
    travel: Integers
    """belt, travel: (3,)"""
    poses: Integers
    """(pose, 6) turn about the camera's axes, rad, then shift, mm."""
    warp: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    """(12,) of the board's shape, mm; (0,) where it is taken to be flat."""
    prints: Integers = field(default_factory=lambda: np.empty((0, 2), np.int64))
    """(board, 2) of the prints' sizes."""

    @property
    def count(self) -> int:
        """Number of unknowns."""
        parts = (self.camera, self.planes, self.belt, self.travel, self.poses, self.warp, self.prints)
        return int(np.concatenate([part.ravel() for part in parts]).max()) + 1

    def of(self, geometry: Geometry, prints: Flags) -> Unknowns:
        """Number the same unknowns of another geometry, and these of its prints' sizes."""
        return unknowns_of(
            geometry,
            free_camera=self.camera >= 0,
            planes=bool((self.planes >= 0).any()),
            belt=bool((self.belt >= 0).any()),
            travel=bool((self.travel >= 0).any()),
            warp=bool(self.warp.size),
            prints=prints,
        )

    def moved(self, geometry: Geometry, step: Floats) -> Geometry:
        """Give the geometry after a step of the unknowns."""
        warp = geometry.warp
        if warp is not None and self.warp.size:
            warp = warp.moved(_part(step, self.warp))
        return replace(
            geometry,
            camera=geometry.camera + _part(step, self.camera),
            planes=geometry.planes + _part(step, self.planes),
            belt=geometry.belt + _part(step, self.belt),
            travel=geometry.travel + _part(step, self.travel),
            # turned from the left: about the camera's axes
            rotation=turned(_part(step, self.poses[:, :3])) @ geometry.rotation,
            shift=geometry.shift + _part(step, self.poses[:, 3:]),
            warp=warp,
            prints=geometry.prints + _part(step, self.prints) if self.prints.size else geometry.prints,
        )


def unknowns_of(
    geometry: Geometry,
    *,
    free_camera: Flags,
    planes: bool = False,
    belt: bool = False,
    travel: bool = False,
    warp: bool = False,
    prints: Flags | None = None,
) -> Unknowns:
    """Number the unknowns, the camera's first, poses last.

    `free_camera` (12,) and `prints` (board, 2; None: none) say which of these numbers are looked for, the
    others whether all of theirs are.
    """
    start = 0

    def numbered(free: Flags) -> Integers:
        """Give the free ones the next numbers, in their order; −1 to the others."""
        nonlocal start
        flat = np.ravel(free)
        # numbers go on from part to part
        numbers = np.where(flat, start + np.cumsum(flat) - 1, -1)
        start += int(flat.sum())
        return numbers.reshape(np.shape(free)).astype(np.int64)

    return Unknowns(
        camera=numbered(free_camera),
        planes=numbered(np.full(geometry.planes.shape, planes)),
        belt=numbered(np.full(3, belt)),
        travel=numbered(np.full(3, travel)),
        poses=numbered(np.ones((geometry.shift.shape[0], 6), np.bool_)),
        warp=numbered(np.full(WARP_COEFFICIENTS if warp else 0, True)),
        prints=numbered(np.empty((0, 2), np.bool_) if prints is None else prints),
    )


def turned(vectors: Floats) -> Floats:
    """Give (n, 3, 3) rotations by vectors (n, 3), rad (Rodrigues)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def crossed(a: Floats, b: Floats) -> Floats:
    """Give the cross products of vectors (…, 3): numpy's to the last digit, in a third of its time."""
    made = np.empty(np.broadcast_shapes(a.shape, b.shape))
    (a0, a1, a2), (b0, b1, b2) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (a, b))
    made[..., 0] = a1 * b2 - a2 * b1
    made[..., 1] = a2 * b0 - a0 * b2
    made[..., 2] = a0 * b1 - a1 * b0
    return made


def _part(step: Floats, at: Integers) -> Floats:
    return np.where(at >= 0, step[np.maximum(at, 0)], 0.0)


_WARP_ROUNDS = 3
"""Of meeting a ray with a warped board: each divides the error by the warp's slope, some 0.01."""

ON_BELT = -1
"""Pose of stripe points that lie on the bare belt."""


@dataclass(frozen=True, eq=False, slots=True)
class Corners:
    """Marks of the board seen in images."""

    pose: Integers
    """(mark,) which pose of the board."""
    board_mm: Floats
    xy_px: Floats
    """board_mm, xy_px: (mark, 3) place on the board, mm: x along its columns, y along its rows, z away from
    the camera; (mark, 2) where it is seen, px."""
    counts: Floats
    """(mark,) encoder counts the belt has carried the board on since the pose was defined."""
    board: Integers
    """(mark,) which board."""


@dataclass(frozen=True, eq=False, slots=True)
class StripePoints:
    """Peaks of stripes on boards and on the belt."""

    pose: Integers
    stripe: Integers
    """pose, stripe: (point,) which pose of the board, or `ON_BELT`; which plane of light."""
    x_px: Floats
    row_px: Floats
    std_px: Floats
    """x_px, row_px, std_px: (point,) where the peak is, px, and its standard uncertainty along x, px, up to a
    common factor."""
    counts: Floats
    """(point,) as for corners."""
    face: Floats | None = None
    """(point, 4) n and d with n·X = d, mm, in the pose's own frame: the plane of the surface the point lies
    on; None where all lie on boards, whose surface is (0, 0, 1, 0)."""

    @property
    def xy_px(self) -> Floats:
        """(point, 2) where the peak is, px."""
        return np.column_stack([self.x_px, self.row_px])


@dataclass(frozen=True, eq=False, slots=True)
class BeltContacts:
    """Points of boards that touch the belt: (n,) pose, (n, 3) place on the board, mm, and (n,) counts."""

    pose: Integers
    board_mm: Floats
    counts: Floats


class Rows(NamedTuple):
    """Residuals (row,) with a sparse Jacobian: (row, k) columns, −1 for none, and values."""

    residual: Floats
    columns: Integers
    values: Floats


def corner_rows(geometry: Geometry, unknowns: Unknowns, corners: Corners) -> Rows:
    """Give predicted − seen, px: for each mark a row for x and one for y, in turn."""
    # arm: from the board's origin, in the camera's axes; at: in the camera's frame
    arm, at = _placed(geometry, corners.pose, _on_print(geometry, corners), corners.counts)
    depth = at[:, 2]
    xy = at[:, :2] / depth[:, None]
    lens = distort(xy, geometry.camera[4:])
    focal, middle = geometry.camera[:2], geometry.camera[2:4]
    residual = lens.xy * focal + middle - corners.xy_px
    # chain: place in space, on the plane at distance 1, distorted, px
    by_at = np.zeros((depth.size, 2, 3))
    by_at[:, :, :2] = lens.by_place / depth[:, None, None]
    by_at[:, :, 2] = -(lens.by_place @ xy[:, :, None])[:, :, 0] / depth[:, None]
    by_at *= focal[:, None]
    values = np.zeros((depth.size, 2, CAMERA + 9))
    values[:, 0, 0], values[:, 1, 1] = lens.xy[:, 0], lens.xy[:, 1]
    values[:, 0, 2] = values[:, 1, 3] = 1.0
    values[:, :, 4:CAMERA] = lens.by_coefficient * focal[:, None]
    # a turn by w moves a point by w × arm
    values[:, :, CAMERA : CAMERA + 3] = crossed(arm[:, None, :], by_at)
    values[:, :, CAMERA + 3 : CAMERA + 6] = by_at
    values[:, :, CAMERA + 6 :] = by_at * corners.counts[:, None, None]
    columns = columns_of(unknowns.camera, unknowns.poses[corners.pose], unknowns.travel)
    rows = Rows(residual.ravel(), np.repeat(columns, 2, axis=0), values.reshape(-1, CAMERA + 9))
    if unknowns.warp.size and geometry.warp is not None:
        # heights of the print are along the board's normal
        away = (by_at @ geometry.rotation[corners.pose][:, :, 2:]).reshape(-1, 1)
        by_warp = np.repeat(geometry.warp.by_coefficient(corners.board_mm[:, :2]), 2, axis=0)
        rows = _with_more(rows, unknowns.warp, away * by_warp)
    if unknowns.prints.size:
        place = _on_print(geometry, corners)[:, :2]
        by_place = by_at @ geometry.rotation[corners.pose][:, :, :2]
        # sizes are logarithms: the derivative by one is the place itself
        by_print = np.stack([(by_place * place[:, None, :]).sum(axis=2), by_place[:, :, 1] * place[:, 1:]], 2)
        rows = _with_more(rows, np.repeat(unknowns.prints[corners.board], 2, axis=0), by_print.reshape(-1, 2))
    return rows


def corner_residuals(geometry: Geometry, corners: Corners) -> Floats:
    """Give predicted − seen, px, x and y in turn, without derivatives."""
    at = _placed(geometry, corners.pose, _on_print(geometry, corners), corners.counts)[1]
    seen = distort(at[:, :2] / at[:, 2:], geometry.camera[4:]).xy * geometry.camera[:2] + geometry.camera[2:4]
    return np.ravel(seen - corners.xy_px)


def stripe_rows(geometry: Geometry, unknowns: Unknowns, points: StripePoints) -> Rows:
    """Give seen − predicted along the image row, px; derivatives are taken at the predicted place."""
    where = _Lines(geometry, points)
    # one Newton step along the row, and a second one from there
    way = where.way_px(points.x_px)[0]
    more, seen, lens, ray, by_seen, slope = where.way_px(points.x_px - way)
    values = np.zeros((way.size, CAMERA + 15))
    values[:, :CAMERA] = _by_camera(geometry, seen, lens, by_seen)
    of_plane = (ray * where.plane).sum(axis=1)[:, None]
    turn = of_plane * crossed(where.normal, where.place) - crossed(where.normal, ray)
    board = ~where.on_belt[:, None]
    values[:, CAMERA : CAMERA + 3] = np.where(board, turn, 0.0)
    values[:, CAMERA + 3 : CAMERA + 6] = np.where(board, of_plane * where.normal, 0.0)
    values[:, CAMERA + 6 : CAMERA + 9] = values[:, CAMERA + 3 : CAMERA + 6] * points.counts[:, None]
    # planes and belt enter the line linearly
    values[:, CAMERA + 9 : CAMERA + 12] = ray * np.where(where.on_belt, 1.0, where.distance)[:, None]
    values[:, CAMERA + 12 :] = np.where(board, 0.0, -ray)
    poses = np.full((way.size, 6), -1)
    if unknowns.poses.size:
        poses = np.where(board, unknowns.poses[np.maximum(points.pose, 0)], -1)
    own = columns_of(unknowns.camera, poses, unknowns.travel)
    columns = np.column_stack([own, unknowns.planes[points.stripe], np.where(board, -1, unknowns.belt)])
    # from the line's left side to px along the row
    values /= slope[:, None]
    rows = Rows(way + more, columns, values)
    if unknowns.warp.size and where.by_warp is not None:
        rows = _with_more(rows, unknowns.warp, of_plane * where.by_warp / slope[:, None])
    return rows


def _by_camera(geometry: Geometry, seen: Floats, lens: Distorted, by_seen: Floats) -> Floats:
    """Give (n, 12) derivatives of a line's left side by the camera, where the place in the image is fixed."""
    focal = geometry.camera[:2]
    by_lens = -(by_seen[:, None, :] @ lens.by_coefficient)[:, 0, :]
    return np.column_stack([-by_seen * seen / focal, -by_seen / focal, by_lens])


def stripe_residuals(geometry: Geometry, points: StripePoints) -> Floats:
    """Give seen − predicted along the image row, px, without derivatives."""
    where = _Lines(geometry, points)
    way = where.way_px(points.x_px)[0]
    return way + where.way_px(points.x_px - way)[0]


def plane_distances(geometry: Geometry, points: StripePoints) -> Floats:
    """Give (point,) how far from its plane of light each peak's ray meets board or belt, mm."""
    where = _Lines(geometry, points)
    ray = rays(geometry.camera, points.xy_px)
    surface = np.where(where.on_belt[:, None], geometry.belt, where.normal)
    away = np.where(where.on_belt, 1.0, where.distance)
    at = ray * (away / (surface * ray).sum(axis=1))[:, None]
    return np.asarray(((at * where.plane).sum(axis=1) - 1.0) / np.sqrt((where.plane**2).sum(axis=1)))


class _Lines:
    """For each point the line, on the plane at distance 1, on which its stripe lies."""

    def __init__(self, geometry: Geometry, points: StripePoints) -> None:
        self._camera, self._row_px = geometry.camera, points.row_px
        self._straight: Floats | None = None
        self.plane = geometry.planes[points.stripe]
        self.on_belt = points.pose == ON_BELT
        self.normal, self.place = np.zeros_like(self.plane), np.zeros_like(self.plane)
        if geometry.shift.size:
            pose = np.maximum(points.pose, 0)
            self.place = geometry.shift[pose] + points.counts[:, None] * geometry.travel
            if points.face is None:
                self.normal = geometry.rotation[pose][:, :, 2]
            else:
                self.normal = (geometry.rotation[pose] @ points.face[:, :3, None])[:, :, 0]
        self.distance = (self.normal * self.place).sum(axis=1)
        if points.face is not None:
            self.distance = self.distance + points.face[:, 3]
        self.by_warp: Floats | None = None
        if geometry.warp is not None and points.face is None:
            self._warp(geometry, geometry.warp, points)
        belt = geometry.belt if self.on_belt.any() else np.zeros(3)
        self._line = np.where(
            self.on_belt[:, None], self.plane - belt, self.distance[:, None] * self.plane - self.normal
        )

    def _warp(self, geometry: Geometry, warp: BoardWarp, points: StripePoints) -> None:
        """Put in place of a board's plane the one that touches it where the ray meets it."""
        on = np.flatnonzero(~self.on_belt)
        rotation, place = geometry.rotation[points.pose[on]], self.place[on]
        ray = rays(self._camera, points.xy_px[on])
        normal, distance = self.normal[on], self.distance[on]
        # the plane that touches moves with the place where the ray meets it: a few rounds
        for _ in range(_WARP_ROUNDS):
            at = ray * (distance / (normal * ray).sum(axis=1))[:, None]
            there = ((at - place)[:, None, :] @ rotation)[:, 0, :2]
            own = np.column_stack([-warp.slopes(there), np.ones(on.size)])
            own /= np.sqrt((own**2).sum(axis=1))[:, None]
            normal = (rotation @ own[:, :, None])[:, :, 0]
            touched = np.column_stack([there, warp.height_mm(there)])
            distance = (normal * place).sum(axis=1) + (own * touched).sum(axis=1)
        self.normal[on], self.distance[on] = normal, distance
        self.by_warp = np.zeros((len(self.on_belt), warp.coefficients_mm.size))
        self.by_warp[on] = own[:, 2:] * warp.by_coefficient(there)

    def way_px(self, x_px: Floats) -> tuple[Floats, Floats, Distorted, Floats, Floats, Floats]:
        """Give the way to the line along the row, px; distorted place, lens, ray, ∂/∂place, slope."""
        focal = self._camera[:2]
        seen = (np.column_stack([x_px, self._row_px]) - self._camera[2:4]) / focal
        xy = undistort(seen, self._camera[4:], self._straight)
        lens = distort(xy, self._camera[4:])
        # the next search for the straight place starts at the last one
        self._straight = xy
        ray = np.column_stack([xy, np.ones(len(xy))])
        by_seen = by_distorted(self._line, lens)
        slope = by_seen[:, 0] / focal[0]
        return (self._line * ray).sum(axis=1) / slope, seen, lens, ray, by_seen, slope


def by_distorted(line: Floats, lens: Distorted) -> Floats:
    """Give (n, 2) the derivatives of line·ray by the ray's place in the distorted image; line is (n, 3)."""
    # inverse of a 2 × 2 matrix
    a, b, c, d = (lens.by_place[:, i, j] for i in (0, 1) for j in (0, 1))
    area = a * d - b * c
    u, v = line[:, 0] / area, line[:, 1] / area
    return np.column_stack([u * d - v * c, v * a - u * b])


def contact_rows(geometry: Geometry, unknowns: Unknowns, contacts: BeltContacts) -> Rows:
    """Give heights of the boards' undersides over the belt, mm; they should be 0."""
    arm, at = _placed(geometry, contacts.pose, contacts.board_mm, contacts.counts)
    size = float(np.sqrt((geometry.belt**2).sum()))
    up = np.broadcast_to(-geometry.belt / size, at.shape)
    residual = (1.0 - at @ geometry.belt) / size
    by_belt = -at / size - (residual / size**2)[:, None] * geometry.belt
    values = np.column_stack([crossed(arm, up), up, up * contacts.counts[:, None], by_belt])
    columns = columns_of(unknowns.poses[contacts.pose], unknowns.travel, unknowns.belt)
    return Rows(residual, columns, values)


def _placed(geometry: Geometry, pose: Integers, board_mm: Floats, counts: Floats) -> tuple[Floats, Floats]:
    """Give places on the board turned into the camera's axes, and in the camera's frame, mm."""
    arm = (geometry.rotation[pose] @ board_mm[:, :, None])[:, :, 0]
    return arm, arm + geometry.shift[pose] + counts[:, None] * geometry.travel


def _on_print(geometry: Geometry, corners: Corners) -> Floats:
    """Give (mark, 3) places on the board as it is, mm."""
    if geometry.prints.size:
        size = np.exp(geometry.prints[corners.board])
        # the second number is of y over x
        way = np.column_stack([size[:, 0], size[:, 0] * size[:, 1], np.ones(len(size))])
        return np.asarray(corners.board_mm * way)
    if geometry.warp is None:
        return corners.board_mm
    away = geometry.warp.height_mm(corners.board_mm[:, :2])
    return corners.board_mm + np.column_stack([np.zeros((away.size, 2)), away])


def _with_more(rows: Rows, unknown: Integers, derivative: Floats) -> Rows:
    """Add the derivatives by further unknowns, the same ones for all rows or others for each."""
    return Rows(rows.residual, columns_of(rows.columns, unknown), np.column_stack([rows.values, derivative]))


def columns_of(*unknown: Integers) -> Integers:
    """Give (row, …) the columns of unknowns side by side, the same ones for all rows or others for each."""
    rows = max(len(one) for one in unknown if one.ndim == 2)
    whole = [np.broadcast_to(one, (rows, one.shape[-1])) for one in unknown]
    return np.column_stack(whole).astype(np.int64)


@dataclass(frozen=True, eq=False, slots=True)
class Edges:
    """Places in the image that lie on a solid's edges."""

    pose: Integers
    """(edge,) which pose of a solid."""
    face: Floats
    wall: Floats
    """face, wall: (edge, 4) n and d with n·X = d, mm, in the solid's frame: two planes meet in the edge."""
    xy_px: Floats
    std_px: Floats
    """xy_px, std_px: (edge, 2) where a point of the edge is seen, px; (edge,) its standard uncertainty across
    the edge, px."""


_NUMBERS, _WHOLE, _PAIRS = np.empty(0), np.empty(0, np.int64), np.empty((0, 2))


NO_CORNERS = Corners(_WHOLE, np.empty((0, 3)), _PAIRS, _NUMBERS, _WHOLE)


NO_POINTS = StripePoints(_WHOLE, _WHOLE, _NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS)


NO_CONTACTS = BeltContacts(_WHOLE, np.empty((0, 3)), _NUMBERS)


NO_EDGES = Edges(_WHOLE, np.empty((0, 4)), np.empty((0, 4)), _PAIRS, _NUMBERS)


def edge_rows(geometry: Geometry, unknowns: Unknowns, edges: Edges) -> Rows:
    """Give distances in the image, px, of the places from the edges' lines.

    Through the camera's centre and the edge of the planes n·X = δ (face) and w·X = ω (wall) goes the plane
    (δ w − ω n)·m = 0 of rays m. The left side over the size of its slope in the image is the distance.
    """
    if not edges.pose.size:
        return Rows(np.empty(0), np.empty((0, CAMERA + 9), np.int64), np.empty((0, CAMERA + 9)))
    turn, shift = geometry.rotation[edges.pose], geometry.shift[edges.pose]
    face = (turn @ edges.face[:, :3, None])[:, :, 0]
    wall = (turn @ edges.wall[:, :3, None])[:, :, 0]
    to_face = (face * shift).sum(axis=1) + edges.face[:, 3]
    to_wall = (wall * shift).sum(axis=1) + edges.wall[:, 3]
    line = to_face[:, None] * wall - to_wall[:, None] * face
    focal = geometry.camera[:2]
    seen = (edges.xy_px - geometry.camera[2:4]) / focal
    ray = rays(geometry.camera, edges.xy_px)
    lens = distort(ray[:, :2], geometry.camera[4:])
    by_seen = by_distorted(line, lens)
    slope = np.sqrt(((by_seen / focal) ** 2).sum(axis=1))
    on_face, on_wall = (face * ray).sum(axis=1)[:, None], (wall * ray).sum(axis=1)[:, None]
    # derivatives of the line's left side by turn and shift of the solid
    by_turn = (
        crossed(face, shift) * on_wall
        + to_face[:, None] * crossed(wall, ray)
        - crossed(wall, shift) * on_face
        - to_wall[:, None] * crossed(face, ray)
    )
    by_shift = face * on_wall - wall * on_face
    values = np.zeros((len(ray), CAMERA + 9))
    values[:, : CAMERA + 6] = np.column_stack([_by_camera(geometry, seen, lens, by_seen), by_turn, by_shift])
    values /= slope[:, None]
    columns = columns_of(unknowns.camera, unknowns.poses[edges.pose], unknowns.travel)
    return Rows((line * ray).sum(axis=1) / slope, columns, values)
