"""The sink `height-map`: heights over the belt on a regular grid, as 16-bit TIFF."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.records import Profiles, Trace
from roemetry.records.arrays import Floats
from roemetry.stages import Run, Sink, StageOptions
from roemetry_files.points import write_each

_LEVELS = 65535  # of 16 bits; 0 is where nothing is known


class HeightMapOptions(StageOptions):
    """Options of `HeightMap`."""

    pixel_mm: float = Field(default=0.25, gt=0, le=100, description="side of a pixel of the map, mm")


class HeightMap(Sink[HeightMapOptions]):
    """Writes ``height_maps/<acquisition>.tif``: two pages, the heights and how each of them is known.

    Page 1, 16 bit: height = offset_mm + scale_mm · grey level; grey level 0 means not known. Page 2, 8 bit:
    0 not known, 1 seen, 2 interpolated. The image description of page 1 is JSON with scale, offset, size of a
    pixel and the belt position of the first one.
    """

    def write(self, run: Run) -> Sequence[Path]:
        """Write a file for each acquisition that was triangulated."""
        return write_each(run, "height_maps", ".tif", lambda trace: _tiff(trace, self.options.pixel_mm))


def _tiff(trace: Trace, pixel_mm: float) -> bytes | None:
    import tifffile

    found = None if trace.profiles is None else raster(trace.profiles, pixel_mm)
    if found is None:
        return None

    grey, offset_mm, scale_mm = _quantised(found.height_mm)
    said = {
        "unit": "mm",
        "height": "offset_mm + scale_mm * grey, grey 0: not known",
        "offset_mm": offset_mm,
        "scale_mm": scale_mm,
        "pixel_mm": pixel_mm,
        "first_pixel_belt_mm": [found.x_mm, found.y_mm],
        "columns": "along belt X",
        "rows": "against belt Y",
        "page 2": {"0": "not known", "1": "seen", "2": "interpolated"},
    }
    file = io.BytesIO()
    with tifffile.TiffWriter(file) as writer:
        resolution = (10.0 / pixel_mm, 10.0 / pixel_mm)
        for page, description in (
            (grey, json.dumps(said)),
            (found.known, "0 not known, 1 seen, 2 interpolated"),
        ):
            writer.write(
                page,
                description=description,
                metadata=None,
                resolution=resolution,
                resolutionunit="CENTIMETER",
                compression="zlib",
            )
    return file.getvalue()


def _quantised(height_mm: Floats) -> tuple[np.ndarray, float, float]:
    """Grey levels from 1, the height of level 0 and the step of one level, mm."""
    low, high = float(np.nanmin(height_mm)), float(np.nanmax(height_mm))
    scale_mm = max((high - low) / (_LEVELS - 1), 1e-6)
    offset_mm = low - scale_mm
    levels = np.rint((height_mm - offset_mm) / scale_mm)
    return np.where(np.isfinite(height_mm), levels, 0).astype(np.uint16), offset_mm, scale_mm


SEEN, INTERPOLATED = 1, 2  # what a cell of the mask says: 0 is empty

_GAP_STEPS = 2.5
"""A slice's points farther apart than so many of its usual steps are not joined."""


@dataclass(frozen=True, eq=False, slots=True)
class Raster:
    """Heights over the belt."""

    height_mm: Floats
    """(row, column) heights, mm; rows go against belt Y (as in the image), columns along X; NaN not known."""
    known: NDArray[np.uint8]
    """(row, column) 0 not known, 1 seen, 2 interpolated."""
    x_mm: float
    y_mm: float
    """x_mm, y_mm: belt position of the centre of pixel (0, 0), mm."""


def raster(profiles: Profiles, pixel_mm: float) -> Raster | None:
    """Lay slices on a grid.

    Between neighbouring stripes heights are interpolated linearly along X, where both show the same product
    (or both the belt); nothing is interpolated over a stripe that is missing, or beyond the outer ones.

    Parameters
    ----------
    profiles
        Slices in the belt frame.
    pixel_mm
        Side of a pixel, mm.

    Returns
    -------
    Raster or None
        None where no point is known.
    """
    known = np.isfinite(profiles.xyz_mm).all(axis=2) & (profiles.product >= 0)
    if not known.any():
        return None
    points = profiles.xyz_mm[known]
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    columns, rows = (int(np.floor((high[axis] - low[axis]) / pixel_mm)) + 1 for axis in (0, 1))
    x_mm = low[0] + pixel_mm * np.arange(columns)
    y_mm = high[1] - pixel_mm * np.arange(rows)
    height_mm = np.full((rows, columns), np.nan)
    marks = np.zeros((rows, columns), dtype=np.uint8)
    order = np.argsort(profiles.stripe, kind="stable")
    slices = {int(profiles.stripe[index]): _on_rows(profiles, index, known[index], y_mm) for index in order}
    for (left, a), (right, b) in pairwise(slices.items()):
        if right == left + 1:
            _between(a, b, x_mm, height_mm, marks)
    for x, z, label in slices.values():
        _along(x, z, label, x_mm, pixel_mm, height_mm, marks)
    return Raster(height_mm, marks, float(x_mm[0]), float(y_mm[0]))


def _on_rows(
    profiles: Profiles, index: int, known: NDArray[np.bool_], y_mm: Floats
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Give a slice's X, Z and label at the grid's rows; NaN and −1 where it was not seen."""
    x, z = np.full(len(y_mm), np.nan), np.full(len(y_mm), np.nan)
    label = np.full(len(y_mm), -1, dtype=np.int64)
    points = profiles.xyz_mm[index][known]
    if len(points) < 2:
        return x, z, label
    order = np.argsort(points[:, 1])
    points, labels = points[order], profiles.product[index][known][order]
    above = np.searchsorted(points[:, 1], y_mm)
    inside = (above > 0) & (above < len(points))
    after = above[inside]
    before = after - 1
    steps = points[after, 1] - points[before, 1]
    usual = float(np.median(np.diff(points[:, 1])))
    joined = (steps <= _GAP_STEPS * usual) & (steps > 0) & (labels[after] == labels[before])
    after, before, rows = after[joined], before[joined], np.flatnonzero(inside)[joined]
    share = (y_mm[rows] - points[before, 1]) / steps[joined]
    x[rows] = points[before, 0] + share * (points[after, 0] - points[before, 0])
    z[rows] = points[before, 2] + share * (points[after, 2] - points[before, 2])
    label[rows] = labels[before]
    return x, z, label


def _between(
    a: tuple[Floats, Floats, NDArray[np.int64]],
    b: tuple[Floats, Floats, NDArray[np.int64]],
    x_mm: Floats,
    height_mm: Floats,
    marks: NDArray[np.uint8],
) -> None:
    for row in np.flatnonzero((a[2] >= 0) & (a[2] == b[2]) & (b[0] > a[0])):
        first, last = np.searchsorted(x_mm, (a[0][row], b[0][row]))
        share = (x_mm[first:last] - a[0][row]) / (b[0][row] - a[0][row])
        height_mm[row, first:last] = a[1][row] + share * (b[1][row] - a[1][row])
        marks[row, first:last] = INTERPOLATED


def _along(
    x: Floats,
    z: Floats,
    label: NDArray[np.int64],
    x_mm: Floats,
    pixel_mm: float,
    height_mm: Floats,
    marks: NDArray[np.uint8],
) -> None:
    rows = np.flatnonzero(label >= 0)
    columns = np.clip(np.rint((x[rows] - x_mm[0]) / pixel_mm).astype(int), 0, len(x_mm) - 1)
    height_mm[rows, columns] = z[rows]
    marks[rows, columns] = SEEN
