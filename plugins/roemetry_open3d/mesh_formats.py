"""PLY and STL with a scalar at each vertex, as other programs read them."""

from __future__ import annotations

import struct

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_open3d.meshing import Mesh
from roemetry_open3d.vertex_uncertainty import ASSUMED, Certainty

_GREY = 150
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
