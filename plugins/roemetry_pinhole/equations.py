"""Observation equations: marks, stripes, feet and edges, with their derivatives.

Observation equations: what camera, poses, planes and belt say the image shows, and derivatives.

Observation equations of straight edges of a solid: where a face ends at a wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_pinhole.geometry import CAMERA, Bend, Distorted, Geometry, Unknowns, crossed, distort, undistort

_BENT_ROUNDS = 3

ON_BELT = -1
"""Pose of stripe points that lie on the bare belt."""


@dataclass(frozen=True, eq=False, slots=True)
class Corners:
    """Marks of the board seen in images.

    Attributes
    ----------
    pose
        (mark,) which pose of the board.
    board_mm
        (mark, 3) place on the board, mm: x along its columns, y along its rows, z away from the camera.
    xy_px
        (mark, 2) where it is seen, px.
    counts
        (mark,) encoder counts the belt has carried the board on since the pose was defined.
    """

    pose: Integers
    board_mm: Floats
    xy_px: Floats
    counts: Floats


@dataclass(frozen=True, eq=False, slots=True)
class StripePoints:
    """Peaks of stripes on boards and on the belt.

    Attributes
    ----------
    pose
        (point,) which pose of the board, or `ON_BELT`.
    stripe
        (point,) which plane of light.
    x_px, row_px
        (point,) where the peak is, px.
    std_px
        (point,) standard uncertainty of `x_px`, px, up to a common factor.
    counts
        (point,) as for corners.
    face
        (point, 4) n and d with n·X = d, mm, in the pose's own frame: the plane of the surface the point lies
        on; None where all lie on boards, whose surface is (0, 0, 1, 0).
    """

    pose: Integers
    stripe: Integers
    x_px: Floats
    row_px: Floats
    std_px: Floats
    counts: Floats
    face: Floats | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Feet:
    """Points of boards that touch the belt: (foot,) pose, (foot, 3) place on the board, mm, and counts."""

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
    arm, at = _placed(geometry, corners.pose, _bent_marks(geometry, corners), corners.counts)
    depth = at[:, 2]
    xy = at[:, :2] / depth[:, None]
    lens = distort(xy, geometry.camera[4:])
    focal, middle = geometry.camera[:2], geometry.camera[2:4]
    residual = lens.xy * focal + middle - corners.xy_px
    by_at = np.zeros((depth.size, 2, 3))
    by_at[:, :, :2] = lens.by_place / depth[:, None, None]
    by_at[:, :, 2] = -(lens.by_place @ xy[:, :, None])[:, :, 0] / depth[:, None]
    by_at *= focal[:, None]
    values = np.zeros((depth.size, 2, CAMERA + 9))
    values[:, 0, 0], values[:, 1, 1] = lens.xy[:, 0], lens.xy[:, 1]
    values[:, 0, 2] = values[:, 1, 3] = 1.0
    values[:, :, 4:CAMERA] = lens.by_coefficient * focal[:, None]
    values[:, :, CAMERA : CAMERA + 3] = crossed(arm[:, None, :], by_at)
    values[:, :, CAMERA + 3 : CAMERA + 6] = by_at
    values[:, :, CAMERA + 6 :] = by_at * corners.counts[:, None, None]
    columns = columns_of(unknowns.camera, unknowns.poses[corners.pose], unknowns.travel)
    rows = Rows(residual.ravel(), np.repeat(columns, 2, axis=0), values.reshape(-1, CAMERA + 9))
    if unknowns.bend.size and geometry.bend is not None:
        away = (by_at @ geometry.rotation[corners.pose][:, :, 2:]).reshape(-1, 1)
        by_bend = np.repeat(geometry.bend.by_coefficient(corners.board_mm[:, :2]), 2, axis=0)
        rows = _with_bend(rows, unknowns, away * by_bend)
    return rows


def corner_residuals(geometry: Geometry, corners: Corners) -> Floats:
    """Give predicted − seen, px, x and y in turn, without derivatives."""
    at = _placed(geometry, corners.pose, _bent_marks(geometry, corners), corners.counts)[1]
    seen = distort(at[:, :2] / at[:, 2:], geometry.camera[4:]).xy * geometry.camera[:2] + geometry.camera[2:4]
    return np.ravel(seen - corners.xy_px)


def stripe_rows(geometry: Geometry, unknowns: Unknowns, points: StripePoints) -> Rows:
    """Give seen − predicted along the image row, px.

    Plane of light p·X = 1 and board n·X = δ meet in a line whose rays m keep (δ p − n)·m = 0; on the belt
    b·X = 1 it is (p − b)·m = 0. The left side over its slope along the row is the way to the predicted
    place; there, not where the noisy peak is, the derivatives are taken: else they would share its noise.
    """
    where = _Lines(geometry, points)
    way = where.way_px(points.x_px)[0]
    more, seen, lens, ray, by_seen, slope = where.way_px(points.x_px - way)
    focal = geometry.camera[:2]
    values = np.zeros((way.size, CAMERA + 15))
    values[:, 0:2] = -by_seen * seen / focal
    values[:, 2:4] = -by_seen / focal
    values[:, 4:CAMERA] = -(by_seen[:, None, :] @ lens.by_coefficient)[:, 0, :]
    of_plane = (ray * where.plane).sum(axis=1)[:, None]
    turn = of_plane * crossed(where.normal, where.place) - crossed(where.normal, ray)
    board = ~where.on_belt[:, None]
    values[:, CAMERA : CAMERA + 3] = np.where(board, turn, 0.0)
    values[:, CAMERA + 3 : CAMERA + 6] = np.where(board, of_plane * where.normal, 0.0)
    values[:, CAMERA + 6 : CAMERA + 9] = values[:, CAMERA + 3 : CAMERA + 6] * points.counts[:, None]
    values[:, CAMERA + 9 : CAMERA + 12] = ray * np.where(where.on_belt, 1.0, where.distance)[:, None]
    values[:, CAMERA + 12 :] = np.where(board, 0.0, -ray)
    poses = np.full((way.size, 6), -1)
    if unknowns.poses.size:
        poses = np.where(board, unknowns.poses[np.maximum(points.pose, 0)], -1)
    columns = np.column_stack(
        [
            columns_of(unknowns.camera, poses, unknowns.travel),
            unknowns.planes[points.stripe],
            np.where(board, -1, unknowns.belt),
        ]
    )
    values /= slope[:, None]
    rows = Rows(way + more, columns, values)
    if unknowns.bend.size and where.by_bend is not None:
        rows = _with_bend(rows, unknowns, of_plane * where.by_bend / slope[:, None])
    return rows


def stripe_residuals(geometry: Geometry, points: StripePoints) -> Floats:
    """Give seen − predicted along the image row, px, without derivatives."""
    where = _Lines(geometry, points)
    way = where.way_px(points.x_px)[0]
    return way + where.way_px(points.x_px - way)[0]


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
        self.by_bend: Floats | None = None
        if geometry.bend is not None and points.face is None:
            self._bend(geometry, geometry.bend, points)
        belt = geometry.belt if self.on_belt.any() else np.zeros(3)
        self._line = np.where(
            self.on_belt[:, None], self.plane - belt, self.distance[:, None] * self.plane - self.normal
        )

    def _bend(self, geometry: Geometry, bend: Bend, points: StripePoints) -> None:
        """Put in place of a board's plane the one that touches it where the ray meets it."""
        on = np.flatnonzero(~self.on_belt)
        rotation, place = geometry.rotation[points.pose[on]], self.place[on]
        seen = np.column_stack([points.x_px, points.row_px])[on]
        xy = undistort((seen - self._camera[2:4]) / self._camera[:2], self._camera[4:])
        ray = np.column_stack([xy, np.ones(len(xy))])
        normal, distance = self.normal[on], self.distance[on]
        for _ in range(_BENT_ROUNDS):
            at = ray * (distance / (normal * ray).sum(axis=1))[:, None]
            there = ((at - place)[:, None, :] @ rotation)[:, 0, :2]
            own = np.column_stack([-bend.slopes(there), np.ones(on.size)])
            own /= np.sqrt((own**2).sum(axis=1))[:, None]
            normal = (rotation @ own[:, :, None])[:, :, 0]
            touched = np.column_stack([there, bend.height_mm(there)])
            distance = (normal * place).sum(axis=1) + (own * touched).sum(axis=1)
        self.normal[on], self.distance[on] = normal, distance
        self.by_bend = np.zeros((len(self.on_belt), bend.coefficients_mm.size))
        self.by_bend[on] = own[:, 2:] * bend.by_coefficient(there)

    def way_px(self, x_px: Floats) -> tuple[Floats, Floats, Distorted, Floats, Floats, Floats]:
        """Give the way to the line along the row, px; place in the bent image, lens, ray, ∂/∂place, slope."""
        focal = self._camera[:2]
        seen = np.empty((x_px.size, 2))
        seen[:, 0] = (x_px - self._camera[2]) / focal[0]
        seen[:, 1] = (self._row_px - self._camera[3]) / focal[1]
        xy = undistort(seen, self._camera[4:], self._straight)
        lens = distort(xy, self._camera[4:])
        self._straight = xy
        ray = np.ones((x_px.size, 3))
        ray[:, :2] = xy
        by_seen = by_bent(self._line, lens)
        slope = by_seen[:, 0] / focal[0]
        return (self._line * ray).sum(axis=1) / slope, seen, lens, ray, by_seen, slope


def by_bent(line: Floats, lens: Distorted) -> Floats:
    """Give (n, 2) the derivatives of line·ray by the ray's place in the bent image; line is (n, 3)."""
    a, b, c, d = (lens.by_place[:, i, j] for i in (0, 1) for j in (0, 1))
    area = a * d - b * c
    u, v = line[:, 0] / area, line[:, 1] / area
    derivatives = np.empty((len(line), 2))
    derivatives[:, 0] = u * d - v * c
    derivatives[:, 1] = v * a - u * b
    return derivatives


def foot_rows(geometry: Geometry, unknowns: Unknowns, feet: Feet) -> Rows:
    """Give heights of the boards' undersides over the belt, mm; they should be 0."""
    arm, at = _placed(geometry, feet.pose, feet.board_mm, feet.counts)
    size = float(np.sqrt((geometry.belt**2).sum()))
    up = np.broadcast_to(-geometry.belt / size, at.shape)
    residual = (1.0 - at @ geometry.belt) / size
    by_belt = -at / size - (residual / size**2)[:, None] * geometry.belt
    values = np.column_stack([crossed(arm, up), up, up * feet.counts[:, None], by_belt])
    columns = np.column_stack(
        [
            unknowns.poses[feet.pose],
            np.broadcast_to(unknowns.travel, (residual.size, 3)),
            np.broadcast_to(unknowns.belt, (residual.size, 3)),
        ]
    )
    return Rows(residual, columns.astype(np.int64), values)


def foot_residuals(geometry: Geometry, feet: Feet) -> Floats:
    """Give heights of the boards' undersides over the belt, mm, without derivatives."""
    at = _placed(geometry, feet.pose, feet.board_mm, feet.counts)[1]
    return np.asarray((1.0 - at @ geometry.belt) / float(np.sqrt((geometry.belt**2).sum())))


def _placed(geometry: Geometry, pose: Integers, board_mm: Floats, counts: Floats) -> tuple[Floats, Floats]:
    """Give places on the board turned into the camera's axes, and in the camera's frame, mm."""
    arm = (geometry.rotation[pose] @ board_mm[:, :, None])[:, :, 0]
    return arm, arm + geometry.shift[pose] + counts[:, None] * geometry.travel


def _bent_marks(geometry: Geometry, corners: Corners) -> Floats:
    """Give (mark, 3) places on the board as it is, mm."""
    if geometry.bend is None:
        return corners.board_mm
    away = geometry.bend.height_mm(corners.board_mm[:, :2])
    return corners.board_mm + np.column_stack([np.zeros((away.size, 2)), away])


def _with_bend(rows: Rows, unknowns: Unknowns, by_bend: Floats) -> Rows:
    """Add the derivatives by the board's shape."""
    more = np.broadcast_to(unknowns.bend, (len(rows.columns), unknowns.bend.size))
    return Rows(rows.residual, np.column_stack([rows.columns, more]), np.column_stack([rows.values, by_bend]))


def columns_of(camera: Integers, poses: Integers, travel: Integers) -> Integers:
    """Give (row, 21) the columns of camera, pose and travel."""
    rows = poses.shape[0]
    return np.column_stack(
        [np.broadcast_to(camera, (rows, camera.size)), poses, np.broadcast_to(travel, (rows, 3))]
    ).astype(np.int64)


@dataclass(frozen=True, eq=False, slots=True)
class Edges:
    """Places in the image that lie on a solid's edges.

    Attributes
    ----------
    pose
        (edge,) which pose of a solid.
    face, wall
        (edge, 4) n and d with n·X = d, mm, in the solid's frame: the two planes that meet in the edge.
    xy_px
        (edge, 2) where a point of the edge is seen, px.
    std_px
        (edge,) its standard uncertainty across the edge, px.
    """

    pose: Integers
    face: Floats
    wall: Floats
    xy_px: Floats
    std_px: Floats


def no_edges() -> Edges:
    """Give none."""
    none, plane = np.empty(0), np.empty((0, 4))
    return Edges(none.astype(np.int64), plane, plane, np.empty((0, 2)), none)


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
    xy = undistort(seen, geometry.camera[4:])
    lens = distort(xy, geometry.camera[4:])
    ray = np.column_stack([xy, np.ones(len(xy))])
    by_seen = by_bent(line, lens)
    slope = np.sqrt(((by_seen / focal) ** 2).sum(axis=1))
    on_face, on_wall = (face * ray).sum(axis=1)[:, None], (wall * ray).sum(axis=1)[:, None]
    values = np.zeros((len(xy), CAMERA + 9))
    values[:, 0:2] = -by_seen * seen / focal
    values[:, 2:4] = -by_seen / focal
    values[:, 4:CAMERA] = -(by_seen[:, None, :] @ lens.by_coefficient)[:, 0, :]
    values[:, CAMERA : CAMERA + 3] = (
        crossed(face, shift) * on_wall
        + to_face[:, None] * crossed(wall, ray)
        - crossed(wall, shift) * on_face
        - to_wall[:, None] * crossed(face, ray)
    )
    values[:, CAMERA + 3 : CAMERA + 6] = face * on_wall - wall * on_face
    values /= slope[:, None]
    columns = columns_of(unknowns.camera, unknowns.poses[edges.pose], unknowns.travel)
    return Rows((line * ray).sum(axis=1) / slope, columns, values)
