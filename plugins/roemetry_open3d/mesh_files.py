"""meshes/: a closed mesh of each product, for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field

from roemetry.errors import RoemetryError
from roemetry.io.files import make_folder, write_bytes, write_whole
from roemetry.stages import Run, Sink
from roemetry_open3d.loading import open3d
from roemetry_open3d.mesh_formats import ply, stl
from roemetry_open3d.meshing import mesh_of
from roemetry_open3d.sheet import sheet_of
from roemetry_open3d.surface_mesh import MeshOptions
from roemetry_open3d.vertex_uncertainty import certainty_of


class MeshFilesOptions(MeshOptions):
    """How meshes are made, and what is written."""

    formats: tuple[Literal["ply", "stl"], ...] = Field(
        default=("ply", "stl"), min_length=1, description="files to write for each product"
    )


class MeshFiles(Sink[MeshFilesOptions]):
    """Writes ``meshes/<product>.ply`` and ``.stl``, and ``meshes/not-made.txt`` where there is no mesh.

    Vertices are millimetres in the belt frame. The meshes are made anew from the images, whatever estimator
    gave the volume.
    """

    Options = MeshFilesOptions

    def write(self, run: Run) -> Sequence[Path]:
        """Write the files of each product.

        Raises
        ------
        StageError
            Open3D is not installed.
        """
        folder = run.folder / "meshes"
        written: list[Path] = []
        missing: list[str] = []
        rows = [row for row in run.measurements() if row.product > 0]
        if rows:
            open3d()
            make_folder(folder)
        for name in dict.fromkeys(row.acquisition for row in rows):
            try:
                products = [each.product for each in run.replay(name).products]
            except RoemetryError as error:
                missing.append(f"{name}: {error}")
                continue
            for product in products:
                title = f"{name}#{product.number}"
                try:
                    sheet = sheet_of(product, self.options.step_mm)
                    mesh = mesh_of(sheet, self.options.method, self.options.step_mm)
                except RoemetryError as error:
                    missing.append(f"{title}: {error}")
                    continue
                certainty = certainty_of(mesh, sheet, self.options.step_mm)
                for ending in dict.fromkeys(self.options.formats):
                    path = folder / f"{_file_name(title)}.{ending}"
                    write_bytes(path, (ply if ending == "ply" else stl)(mesh, certainty, title))
                    written.append(path)
        if missing:
            path = folder / "not-made.txt"
            write_whole(path, "".join(f"{line}\n" for line in missing))
            written.append(path)
        return written


def _file_name(title: str) -> str:
    """Give a name that stays in its folder, whatever a source calls its acquisitions."""
    return title.replace("/", "_").replace("\\", "_").replace("#", "_")
