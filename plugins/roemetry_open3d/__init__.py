"""The volume of a closed mesh, reconstructed by Open3D."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl

_SOURCE = "Kazhdan and Hoppe (2013), screened Poisson, by Open3D. Sheet and closing are ours"


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the volume estimator."""
    yield StageEntry(
        kind="volume",
        name="surface-mesh",
        target="roemetry_open3d.surface_mesh:SurfaceMesh",
        summary="The volume within a closed mesh by screened Poisson reconstruction, by Open3D",
        reference=_SOURCE,
    )
