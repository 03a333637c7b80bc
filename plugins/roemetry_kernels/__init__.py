"""Compiled kernels that several plugins share: a library that registers nothing."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path


def _give_numba_a_place() -> None:
    """Let numba keep its cache in the system's temporary folder where it can write nowhere else.

    It looks beside the code and in the home folder; a service in a container may have neither.
    """
    writable = any(os.access(place, os.W_OK) for place in (Path(__file__).parent, Path.home()))
    if not writable and "NUMBA_CACHE_DIR" not in os.environ:
        os.environ["NUMBA_CACHE_DIR"] = str(Path(tempfile.gettempdir()) / f"roemetry-numba-{os.getuid()}")


_COMMON = "x86-64-v3"
"""AVX2 and FMA: processors of Intel since Haswell (2013), of AMD since Excavator (2015)."""
_NEEDED = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")


def _compile_for_common_processors() -> None:
    """Let numba compile for every processor with AVX2 instead of for this one.

    Kernels that a wheel brings then run on other machines, and numbers are the same on all of them. Wider
    vectors make the recommended recipe no faster (decision 6). Where somebody has chosen, or uses numba
    already in this process, it stays as it is.
    """
    chosen = "NUMBA_CPU_NAME" in os.environ or "NUMBA_CPU_FEATURES" in os.environ
    if chosen or "numba" in sys.modules:
        return
    from llvmlite import binding

    has = binding.get_host_cpu_features()
    if all(has.get(name) for name in _NEEDED):
        os.environ |= {"NUMBA_CPU_NAME": _COMMON, "NUMBA_CPU_FEATURES": ""}


if hasattr(os, "getuid"):
    _give_numba_a_place()
_compile_for_common_processors()
