"""Closed meshes of products by Open3D: their volume, and files for other programs."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl

_SOURCE = "Kazhdan and Hoppe (2013), screened Poisson, by Open3D. Sheet and closing are ours"


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the volume estimator and the sink."""
    yield StageEntry(
        kind="volume",
        name="surface-mesh",
        target="roemetry_open3d.mesh_files:SurfaceMesh",
        summary="The volume within a closed mesh by screened Poisson reconstruction, by Open3D",
        reference=_SOURCE,
    )
    yield StageEntry(
        kind="sink",
        name="mesh-files",
        target="roemetry_open3d.mesh_files:MeshFiles",
        summary="meshes/<product>.ply and .stl: closed meshes with each vertex's uncertainty",
        reference=_SOURCE,
    )
