"""The source `height-files`: slices from files of heights and points that other sensors have made."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from roemetry.errors import DataError
from roemetry.records import Acquisition, AcquisitionReference
from roemetry.stages import Capabilities, Source, StageOptions
from roemetry_scan.formats import SUFFIXES, read
from roemetry_scan.formats.points import Measured, profiles_of

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

    Options: ClassVar[type[StageOptions]] = HeightSourceOptions
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
            xyz = np.stack([-xyz[..., 1], xyz[..., 0], xyz[..., 2]], axis=-1)
        if quarter % 2 and xyz.ndim == 3:
            xyz = xyz.transpose(1, 0, 2)
        std_mm = found.std_mm * _MM[self.options.unit]
        profiles = profiles_of(Measured(xyz, std_mm), self.options.pixel_mm, str(path))
        return Acquisition(reference.id, (), profiles=profiles)
