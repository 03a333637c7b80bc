"""How sure each vertex of a mesh is, and whether anything was measured there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_open3d.meshing import Mesh
from roemetry_open3d.sheet import Sheet

MEASURED, BRIDGED, ASSUMED = 0, 1, 2


class Certainty(NamedTuple):
    """What is known of each vertex.

    `std_mm` (vertex,): standard uncertainty of its place across the surface, mm, NaN on what is assumed;
    `support` (vertex,): measured, bridged or assumed.
    """

    std_mm: Floats
    support: np.ndarray


def certainty_of(mesh: Mesh, sheet: Sheet, step_mm: float) -> Certainty:
    """Give each vertex's standard uncertainty and support.

    Between lines it is m·√(d/h): d the distance to the nearest measured point, h the spacing of lines, m how
    far bridges twice as wide miss the lines that were left out. The measured points' own uncertainty is
    added. Walls, the face on the belt and the tips beyond the outer lines are assumed, and have none.

    Notes
    -----
    Points whose height's uncertainty is not stated count with none: what stands then is the bridges' alone.
    """
    from scipy.spatial import cKDTree

    points = np.concatenate([line.xyz_mm for line in sheet.lines])
    own = np.nan_to_num(np.concatenate([line.std_mm for line in sheet.lines]))
    seen = np.concatenate([line.seen for line in sheet.lines])
    distance, nearest = cKDTree(points).query(mesh.vertices)
    std = np.hypot(own[nearest], sheet.miss_mm * np.sqrt(distance / sheet.spacing_mm))
    on_top = _on_sheet(mesh.vertices, sheet, step_mm)
    support = np.where((distance <= step_mm) & seen[nearest], MEASURED, BRIDGED)
    support = np.where(on_top, support, ASSUMED).astype(np.uint8)
    return Certainty(np.where(on_top, std, np.nan), support)


def _on_sheet(vertices: Floats, sheet: Sheet, step_mm: float) -> np.ndarray:
    """Say which vertices lie on the part of the sheet between the outer lines, not on wall or belt."""
    from scipy.spatial import cKDTree

    grid = sheet.xyz_mm
    between = np.repeat(~sheet.assumed[:, None], grid.shape[1], axis=1)
    off, nearest = cKDTree(grid.reshape(-1, 3)).query(vertices)
    on: np.ndarray = (off <= 1.5 * step_mm) & between.ravel()[nearest] & (vertices[:, 2] > 0.0)
    return on
