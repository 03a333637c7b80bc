"""X3P (ISO 25178-72): a zip of an XML description and a matrix of heights, in metres; its MD5 is checked."""

from __future__ import annotations

import hashlib
import io
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from roemetry.errors import DataError
from roemetry.io.files import write_bytes
from roemetry_scan.formats.points import Measured, sliced

_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
_MM = 1000.0  # in a metre, the unit of the file
_NAMESPACE = "http://www.opengps.eu/2008/ISO5436_2"
_BYTES_MAX = 2_000_000_000  # of an unpacked member: a small archive may hold any size


def read(path: Path) -> Measured:
    """Read the heights; DataError where parts are missing, sizes differ, or the checksum is another one."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = {name.lower(): name for name in archive.namelist()}
            if "main.xml" not in names:
                raise DataError(f"{path}: there is no main.xml in it")
            text = archive.read(names["main.xml"])
            # entities can make a small file endless (billion laughs)
            if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
                raise DataError(f"{path}: main.xml declares entities: no X3P file does")
            tree = ElementTree.fromstring(text)
            link = _text(tree, "PointDataLink").lower()
            if link.removeprefix("./") not in names:
                raise DataError(f"{path}: there is no {link} in it")
            member = names[link.removeprefix("./")]
            if archive.getinfo(member).file_size > _BYTES_MAX:
                raise DataError(f"{path}: its heights are larger than 2 GB")
            data = archive.read(member)
    except (zipfile.BadZipFile, ElementTree.ParseError, EOFError) as error:
        raise DataError(f"{path}: not an X3P file, or damaged: {error}") from error
    # a checksum that is left out is not missed
    wanted = _text(tree, "MD5ChecksumPointData", "")
    if wanted and hashlib.md5(data, usedforsecurity=False).hexdigest().upper() != wanted.upper():
        raise DataError(f"{path}: the heights' checksum is another one than main.xml says: damaged")
    columns, rows, layers = (int(_text(tree, f"Size{axis}")) for axis in "XYZ")
    if layers != 1:
        raise DataError(f"{path}: {layers} layers, expected one")
    axes = [_axis(tree, f"C{axis}") for axis in "XYZ"]
    kinds = [np.dtype(_TYPES[_text(one, "DataType", "D")]) for one in axes]
    # absolute axes: each point has its own X and Y; else they are steps of the number
    own = _text(axes[0], "AxisType", "I") == _text(axes[1], "AxisType", "I") == "A"
    whole = np.dtype([(str(k), kind) for k, kind in enumerate(kinds)] if own else [("2", kinds[2])])
    if len(data) != columns * rows * whole.itemsize:
        raise DataError(
            f"{path}: {len(data)} bytes of heights, expected {columns} × {rows} × {whole.itemsize}"
        )
    points = np.frombuffer(data, whole).reshape(rows, columns)
    number = {"0": np.arange(columns)[None, :], "1": np.arange(rows)[:, None]}
    xyz = np.empty((columns, rows, 3))
    for k, one in enumerate(axes):
        values = points[str(k)] if own or k == 2 else number[str(k)]
        step = _text(one, "Increment", "1" if own or k == 2 else None)
        xyz[..., k] = ((values * float(step) + float(_text(one, "Offset", "0"))) * _MM).T
    return Measured(xyz)


def _find(tree: ElementTree.Element, name: str) -> ElementTree.Element | None:
    return next((one for one in tree.iter() if one.tag.rsplit("}", 1)[-1] == name), None)


def _axis(tree: ElementTree.Element, name: str) -> ElementTree.Element:
    found = _find(tree, name)
    if found is None:
        raise ValueError(f"main.xml has no {name}")
    return found


def _text(tree: ElementTree.Element, name: str, default: str | None = None) -> str:
    found = _find(tree, name)
    if found is None or not (found.text or "").strip():
        if default is None:
            raise ValueError(f"main.xml has no {name}")
        return default
    return (found.text or "").strip()


def write(path: Path, measured: Measured) -> list[Path]:
    """Write slices with each point's own X and Y, as doubles; DataError for a cloud without slices."""
    xyz = sliced(measured).transpose(1, 0, 2)
    data = np.ascontiguousarray(xyz / _MM).astype("<f8").tobytes()
    axes = "".join(
        f"<C{axis}><AxisType>A</AxisType><DataType>D</DataType><Increment>1.0</Increment>"
        f"<Offset>0.0</Offset></C{axis}>"
        for axis in "XYZ"
    )
    date = datetime.now(UTC).isoformat(timespec="seconds")
    main = (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<p:ISO5436_2 xmlns:p="{_NAMESPACE}"><Record1>'
        f"<Revision>ISO5436 - 2000</Revision><FeatureType>SUR</FeatureType><Axes>{axes}</Axes></Record1>"
        f"<Record2><Date>{date}</Date><Creator>roemetry</Creator></Record2><Record3><MatrixDimension>"
        f"<SizeX>{xyz.shape[1]}</SizeX><SizeY>{xyz.shape[0]}</SizeY><SizeZ>1</SizeZ></MatrixDimension><DataLink>"
        "<PointDataLink>bindata/data.bin</PointDataLink><MD5ChecksumPointData>"
        f"{hashlib.md5(data, usedforsecurity=False).hexdigest().upper()}</MD5ChecksumPointData></DataLink>"
        "</Record3><Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4></p:ISO5436_2>\n"
    ).encode()
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("main.xml", main)
        archive.writestr("bindata/data.bin", data)
        sum_ = hashlib.md5(main, usedforsecurity=False).hexdigest().upper()
        archive.writestr("md5checksum.hex", f"{sum_} *main.xml\n")
    write_bytes(path, file.getvalue())
    return [path]
