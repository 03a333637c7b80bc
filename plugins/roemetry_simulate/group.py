"""Several products on the belt as one body for the kernels, and which of them a point lies on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roemetry_simulate.bodies import FIELDS, PARTS, ExactBody, Fields, Reach
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.mesh import MeshSolid
from roemetry_simulate.products.parts import PartsSolid, box, placed
from roemetry_simulate.solid import Block, GriddedSolid, Solid

Floats = NDArray[np.float64]

_NEAR_MM = 0.5


@dataclass(frozen=True, eq=False)
class Group:
    """Solids that do not touch each other.

    Attributes
    ----------
    members : tuple of Solid
        All gridded, all of exact parts (or blocks), or all meshes.
    """

    members: tuple[Solid, ...]

    @property
    def visible_volume_mm3(self) -> float:
        """Sum of the members' visible volumes."""
        return sum(one.visible_volume_mm3 for one in self.members)

    @property
    def true_volume_mm3(self) -> float:
        """Sum of the members' volumes."""
        return sum(one.true_volume_mm3 for one in self.members)

    @property
    def footprint_mm2(self) -> float:
        """Sum of the members' footprints."""
        return sum(one.footprint_mm2 for one in self.members)

    def heights_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Highest and lowest Z over belt positions of one shape; NaN outside all footprints."""
        found = [one.heights_mm(x_mm, y_mm) for one in self.members]
        top, bottom = found[0]
        for higher, lower in found[1:]:
            top, bottom = np.fmax(top, higher), np.fmin(bottom, lower)
        return top, bottom

    def footprint_extent_mm(self) -> tuple[float, float, float, float]:
        """Smallest and largest X, smallest and largest Y of all footprints, millimetres."""
        ends = np.array([one.footprint_extent_mm() for one in self.members])
        return (
            float(ends[:, 0].min()),
            float(ends[:, 1].max()),
            float(ends[:, 2].min()),
            float(ends[:, 3].max()),
        )

    def body(self) -> ExactBody | Fields:
        """Return the kernels' form."""
        members = [_parts_of(one) if isinstance(one, Block) else one for one in self.members]
        gridded = [one for one in members if isinstance(one, GriddedSolid)]
        exact = [one for one in members if isinstance(one, PartsSolid)]
        meshes = [one for one in members if isinstance(one, MeshSolid)]
        if len(gridded) == len(members):
            return _fields(gridded)
        if len(exact) == len(members):
            return _parts(exact)
        if len(meshes) == len(members):
            corners = np.concatenate([one.corners_mm for one in meshes])
            return MeshSolid(corners, np.nan, np.nan, np.nan).body()
        raise TypeError("the solids of a group are of one kind")

    def member_at(self, points_mm: Floats) -> NDArray[np.int16]:
        """Tell which member, from 1, each of some points (n, 3) of their skins belongs to."""
        label = np.zeros(len(points_mm), np.int16)
        around = [
            (0.0, 0.0),
            *((_NEAR_MM * np.cos(a), _NEAR_MM * np.sin(a)) for a in np.arange(8) * np.pi / 4),
        ]
        for dx, dy in around:
            for number, one in enumerate(self.members, start=1):
                over = np.isfinite(one.heights_mm(points_mm[:, 0] + dx, points_mm[:, 1] + dy)[0])
                label[(label == 0) & over] = number
        left = label == 0
        if left.any():
            # a wall that leans out by more than that: the nearest footprint's extent
            x, y = points_mm[left, 0], points_mm[left, 1]
            ends = [one.footprint_extent_mm() for one in self.members]
            off = [
                np.hypot(np.fmax(np.fmax(a - x, x - b), 0.0), np.fmax(np.fmax(c - y, y - d), 0.0))
                for a, b, c, d in ends
            ]
            label[left] = 1 + np.argmin(off, axis=0)
        return label


def lying_together(solids: Sequence[Solid]) -> Solid:
    """Return one solid for the kernels: the only one itself, or a group."""
    return solids[0] if len(solids) == 1 else Group(tuple(solids))


def _fields(members: Sequence[GriddedSolid]) -> Fields:
    places, first = [], 0
    for one in members:
        body, (rows, columns) = one.body(), one.grid.shape[:2]
        places.append(
            [body.x0_mm, body.y0_mm, body.step_mm, body.top_mm, body.mid_slope, body.u_slope_mm,
             float(first), float(rows), float(columns)]
        )  # fmt: skip
        first += rows * columns
    nodes, table = np.concatenate([one.grid.reshape(-1, 3) for one in members]), np.array(places)
    for array in (nodes, table):
        array.flags.writeable = False
    reach = _reach([one.body().reach for one in members])
    return Fields(FIELDS, reach, reach[5], nodes, table)


def _parts(members: Sequence[PartsSolid]) -> ExactBody:
    tables, first = [], 0.0
    for one in members:
        table = one.surfaces.copy()
        table[:, 0] += first
        first = float(table[-1, 0]) + 1.0
        tables.append(table)
    reach = _reach([one.body().reach for one in members])
    surfaces, bounds = np.concatenate(tables), np.array([reach])
    for array in (surfaces, bounds):
        array.flags.writeable = False
    return ExactBody(PARTS, reach, reach[5], surfaces=surfaces, boxes=bounds)


def _parts_of(block: Block) -> PartsSolid:
    half_x, half_y, height = 0.5 * block.length_mm, 0.5 * block.width_mm, block.height_mm
    sides = box((-half_x, half_x), (-half_y, half_y), (0.0, height))
    pose = Pose(block.centre_x_mm, block.centre_y_mm, block.yaw_deg)
    volumes = block.visible_volume_mm3, block.true_volume_mm3, block.footprint_mm2
    return PartsSolid(placed([sides], pose), *volumes, block.footprint_extent_mm(), height)


def _reach(boxes: Sequence[Reach]) -> Reach:
    low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
    return (float(low[0]), float(low[1]), float(low[2]), float(high[3]), float(high[4]), float(high[5]))
