"""A red line across a printed board in a lit room, twelve poses, the same pose without the laser taken away.

The board's width is known from its circles: the plate ends 1.5 pitches beyond the outer ones. The line's
place is a parabola through the brightest pixel of each column of the difference of all colours, fitted
without outliers: it comes from no extractor.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats

POSES = 12
_PLATE = (-1.5, 7.5)


def line_on_board(dark: NDArray[Any], lit: NDArray[Any]) -> Floats:
    """Give the line's y for each column on the board, NaN beside it."""
    corner = circles(dark)
    grid = np.stack(np.meshgrid(np.arange(7.0), np.arange(7.0)), axis=-1).reshape(-1, 2)
    to_image, _ = cv2.findHomography(grid, corner)
    to_board = np.linalg.inv(to_image)
    light = np.clip(lit.astype(int) - dark, 0, 255).sum(axis=2).astype(np.float32)
    light = cv2.GaussianBlur(light, (1, 9), 0)
    columns = np.arange(lit.shape[1])
    brightest = light.argmax(axis=0).astype(np.float64)
    ends = cv2.perspectiveTransform(np.array([[[_PLATE[0], 3.0], [_PLATE[1], 3.0]]]), to_image)[0, :, 0]
    inside = (columns > ends[0]) & (columns < ends[1])
    kept = inside.copy()
    for _ in range(6):
        path = np.polyval(np.polyfit(columns[kept], brightest[kept], 2), columns)
        off = np.abs(brightest - path)
        kept = inside & (off <= max(3.0, 2.0 * float(np.median(off[inside]))))
    board = cv2.perspectiveTransform(np.stack([columns, path], axis=1)[None], to_board)[0]
    on_board = (board[:, 0] >= _PLATE[0]) & (board[:, 0] <= _PLATE[1])
    return np.where(on_board, path, np.nan)


def circles(dark: NDArray[Any]) -> NDArray[np.float32]:
    """Find the 7 × 7 circles, row by row."""
    settings = cv2.SimpleBlobDetector_Params()
    settings.minArea, settings.maxArea = 200.0, 8000.0
    grey, blobs = cv2.cvtColor(dark, cv2.COLOR_BGR2GRAY), cv2.SimpleBlobDetector_create(settings)
    how = {"flags": cv2.CALIB_CB_SYMMETRIC_GRID, "blobDetector": blobs}
    found, centres = cv2.findCirclesGrid(grey, (7, 7), **how)
    if not found:
        raise SystemExit("the circles of a board were not found")
    return np.asarray(centres).reshape(-1, 2)
