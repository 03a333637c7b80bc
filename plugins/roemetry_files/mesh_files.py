"""The sink `mesh-files`: closed meshes of the surfaces that volumes were integrated under, as PLY and STL.

Model. A volume estimator's surface is a grid over the product (`roemetry.records.Surface`). Each cell is two
triangles; the same two lie below it on the belt and face down; and an upright wall joins both along each edge
that a cell has alone, the footprint's border or a gap's. So the mesh is closed whatever the grid, and holds
the estimator's volume but for its facets, which cut what is curved.

Between slices a vertex's standard uncertainty across the surface is m·√(d/h): d the distance to the nearest
measured point, h the spacing of slices, m how far cubics through two slices on either side miss the one
between (root mean square), so of bridges twice as wide. Errors of a random walk grow so. The points' own
uncertainty is added. What is common to all points, the calibration's, is not: it moves the mesh as a whole.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import RoemetryError
from roemetry.io.files import make_folder, write_bytes, write_whole
from roemetry.records import Product, Profiles, Surface
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Run, Sink, StageOptions

MEASURED, BRIDGED, ASSUMED = 0, 1, 2  # what supports a vertex, as the files have it
_NEAR_MM = 1.5  # a seen point so near measures a vertex: some five image rows of the herring roe rig
_SLICE_POINTS_MIN = 4  # of a slice: fewer show no curve
_SLICES_MIN = 5  # two on either side of the one that is left out
_ALONG = 27  # places along a slice that are compared with those of the others


class MeshFilesOptions(StageOptions):
    """What is written."""

    formats: tuple[Literal["ply", "stl"], ...] = Field(
        default=("ply", "stl"), min_length=1, description="files to write for each product"
    )


class MeshFiles(Sink[MeshFilesOptions]):
    """Writes ``meshes/<product>.ply`` and ``.stl``, and ``meshes/not-made.txt`` where there is no mesh.

    Vertices are millimetres in the belt frame.
    """

    def write(self, run: Run) -> Sequence[Path]:
        """Write the files of each product."""
        folder = run.folder / "meshes"
        written: list[Path] = []
        missing: list[str] = []
        rows = [row for row in run.measurements() if row.product > 0]
        if rows:
            make_folder(folder)
        for name in dict.fromkeys(row.acquisition for row in rows):
            try:
                products = run.replay(name).products
            except RoemetryError as error:
                missing.append(f"{name}: {error}")
                continue
            for found in products:
                title = f"{name}#{found.product.number}"
                if "surface" in found.undrawn:
                    missing.append(f"{title}: {found.undrawn['surface'].text}")
                    continue
                if found.surface is None:
                    missing.append(f"{title}: its volume has no surface: there is none, or it sums up areas")
                    continue
                mesh = mesh_of(found.surface)
                if not len(mesh.triangles):
                    missing.append(f"{title}: no four neighbouring points of its surface are known")
                    continue
                certainty = certainty_of(mesh, found.product)
                for ending in dict.fromkeys(self.options.formats):
                    path = folder / f"{_file_name(title)}.{ending}"
                    write_bytes(path, (ply if ending == "ply" else stl)(mesh, certainty, title))
                    written.append(path)
        if missing:
            path = folder / "not-made.txt"
            write_whole(path, "".join(f"{line}\n" for line in missing))
            written.append(path)
        return written


def _file_name(title: str) -> str:
    """Give a name that stays in its folder, whatever a source calls its acquisitions."""
    return title.replace("/", "_").replace("\\", "_").replace("#", "_")


class Mesh(NamedTuple):
    """A closed mesh that stands on the belt."""

    vertices: Floats
    triangles: Integers
    """vertices, triangles: (n, 3) mm; (m, 3), counter-clockwise from outside."""
    assumed: Flags
    """(n,) True below, and where no slice was seen that the surface could rest on."""

    @property
    def volume_mm3(self) -> float:
        """Volume within."""
        corner = self.vertices[self.triangles]
        return float(np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0)


def mesh_of(surface: Surface) -> Mesh:
    """Close a surface by the belt below it, and by walls along its border and its gaps'."""
    xyz = surface.xyz_mm.reshape(-1, 3)
    count = len(xyz)
    number = np.arange(count).reshape(surface.assumed.shape)
    cells = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    cells = cells[np.isfinite(surface.xyz_mm).all(axis=2).ravel()[cells].all(axis=-1)]
    top = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
    begin, end = edges_of(top).T
    alone = ~np.isin(end * count + begin, begin * count + end)
    one, other = begin[alone], end[alone]
    walls = [np.column_stack([other, one, one + count]), np.column_stack([other, one + count, other + count])]
    triangles = np.concatenate([top, top[:, ::-1] + count, *walls])
    used, triangles = np.unique(triangles, return_inverse=True)
    above = np.maximum(xyz, [-np.inf, -np.inf, 0.0])
    vertices = np.concatenate([above, above * [1.0, 1.0, 0.0]])[used]
    assumed = np.concatenate([surface.assumed.ravel(), np.ones(count, np.bool_)])[used]
    mesh = Mesh(vertices, triangles.reshape(-1, 3), assumed)
    # which way round depends on which way stations and points run
    return mesh if mesh.volume_mm3 >= 0.0 else mesh._replace(triangles=mesh.triangles[:, ::-1].copy())


def edges_of(triangles: Integers) -> Integers:
    """Give (edge, 2) the vertices at both ends of each triangle's edges, in its order."""
    return np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


class Certainty(NamedTuple):
    """What is known of each vertex."""

    std_mm: Floats
    """(vertex,) standard uncertainty of its place across the surface, mm; NaN on what is assumed."""
    support: np.ndarray
    """(vertex,) measured, bridged or assumed."""


def certainty_of(mesh: Mesh, product: Product) -> Certainty:
    """Give each vertex's standard uncertainty and support.

    Points whose height's uncertainty is not stated count with none: what stands then is the bridges' alone.
    """
    from scipy.spatial import cKDTree

    profiles = product.profiles
    mine = (profiles.product == product.number) & np.isfinite(profiles.xyz_mm).all(axis=2)
    distance, nearest = cKDTree(profiles.xyz_mm[mine]).query(mesh.vertices)
    spacing_mm, miss_mm = bridges_miss(profiles, product.number)
    own = np.nan_to_num(profiles.height_std_mm[mine])[nearest]
    std_mm = np.hypot(own, miss_mm * np.sqrt(distance / spacing_mm))
    support = np.where((distance <= _NEAR_MM) & profiles.seen[mine][nearest], MEASURED, BRIDGED)
    support = np.where(mesh.assumed, ASSUMED, support).astype(np.uint8)
    return Certainty(np.where(mesh.assumed, np.nan, std_mm), support)


def bridges_miss(profiles: Profiles, number: int) -> tuple[float, float]:
    """Give the spacing of a product's slices, mm, and by how much bridges twice as wide miss the slices, mm.

    NaN where too few slices show the product.
    """
    slices = []
    for xyz, on in zip(profiles.xyz_mm, profiles.product == number, strict=True):
        points = xyz[on & np.isfinite(xyz).all(axis=1)]
        if len(points) >= _SLICE_POINTS_MIN:
            points = points[np.argsort(points[:, 1], kind="stable")]
            at = np.linspace(points[0, 1], points[-1, 1], _ALONG)
            slices.append([np.interp(at, points[:, 1], points[:, k]) for k in (0, 2)])
    if len(slices) < _SLICES_MIN:
        return math.nan, math.nan
    x, z = np.array(slices).transpose(1, 0, 2)
    middle = x.mean(axis=1)
    order = np.argsort(middle, kind="stable")
    middle, z = middle[order], z[order]
    missed = []
    for k in range(2, len(z) - 2):
        beside = np.array([k - 2, k - 1, k + 1, k + 2])
        apart = middle[beside, None] - middle[None, beside]
        share = [
            np.prod([(middle[k] - middle[m]) / apart[i, j] for j, m in enumerate(beside) if j != i])
            for i in range(4)
        ]
        missed.append(np.array(share) @ z[beside] - z[k])
    return float(np.diff(middle).mean()), float(np.sqrt(np.mean(np.square(missed))))


_GREY = 150  # of 255, where the surface is assumed
_STOPS = np.array([[38, 84, 148], [91, 167, 176], [236, 220, 141], [178, 57, 40]], np.float64)
"""Blue where it is sure, over green and yellow, to red at the highest uncertainty of the mesh."""


def ply(mesh: Mesh, certainty: Certainty, title: str) -> bytes:
    """Write binary PLY: place, `quality` (standard uncertainty, mm), `support`, colour."""
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            f"comment {_plain(title)}",
            "comment x y z in mm in the belt frame; z up from the belt",
            "comment quality: standard uncertainty across the surface in mm; nan where it is assumed",
            "comment support: 0 measured, 1 bridged between stripes, 2 assumed (walls, belt, tips)",
            f"element vertex {len(mesh.vertices)}",
            *(f"property float {name}" for name in ("x", "y", "z", "quality")),
            *(f"property uchar {name}" for name in ("support", "red", "green", "blue")),
            f"element face {len(mesh.triangles)}",
            "property list uchar int vertex_indices",
            "end_header\n",
        ]
    )
    fields: list[tuple[str, str]] = [(name, "<f4") for name in ("x", "y", "z", "quality")]
    fields += [(name, "u1") for name in ("support", "red", "green", "blue")]
    vertices = np.zeros(len(mesh.vertices), np.dtype(fields))
    for k, name in enumerate("xyz"):
        vertices[name] = mesh.vertices[:, k]
    vertices["quality"], vertices["support"] = certainty.std_mm, certainty.support
    for k, name in enumerate(("red", "green", "blue")):
        vertices[name] = colours(certainty)[:, k]
    faces = np.zeros(len(mesh.triangles), np.dtype([("many", "u1"), ("corners", "<i4", (3,))]))
    faces["many"], faces["corners"] = 3, mesh.triangles
    return header.encode("ascii") + vertices.tobytes() + faces.tobytes()


def stl(mesh: Mesh, certainty: Certainty, title: str) -> bytes:
    """Write binary STL; the two spare bytes of a facet hold its colour, 5 bits each, as VisCAM reads them."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    facets = np.zeros(len(corners), np.dtype([("floats", "<f4", (4, 3)), ("colour", "<u2")]))
    facets["floats"][:, 0], facets["floats"][:, 1:] = normal, corners
    shade = colours(certainty)[mesh.triangles].mean(axis=1).astype(np.uint16) >> 3
    facets["colour"] = 0x8000 | shade[:, 0] << 10 | shade[:, 1] << 5 | shade[:, 2]
    # readers take a file that begins with "solid" for text
    head = f"roemetry mm {_plain(title)}".encode("ascii")[:80].ljust(80)
    return head + struct.pack("<I", len(facets)) + facets.tobytes()


def colours(certainty: Certainty) -> np.ndarray:
    """Give (vertex, 3) colours of 0 to 255: by uncertainty, grey where the surface is assumed."""
    std: Floats = certainty.std_mm
    known = np.isfinite(std) & (certainty.support != ASSUMED)
    largest = float(np.percentile(std[known], 99)) if known.any() else 0.0
    share = np.clip(np.nan_to_num(std) / largest, 0.0, 1.0) if largest > 0.0 else np.zeros(std.size)
    at = np.linspace(0.0, 1.0, len(_STOPS))
    coloured = np.column_stack([np.interp(share, at, _STOPS[:, k]) for k in range(3)])
    return np.where(known[:, None], coloured, _GREY).round().astype(np.uint8)


def _plain(title: str) -> str:
    return title.encode("ascii", "replace").decode("ascii").replace("\n", " ").replace("\r", " ")
