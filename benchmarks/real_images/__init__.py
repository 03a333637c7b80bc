"""Extractors on real camera images: not part of the project, ROEMETRY_REAL_DATA names their folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import WIDE, Acquisition, Frame, Peaks
from roemetry.run.preprocess import prepare


def folder_of(name: str) -> Path | None:
    """Give a folder of real images; None where it is absent."""
    home = Path(os.environ.get("ROEMETRY_REAL_DATA", "../shared/real")) / name
    return home if home.is_dir() else None


def prepared(
    pixels: NDArray[Any],
    *,
    turn_deg: int,
    channel: str = "grey",
    contrast: str = "none",
    dark: NDArray[Any] | None = None,
) -> Frame:
    """Make a frame as a recipe would."""
    frames = [Frame(pixels, "laser")]
    if dark is not None:
        frames.append(Frame(dark, "dark"))
    subtract = "none" if dark is None else "dark"
    how = {"channel": channel, "contrast": contrast, "subtract": subtract}
    return prepare(Acquisition("real", tuple(frames)), turn_deg=turn_deg, **how)


def sound(peaks: Peaks) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Give rows and positions of the peaks that are not flagged too wide."""
    kept = peaks.flags & WIDE == 0
    return peaks.row[kept], peaks.x_px[kept]
