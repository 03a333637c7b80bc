"""PCD 0.7 (Point Cloud Library), ASCII and binary; counts are checked, compressed ones refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roemetry.errors import DataError
from roemetry.io.files import write_bytes
from roemetry_scan.formats.points import Measured

_KINDS = {"F": "f", "I": "i", "U": "u"}


def read(path: Path) -> Measured:
    """Read the points; of an organised cloud (HEIGHT above 1) each row is a slice."""
    data = path.read_bytes()
    header: dict[str, list[str]] = {}
    begin = 0
    while "DATA" not in header:
        end = data.find(b"\n", begin)
        # a header is short: longer is another file
        if end < 0 or begin > 4096:
            raise DataError(f"{path}: no PCD header")
        words = data[begin:end].decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
        begin = end + 1
    names, width, height = header["FIELDS"], int(header["WIDTH"][0]), int(header["HEIGHT"][0])
    count = int(header.get("POINTS", [str(width * height)])[0])
    if count != width * height:
        raise DataError(f"{path}: {count} points, but WIDTH × HEIGHT is {width} × {height}")
    each = [int(n) for n in header.get("COUNT", ["1"] * len(names))]
    if not {"x", "y", "z"} <= set(names) or not len(names) == len(header["SIZE"]) == len(each):
        raise DataError(f"{path}: its fields are {' '.join(names)}, expected x y z, each with a size")
    form = header["DATA"][0]
    if form == "ascii":
        numbers = data[begin:].split()
        if len(numbers) < count * sum(each):
            raise DataError(f"{path}: {len(numbers) // sum(each)} of {count} points: it was cut off")
        table = np.array(numbers[: count * sum(each)], np.float64).reshape(count, sum(each))
        # a field may be several numbers; its first counts
        at = {name: table[:, sum(each[:k])] for k, name in enumerate(names)}
    elif form == "binary":
        sizes = zip(names, header["SIZE"], header["TYPE"], each, strict=True)
        kind = np.dtype([(name, f"<{_KINDS[type_]}{size}", (n,)) for name, size, type_, n in sizes])
        there = (len(data) - begin) // kind.itemsize
        if there < count:
            raise DataError(f"{path}: {there} of {count} points: it was cut off")
        points = np.frombuffer(data, kind, count, begin)
        at = {name: points[name][:, 0] for name in names}
    else:
        raise DataError(f"{path}: DATA {form} is not read", hint="save it as ascii or binary")
    xyz = np.column_stack([at[name] for name in "xyz"]).astype(np.float64)
    # an unorganised cloud has one row
    if height == 1:
        return Measured(xyz)
    return Measured(xyz.reshape(height, width, 3))


def write(path: Path, measured: Measured) -> list[Path]:
    """Write an organised cloud, binary: a row a slice, NaN where nothing is known."""
    xyz = measured.xyz_mm if measured.xyz_mm.ndim == 3 else measured.xyz_mm[None]
    height, width = xyz.shape[:2]
    header = (
        "# .PCD v0.7 - roemetry: belt frame, mm\nVERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\n"
        f"COUNT 1 1 1\nWIDTH {width}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {width * height}\n"
        "DATA binary\n"
    )
    write_bytes(path, header.encode("ascii") + xyz.astype("<f8").tobytes())
    return [path]
