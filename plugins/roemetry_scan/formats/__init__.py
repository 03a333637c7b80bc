"""Heights and points of other sensors' files: one module a format, each a reader and a writer.

Every reader checks what it reads against the file's header and raises `DataError` with the file's name: a
file that was cut off is refused, not read as far as it goes.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roemetry.errors import DataError, RecordError

if TYPE_CHECKING:
    from roemetry_scan.formats.points import Measured

_MODULES = {
    ".tif": "raster", ".tiff": "raster", ".png": "raster", ".npy": "raster", ".csv": "table", ".ply": "ply",
    ".pcd": "pcd", ".las": "las", ".laz": "las", ".x3p": "x3p",
}  # fmt: skip
SUFFIXES = tuple(_MODULES)


def read(path: Path) -> Measured:
    """Read a file by its suffix; DataError where it cannot be read, is damaged, or is cut off."""
    try:
        found: Measured = _module(path).read(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, KeyError, IndexError, OverflowError, TypeError, EOFError, RecordError) as error:
        raise DataError(f"{path}: not a readable {path.suffix[1:].upper()} file: {error}") from error
    return found


def write(path: Path, measured: Measured) -> list[Path]:
    """Write a file by its suffix; give the files written."""
    written: list[Path] = _module(path).write(path, measured)
    return written


def _module(path: Path) -> Any:
    name = _MODULES.get(path.suffix.lower())
    if name is None:
        raise DataError(f"{path}: no format of heights or points", hint=f"known are {', '.join(SUFFIXES)}")
    return import_module(f"roemetry_scan.formats.{name}")
