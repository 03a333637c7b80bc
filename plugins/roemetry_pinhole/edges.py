"""Observation equations of straight edges of a solid: where a face ends at a wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry_pinhole.equations import Rows, by_bent, columns_of
from roemetry_pinhole.geometry import CAMERA, Geometry, Unknowns, crossed
from roemetry_pinhole.lens import bent, straightened


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
    xy = straightened(seen, geometry.camera[4:])
    lens = bent(xy, geometry.camera[4:])
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
