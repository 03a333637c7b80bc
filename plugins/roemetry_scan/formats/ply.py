"""PLY (Turk 1994): the element `vertex` with x, y, z, ASCII or binary of either order; counts are checked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roemetry.errors import DataError
from roemetry.io.files import write_bytes
from roemetry_scan.formats.points import Measured, flat, from_flat

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


def read(path: Path) -> Measured:
    """Read the vertices; DataError where there are fewer than the header says."""
    data = path.read_bytes()
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise DataError(f"{path}: no PLY header")
    begin = data.index(b"\n", end) + 1
    lines = [line.split() for line in data[:end].decode("ascii").splitlines()]
    form = next(line[1] for line in lines if line[:1] == ["format"])
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for line in lines:
        if line[:1] == ["element"]:
            elements.append((line[1], int(line[2]), []))
        elif line[:1] == ["property"]:
            if line[1] == "list":
                # lists have no fixed size; noted, and refused if they are of vertices
                elements[-1][2].append((line[-1], ""))
            else:
                elements[-1][2].append((line[2], _TYPES[line[1]]))
    if not elements or elements[0][0] != "vertex":
        raise DataError(f"{path}: the first element is not `vertex`")
    _, count, properties = elements[0]
    if any(not kind for _, kind in properties):
        raise DataError(f"{path}: vertices have lists")
    if form == "ascii":
        rows = data[begin:].split(b"\n")[:count]
        # the last line may be empty where the file was cut off
        if len(rows) < count or (count and not rows[-1].strip()):
            raise DataError(
                f"{path}: {len(rows)} of the {count} points that its header names: it was cut off"
            )
        table = np.array([[float(word) for word in row.split()] for row in rows])
        at = {name: table[:, k] for k, (name, _) in enumerate(properties)}
    else:
        kind = np.dtype([(name, _ORDERS[form] + kind) for name, kind in properties])
        there = (len(data) - begin) // kind.itemsize
        if there < count:
            raise DataError(f"{path}: {there} of the {count} points that its header names: it was cut off")
        points = np.frombuffer(data, kind, count, begin)
        at = {name: points[name] for name in kind.names or ()}
    xyz = np.column_stack([at[name] for name in "xyz"]).astype(np.float64)
    return from_flat(xyz, at.get("slice"), at.get("point"))


_POINT = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("slice", "<i4"), ("point", "<i4")])
_NAMES = {"<f8": "double", "<i4": "int"}


def write(path: Path, measured: Measured) -> list[Path]:
    """Write the points, binary, with each one's slice and place in it."""
    xyz, slices, places = flat(measured)
    points = np.empty(len(xyz), _POINT)
    for k, name in enumerate("xyz"):
        points[name] = xyz[:, k]
    points["slice"], points["point"] = slices, places
    header = [
        "ply", "format binary_little_endian 1.0", "comment roemetry: belt frame, mm",
        f"element vertex {len(points)}",
        *(f"property {_NAMES[_POINT[name].str]} {name}" for name in _POINT.names or ()), "end_header\n",
    ]  # fmt: skip
    write_bytes(path, "\n".join(header).encode("ascii") + points.tobytes())
    return [path]
