"""What people use today, each in its best form that we could write: OpenCV, scipy, numpy, packages.

All are told the threshold that suits these images; ours have to find it. None states an uncertainty. A first
try in C++ is `rows.cpp`, compiled where there is a compiler.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from benchmarks.extraction.drawing import Found
from roemetry.records.arrays import Floats, Integers

LEVEL = 40.0
"""Grey level between the ambient light of the images and the dimmest stripe."""
PROMINENCE = 30.0
SOURCE = Path(__file__).with_name("rows.cpp")
COMPILER = next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)
_REACH = 7
_SIGMA_PX = 2.0
_LOG = np.log(np.maximum(np.arange(256, dtype=np.float64), 0.5))
_PEAKS_A_ROW = 64
Pixels = NDArray[Any]
Maxima = tuple[Integers, Integers]


def opencv_log_parabola(pixels: Pixels) -> Found:
    """Blur, dilate, keep what equals its dilation; a parabola through three logarithms."""
    blurred, (row, column) = _opencv_maxima(pixels)
    at = row * pixels.shape[1] + column
    return _parabola(row, column, *(_LOG[blurred.ravel()[at + step]] for step in (-1, 0, 1)))


def opencv_centre_of_gravity(pixels: Pixels) -> Found:
    """The same maxima; centre of gravity of 15 pixels of the image, less the darkest of them."""
    return _gravity(pixels, *_opencv_maxima(pixels)[1])


def scipy_log_parabola(pixels: Pixels) -> Found:
    """`scipy.signal.find_peaks` with a prominence, row by row; a parabola through three logarithms."""
    row, column = _scipy_maxima(pixels)
    levels, last = _LOG[pixels], pixels.shape[1] - 1
    return _parabola(row, column, *(levels[row, np.clip(column + step, 0, last)] for step in (-1, 0, 1)))


def scipy_centre_of_gravity(pixels: Pixels) -> Found:
    """`scipy.signal.find_peaks` with a prominence, row by row; centre of gravity of 15 pixels."""
    return _gravity(pixels, *_scipy_maxima(pixels))


def numpy_run_centre_of_gravity(pixels: Pixels) -> Found:
    """Runs of pixels above a level, found by differences; the centre of gravity of each, above that level."""
    at = np.flatnonzero(pixels.ravel() > int(LEVEL))  # of a fraction, numpy would compare in floats
    row, column = np.divmod(at, pixels.shape[1])
    begins = np.ones(len(at), bool)
    begins[1:] = (np.diff(at) != 1) | (np.diff(row) != 0)
    first = np.flatnonzero(begins)
    wide = np.diff(np.append(first, len(at))) > 2
    if not wide.any():
        return _found(np.empty(0), np.empty(0))
    weight = pixels.ravel()[at] - LEVEL
    x_px = np.add.reduceat(weight * column, first) / np.add.reduceat(weight, first)
    return _found(row[first[wide]], x_px[wide])


def numpy_runs(pixels: Pixels) -> Found:
    """Take the middle of each run above a level: the fixed threshold of the paper's Figures 7 and 9."""
    above = np.pad(pixels > int(LEVEL), ((0, 0), (1, 1)))
    row, begin = np.nonzero(above[:, 1:] & ~above[:, :-1])
    end = np.nonzero(above[:, :-1] & ~above[:, 1:])[1]
    return _found(row, 0.5 * (begin + end - 1))


def numpy_maxima(pixels: Pixels) -> Found:
    """Take every maximum of a row above a level, as the paper's section 3.2 sets out."""
    here = pixels[:, 1:-1]
    row, before = np.nonzero((here >= pixels[:, :-2]) & (here > pixels[:, 2:]) & (here >= LEVEL))
    return _found(row, before + 1.0)


def opencv_steger(pixels: Pixels) -> Found:
    """Steger's lines with σ 2 px: where the second derivative across is strongest and the first one zero."""
    off = np.arange(-_REACH, _REACH + 1, dtype=np.float64)
    smooth = np.exp(-0.5 * (off / _SIGMA_PX) ** 2)
    smooth /= smooth.sum()
    first = -off / _SIGMA_PX**2 * smooth
    second = (off**2 / _SIGMA_PX**4 - 1.0 / _SIGMA_PX**2) * smooth
    pairs = (first, smooth), (smooth, first), (second, smooth), (smooth, second), (first, first)
    rx, ry, rxx, ryy, rxy = (
        # OpenCV's filters correlate: an odd kernel is turned round
        cv2.sepFilter2D(pixels, cv2.CV_32F, across[::-1].copy(), along[::-1].copy())
        for across, along in pairs
    )
    row, column = np.nonzero(rxx < -0.2 * PROMINENCE / _SIGMA_PX**2)
    gx, gy, xx, yy, xy = (each[row, column].astype(np.float64) for each in (rx, ry, rxx, ryy, rxy))
    strongest = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    straight = np.abs(xy) < 1e-9
    nx, ny = np.where(straight, 1.0, strongest - yy), np.where(straight, 0.0, xy)
    length = np.hypot(nx, ny)
    nx, ny = nx / length, ny / length
    step = -(gx * nx + gy * ny) / (xx * nx**2 + 2.0 * xy * nx * ny + yy * ny**2)
    inside = (np.abs(step * nx) <= 0.5) & (np.abs(step * ny) <= 0.5)
    return _found((row + step * ny)[inside], (column + step * nx)[inside])


def skimage_hessian(pixels: Pixels) -> Found:
    """Take maxima along the rows of the Hessian's strongest eigenvalue, with a parabola."""
    from skimage.feature import hessian_matrix, hessian_matrix_eigvals

    grey = pixels.astype(np.float64)
    entries = hessian_matrix(grey, sigma=_SIGMA_PX, order="rc", use_gaussian_derivatives=True)
    return _maxima(-hessian_matrix_eigvals(entries)[1], 0.2 * PROMINENCE / _SIGMA_PX**2)


def skimage_sato(pixels: Pixels) -> Found:
    """Take maxima along the rows of scikit-image's `sato` ridge filter, with a parabola."""
    from skimage.filters import sato

    strength = sato(pixels.astype(np.float64), sigmas=[_SIGMA_PX], black_ridges=False)
    return _maxima(strength, 0.2 * PROMINENCE)


def ridge_detector(pixels: Pixels) -> Found:
    """The package ridge-detector (Steger, many widths), lines of 3 to 8 px, positions as it gives them."""
    from ridge_detector import RidgeDetector

    how = {"low_contrast": 20, "high_contrast": 40, "min_len": 5, "dark_line": False, "estimate_width": False}
    detector = RidgeDetector(line_widths=np.array([3, 5, 8]), **how)
    detector.detect_lines(pixels)
    lines = detector.contours
    row = np.concatenate([np.asarray(line.row, np.float64) for line in lines] or [np.empty(0)])
    return _found(row, np.concatenate([np.asarray(line.col, np.float64) for line in lines] or [np.empty(0)]))


def compiled(reach: int, *, weighted: bool) -> Callable[[Pixels], Found]:
    """Give the extractor in C++ that looks at `reach` pixels on both sides of a top."""

    def find(pixels: Pixels) -> Found:
        """Find the peaks of an image by the compiled library."""
        rows, columns = pixels.shape
        room = _PEAKS_A_ROW * rows
        row, x_px = np.empty(room), np.empty(room)
        count = _library().peaks(
            pixels.ctypes.data, rows, columns, int(PROMINENCE), reach, int(weighted), room, row.ctypes.data,
            x_px.ctypes.data,
        )  # fmt: skip
        return _found(row[:count], x_px[:count])

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


def _opencv_maxima(pixels: Pixels) -> tuple[Pixels, Maxima]:
    """Local maxima along the rows of the blurred image, one a plateau, none at the border."""
    blurred = cv2.GaussianBlur(pixels, (5, 5), 0)
    highest = cv2.dilate(blurred, np.ones((1, 7), np.uint8))
    # a mask of OpenCV, so that nothing as large as the image is made by numpy
    equal, bright = cv2.compare(blurred, highest, cv2.CMP_EQ), cv2.compare(blurred, LEVEL, cv2.CMP_GT)
    at = cv2.findNonZero(cv2.bitwise_and(equal, bright))
    if at is None:
        return blurred, (np.empty(0, np.int64), np.empty(0, np.int64))
    column, row = at.reshape(-1, 2).T.astype(np.int64)
    begins = np.ones(len(row), bool)
    begins[1:] = (np.diff(column) != 1) | (np.diff(row) != 0)
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(row)) - 1
    row, column = row[first], (column[first] + column[last]) // 2
    inside = (column > 0) & (column < pixels.shape[1] - 1)
    return blurred, (row[inside], column[inside])


def _scipy_maxima(pixels: Pixels) -> Maxima:
    columns = [find_peaks(line, prominence=PROMINENCE)[0] for line in pixels]
    row = np.repeat(np.arange(len(columns)), [len(each) for each in columns])
    return row, np.concatenate(columns)


def _maxima(strength: Floats, least: float) -> Found:
    left, here, right = strength[:, :-2], strength[:, 1:-1], strength[:, 2:]
    row, column = np.nonzero((here > left) & (here >= right) & (here > least))
    left, here, right = left[row, column], here[row, column], right[row, column]
    return _found(row, column + 1 + 0.5 * (left - right) / (left - 2.0 * here + right))


def _parabola(row: Integers, column: Integers, left: Floats, here: Floats, right: Floats) -> Found:
    bend = left - 2.0 * here + right
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(bend < 0.0, 0.5 * (left - right) / bend, 0.0)
    return _found(row, column + shift)


def _gravity(pixels: Pixels, row: Integers, column: Integers) -> Found:
    at = np.clip(column[:, None] + np.arange(-_REACH, _REACH + 1), 0, pixels.shape[1] - 1)
    level = pixels[row[:, None], at].astype(np.float64)
    level -= level.min(axis=1, keepdims=True)
    return _found(row, (level * at).sum(axis=1) / np.maximum(level.sum(axis=1), 1e-9))


def _found(row: NDArray[Any], x_px: Floats) -> Found:
    return Found(row.astype(np.float64), x_px, np.full(len(row), np.nan))
