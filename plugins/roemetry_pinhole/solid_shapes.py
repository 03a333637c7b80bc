"""Solids of known shape on the belt: the faces that stripes can lie on, and the edges where they end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from roemetry.arrays import Floats
from roemetry.records import Block, Pyramid, Staircase

Solid = Block | Staircase | Pyramid


@dataclass(frozen=True, eq=False, slots=True)
class Face:
    """One face as seen from above.

    Attributes
    ----------
    plane
        (4,) n and d with n·X = d, mm, in the solid's frame: X across the stripes, Y along them, Z up, origin
        on the belt under its middle.
    corners_mm
        (corner, 2) X and Y of its corners, convex, counter-clockwise.
    walls
        (2, 4) vertical planes at which it ends towards −Y and +Y.
    ends
        Whether it drops there, so that a stripe that crosses it ends at the wall.
    """

    plane: Floats
    corners_mm: Floats
    walls: Floats
    ends: tuple[bool, bool]


@dataclass(frozen=True, eq=False, slots=True)
class Shape:
    """A solid.

    Attributes
    ----------
    kind, name
        For people.
    faces
        All that stripes can lie on, but for the belt.
    top
        Index of its highest level face.
    height_mm
        Height of that face.
    along_mm, along_height_mm
        Extent along the stripes over which they are not on the belt, and the height at its ends.
    wide_top
        Whether all stripes that lie on the solid reach its highest face.
    turns_deg
        Ways round it may lie, as far as its shape tells them apart.
    """

    kind: str
    name: str
    faces: tuple[Face, ...]
    top: int
    height_mm: float
    along_mm: float
    along_height_mm: float
    wide_top: bool
    turns_deg: tuple[float, ...]


def shape_of(solid: Solid) -> Shape:
    """Give the shape of a block, a staircase or a truncated pyramid."""
    match solid:
        case Block():
            return _block(solid)
        case Staircase():
            return _staircase(solid)
        case Pyramid():
            return _pyramid(solid)


def toleranced(solid: Solid) -> tuple[Callable[[float], Solid], ...]:
    """Give, for each length with a tolerance, the solid with that length longer by so many mm."""
    from dataclasses import replace

    match solid:
        case Block():
            return (
                lambda more: replace(solid, height_mm=solid.height_mm + more),
                lambda more: replace(solid, width_mm=solid.width_mm + more),
            )
        case Staircase():
            steps = range(len(solid.heights_mm))
            return (
                *(
                    lambda more, step=step: replace(solid, heights_mm=_longer(solid.heights_mm, step, more))
                    for step in steps
                ),
                lambda more: replace(solid, tread_mm=solid.tread_mm + more / len(solid.heights_mm)),
            )
        case Pyramid():
            return (
                lambda more: replace(solid, base_mm=solid.base_mm + more),
                lambda more: replace(solid, top_mm=solid.top_mm + more),
                lambda more: replace(solid, height_mm=solid.height_mm + more),
            )


def _longer(heights_mm: tuple[float, ...], step: int, more: float) -> tuple[float, ...]:
    return tuple(height + (more if number == step else 0.0) for number, height in enumerate(heights_mm))


def _block(block: Block) -> Shape:
    half = 0.5 * block.width_mm
    top = _level(block.length_mm, -half, half, block.height_mm, (True, True))
    return Shape(
        "block", block.name, (top,), 0, block.height_mm, block.width_mm, block.height_mm, True, (0.0,)
    )


def _staircase(stairs: Staircase) -> Shape:
    heights = stairs.heights_mm
    y = (np.arange(len(heights) + 1) - 0.5 * len(heights)) * stairs.tread_mm
    around = (0.0, *heights, 0.0)
    faces = tuple(
        _level(
            stairs.width_mm,
            float(y[step]),
            float(y[step + 1]),
            height,
            (around[step] < height, around[step + 2] < height),
        )
        for step, height in enumerate(heights)
    )
    top = int(np.argmax(heights))
    ends = 0.5 * (heights[0] + heights[-1])
    alike = heights == heights[::-1]
    turns = (0.0,) if alike else (0.0, 180.0)
    return Shape("staircase", stairs.name, faces, top, heights[top], float(y[-1] - y[0]), ends, True, turns)


def _pyramid(pyramid: Pyramid) -> Shape:
    base, top, height = 0.5 * pyramid.base_mm, 0.5 * pyramid.top_mm, pyramid.height_mm
    none = np.tile([0.0, 1.0, 0.0, 0.0], (2, 1))
    faces = [_level(2.0 * top, -top, top, height, (False, False))]
    for turn in range(4):
        cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn]
        way = np.array([[cos, -sin], [sin, cos]], np.float64)
        # of the side towards +X: X + Z (base − top)/height = base
        normal = np.array([1.0, 0.0, (base - top) / height])
        size = np.sqrt(normal @ normal)
        corners = np.array([[base, -base], [base, base], [top, top], [top, -top]])
        plane = np.array([*(way @ normal[:2]), normal[2], base]) / size
        faces.append(Face(plane, corners @ way.T, none, (False, False)))
    return Shape(
        "truncated-pyramid", pyramid.name, tuple(faces), 0, height, pyramid.base_mm, 0.0, False, (0.0,)
    )


def _level(length: float, low: float, high: float, height: float, ends: tuple[bool, bool]) -> Face:
    half = 0.5 * length
    corners = np.array([[-half, low], [half, low], [half, high], [-half, high]])
    walls = np.array([[0.0, 1.0, 0.0, low], [0.0, 1.0, 0.0, high]])
    return Face(np.array([0.0, 0.0, 1.0, height]), corners, walls, ends)


def inside(face: Face, xy_mm: Floats) -> Floats:
    """Give (point,) how far points lie inside a face's outline, mm; negative outside."""
    corners = face.corners_mm
    along = np.roll(corners, -1, axis=0) - corners
    inwards = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
    off = (xy_mm[:, None, :] - corners) * inwards
    return np.asarray(off.sum(axis=2).min(axis=1))


def footprint(shape: Shape, xy_mm: Floats) -> Floats:
    """Give (point,) how far points lie inside the solid's outline on the belt, mm; negative outside."""
    return np.asarray(np.stack([inside(face, xy_mm) for face in shape.faces]).max(axis=0))


def off_surface(shape: Shape, xyz_mm: Floats, rim_mm: float) -> Floats:
    """Give (point,) how far points in the solid's frame are from belt or faces, mm.

    Near a rim, by less than `rim_mm`, the nearer of both sides counts.
    """
    off = np.where(footprint(shape, xyz_mm[:, :2]) < rim_mm, np.abs(xyz_mm[:, 2]), np.inf)
    for face in shape.faces:
        there = inside(face, xyz_mm[:, :2]) > -rim_mm
        own = np.abs(xyz_mm @ face.plane[:3] - face.plane[3])
        off = np.where(there, np.minimum(off, own), off)
    return off
