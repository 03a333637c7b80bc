"""The volume within a closed surface through profiles, reconstructed by Open3D, and what it may be wrong by.

A sheet is laid through the stripes and mirrored at the belt, so that the surface has no edge there; screened
Poisson reconstruction (Kazhdan and Hoppe 2013) makes a closed mesh of it, and V = ∮ z dA. Its facets cut what
is curved, so it is too small on bodies of few stripes: slice estimators are nearer to the truth.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import math
import sys
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Shares, Volume
from roemetry.records.arrays import Floats, Integers
from roemetry.stages import Capabilities, StageOptions, VolumeEstimator
from roemetry_open3d.sheet import Sheet, sheet_of


class MeshOptions(StageOptions):
    """How a mesh is made."""

    step_mm: float = Field(
        default=1.5, ge=0.2, le=20.0, description="distance of the cloud's points, and size of the mesh, mm"
    )


class SurfaceMesh(VolumeEstimator[MeshOptions]):
    """V = ∮ z dA over a closed mesh that stands on the belt."""

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
        mesh = mesh_of(sheet, self.options.step_mm)
        volume = mesh.volume_mm3
        if not volume > 0.0:
            raise StageError(
                f"the mesh encloses {volume:.4g} mm³: the points lie on or below the belt",
                hint="look at the coding and the belt's zero",
            )
        shares = _shares(sheet)
        budget = budget_of(sheet, volume, shares.assumed)
        if rng is not None:
            volume += sum(std * rng.standard_normal() for std in budget.values())
        std = math.hypot(*budget.values())
        return Volume(Estimate(volume, std, budget), None, shares, reasons=sheet.reasons)


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


# looked at on skeins of the seeds 60000 to 60499: docs/reference/plugins/surface-mesh.md
_FACETS = 0.012  # of the volume: flat faces cut what is curved
_BRIDGES = 0.25  # of what bridges twice as wide miss
_TIPS = 0.15  # of what lies beyond the outer lines
_FEW_LINES = 0.1  # of the volume, where lines are too few to leave one out


def budget_of(sheet: Sheet, volume_mm3: float, assumed: float) -> dict[str, float]:
    """Give standard uncertainties by cause, mm³: facets, between lines, ends.

    `assumed` is the share of the volume beyond the outer lines. Where the sheet ends at an outer line, the
    product may go on to the next stripe: anything up to that line's area times the spacing is missing.
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
        "facets": _FACETS * volume_mm3,
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


_SCALE = 1.1  # Poisson's cube over the cloud's extent: Open3D's default, a margin for the smoothing
_SUPPORT_STEPS = 3.0  # steps of the cloud beyond which Poisson's surface has no support and is cut off


class Mesh(NamedTuple):
    """A closed mesh that stands on the belt: `vertices` (n, 3) mm, `triangles` (m, 3), outwards."""

    vertices: Floats
    triangles: Integers

    @property
    def volume_mm3(self) -> float:
        """Volume within."""
        corner = self.vertices[self.triangles]
        return float(np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0)


def mesh_of(sheet: Sheet, step_mm: float) -> Mesh:
    """Make a closed mesh by screened Poisson reconstruction (Kazhdan and Hoppe 2013).

    Raises
    ------
    StageError
        Open3D is missing, or what it made is not closed: it has no inside, and no volume.
    """
    vertices, triangles = _poisson(open3d(), mirrored_cloud(sheet, step_mm), step_mm)
    at_fault = open_edges(triangles)
    if at_fault or not len(triangles):
        raise StageError(
            f"the mesh is not closed ({at_fault} of its edges do not join two triangles): it has "
            "no inside, so no volume",
            hint="try a finer `step_mm`; a slice estimator needs no mesh",
        )
    pressed = vertices * np.array([1.0, 1.0, 0.0]) + np.maximum(vertices, 0.0) * np.array([0.0, 0.0, 1.0])
    mesh = Mesh(pressed, triangles)
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


_MIRROR = np.array([1.0, 1.0, -1.0])  # at the belt
_LEAST_STEPS = 0.25  # height over the belt, in steps, below which a point and its mirror image would clash
_STIRRED_STEPS = 0.01  # how far points are moved, in steps: enough to part points of a regular grid


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


def _stirred(step_mm: float, points: Floats, normal: Floats) -> Cloud:
    """Move points by a hundredth of a step, the same way each time: a regular grid makes meshes ambiguous."""
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
    # levels that rise and fall with the edge, so that the points form no regular grid
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


def open_edges(triangles: Integers) -> int:
    """Count edges that do not join exactly two triangles which run through them in opposite ways."""
    ways = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, each = np.unique(ways, axis=0, return_counts=True)
    _, both = np.unique(np.sort(ways, axis=1), axis=0, return_counts=True)
    return int((both != 2).sum() + (each > 1).sum())


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
