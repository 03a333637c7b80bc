"""What people use today, each in its best form that we could write: OpenCV, scipy and numpy recipes.

All are told the threshold that suits these images; ours have to find it. None states an uncertainty.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from benchmarks.extraction.scoring import Found
from roemetry.records.arrays import Floats

LEVEL = 40.0
"""Grey level between the ambient light of the images and the dimmest stripe."""
PROMINENCE = 30.0
_REACH = 7
_LOG = np.log(np.maximum(np.arange(256, dtype=np.float64), 0.5))
Pixels = NDArray[Any]


def opencv_log_parabola(pixels: Pixels) -> Found:
    """Blur, dilate, keep what equals its dilation; a parabola through three logarithms."""
    blurred, row, column = _opencv_maxima(pixels)
    left, here, right = (_LOG[blurred.ravel()[row * pixels.shape[1] + column + step]] for step in (-1, 0, 1))
    bend = left - 2.0 * here + right
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(bend < 0.0, 0.5 * (left - right) / bend, 0.0)
    return _found(row, column + shift)


def opencv_centre_of_gravity(pixels: Pixels) -> Found:
    """The same maxima; centre of gravity of 15 pixels of the image, less the darkest of them."""
    _, row, column = _opencv_maxima(pixels)
    return _found(row, _gravity(pixels, row, column))


def scipy_log_parabola(pixels: Pixels) -> Found:
    """`scipy.signal.find_peaks` with a prominence, row by row; a parabola through three logarithms."""
    row, column = _scipy_maxima(pixels)
    levels = _LOG[pixels]
    left, here, right = (levels[row, np.clip(column + step, 0, pixels.shape[1] - 1)] for step in (-1, 0, 1))
    bend = left - 2.0 * here + right
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(bend < 0.0, 0.5 * (left - right) / bend, 0.0)
    return _found(row, column + shift)


def scipy_centre_of_gravity(pixels: Pixels) -> Found:
    """`scipy.signal.find_peaks` with a prominence, row by row; centre of gravity of 15 pixels."""
    row, column = _scipy_maxima(pixels)
    return _found(row, _gravity(pixels, row, column))


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


def opencv_steger(pixels: Pixels) -> Found:
    """Steger's lines with σ 2 px: where the second derivative across is strongest and the first one zero."""
    sigma = 2.0
    off = np.arange(-_REACH, _REACH + 1, dtype=np.float64)
    smooth = np.exp(-0.5 * (off / sigma) ** 2)
    smooth /= smooth.sum()
    first = -off / sigma**2 * smooth
    second = (off**2 / sigma**4 - 1.0 / sigma**2) * smooth
    rx, ry, rxx, ryy, rxy = (
        # OpenCV's filters correlate: an odd kernel is turned round
        cv2.sepFilter2D(pixels, cv2.CV_32F, across[::-1].copy(), along[::-1].copy())
        for across, along in (
            (first, smooth),
            (smooth, first),
            (second, smooth),
            (smooth, second),
            (first, first),
        )
    )
    row, column = np.nonzero(rxx < -0.2 * PROMINENCE / sigma**2)
    gx, gy, xx, yy, xy = (each[row, column].astype(np.float64) for each in (rx, ry, rxx, ryy, rxy))
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    strongest = middle - half
    nx, ny = xy, strongest - xx
    straight = np.abs(xy) < 1e-9
    nx, ny = np.where(straight, 1.0, strongest - yy), np.where(straight, 0.0, xy)
    length = np.hypot(nx, ny)
    nx, ny = nx / length, ny / length
    step = -(gx * nx + gy * ny) / (xx * nx**2 + 2.0 * xy * nx * ny + yy * ny**2)
    inside = (np.abs(step * nx) <= 0.5) & (np.abs(step * ny) <= 0.5)
    return _found((row + step * ny)[inside], (column + step * nx)[inside])


def _opencv_maxima(pixels: Pixels) -> tuple[Pixels, NDArray[np.int64], NDArray[np.int64]]:
    """Local maxima along the rows of the blurred image, one a plateau, none at the border."""
    blurred = cv2.GaussianBlur(pixels, (5, 5), 0)
    highest = cv2.dilate(blurred, np.ones((1, 7), np.uint8))
    # a mask of OpenCV, so that nothing as large as the image is made by numpy
    equal = cv2.compare(blurred, highest, cv2.CMP_EQ)
    bright = cv2.compare(blurred, LEVEL, cv2.CMP_GT)
    at = cv2.findNonZero(cv2.bitwise_and(equal, bright))
    if at is None:
        nothing = np.empty(0, np.int64)
        return blurred, nothing, nothing
    column, row = at.reshape(-1, 2).T.astype(np.int64)
    begins = np.ones(len(row), bool)
    begins[1:] = (np.diff(column) != 1) | (np.diff(row) != 0)
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(row)) - 1
    row, column = row[first], (column[first] + column[last]) // 2
    inside = (column > 0) & (column < pixels.shape[1] - 1)
    return blurred, row[inside], column[inside]


def _scipy_maxima(pixels: Pixels) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    columns = [find_peaks(line, prominence=PROMINENCE)[0] for line in pixels]
    row = np.repeat(np.arange(len(columns)), [len(each) for each in columns])
    return row, np.concatenate(columns)


def _gravity(pixels: Pixels, row: NDArray[np.int64], column: NDArray[np.int64]) -> Floats:
    off = np.arange(-_REACH, _REACH + 1)
    at = np.clip(column[:, None] + off, 0, pixels.shape[1] - 1)
    level = pixels[row[:, None], at].astype(np.float64)
    level -= level.min(axis=1, keepdims=True)
    return np.asarray((level * at).sum(axis=1) / np.maximum(level.sum(axis=1), 1e-9))


def _found(row: NDArray[Any], x_px: Floats) -> Found:
    return Found(row.astype(np.float64), x_px, np.full(len(row), np.nan))
