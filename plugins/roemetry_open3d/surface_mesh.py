"""Visible volume within a closed mesh."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Reason, Shares, Volume
from roemetry.stages import Capabilities, StageOptions, VolumeEstimator
from roemetry_open3d.mesh_budget import budget_of
from roemetry_open3d.meshing import mesh_of
from roemetry_open3d.sheet import Sheet, sheet_of


class MeshOptions(StageOptions):
    """How a mesh is made."""

    method: Literal["poisson", "ball-pivoting", "alpha-shape"] = Field(
        default="poisson", description="how a surface is laid through the cloud"
    )
    step_mm: float = Field(
        default=1.5, ge=0.2, le=20.0, description="distance of the cloud's points, and size of the mesh, mm"
    )


class SurfaceMesh(VolumeEstimator[MeshOptions]):
    """V = ∮ z dA over a closed mesh that stands on the belt."""

    Options = MeshOptions
    capabilities = Capabilities(relative_tolerance=0.05)

    @property
    def states_model_error(self) -> bool:
        """Whether all of the model's error is drawn."""
        return True

    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the visible volume; with `rng` the model's own error is drawn, too.

        Raises
        ------
        StageError
            Open3D is not installed; fewer than three stripes lie on the product, or one shows a hole; the
            outline reaches the image's edge; the mesh is not closed.
        """
        sheet = sheet_of(product, self.options.step_mm)
        mesh = mesh_of(sheet, self.options.method, self.options.step_mm)
        volume = mesh.volume_mm3
        if not volume > 0.0:
            raise StageError(
                f"the mesh encloses {volume:.4g} mm³: the points lie on or below the belt",
                hint="look at the coding and the belt's zero",
            )
        reasons = sheet.reasons
        if mesh.mended:
            reasons += (
                Reason("mesh-mended", f"holes with {mesh.mended} edges in all were filled to close the mesh"),
            )
        shares = _shares(sheet)
        budget = budget_of(sheet, self.options.method, volume, shares.assumed)
        if rng is not None:
            volume += sum(std * rng.standard_normal() for std in budget.values())
        std = math.hypot(*budget.values())
        return Volume(Estimate(volume, std, budget), None, shares, reasons=reasons)


def _shares(sheet: Sheet) -> Shares:
    """What lies beyond the outer lines is assumed; between them it is as seen as the lines' points are."""
    grid = sheet.xyz_mm
    one, other = grid[1:, 1:] - grid[:-1, :-1], grid[1:, :-1] - grid[:-1, 1:]
    area = 0.5 * np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])
    height = 0.25 * (grid[1:, 1:] + grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:])[..., 2]
    part = (area * np.maximum(height, 0.0)).sum(axis=1)
    beyond = sheet.assumed[1:] | sheet.assumed[:-1]
    assumed = float(part[beyond].sum() / max(float(part.sum()), 1e-12))
    seen = float(np.concatenate([line.seen for line in sheet.lines]).mean())
    return Shares((1.0 - assumed) * seen, (1.0 - assumed) * (1.0 - seen), assumed)
