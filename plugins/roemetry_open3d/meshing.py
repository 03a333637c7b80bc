"""Closed meshes through a cloud, by Open3D."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records.arrays import Floats, Integers
from roemetry_open3d.closing import mended, open_edges
from roemetry_open3d.cloud import Cloud, mirrored_cloud, standing_cloud
from roemetry_open3d.loading import open3d
from roemetry_open3d.sheet import Sheet

Method = Literal["poisson", "ball-pivoting", "alpha-shape"]
_SCALE = 1.1
_SUPPORT_STEPS = 3.0
_RADII_STEPS = 2.0, 4.0, 8.0
_ALPHA_START_SPACINGS = 0.75
_ALPHA_GROWS = 1.25
_ALPHA_TRIES = 8


class Mesh(NamedTuple):
    """A closed mesh that stands on the belt: `vertices` (n, 3) mm, `triangles` (m, 3), outwards.

    `mended` counts the edges of the holes that were filled to close it.
    """

    vertices: Floats
    triangles: Integers
    mended: int

    @property
    def volume_mm3(self) -> float:
        """Volume within."""
        corner = self.vertices[self.triangles]
        return float(np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0)


def mesh_of(sheet: Sheet, method: Method, step_mm: float) -> Mesh:
    """Make a closed mesh.

    Raises
    ------
    StageError
        Open3D is missing, or what it made is not closed: it has no inside, and no volume.
    """
    o3d = open3d()
    mended_edges = 0
    if method == "alpha-shape":
        vertices, triangles = _alpha_shape(o3d, standing_cloud(sheet, step_mm), sheet)
    else:
        cloud = mirrored_cloud(sheet, step_mm)
        build = _poisson if method == "poisson" else _ball_pivoting
        vertices, triangles = build(o3d, cloud, step_mm)
        if method == "ball-pivoting":
            vertices, triangles, mended_edges = mended(vertices, triangles)
    at_fault = open_edges(triangles)
    if at_fault or not len(triangles):
        raise StageError(
            f"the mesh by {method} is not closed ({at_fault} of its edges do not join two triangles): it has "
            "no inside, so no volume",
            hint="another `method`, or a finer `step_mm`; a slice estimator needs no mesh",
        )
    pressed = vertices * np.array([1.0, 1.0, 0.0]) + np.maximum(vertices, 0.0) * np.array([0.0, 0.0, 1.0])
    mesh = Mesh(pressed, triangles, mended_edges)
    return mesh if mesh.volume_mm3 >= 0.0 else mesh._replace(triangles=triangles[:, ::-1].copy())


def _points(o3d: object, cloud: Cloud) -> object:
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.xyz_mm))  # type: ignore[attr-defined]
    points.normals = o3d.utility.Vector3dVector(cloud.normal)  # type: ignore[attr-defined]
    return points


def _arrays(mesh: object) -> tuple[Floats, Integers]:
    vertices = np.asarray(mesh.vertices, np.float64)  # type: ignore[attr-defined]
    return vertices.copy(), np.asarray(mesh.triangles, np.int64).copy()  # type: ignore[attr-defined]


def _poisson(o3d, cloud: Cloud, step_mm: float) -> tuple[Floats, Integers]:  # type: ignore[no-untyped-def] # noqa: ANN001
    """Screened Poisson, cells about a step wide; trimmed where no point is near."""
    extent = _SCALE * float(np.ptp(cloud.xyz_mm, axis=0).max())
    depth = int(np.clip(round(math.log2(extent / step_mm)), 4, 10))
    # one thread: more give other meshes each time
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        _points(o3d, cloud), depth=depth, scale=_SCALE, linear_fit=True, n_threads=1
    )
    far = _distances(o3d, mesh, cloud) > _SUPPORT_STEPS * step_mm
    mesh.remove_vertices_by_mask(far)
    return _arrays(mesh)


def _distances(o3d, mesh, cloud: Cloud) -> Floats:  # type: ignore[no-untyped-def] # noqa: ANN001
    corners = o3d.geometry.PointCloud(mesh.vertices)
    return np.asarray(corners.compute_point_cloud_distance(_points(o3d, cloud)), np.float64)


def _ball_pivoting(o3d, cloud: Cloud, step_mm: float) -> tuple[Floats, Integers]:  # type: ignore[no-untyped-def] # noqa: ANN001
    radii = o3d.utility.DoubleVector([steps * step_mm for steps in _RADII_STEPS])
    return _arrays(
        o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(_points(o3d, cloud), radii)
    )


def _alpha_shape(o3d, cloud: Cloud, sheet: Sheet) -> tuple[Floats, Integers]:  # type: ignore[no-untyped-def] # noqa: ANN001
    """Alpha grows until the shape is one closed body: too small a one leaves a hollow shell."""
    points = _points(o3d, cloud)
    tetrahedra, origin = o3d.geometry.TetraMesh.create_from_point_cloud(points)
    alpha = max(_ALPHA_START_SPACINGS * sheet.spacing_mm, 0.5 * float(sheet.xyz_mm[..., 2].max()))
    for _ in range(_ALPHA_TRIES):
        mesh = o3d.geometry.TriangleMesh.create_from_point_cloud_alpha_shape(
            points, alpha, tetrahedra, origin
        )
        vertices, triangles = _arrays(mesh)
        bodies = len(mesh.cluster_connected_triangles()[1])
        if bodies == 1 and not open_edges(triangles):
            break
        alpha *= _ALPHA_GROWS
    return vertices, triangles
