"""Solid targets as closed triangle meshes, mm: X across the stripes, Y along them, Z up from the belt."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from roemetry.config.target_file import BlockFile, PyramidFile, SpherePlateFile, StaircaseFile
from roemetry.errors import ConfigurationError
from roemetry.records.arrays import Floats

Solid = BlockFile | StaircaseFile | PyramidFile | SpherePlateFile

_BALL_STEPS = 96  # of a ball's circumference
_PLATE_RIM_MM = 5.0  # of a plate, beside its outer balls
_SUNK_SHARE = 0.1
"""Part of a ball's diameter that is sunk into its plate, so that it holds."""


def solid_triangles(target: Solid) -> Floats:
    """(n, 3, 3) triangles, corners counter-clockwise seen from outside; several closed bodies may overlap.

    Raises
    ------
    ConfigurationError
        A side is not known, or balls touch each other or lie too low for a plate under them.
    """
    match target:
        case BlockFile():
            return _block(target)
        case StaircaseFile():
            return _staircase(target)
        case PyramidFile():
            return _pyramid(target)
        case SpherePlateFile():
            return _sphere_plate(target)


def _block(target: BlockFile) -> Floats:
    sides = target.length_mm, target.width_mm, target.height_mm
    if None in sides:
        raise ConfigurationError(
            f"the block `{target.name}` lacks a side", hint="give length_mm, width_mm and height_mm"
        )
    length, width, height = (float(side or 0.0) for side in sides)
    return _box((-length / 2, -width / 2, 0.0), (length / 2, width / 2, height))


def _staircase(target: StaircaseFile) -> Floats:
    """Steps cut into bands at every step's height, so that neighbours share whole edges."""
    heights = target.heights_mm
    left, right = -target.width_mm / 2, target.width_mm / 2
    y = (np.arange(len(heights) + 1) - len(heights) / 2) * target.tread_mm
    bands = list(itertools.pairwise(sorted({0.0, *heights})))
    faces = []
    for step, height in enumerate(heights):
        begin, end = y[step], y[step + 1]
        faces += _quad(
            (left, begin, height), (right, begin, height), (right, end, height), (left, end, height)
        )
        faces += _quad((left, begin, 0), (left, end, 0), (right, end, 0), (right, begin, 0))
        for low, high in bands:
            if high <= height:
                faces += _quad(
                    (right, begin, low), (right, end, low), (right, end, high), (right, begin, high)
                )
                faces += _quad((left, begin, low), (left, begin, high), (left, end, high), (left, end, low))
    for place, (before, after) in zip(y, itertools.pairwise([0.0, *heights, 0.0]), strict=True):
        for low, high in bands:
            if min(before, after) <= low and high <= max(before, after):
                front = _quad(
                    (left, place, low), (right, place, low), (right, place, high), (left, place, high)
                )
                faces += front if after > before else [triangle[::-1] for triangle in front]
    return np.array(faces, np.float64)


def _pyramid(target: PyramidFile) -> Floats:
    if target.top_mm >= target.base_mm:
        raise ConfigurationError(f"`{target.name}`: its top is no smaller than its base")
    base, top = target.base_mm / 2, target.top_mm / 2
    return _hexahedron(
        [(-base, -base, 0), (base, -base, 0), (base, base, 0), (-base, base, 0)],
        [(x * top, y * top, target.height_mm) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))],
    )


def _sphere_plate(target: SpherePlateFile) -> Floats:
    radius = target.diameter_mm / 2
    thick = target.centre_height_mm - radius + _SUNK_SHARE * target.diameter_mm
    if target.diameter_mm >= target.pitch_mm and target.columns * target.rows > 1:
        raise ConfigurationError(f"`{target.name}`: the balls touch each other")
    if thick <= 0:
        raise ConfigurationError(f"`{target.name}`: the balls lie too low: there is no room for a plate")
    x = (np.arange(target.columns) - (target.columns - 1) / 2) * target.pitch_mm
    y = (np.arange(target.rows) - (target.rows - 1) / 2) * target.pitch_mm
    half_x, half_y = x[-1] + radius + _PLATE_RIM_MM, y[-1] + radius + _PLATE_RIM_MM
    parts = [_box((-half_x, -half_y, 0.0), (half_x, half_y, thick))]
    ball = _ball(radius)
    parts += [ball + np.array([cx, cy, target.centre_height_mm]) for cx in x for cy in y]
    return np.concatenate(parts)


def _ball(radius: float) -> Floats:
    """A ball about the origin: latitude and longitude, closed at the poles; corners lie on the ball."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, _BALL_STEPS // 2 + 1)
    longitude = np.arange(_BALL_STEPS) * 2 * np.pi / _BALL_STEPS
    on_x = radius * np.cos(latitude)[:, None] * np.cos(longitude)
    on_y = radius * np.cos(latitude)[:, None] * np.sin(longitude)
    on_z = np.broadcast_to(radius * np.sin(latitude)[:, None], on_x.shape)
    grid = np.stack([on_x, on_y, on_z], axis=-1)
    grid[0], grid[-1] = (0.0, 0.0, -radius), (0.0, 0.0, radius)
    triangles = []
    for row in range(len(latitude) - 1):
        for column in range(_BALL_STEPS):
            after = (column + 1) % _BALL_STEPS
            a, b = grid[row, column], grid[row, after]
            c, d = grid[row + 1, after], grid[row + 1, column]
            # At a pole two of the four corners are one.
            if row > 0:
                triangles.append([a, b, c])
            if row < len(latitude) - 2:
                triangles.append([a, c, d])
    return np.array(triangles)


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Floats:
    (x0, y0, z0), (x1, y1, z1) = low, high
    below = [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)]
    return _hexahedron(below, [(x, y, z1) for x, y, _ in below])


def _hexahedron(below: Sequence[tuple[float, ...]], above: Sequence[tuple[float, ...]]) -> Floats:
    """Close two squares, each counter-clockwise seen from above."""
    triangles = [*_quad(*below[::-1]), *_quad(*above)]
    for n in range(4):
        after = (n + 1) % 4
        triangles += _quad(below[n], below[after], above[after], above[n])
    return np.array(triangles, np.float64)


def _quad(*corners: tuple[float, ...]) -> list[list[tuple[float, ...]]]:
    a, b, c, d = corners
    return [[a, b, c], [a, c, d]]


def stl_of(triangles: Floats, name: str) -> bytes:
    """Write (n, 3, 3) triangles, mm, as binary STL; the name stands in its head."""
    along = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.sqrt((along**2).sum(axis=1))
    record = np.zeros(
        len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    )
    record["normal"] = along / length[:, None]
    record["corners"] = triangles
    head = f"roemetry {name}, mm".encode("ascii", "replace")[:80].ljust(80)
    return head + np.uint32(len(triangles)).tobytes() + record.tobytes()
