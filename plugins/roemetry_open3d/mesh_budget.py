"""How far the volume within a mesh may be off, by cause."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_open3d.meshing import Method
from roemetry_open3d.sheet import Sheet

# looked at on skeins of the seeds 60000 to 60499: docs/reference/plugins/surface-mesh.md
# of the volume: flat faces cut what is curved; an alpha shape closes hollows over as well
_FACETS: Mapping[Method, float] = {"poisson": 0.012, "ball-pivoting": 0.015, "alpha-shape": 0.025}
_BRIDGES = 0.25  # of what bridges twice as wide miss
_TIPS = 0.15  # of what lies beyond the outer lines
_FEW_LINES = 0.1  # of the volume, where lines are too few to leave one out


def budget_of(sheet: Sheet, method: Method, volume_mm3: float, assumed: float) -> dict[str, float]:
    """Give standard uncertainties by cause, mm³: facets, between lines, ends.

    Parameters
    ----------
    sheet
        What the mesh goes through.
    method
        How the mesh was laid.
    volume_mm3
        The number.
    assumed
        Share of it beyond the outer lines.

    Notes
    -----
    Where the sheet ends at an outer line, the product may go on to the next stripe: anything up to that
    line's area times the spacing is missing.
    """
    missing = [
        sheet.spacing_mm * _area_mm2(line.xyz_mm) / math.sqrt(3.0)
        for line, tip in zip(
            (sheet.lines[0], sheet.lines[-1]), (sheet.assumed[0], sheet.assumed[-1]), strict=True
        )
        if not tip
    ]
    between = _FEW_LINES * volume_mm3
    if math.isfinite(sheet.miss_mm):
        between = _BRIDGES * sheet.miss_mm * _footprint_mm2(sheet) / math.sqrt(len(sheet.lines) - 1)
    return {
        "facets": _FACETS[method] * volume_mm3,
        "between lines": between,
        "ends": math.hypot(_TIPS * assumed * volume_mm3, *missing),
    }


def _area_mm2(line: Floats) -> float:
    y, z = line[:, 1], np.maximum(line[:, 2], 0.0)
    return float((0.5 * (z[1:] + z[:-1]) * np.diff(y)).sum())


def _footprint_mm2(sheet: Sheet) -> float:
    grid = sheet.xyz_mm
    one, other = grid[1:, 1:] - grid[:-1, :-1], grid[1:, :-1] - grid[:-1, 1:]
    return float((0.5 * np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])).sum())
