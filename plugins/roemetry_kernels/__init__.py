"""Compiled kernels that several plugins share: a library that registers nothing."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def _give_numba_a_place() -> None:
    """Let numba keep its cache in the system's temporary folder where it can write nowhere else.

    It looks beside the code and in the home folder; a service in a container may have neither.
    """
    writable = any(os.access(place, os.W_OK) for place in (Path(__file__).parent, Path.home()))
    if not writable and "NUMBA_CACHE_DIR" not in os.environ:
        os.environ["NUMBA_CACHE_DIR"] = str(Path(tempfile.gettempdir()) / f"roemetry-numba-{os.getuid()}")


if hasattr(os, "getuid"):
    _give_numba_a_place()
