"""Triangle meshes from files (OBJ, STL, PLY), and the check that one is closed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


class Triangles(NamedTuple):
    """Points (V, 3) in the file's unit, and triangles (T, 3) of their indices, counted from 0."""

    points: Floats
    faces: Integers


def read_mesh(path: Path) -> Triangles:
    """Read an .obj, .stl or .ply file as it stands; faces of more corners are cut into fans.

    Raises
    ------
    DataError
        The file cannot be read; the message has its name and the reason.
    """
    readers = {".obj": _read_obj, ".stl": _read_stl, ".ply": _read_ply}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise DataError(f"{path}: a mesh file ends in {', '.join(readers)}, not {path.suffix!r}")
    try:
        mesh = reader(path.read_bytes())
    except OSError as fault:
        raise DataError(f"{path}: {fault.strerror or fault}") from fault
    except (ValueError, IndexError, KeyError, OverflowError) as fault:
        raise DataError(f"{path}: not a readable {path.suffix[1:].upper()} mesh: {fault}") from fault
    if not mesh.faces.size:
        raise DataError(f"{path}: the mesh has no faces")
    if not np.isfinite(mesh.points).all():
        raise DataError(f"{path}: the mesh has points that are NaN or infinite")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.points):
        raise DataError(f"{path}: a face names a point that is not there ({len(mesh.points)} points)")
    return mesh


def check_closed(mesh: Triangles, name: str) -> Triangles:
    """Join points at exactly the same place, drop faces without three corners, and check the rest.

    Raises
    ------
    DataError
        Edges are open, faces are turned against their neighbours, or no volume is enclosed; the message
        begins with the name.
    """
    points, which = np.unique(mesh.points, axis=0, return_inverse=True)
    faces = which.reshape(-1)[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    way = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    _, edge, counts = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    open_edges = int((counts % 2).sum())
    if open_edges:
        raise DataError(
            f"{name}: the mesh is not watertight: {open_edges} of {len(counts)} edges are open",
            hint="close its holes first; the volume of an open mesh is not defined",
        )
    turned = int((np.bincount(edge.reshape(-1), weights=way) != 0.0).sum())
    if turned:
        raise DataError(
            f"{name}: at {turned} of {len(counts)} edges faces are turned against each other",
            hint="make the faces' order of corners agree, so that all look outwards",
        )
    corner = points[faces]
    volume = np.einsum("ti,ti->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    if abs(volume) <= 1e-9 * float(np.prod(np.ptp(points, axis=0))):
        raise DataError(f"{name}: the mesh encloses no volume")
    return Triangles(points, faces)


def _read_obj(data: bytes) -> Triangles:
    points: list[list[float]] = []
    faces: list[list[int]] = []
    for number, line in enumerate(data.decode("utf-8", errors="replace").splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "v":
                points.append([float(word) for word in words[1:4]])
                if len(points[-1]) != 3:
                    raise ValueError("a point has three numbers")
            elif words[0] == "f":
                corners = [int(word.split("/")[0]) for word in words[1:]]
                faces.append([c - 1 if c > 0 else len(points) + c for c in corners])
        except ValueError as fault:
            raise ValueError(f"line {number}: {fault}") from fault
    return Triangles(np.array(points, dtype=np.float64).reshape(-1, 3), _fans(faces))


def _read_stl(data: bytes) -> Triangles:
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count and len(data) >= 84:
        row = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(data, row, count, 84)["corners"].astype(np.float64)
    elif data.lstrip().startswith(b"solid"):
        words = data.decode("ascii", errors="replace").split()
        at = [k for k, word in enumerate(words) if word == "vertex"]
        corners = np.array([words[k + 1 : k + 4] for k in at], dtype=np.float64).reshape(-1, 3, 3)
    else:
        raise ValueError(f"{count} triangles need {84 + 50 * count} bytes, the file has {len(data)}")
    return Triangles(corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int64).reshape(-1, 3))


class _Element(NamedTuple):
    """An element of a PLY header: name, rows, and its properties (name, type, type of a list's length)."""

    name: str
    rows: int
    properties: list[tuple[str, str, str]]


def _read_ply(data: bytes) -> Triangles:
    head, mark, rest = data.partition(b"end_header")
    if not data.startswith(b"ply") or not mark:
        raise ValueError("the header does not run from 'ply' to 'end_header'")
    body = rest[rest.index(b"\n") + 1 :]
    form, elements = _ply_header(head.decode("ascii", errors="replace").splitlines())
    take = _ply_text(body) if form == "ascii" else _ply_binary(body, form)
    rows = {element.name: _ply_rows(element, take) for element in elements}
    for needed in ("vertex", "face"):
        if needed not in rows:
            raise ValueError(f"there is no element {needed!r}")
    names = {element.name: [p[0] for p in element.properties] for element in elements}
    axes = [names["vertex"].index(axis) for axis in "xyz"]
    lists = [name in ("vertex_indices", "vertex_index") for name in names["face"]]
    points = np.array([[row[axis][0] for axis in axes] for row in rows["vertex"]], dtype=np.float64)
    faces = [[int(corner) for corner in row[lists.index(True)]] for row in rows["face"]]
    return Triangles(points.reshape(-1, 3), _fans(faces))


def _ply_header(lines: Sequence[str]) -> tuple[str, list[_Element]]:
    form, elements = "", list[_Element]()
    for words in (line.split() for line in lines):
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            length = _PLY_TYPES[words[2]] if words[1] == "list" else ""
            elements[-1].properties.append((words[-1], _PLY_TYPES[words[-2]], length))
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError(f"unknown format {form!r}")
    return form, elements


Take = Callable[[str, int], list[float]]
"""Gives the next so many numbers of a type."""


def _ply_text(body: bytes) -> Take:
    numbers, at = [float(word) for word in body.split()], 0

    def take(kind: str, count: int) -> list[float]:
        nonlocal at
        at += count
        if at > len(numbers):
            raise ValueError("the file ends early")
        return numbers[at - count : at]

    return take


def _ply_binary(body: bytes, form: str) -> Take:
    order, at = "<" if form == "binary_little_endian" else ">", 0

    def take(kind: str, count: int) -> list[float]:
        nonlocal at
        found: list[float] = np.frombuffer(body, order + kind, count, at).tolist()
        at += count * np.dtype(kind).itemsize
        return found

    return take


def _ply_rows(element: _Element, take: Take) -> list[list[list[float]]]:
    """Read an element's rows: of each property its number, or the numbers of its list."""
    return [
        [take(kind, int(take(length, 1)[0]) if length else 1) for _, kind, length in element.properties]
        for _ in range(element.rows)
    ]


def _fans(faces: Iterable[Sequence[int]]) -> Integers:
    """Cut polygons into triangles about their first corner."""
    cut = [(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)]
    return np.array(cut, dtype=np.int64).reshape(-1, 3)
