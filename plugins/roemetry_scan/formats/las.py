"""LAS 1.0 to 1.4 (ASPRS): whole numbers with a scale and an offset; LAZ by the extra package laspy.

A point's slice and its place in it are extra bytes of it, which a record of the header describes to any
program; where roemetry wrote the file, they are read again.
LAS is told in metres by custom; the source's option `unit` says otherwise, and roemetry writes mm.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from roemetry.errors import DataError
from roemetry.io.files import write_bytes
from roemetry_scan.formats.points import Measured, flat, from_flat

_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of the point formats 0 to 10, at least."""
_STEP_MM = 1e-4  # that whole numbers of the file count
_EXTRA = ("slice", "point")
_SYSTEM = b"roemetry slices"
_POINT = np.dtype(
    {
        "names": ["xyz", "returns", *_EXTRA],
        "formats": [("<i4", 3), "u1", "<u2", "<u2"],
        "offsets": [0, 14, 20, 22],
        "itemsize": 24,
    }
)


def read(path: Path) -> Measured:
    """Read the points; DataError where there are fewer than the header says."""
    if path.suffix.lower() == ".laz":
        return _compressed(path)
    data = path.read_bytes()
    if data[:4] != b"LASF" or len(data) < 227:
        raise DataError(f"{path}: no LAS header")
    # offset of the points; then their format, size and number (public header, ASPRS)
    begin = struct.unpack_from("<I", data, 96)[0]
    form, size, count = struct.unpack_from("<BHI", data, 104)
    # LAZ sets the high bit of the format
    if form & 0x80:
        raise DataError(f"{path}: its points are compressed", hint="name the file .laz")
    # from version 1.4 on numbers of points are 64 bits; the old field may be 0
    if count == 0 and data[25] >= 4 and len(data) >= 255:
        count = struct.unpack_from("<Q", data, 247)[0]
    if form >= len(_SIZES) or size < _SIZES[form]:
        raise DataError(f"{path}: point format {form} of {size} bytes is not one of LAS")
    there = (len(data) - begin) // size
    if there < count:
        raise DataError(f"{path}: {there} of the {count} points that its header names: it was cut off")
    # scales before offsets, three of each
    scale, offset = np.frombuffer(data, "<f8", 6, 131).reshape(2, 3)
    # extra bytes of other programs' files mean something else
    ours = data[26:58].rstrip(b"\0") == _SYSTEM and size == _POINT.itemsize
    kind = _POINT if ours else np.dtype({"names": ["xyz"], "formats": [("<i4", 3)], "itemsize": size})
    points = np.frombuffer(data, kind, count, begin)
    xyz = points["xyz"] * scale + offset
    return from_flat(xyz, *(points[name] for name in _EXTRA)) if ours else Measured(xyz)


def write(path: Path, measured: Measured) -> list[Path]:
    """Write LAS 1.2, point format 0 with extra bytes, in steps of a tenth of a micrometre."""
    if path.suffix.lower() == ".laz":
        raise DataError(f"{path}: LAZ is read, not written", hint="write .las")
    xyz, *numbers = flat(measured)
    points = np.zeros(len(xyz), _POINT)
    for name, values in zip(_EXTRA, numbers, strict=True):
        if values.max(initial=0) > 65535:
            raise DataError(f"{path}: numbers of a {name} go up to {int(values.max())}, 65,535 is the most")
        points[name] = values
    # offset to the middle, so that whole numbers of 0.1 µm reach ± 200 m
    middle = np.rint(xyz.mean(axis=0))
    points["xyz"] = np.rint((xyz - middle) / _STEP_MM)
    # return 1 of 1
    points["returns"] = 0b00001001
    described = b"".join(struct.pack("<2xBx32s156x", 3, name.encode()) for name in _EXTRA)  # 3: two bytes
    record = struct.pack("<2x16sHH32s", b"LASF_Spec", 4, len(described), b"extra bytes") + described
    header = bytearray(227)
    header[0:4] = b"LASF"
    header[24:26] = bytes([1, 2])
    header[26 : 26 + len(_SYSTEM)] = _SYSTEM
    header[58:66] = b"roemetry"
    struct.pack_into("<HIIBHI", header, 94, 227, 227 + len(record), 1, 0, _POINT.itemsize, len(xyz))
    struct.pack_into("<I", header, 111, len(xyz))
    struct.pack_into("<6d", header, 131, *[_STEP_MM] * 3, *middle)
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    # largest and smallest of each axis alternate
    struct.pack_into("<6d", header, 179, *(value for pair in zip(high, low, strict=True) for value in pair))
    write_bytes(path, bytes(header) + record + points.tobytes())
    return [path]


def _compressed(path: Path) -> Measured:
    try:
        import laspy
    except ImportError as error:
        raise DataError(f"{path}: LAZ needs the package laspy", hint="pip install 'roemetry[laz]'") from error
    try:
        found = laspy.read(path)
        return Measured(np.column_stack([found.x, found.y, found.z]).astype(np.float64))
    except Exception as error:  # laspy and its decompressor raise what they like
        raise DataError(f"{path}: not a readable LAZ file: {error}") from error
