"""From a target's description to the file that is printed or milled."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from roemetry.config.target_file import BoardFile, TargetFile, read_target
from roemetry.errors import ConfigurationError
from roemetry.io.files import make_folder, write_bytes, write_whole
from roemetry.targets.sheets import lay_out, pdf_of, svg_of
from roemetry.targets.solids import solid_triangles, stl_of

SheetFormat = Literal["svg", "pdf"]


@dataclass(frozen=True, slots=True)
class Made:
    """What was made of a target."""

    target: TargetFile
    """Its description."""
    identity: str
    """Short hash of it, as printed on a sheet."""
    file: Path
    """The sheet, or the solid."""
    size_mm: tuple[float, ...]
    """Of the page, or of the solid's box."""


def make_target(
    path: Path, folder: Path, *, sheet_format: SheetFormat = "svg", page: str | None = None
) -> Made:
    """Write a flat board as a sheet at true scale, a solid one as STL.

    Parameters
    ----------
    path
        The description.
    folder
        Where to write; made if need be.
    sheet_format
        Of a flat board.
    page
        Page size of a flat board; None takes the smallest ISO size that holds it.

    Raises
    ------
    ConfigurationError
        The description is at fault, or what was asked for does not go with it.
    OutputError
        The folder cannot be written.
    """
    target = read_target(path)
    identity = hashlib.sha256(json.dumps(target.model_dump(), sort_keys=True).encode()).hexdigest()[:8]
    make_folder(folder)
    if isinstance(target, BoardFile):
        sheet = lay_out(target, identity, page)
        file = folder / f"{target.name}.{sheet_format}"
        if sheet_format == "pdf":
            write_bytes(file, pdf_of(sheet))
        else:
            write_whole(file, svg_of(sheet))
        return Made(target, identity, file, (sheet.width_mm, sheet.height_mm))
    if page is not None:
        raise ConfigurationError(f"`{target.name}` is a solid: it has no page", hint="leave --page out")
    triangles = solid_triangles(target)
    file = folder / f"{target.name}.stl"
    write_bytes(file, stl_of(triangles, target.name))
    size = triangles.max(axis=(0, 1)) - triangles.min(axis=(0, 1))
    return Made(target, identity, file, tuple(float(side) for side in size))
