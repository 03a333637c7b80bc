"""Which face of a solid each peak lies on, by a geometry that is nearly right, and where faces end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry_pinhole.edges import Edges
from roemetry_pinhole.equations import ON_BELT, StripePoints
from roemetry_pinhole.geometry import Geometry
from roemetry_pinhole.solid_shapes import Shape, footprint, inside, off_surface
from roemetry_pinhole.solid_start import Numbered, renumbered

_GAP_ROWS_MAX = 3.0
_ON_FACE_MIN = 4
_RIM_SHARE = 0.1
_EDGE_PX = 0.6
_SOMEWHERE_SHARE = 0.5
_NOWHERE, _BELT = -2, -1


@dataclass(frozen=True, eq=False, slots=True)
class Assigned:
    """Peaks on belt and faces, and ends of faces; by number, so that other lengths can be put in.

    Attributes
    ----------
    points
        Of the adjustment, their `face` not yet given.
    solid, face
        (point,) number of the view's solid and of the face on it, −1 on the belt.
    edges
        Of the adjustment; `face` and `wall` not yet given.
    edge_solid, edge_face, edge_side
        (edge,) solid, face and which of its walls; −1 for the one that says that the solid is in the image.
    left_share
        Share of the peaks that lie nowhere.
    """

    points: StripePoints
    solid: Integers
    face: Integers
    edges: Edges
    edge_solid: Integers
    edge_face: Integers
    edge_side: Integers
    left_share: float

    def placed(self, shapes: list[Shape]) -> tuple[StripePoints, Edges]:
        """Give points and edges with the planes of these shapes."""
        plane = np.tile([0.0, 0.0, 1.0, 0.0], (self.face.size, 1))
        for number, shape in enumerate(shapes):
            planes = np.array([one.plane for one in shape.faces])
            mine = (self.solid == number) & (self.face >= 0)
            plane[mine] = planes[self.face[mine]]
        face, wall = np.empty((self.edge_face.size, 4)), np.empty((self.edge_face.size, 4))
        for row, (solid, at, side) in enumerate(
            zip(self.edge_solid, self.edge_face, self.edge_side, strict=True)
        ):
            one = shapes[solid].faces[at]
            face[row] = one.plane
            wall[row] = one.walls[side] if side >= 0 else (1.0, 0.0, 0.0, 0.0)
        return replace(self.points, face=plane), replace(self.edges, face=face, wall=wall)


def assigned(
    geometry: Geometry,
    bare: list[Numbered],
    views: list[Numbered],
    shapes: list[Shape],
    first_pose: int,
    image_size: tuple[int, int],
    *,
    off_share: float,
    rim_share: float,
    points_max: int,
) -> Assigned:
    """Assign peaks to belt and faces.

    Parameters
    ----------
    geometry
        Nearly right; the solids' poses are the last ones.
    bare
        Images of the empty belt.
    views, shapes
        Images of solids, and what each shows.
    first_pose
        Number of the first solid's pose.
    image_size
        Rows and columns.
    off_share, rim_share
        How far off a face its points may be, in solid's heights; how far within its rim they must lie, in
        solid's extents.
    points_max
        How many peaks are taken at most: every so many-th.
    """
    every = sum(view.stripe.size for view in [*bare, *views])
    step = max(1, -(-every // points_max))
    points, edges, kept = [], [], 0
    for view in bare:
        points.append(_rows(view, ON_BELT, np.full(view.stripe.size, 0), np.full(view.stripe.size, _BELT)))
        kept += view.stripe.size
    for number, (view, shape) in enumerate(zip(views, shapes, strict=True)):
        pose = first_pose + number
        xyz = _on_solid(geometry, view, pose)
        face, core = _faces(xyz, shape, off_share * shape.height_mm, rim_share * shape.along_mm)
        kept += int((face != _NOWHERE).sum())
        solid = np.full(view.stripe.size, number)
        table = _rows(view, pose, solid, np.where(core, face, _NOWHERE))
        points.append(table[np.where(core, face, _NOWHERE) != _NOWHERE])
        edges += [(pose, number, *end) for end in _ends(view, face, xyz[:, 1], shape)]
        middle = (0.5 * (image_size[1] - 1), 0.5 * (image_size[0] - 1))
        edges.append((pose, number, shape.top, -1, *middle, _SOMEWHERE_SHARE * image_size[1]))
    table = np.concatenate(points)[::step]
    rims = np.array(edges, np.float64).reshape(-1, 7)
    none = np.empty((len(rims), 4))
    x_px, row_px, std_px = np.ascontiguousarray(table[:, 2:5].T)
    on = np.where(table[:, 6] < 0, ON_BELT, table[:, 0]).astype(np.int64)
    found = StripePoints(on, table[:, 1].astype(np.int64), x_px, row_px, std_px, np.zeros(len(table)))
    of_solid, of_face, side = (rims[:, column].astype(np.int64) for column in (1, 2, 3))
    return Assigned(
        found,
        table[:, 5].astype(np.int64),
        table[:, 6].astype(np.int64),
        Edges(rims[:, 0].astype(np.int64), none, none, rims[:, 4:6], rims[:, 6]),
        of_solid,
        of_face,
        side,
        left_share=1.0 - kept / max(every, 1),
    )


def _rows(view: Numbered, pose: int, solid: Integers, face: Integers) -> Floats:
    """(peak, 7) pose, stripe, x, row, standard uncertainty, solid, face."""
    same = np.ones(view.stripe.size)
    return np.column_stack([pose * same, view.stripe, view.x_px, view.row_px, view.std_px, solid, face])


def _on_solid(geometry: Geometry, view: Numbered, pose: int) -> Floats:
    """(peak, 3) where the peaks' rays meet their planes of light, in the solid's frame, mm."""
    depth = 1.0 / (view.ray * geometry.planes[view.stripe]).sum(axis=1)
    return np.asarray((view.ray * depth[:, None] - geometry.shift[pose]) @ geometry.rotation[pose])


def righted(geometry: Geometry, view: Numbered, shape: Shape, pose: int) -> Numbered:
    """Exchange the numbers of neighbours that a solid's rim has made change places."""
    stripes = len(geometry.planes)
    off = np.full((3, view.stripe.size), np.inf)
    for row, step in enumerate((-1, 0, 1)):
        other = view.stripe + step
        there = (other >= 0) & (other < stripes)
        moved = replace(view, stripe=np.clip(other, 0, stripes - 1))
        near = off_surface(shape, _on_solid(geometry, moved, pose), _RIM_SHARE * shape.along_mm)
        off[row] = np.where(there, near, np.inf)
    return renumbered(view, off)


def _faces(xyz: Floats, shape: Shape, off_mm: float, rim_mm: float) -> tuple[Integers, np.ndarray]:
    """(peak,) face, −1 belt, −2 none; and whether it is well within its rim."""
    face = np.full(len(xyz), _NOWHERE)
    core = np.zeros(len(xyz), np.bool_)
    away = footprint(shape, xyz[:, :2])
    on_belt = (np.abs(xyz[:, 2]) <= off_mm) & (away < rim_mm)
    face[on_belt], core[on_belt] = _BELT, (away < -rim_mm)[on_belt]
    for number, one in enumerate(shape.faces):
        off = np.abs(xyz @ one.plane[:3] - one.plane[3])
        depth = inside(one, xyz[:, :2])
        mine = (off <= off_mm) & (depth > -rim_mm)
        # where two faces meet a point belongs to the one in whose outline it lies
        mine &= (depth > 0.0) | (face == _NOWHERE)
        face[mine], core[mine] = number, depth[mine] > rim_mm
    return face, core


def _ends(view: Numbered, face: Integers, y_mm: Floats, shape: Shape) -> list[tuple[float, ...]]:
    """Where stripes leave a face over one of its walls: face, side, x, row, standard uncertainty."""
    found: list[tuple[float, ...]] = []
    for stripe in np.unique(view.stripe):
        mine = np.flatnonzero(view.stripe == stripe)
        row, x, at = view.row_px[mine], view.x_px[mine], face[mine]
        for number, one in enumerate(shape.faces):
            on = np.flatnonzero(at == number)
            if on.size < _ON_FACE_MIN:
                continue
            for end, inwards in ((on[0], 1), (on[-1], -1)):
                beyond = end - inwards
                if not 0 <= beyond < row.size or abs(row[end] - row[beyond]) > _GAP_ROWS_MAX:
                    continue
                side = int(y_mm[mine[end]] > 0.5 * (one.walls[0, 3] + one.walls[1, 3]))
                if not one.ends[side]:
                    continue
                half = 0.5 * (row[beyond] - row[end])
                found.append(
                    (
                        number,
                        side,
                        x[end] + abs(half) * (x[end] - x[end + inwards]),
                        row[end] + half,
                        _EDGE_PX,
                    )
                )
    return found
