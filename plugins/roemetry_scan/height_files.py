"""Files of heights and points: the source `height-files` reads them, the sink `slices` writes them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.errors import DataError, RoemetryError
from roemetry.io.files import make_folder
from roemetry.records import Acquisition, AcquisitionReference
from roemetry.stages import Capabilities, Run, Sink, Source, StageOptions
from roemetry_scan.formats import SUFFIXES, read, write
from roemetry_scan.formats.points import Measured, measured_of, profiles_of

_MM = {"mm": 1.0, "m": 1000.0, "um": 1e-3, "inch": 25.4}


class HeightSourceOptions(StageOptions):
    """Options of `HeightMaps`."""

    unit: Literal["mm", "m", "um", "inch"] = Field(default="mm", description="unit of the file's lengths")
    turn: Literal[0, 90, 180, 270] = Field(
        default=0, description="counter-clockwise turn about Z, degrees, that lays the belt's way along X"
    )
    pixel_mm: float | None = Field(
        default=None,
        gt=0,
        le=100,
        description="of a cloud without slices: side of a pixel, mm; none: its own",
    )


class HeightMaps(Source[HeightSourceOptions]):
    """Reads height maps and point clouds: TIFF, PNG, NPY with a sidecar, CSV, PLY, PCD, LAS, LAZ, X3P.

    Where in them the belt lies, and what is product, the assembler finds.
    """

    capabilities = Capabilities(fixture="roemetry_scan.conformance:two_height_maps")
    gives = "slices"

    def references(self, path: Path) -> Sequence[AcquisitionReference]:
        """List the files that a path, a folder or a pattern names; DataError where there is none."""
        if path.is_dir():
            found = [one for one in sorted(path.iterdir()) if one.suffix.lower() in SUFFIXES]
        elif path.is_file():
            found = [path]
        else:
            whole = path.absolute()
            found = sorted(Path(whole.anchor).glob(str(whole.relative_to(whole.anchor))))
            found = [one for one in found if one.suffix.lower() in SUFFIXES]
        if not found:
            raise DataError(f"{path}: there is no height map", hint=f"known are {', '.join(SUFFIXES)}")
        # files that differ by suffix alone keep it in their names
        stems = [one.stem for one in found]
        return [
            AcquisitionReference(one.stem if stems.count(one.stem) == 1 else one.name, {"laser": one})
            for one in found
        ]

    def read(self, reference: AcquisitionReference) -> Acquisition:
        """Read a file; DataError where it is damaged, cut off, or not in the unit that is stated."""
        path = reference.files["laser"]
        found = read(path)
        xyz = found.xyz_mm * _MM[self.options.unit]
        quarter = self.options.turn // 90
        for _ in range(quarter):
            # a quarter turn counter-clockwise: (x, y) to (−y, x)
            xyz = np.stack([-xyz[..., 1], xyz[..., 0], xyz[..., 2]], axis=-1)
        # an odd number of quarters changes what is a slice and what a point of it
        if quarter % 2 and xyz.ndim == 3:
            xyz = xyz.transpose(1, 0, 2)
        std_mm = found.std_mm * _MM[self.options.unit]
        profiles = profiles_of(Measured(xyz, std_mm), self.options.pixel_mm, str(path))
        return Acquisition(reference.id, (), profiles=profiles)


class SlicesOptions(StageOptions):
    """Options of `SliceFiles`."""

    format: Literal["ply", "pcd", "las", "csv", "tif", "png", "npy", "x3p"] = Field(
        default="ply", description="clouds that keep their slices (ply, pcd, las, csv), or height maps"
    )


class SliceFiles(Sink[SlicesOptions]):
    """Writes ``slices/<acquisition>.<format>``: what was seen of belt and products, belt frame, mm.

    Clouds keep each point's slice and place in it. Height maps hold a slice a column, each pixel with its own
    X, Y and Z. What was bridged or followed is left out: who reads the file follows it again.
    """

    def write(self, run: Run) -> Sequence[Path]:
        """Write a file for each acquisition that was triangulated; what is gone is passed over."""
        folder = run.folder / "slices"
        make_folder(folder)
        written: list[Path] = []
        for name in dict.fromkeys(row.acquisition for row in run.measurements()):
            try:
                profiles = run.replay(name).profiles
            except RoemetryError:
                continue
            if profiles is None:
                continue
            # whatever a source calls its acquisitions, the file stays in its folder
            path = folder / f"{name.replace('/', '_').replace(chr(92), '_')}.{self.options.format}"
            written += write(path, measured_of(profiles))
        return written
