"""The sink `slices`: every acquisition's slices in the formats of other sensors and programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from roemetry.errors import RoemetryError
from roemetry.io.files import make_folder
from roemetry.stages import Run, Sink, StageOptions
from roemetry_scan.formats import write
from roemetry_scan.formats.points import measured_of


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

    Options: ClassVar[type[StageOptions]] = SlicesOptions

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
