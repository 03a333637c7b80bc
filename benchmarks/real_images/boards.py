"""A red line across a printed board in a lit room, twelve poses, the same pose without the laser taken away.

The board's width is known from its circles: the plate ends 1.5 pitches beyond the outer ones. The line's
place is a parabola through the brightest pixel of each column of the difference of all colours, fitted
without outliers: it comes from no extractor.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.real_images import prepared, sound
from benchmarks.tables import Table, number
from roemetry.records.arrays import Floats
from roemetry.stages import Extractor

POSES = 12
NEAR_PX = 4.0
CHANNELS = ("grey", "red", "green")
_PLATE = (-1.5, 7.5)


def boards(home: Path, stages: Mapping[str, Extractor[Any]]) -> Table:
    """Judge extractors on the boards, whose images are in a folder."""
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    for pose in range(POSES):
        dark = cv2.imread(str(home / "calib_picture" / f"calib{pose}.jpg"))
        lit = cv2.imread(str(home / "light_picture" / f"light{pose}.jpg"))
        line = line_on_board(dark, lit)[::-1]  # by row of the turned image
        on_board = np.isfinite(line)
        for channel in CHANNELS:
            frame = prepared(lit, turn_deg=90, channel=channel, dark=dark)
            for name, stage in stages.items():
                row, x_px = sound(stage.extract(frame))
                near = np.abs(x_px - line[row]) <= NEAR_PX
                seen = np.zeros(line.size, bool)
                seen[row[near]] = True
                others = float((on_board[row] & ~near).sum()) / on_board.sum()
                share = 100.0 * seen[on_board].mean()
                found[name, channel].append((share, others, roughness(row[near], x_px[near])))
    rows = []
    for name in stages:
        cells = [name]
        for channel in CHANNELS:
            shares, others, scatter = np.array(found[name, channel]).T
            told = f"{shares.min():.1f} ({shares.mean():.1f}); {number(float(others.mean()), 2)}"
            cells.append(f"{told}; {number(float(np.median(scatter)), 2)}")
        rows.append(cells)
    what = "found over the width, %: worst (mean); others a column; roughness, px"
    head = ["extractor", *(f"{channel}: {what}" for channel in CHANNELS)]
    return Table("Red line on 12 boards, laser-off image taken away", head, rows)


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


def roughness(row: NDArray[np.int64], x_px: Floats) -> float:
    """Give the scatter of the line about its neighbours: of second differences, as of a single row, px."""
    bend = x_px[:-2] - 2.0 * x_px[1:-1] + x_px[2:]
    bend = bend[(np.diff(row)[:-1] == 1) & (np.diff(row)[1:] == 1)]
    return float(1.4826 * np.median(np.abs(bend)) / np.sqrt(6.0)) if bend.size else float("nan")
