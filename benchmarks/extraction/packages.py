"""Installed packages that find lines: scikit-image's ridge filters, ridge-detector (Steger, many widths)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.extraction.peers import PROMINENCE
from benchmarks.extraction.scoring import Found

Pixels = NDArray[Any]
_SIGMA_PX = 2.0


def skimage_hessian(pixels: Pixels) -> Found:
    """Take maxima along the rows of the Hessian's strongest eigenvalue, with a parabola."""
    from skimage.feature import hessian_matrix, hessian_matrix_eigvals

    entries = hessian_matrix(
        pixels.astype(np.float64), sigma=_SIGMA_PX, order="rc", use_gaussian_derivatives=True
    )
    strength = -hessian_matrix_eigvals(entries)[1]
    return _maxima(strength, 0.2 * PROMINENCE / _SIGMA_PX**2)


def skimage_sato(pixels: Pixels) -> Found:
    """Take maxima along the rows of scikit-image's `sato` ridge filter, with a parabola."""
    from skimage.filters import sato

    strength = sato(pixels.astype(np.float64), sigmas=[_SIGMA_PX], black_ridges=False)
    return _maxima(strength, 0.2 * PROMINENCE)


def ridge_detector(pixels: Pixels) -> Found:
    """The package ridge-detector, lines of 3 to 8 px, positions as it gives them."""
    from ridge_detector import RidgeDetector

    detector = RidgeDetector(
        line_widths=np.array([3, 5, 8]),
        low_contrast=20,
        high_contrast=40,
        min_len=5,
        dark_line=False,
        estimate_width=False,
    )
    detector.detect_lines(pixels)
    lines = detector.contours
    row = np.concatenate([np.asarray(line.row, np.float64) for line in lines] or [np.empty(0)])
    x_px = np.concatenate([np.asarray(line.col, np.float64) for line in lines] or [np.empty(0)])
    return Found(row, x_px, np.full(len(row), np.nan))


def _maxima(strength: NDArray[np.float64], least: float) -> Found:
    left, here, right = strength[:, :-2], strength[:, 1:-1], strength[:, 2:]
    row, column = np.nonzero((here > left) & (here >= right) & (here > least))
    left, here, right = left[row, column], here[row, column], right[row, column]
    x_px = column + 1 + 0.5 * (left - right) / (left - 2.0 * here + right)
    return Found(row.astype(np.float64), x_px, np.full(len(row), np.nan))
