"""From a product's sheet of points to a closed mesh by Open3D: cloud, mesh, holes closed."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import math
import sys
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records.arrays import Floats, Integers
from roemetry_open3d.sheet import Sheet

Method = Literal["poisson", "ball-pivoting", "alpha-shape"]
_SCALE = 1.1  # Poisson's cube over the cloud's extent: Open3D's default, a margin for the smoothing
_SUPPORT_STEPS = 3.0  # steps of the cloud beyond which Poisson's surface has no support and is cut off
_RADII_STEPS = 2.0, 4.0, 8.0  # balls, in steps: the first rolls over the grid, the others over wider gaps
_ALPHA_START_SPACINGS = 0.75  # of the lines: a smaller alpha falls through between them
_ALPHA_GROWS = 1.25  # from try to try, until the shape is one closed body
_ALPHA_TRIES = 8  # up to five times the first alpha


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


_MIRROR = np.array([1.0, 1.0, -1.0])  # at the belt
_LEAST_STEPS = 0.25  # height over the belt, in steps, below which a point and its mirror image would clash
_STIRRED_STEPS = 0.01  # how far points are moved, in steps: enough to part four points of one ball


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


_LARGEST_LOOP = 12  # edges of a hole that is filled; larger ones are no gaps between balls


def open_edges(triangles: Integers) -> int:
    """Count edges that do not join exactly two triangles which run through them in opposite ways."""
    ways = _ways(triangles)
    _, each = np.unique(ways, axis=0, return_counts=True)
    _, both = np.unique(np.sort(ways, axis=1), axis=0, return_counts=True)
    return int((both != 2).sum() + (each > 1).sum())


def mended(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers, int]:
    """Fill loops of up to twelve open edges by fans about their middles; also how many edges were closed."""
    ways = _ways(triangles)
    known = {(int(a), int(b)) for a, b in ways}
    # an edge that one triangle runs through from a to b is open where none runs back
    after: dict[int, list[int]] = {}
    for a, b in sorted(known):
        if (b, a) not in known:
            after.setdefault(b, []).append(a)
    fans: list[tuple[int, int, int]] = []
    middles: list[Floats] = []
    closed = 0
    for loop in _loops(after):
        if not 3 <= len(loop) <= _LARGEST_LOOP:
            continue
        # from the middle, for a diagonal may be an edge of the mesh already
        middle = len(vertices) + len(middles)
        middles.append(vertices[loop].mean(axis=0))
        fans += [(middle, loop[k - 1], loop[k]) for k in range(len(loop))]
        closed += len(loop)
    if not fans:
        return vertices, triangles, 0
    return np.vstack([vertices, middles]), np.vstack([triangles, fans]), closed


def _loops(after: dict[int, list[int]]) -> Iterator[list[int]]:
    """Give the loops of open edges; where loops touch at a corner, each by itself. Empties `after`."""
    while after:
        walk = [min(after)]
        while walk:
            ways = after.get(walk[-1])
            if not ways:  # a dead end: these edges lie on no loop
                walk.pop()
                continue
            corner = ways.pop()
            if not ways:
                del after[walk[-1]]
            if corner in walk:
                at = walk.index(corner)
                yield walk[at:]
                del walk[at + 1 :]
            else:
                walk.append(corner)


def _ways(triangles: Integers) -> Integers:
    return np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


_INSTALL = "pip install 'roemetry[open3d]'"


def open3d() -> Any:
    """Import Open3D; where the system lacks libusb-1.0, with the one of the package libusb-package.

    Raises
    ------
    StageError
        Open3D is not installed, or cannot be loaded.
    """
    if importlib.util.find_spec("open3d") is None:
        raise StageError("meshes are made by Open3D, which is not installed", hint=_INSTALL)
    try:
        loaded = importlib.import_module("open3d")
    except (ImportError, OSError):
        for name in [name for name in sys.modules if name.split(".")[0] == "open3d"]:
            del sys.modules[name]
        try:
            path = importlib.import_module("libusb_package").get_library_path()
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
            loaded = importlib.import_module("open3d")
        except (ImportError, OSError) as error:
            raise StageError(
                f"Open3D is installed and cannot be loaded: {error}",
                hint=f"{_INSTALL} brings the libusb-1.0 that a bare system lacks",
            ) from error
    # its warnings of degenerate simplices are no news to who asked for a volume
    loaded.utility.set_verbosity_level(loaded.utility.VerbosityLevel.Error)
    return loaded
