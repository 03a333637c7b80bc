"""Where every stripe truly is: planes cut with triangles in float64, without the renderer.

A laser plane meets a mesh in straight segments, one a face, and the belt in a line. Where such a segment
crosses the middle of an image row follows from the camera's projection, solved along the segment to 1e-10 px
by secants (distortion bends the row's ray sheet, so no closed form). A crossing counts if its face
looks at camera and projector, and no other face stands between it and either; these two tests are exact ray
against triangle tests, over bins of a central projection onto the belt.

Faces flatter than the test's margin of 3e-7 of the distance (0.1 µm) do not shadow each other. Where a plane
is both lit and seen at several places of a row, all are told; the first is that on a body, then the highest.

It assumes closed meshes, and that camera and projector are above all of them. It fails where a segment runs
along a row: the crossing is hardly determined there, and of a segment that lies in the row none is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records import StripeTruth
from roemetry_kernels.compiling import kernel
from roemetry_mitsuba.bodies import Body
from roemetry_mitsuba.scene import Camera, Fan

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_BIN_MM = 1.0
"""Side of the bins that faces are sorted into: about a face's size, so that a bin holds few."""
_MARGIN = 3e-7
"""Of the distance to the light: a face nearer than this to its own point does not shadow it (0.1 µm)."""
_BELT_STEP_MM = 2.0
"""Pieces of a line on the belt, so short that a row crosses a piece once."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """All N places where a stripe is lit and seen, by stripe and row; of several, the first is told.

    Column `x_px` and point `xyz_mm`, shape (N, 3), belt frame; `label` is 0 on the belt, k on the k-th
    body; `shape` counts stripes and rows.
    """

    stripe: Integers
    row: Integers
    x_px: Floats
    xyz_mm: Floats
    label: Integers
    shape: tuple[int, int]

    def first(self) -> NDArray[np.bool_]:
        """Mark the first of each stripe and row."""
        key = self.stripe * self.shape[1] + self.row
        return np.concatenate([[True], key[1:] != key[:-1]]) if len(key) else np.zeros(0, np.bool_)

    def on_bodies(self) -> Crossings:
        """Give those on bodies."""
        on = self.label > 0
        return Crossings(
            self.stripe[on], self.row[on], self.x_px[on], self.xyz_mm[on], self.label[on], self.shape
        )

    def record(self) -> StripeTruth:
        """Give the record of a data set: the first of each stripe and row."""
        x = np.full(self.shape, np.nan)
        xyz = np.full((*self.shape, 3), np.nan)
        product = np.full(self.shape, -1, dtype=np.int16)
        first = self.first()
        at = self.stripe[first], self.row[first]
        x[at], xyz[at], product[at] = self.x_px[first], self.xyz_mm[first], self.label[first]
        return StripeTruth(x, product > 0, xyz, product)


class _Found(NamedTuple):
    """Crossings before they are judged: stripe, row, column (px), point (mm), face (-1: the belt)."""

    stripe: Integers
    row: Integers
    x_px: Floats
    points: Floats
    face: Integers

    def at(self, which: NDArray[Any]) -> _Found:
        """Give some of them, by flags or in an order."""
        return _Found(*(column[which] for column in self))


def crossings(camera: Camera, fan: Fan, bodies: Sequence[Body]) -> Crossings:
    """Find where every stripe crosses the middle of every image row on what is lit and seen."""
    empty = np.zeros((0, 3, 3))
    owner = np.repeat(np.arange(1, len(bodies) + 1), [len(body.faces) for body in bodies])
    corners = np.concatenate([empty, *(body.corners_mm for body in bodies)])
    parts = []
    # stripes without light have no truth
    for i in np.flatnonzero(fan.peak_grey > 0.0):
        ends, faces = _cut(corners, fan.normals[i], float(fan.offsets_mm[i]))
        belt = _on_belt(camera, fan, int(i))
        ends = np.concatenate([ends, belt])
        faces = np.concatenate([faces, np.full(len(belt), -1)])
        row, points, which = _rows(camera, ends)
        parts.append(_Found(np.full(len(row), i), row, camera.project(points)[:, 0], points, faces[which]))
    found = _Found(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    # pixels' middles are whole numbers: the image ends half a pixel further out
    found = found.at((found.x_px >= -0.5) & (found.x_px <= camera.width_px - 0.5))
    # only where the projector's line has light
    beam = found.points - fan.origin_mm
    run = beam @ fan.axis / np.linalg.norm(beam, axis=1)
    found = found.at((run >= fan.runs[0]) & (run <= fan.runs[1]))
    for source in (camera.centre_mm, fan.origin_mm):
        found = found.at(_faces_it(found.points, found.face, corners, source))
        found = found.at(~_hidden(found.points, found.face, corners, source))
    label = np.zeros(len(found.face), dtype=np.int64)
    label[found.face >= 0] = owner[found.face[found.face >= 0]]
    order = np.lexsort((found.x_px, -found.points[:, 2], label == 0, found.row, found.stripe))
    found, label = found.at(order), label[order]
    # a crossing on an edge belongs to both of its faces: one of them is left out
    keep = np.ones(len(label), dtype=np.bool_)
    same = (found.stripe[1:] == found.stripe[:-1]) & (found.row[1:] == found.row[:-1])
    keep[1:] = ~(same & (np.abs(np.diff(found.x_px)) < 1e-7))
    found = found.at(keep)
    shape = (len(fan.normals), camera.height_px)
    return Crossings(found.stripe, found.row, found.x_px, found.points, label[keep], shape)


def _cut(corners: Floats, normal: Floats, offset: float) -> tuple[Floats, Integers]:
    """Segments, shape (M, 2, 3), in which a plane meets triangles, and which triangles."""
    side = corners @ normal - offset
    # what lies on the plane counts as above, so that a corner is cut once
    above = side >= 0.0
    count = above.sum(axis=1)
    found = np.flatnonzero((count == 1) | (count == 2))
    side, above, cut = side[found], above[found], corners[found]
    # turned so that corner 0 lies alone on its side
    lone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    turn = (lone[:, None] + np.arange(3)) % 3
    side = np.take_along_axis(side, turn, axis=1)
    cut = np.take_along_axis(cut, turn[..., None], axis=1)
    ends = []
    for k in (1, 2):
        t = side[:, 0] / (side[:, 0] - side[:, k])
        ends.append(cut[:, 0] + t[:, None] * (cut[:, k] - cut[:, 0]))
    return np.stack(ends, axis=1), found


def _on_belt(camera: Camera, fan: Fan, i: int) -> Floats:
    """Pieces of the line in which a plane meets the belt, over the view, shape (M, 2, 3)."""
    # 5 mm beyond the view on both sides
    y = camera.border_on(0.0)[:, 1]
    at = np.arange(y.min() - 5.0, y.max() + 5.0 + _BELT_STEP_MM, _BELT_STEP_MM)
    x = (fan.offsets_mm[i] - at * fan.normals[i, 1]) / fan.normals[i, 0]
    line = np.stack([x, at, np.zeros_like(at)], axis=-1)
    return np.stack([line[:-1], line[1:]], axis=1)


def _rows(camera: Camera, ends: Floats) -> tuple[Integers, Floats, Integers]:
    """Where segments cross the middles of image rows: the rows, the points, and of which segment."""
    v = camera.project(ends)[..., 1]
    low, high = v.min(axis=1), v.max(axis=1)
    first = np.maximum(np.ceil(low), 0).astype(np.int64)
    last = np.minimum(np.ceil(high) - 1, camera.height_px - 1).astype(np.int64)  # half open: none twice
    count = np.maximum(last - first + 1, 0)
    which = np.repeat(np.arange(len(ends)), count)
    row = first[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    a, way = ends[which, 0], ends[which, 1] - ends[which, 0]
    va, vb = v[which, 0], v[which, 1]
    t = (row - va) / (vb - va)
    # secants: slopes between the last two places need no derivative of the lens
    slope = vb - va
    t_old, off_old = np.zeros_like(t), va - row
    for _ in range(8):
        off = camera.project(a + t[:, None] * way)[:, 1] - row
        with np.errstate(invalid="ignore", divide="ignore"):
            secant = (off - off_old) / (t - t_old)
        # near the end a difference is rounding: the last slope is kept
        slope = np.where(np.isfinite(secant) & (np.abs(secant) > 0.2 * np.abs(slope)), secant, slope)
        t_old, off_old = t, off
        t = np.clip(t - off / slope, 0.0, 1.0)
        if np.abs(off).max(initial=0.0) < 1e-11:
            break
    return row, a + t[:, None] * way, which


def _faces_it(points: Floats, face: Integers, corners: Floats, source: Floats) -> NDArray[np.bool_]:
    """Whether the faces of points, the belt among them (-1), look at a place."""
    looks = np.ones(len(points), dtype=np.bool_)
    on = face >= 0
    # corners run counter-clockwise, seen from outside: the cross product points outwards
    a, b, c = np.moveaxis(corners[face[on]], 1, 0)
    looks[on] = np.einsum("ti,ti->t", np.cross(b - a, c - a), source - points[on]) > 0.0
    return looks


def _hidden(points: Floats, face: Integers, corners: Floats, source: Floats) -> NDArray[np.bool_]:
    """Whether another face stands between points and a place above all of them."""
    hidden = np.zeros(len(points), dtype=np.bool_)
    if not len(corners) or not len(points):
        return hidden

    # what hides a point from the source falls into its bin in a central projection
    def on_belt(at: Floats) -> Floats:
        along = source[2] / (source[2] - at[..., 2])
        return np.asarray(source[:2] + along[..., None] * (at[..., :2] - source[:2]))

    shadow, points_on_belt = on_belt(corners), on_belt(points)
    low = shadow.min(axis=(0, 1))
    cells = np.maximum(np.ceil((shadow.max(axis=(0, 1)) - low) / _BIN_MM), 1).astype(np.int64)
    boxes = np.concatenate([shadow.min(axis=1), shadow.max(axis=1)], axis=1) - np.tile(low, 2)
    boxes = np.clip(np.floor(boxes / _BIN_MM).astype(np.int64), 0, np.tile(cells - 1, 2))
    start, member = _binned(boxes, int(cells[0]), int(cells[1]))
    _between(
        np.ascontiguousarray(points), face, np.floor((points_on_belt - low) / _BIN_MM).astype(np.int64),
        np.ascontiguousarray(corners), np.ascontiguousarray(source), start, member,
        int(cells[0]), int(cells[1]), hidden,
    )  # fmt: skip
    return hidden


@kernel
def _binned(boxes: Integers, columns: int, rows: int) -> tuple[Integers, Integers]:
    """List the faces of every bin: bin b's are member[start[b] : start[b + 1]]."""
    start = np.zeros(columns * rows + 1, np.int64)
    for f in range(boxes.shape[0]):
        for j in range(boxes[f, 1], boxes[f, 3] + 1):
            for i in range(boxes[f, 0], boxes[f, 2] + 1):
                start[j * columns + i + 1] += 1
    for b in range(columns * rows):
        start[b + 1] += start[b]
    member = np.empty(start[-1], np.int64)
    at = start.copy()
    for f in range(boxes.shape[0]):
        for j in range(boxes[f, 1], boxes[f, 3] + 1):
            for i in range(boxes[f, 0], boxes[f, 2] + 1):
                b = j * columns + i
                member[at[b]] = f
                at[b] += 1
    return start, member


@kernel
def _between(
    points: Floats, own: Integers, bins: Integers, corners: Floats, source: Floats, start: Integers,
    member: Integers, columns: int, rows: int, hidden: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Mark points with a face strictly between them and the source (Möller and Trumbore's test)."""
    for p in range(points.shape[0]):
        i, j = bins[p, 0], bins[p, 1]
        if i < 0 or j < 0 or i >= columns or j >= rows:
            continue
        dx, dy, dz = points[p, 0] - source[0], points[p, 1] - source[1], points[p, 2] - source[2]
        b = j * columns + i
        for m in range(start[b], start[b + 1]):
            f = member[m]
            if f == own[p]:
                continue
            a, q, r = corners[f, 0], corners[f, 1], corners[f, 2]
            ex, ey, ez = q[0] - a[0], q[1] - a[1], q[2] - a[2]
            gx, gy, gz = r[0] - a[0], r[1] - a[1], r[2] - a[2]
            hx, hy, hz = dy * gz - dz * gy, dz * gx - dx * gz, dx * gy - dy * gx
            det = ex * hx + ey * hy + ez * hz
            # the ray runs along the face
            if det == 0.0:
                continue
            sx, sy, sz = source[0] - a[0], source[1] - a[1], source[2] - a[2]
            u = (sx * hx + sy * hy + sz * hz) / det
            if u < 0.0 or u > 1.0:
                continue
            kx, ky, kz = sy * ez - sz * ey, sz * ex - sx * ez, sx * ey - sy * ex
            v = (dx * kx + dy * ky + dz * kz) / det
            if v < 0.0 or u + v > 1.0:
                continue
            t = (gx * kx + gy * ky + gz * kz) / det
            # strictly before the point, by the margin
            if 0.0 < t < 1.0 - _MARGIN:
                hidden[p] = True
                break
