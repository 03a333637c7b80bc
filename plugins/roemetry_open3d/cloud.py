"""From a sheet to a closed cloud with normals: sheet, wall below its edge, and what closes it at the belt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_open3d.sheet import Sheet

_MIRROR = np.array([1.0, 1.0, -1.0])
_LEAST_STEPS = 0.25
_STIRRED_STEPS = 0.01


class Cloud(NamedTuple):
    """Points (n, 3) mm with outward normals (n, 3)."""

    xyz_mm: Floats
    normal: Floats


def mirrored_cloud(sheet: Sheet, step_mm: float) -> Cloud:
    """Give sheet and wall with their mirror image below the belt.

    A surface through it has no edge at the belt that it could round off, and no bottom to bulge: what lies
    below the belt is pressed flat afterwards.
    """
    top, wall, foot = _top(sheet, step_mm), *_wall(sheet, step_mm)
    upper = Cloud(np.vstack([top.xyz_mm, wall.xyz_mm]), np.vstack([top.normal, wall.normal]))
    return _stirred(
        step_mm,
        np.vstack([upper.xyz_mm, upper.xyz_mm * _MIRROR, foot.xyz_mm]),
        np.vstack([upper.normal, upper.normal * _MIRROR, foot.normal]),
    )


def standing_cloud(sheet: Sheet, step_mm: float) -> Cloud:
    """Give sheet, wall and a bottom on the belt."""
    top, wall, foot = _top(sheet, step_mm), *_wall(sheet, step_mm)
    bottom = sheet.xyz_mm[1:-1, 1:-1].reshape(-1, 3) * np.array([1.0, 1.0, 0.0])
    down = np.tile([0.0, 0.0, -1.0], (len(bottom), 1))
    return _stirred(
        step_mm,
        np.vstack([top.xyz_mm, wall.xyz_mm, foot.xyz_mm, bottom]),
        np.vstack([top.normal, wall.normal, foot.normal, down]),
    )


def _stirred(step_mm: float, points: Floats, normal: Floats) -> Cloud:
    """Move points by a hundredth of a step, the same way each time: grids have balls through four points."""
    moved = np.random.default_rng(0).uniform(-_STIRRED_STEPS, _STIRRED_STEPS, points.shape)
    return Cloud(points + step_mm * moved, normal)


def _top(sheet: Sheet, step_mm: float) -> Cloud:
    grid = sheet.xyz_mm
    normal = np.cross(np.gradient(grid, axis=0), np.gradient(grid, axis=1)).reshape(-1, 3)
    length = np.linalg.norm(normal, axis=1)
    points = grid.reshape(-1, 3)
    keep = (length > 1e-9) & (points[:, 2] > _LEAST_STEPS * step_mm)
    normal = normal[keep] / length[keep, None]
    # one sign for all: where an end wall is part of the sheet, up and down mean nothing
    return Cloud(points[keep], normal * (np.sign(float(normal[:, 2].sum())) or 1.0))


def _wall(sheet: Sheet, step_mm: float) -> tuple[Cloud, Cloud]:
    """Give the points below the sheet's edge, and those of its foot on the belt."""
    ring = _ring(sheet, step_mm)
    x, y = ring[:, 0], ring[:, 1]
    turn = np.sign(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) or 1.0
    along = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
    outward = turn * np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(ring))])
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-9)[:, None]
    # levels that rise and fall with the edge: a regular grid would make balls and circumspheres ambiguous
    levels = max(round(float(ring[:, 2].max()) / step_mm), 1)
    share = (np.arange(1, levels) / levels)[:, None]
    below, at = np.nonzero(share * ring[None, :, 2] > _LEAST_STEPS * step_mm)
    wall = np.column_stack([ring[at, :2], share[below, 0] * ring[at, 2]])
    return Cloud(wall, outward[at]), Cloud(ring * np.array([1.0, 1.0, 0.0]), outward)


def _ring(sheet: Sheet, step_mm: float) -> Floats:
    """Resample the sheet's edge, all around, to points about a step apart along the belt."""
    grid = sheet.xyz_mm
    edge = np.vstack([grid[:, 0], grid[-1, 1:-1], grid[::-1, -1], grid[0, ::-1][1:-1], grid[:1, 0]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(edge[:, :2], axis=0).T))])
    at = np.linspace(0.0, along[-1], max(round(along[-1] / step_mm), 8), endpoint=False)
    return np.column_stack([np.interp(at, along, edge[:, k]) for k in range(3)])
