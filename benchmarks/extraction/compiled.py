"""What a first try in C++ finds: `rows.cpp`, compiled where there is a compiler; told a fitting threshold."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.extraction.peers import PROMINENCE
from benchmarks.extraction.scoring import Found

SOURCE = Path(__file__).with_name("rows.cpp")
COMPILER = next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)
_PEAKS_A_ROW = 64


def compiled(reach: int, *, weighted: bool) -> Callable[[NDArray[Any]], Found]:
    """Give the extractor that looks at `reach` pixels on both sides of a top."""

    def find(pixels: NDArray[Any]) -> Found:
        rows, columns = pixels.shape
        room = _PEAKS_A_ROW * rows
        row, x_px = np.empty(room), np.empty(room)
        count = _library().peaks(
            pixels.ctypes.data, rows, columns, int(PROMINENCE), reach, int(weighted), room, row.ctypes.data,
            x_px.ctypes.data,
        )  # fmt: skip
        return Found(row[:count], x_px[:count], np.full(count, np.nan))

    return find


@cache
def _library() -> Any:
    assert COMPILER is not None
    made = Path(mkdtemp(prefix="roemetry-rows-")) / "rows.so"
    flags = ["-O3", "-march=native", "-std=c++17", "-shared", "-fPIC"]
    subprocess.run([COMPILER, *flags, str(SOURCE), "-o", str(made)], check=True)
    library = ctypes.CDLL(str(made))
    pointer, whole = ctypes.c_void_p, ctypes.c_int64
    library.peaks.argtypes = [pointer, whole, whole, *3 * [ctypes.c_int], whole, pointer, pointer]
    library.peaks.restype = whole
    return library
