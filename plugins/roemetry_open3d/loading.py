"""Open3D, which is large and optional: imported where a mesh is made, and nowhere else."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import sys
from typing import Any

from roemetry.errors import StageError

_INSTALL = "pip install 'roemetry[open3d]'"


def open3d() -> Any:
    """Import Open3D; where the system lacks libusb-1.0, with the one of the package libusb-package.

    Raises
    ------
    StageError
        Open3D is not installed, or cannot be loaded.
    """
    if importlib.util.find_spec("open3d") is None:
        raise StageError("meshes are made by Open3D, which is not installed", hint=_INSTALL)
    try:
        loaded = importlib.import_module("open3d")
    except (ImportError, OSError):
        for name in [name for name in sys.modules if name.split(".")[0] == "open3d"]:
            del sys.modules[name]
        try:
            path = importlib.import_module("libusb_package").get_library_path()
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
            loaded = importlib.import_module("open3d")
        except (ImportError, OSError) as error:
            raise StageError(
                f"Open3D is installed and cannot be loaded: {error}",
                hint=f"{_INSTALL} brings the libusb-1.0 that a bare system lacks",
            ) from error
    # its warnings of degenerate simplices are no news to who asked for a volume
    loaded.utility.set_verbosity_level(loaded.utility.VerbosityLevel.Error)
    return loaded
