"""TIFF, PNG and NumPy arrays of heights with a YAML file of the same name beside them, GenICam's Coord3D too.

The sidecar says how numbers become millimetres, for each axis as GenICam's SFNC does (Scan3dCoordinateScale,
…Offset, InvalidDataFlag with …Value):

    pixel_format: Coord3D_C16      # C: a height a pixel; ABC: X, Y and Z of each; AC: X and Z
    z: {scale: 0.01, offset: -5}   # mm = scale · number + offset
    x: {scale: 0.25, offset: 0}    # of the column, where the format does not hold X itself
    y: {scale: -0.25, offset: 0}   # of the row
    no_data: 0                     # number that means nothing is known; NaN always does

`slices` says whether columns or rows lie across the belt's way.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from roemetry.config.recipe_file import Section
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError, DataError
from roemetry.io.files import is_file, write_bytes, write_whole
from roemetry.io.yaml_source import dump
from roemetry.io.yaml_source import read as read_yaml
from roemetry_scan.formats.points import Measured, sliced


class Axis(Section):
    """How numbers of one axis become millimetres."""

    scale: float = Field(description="mm for each step of the number")
    offset: float = Field(default=0.0, description="mm at the number 0")


class Sidecar(Section):
    """What a height map's numbers mean."""

    pixel_format: Literal[
        "Coord3D_C16", "Coord3D_C32f", "Coord3D_ABC32f", "Coord3D_ABC16", "Coord3D_AC32f", "Coord3D_AC16"
    ] = Field(default="Coord3D_C16", description="which coordinates a pixel holds")
    z: Axis = Field(description="of the heights")
    x: Axis = Field(default=Axis(scale=1.0), description="of X, or of the column where pixels hold no X")
    y: Axis = Field(default=Axis(scale=-1.0), description="of Y, or of the row where pixels hold no Y")
    no_data: float | None = Field(default=None, description="number of a height that is not known")
    slices: Literal["columns", "rows"] = Field(
        default="columns", description="what lies across the way the belt runs"
    )
    height_std_mm: float | None = Field(
        default=None, gt=0, description="standard uncertainty of a height, mm, where it is known"
    )


def read(path: Path) -> Measured:
    """Read heights by their sidecar; DataError where there is none, or the array is not as it says."""
    beside = path.with_suffix(".yaml")
    if not is_file(beside):
        raise DataError(
            f"{path}: there is no {beside.name} beside it, which says what its numbers mean",
            hint="it needs `z: {scale, offset}` and `x`, `y: {scale}` in mm; see the page of `height-files`",
        )
    document = read_yaml(beside)
    told, faults = checked(Sidecar, document.data, document.place)
    if told is None:
        raise ConfigurationError(faults)
    numbers = _array(path)
    # letters of the format: which coordinates a pixel holds
    channels = told.pixel_format.removeprefix("Coord3D_").rstrip("0123456789f")
    wanted = 2 if channels == "C" else 3
    if numbers.ndim != wanted or (wanted == 3 and numbers.shape[2] != len(channels)):
        raise DataError(f"{path}: an array of shape {numbers.shape}, which is no {told.pixel_format}")
    planes = {name: numbers if wanted == 2 else numbers[..., k] for k, name in enumerate(channels)}
    height = planes["C"].astype(np.float64)
    lost = ~np.isfinite(height) | (height == told.no_data if told.no_data is not None else False)
    rows, columns = height.shape
    xyz = np.empty((rows, columns, 3))
    x = planes["A"] if "A" in planes else np.arange(columns, dtype=np.float64)[None, :]
    y = planes["B"] if "B" in planes else np.arange(rows, dtype=np.float64)[:, None]
    for k, (values, axis) in enumerate(((x, told.x), (y, told.y), (height, told.z))):
        xyz[..., k] = axis.scale * values + axis.offset
    xyz[lost] = np.nan
    std = np.nan if told.height_std_mm is None else told.height_std_mm
    return Measured(xyz.transpose(1, 0, 2) if told.slices == "columns" else xyz, std)


def _array(path: Path) -> Any:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return np.load(path, allow_pickle=False)
    if suffix == ".png":
        import cv2

        data = np.fromfile(path, np.uint8)
        # OpenCV decodes as far as it goes, and fills up with black
        whole = data.size > 12 and data[-8:-4].tobytes() == b"IEND"
        found = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if whole else None
        if found is None:
            raise DataError(f"{path}: not a whole PNG image")
        # OpenCV has blue first
        if found.ndim == 3:
            found = found[..., ::-1]
        return found
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            return file.pages[0].asarray()
    except Exception as error:  # tifffile raises what it likes on damaged files
        raise DataError(f"{path}: not a readable TIFF: {error}") from error


def write(path: Path, measured: Measured) -> list[Path]:
    """Write slices as columns, each pixel with its own X, Y and Z, and the sidecar that says so.

    TIFF and NPY of 32-bit floats, PNG of 16 bits: resampled on a regular grid, edges would move.
    """
    xyz = sliced(measured).transpose(1, 0, 2)
    told: dict[str, Any] = {"pixel_format": "Coord3D_ABC32f"}
    told |= {axis: {"scale": 1.0, "offset": 0.0} for axis in "xyz"}
    if path.suffix.lower() == ".npy":
        import io

        file = io.BytesIO()
        np.save(file, xyz.astype(np.float32))
        write_bytes(path, file.getvalue())
    elif path.suffix.lower() == ".png":
        import cv2

        known = xyz[np.isfinite(xyz).all(axis=2)]
        if not known.size:
            raise DataError(f"{path}: no point was seen, there is nothing to write")
        low = known.min(axis=0)
        scale = np.maximum(np.ptp(known, axis=0) / 65533.0, 1e-6)
        # steps from 1 to 65,534; 0 is kept for what is not known
        grey = np.where(np.isfinite(xyz), np.rint((xyz - low) / scale) + 1.0, 0.0).astype(np.uint16)
        told = {"pixel_format": "Coord3D_ABC16", "no_data": 0}
        told |= {
            axis: {"scale": float(step), "offset": float(first - step)}
            for axis, step, first in zip("xyz", scale, low, strict=True)
        }
        write_bytes(path, bytes(cv2.imencode(".png", grey[..., ::-1])[1].tobytes()))
    else:
        import io

        import tifffile

        file = io.BytesIO()
        tifffile.imwrite(file, xyz.astype(np.float32), compression="zlib", photometric="rgb")
        write_bytes(path, file.getvalue())
    beside = path.with_suffix(".yaml")
    write_whole(beside, "# What the heights beside this file mean, mm.\n" + dump(told))
    return [path, beside]
