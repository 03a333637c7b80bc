"""height_maps/: the heights of each acquisition as a 16-bit TIFF, for image processing."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry.records import Trace
from roemetry.records.arrays import Floats
from roemetry.stages import Run, Sink, StageOptions
from roemetry_files.each_acquisition import write_each
from roemetry_files.rastering import raster

_LEVELS = 65535


class HeightMapOptions(StageOptions):
    """Options of `HeightMap`."""

    pixel_mm: float = Field(default=0.25, gt=0, le=100, description="side of a pixel of the map, mm")


class HeightMap(Sink[HeightMapOptions]):
    """Writes ``height_maps/<acquisition>.tif``: two pages, the heights and how each of them is known.

    Page 1, 16 bit: height = offset_mm + scale_mm · grey level; grey level 0 means not known. Page 2, 8 bit:
    0 not known, 1 seen, 2 interpolated. The image description of page 1 is JSON with scale, offset, size of a
    pixel and the belt position of the first one.
    """

    Options: ClassVar[type[StageOptions]] = HeightMapOptions

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
