"""What the conformance kit cannot make itself: two scans, and two height maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roemetry_scan.formats import write
from roemetry_scan.formats.points import Measured


def two_scans(folder: Path) -> Path:
    """Put two tall images of four frames each into a folder, with their counts."""
    import cv2

    for number in (1, 2):
        rng = np.random.default_rng(number)
        cv2.imwrite(str(folder / f"scan_{number}.png"), rng.integers(0, 256, (160, 48), np.uint8))
        told = "encoder_count,frame_number\n" + "".join(f"{25 * k},{k}\n" for k in range(4))
        (folder / f"scan_{number}.csv").write_text(told)
    return folder


def two_height_maps(folder: Path) -> Path:
    """Put two height maps of a block on a belt into a folder."""
    x, y = np.meshgrid(np.arange(0.0, 40.0, 0.5), np.arange(30.0, 0.0, -0.5), indexing="ij")
    for number in (1, 2):
        z = np.where((np.abs(x - 20.0) < 8.0) & (np.abs(y - 15.0) < 6.0), 5.0 * number, 0.0)
        write(folder / f"map_{number}.ply", Measured(np.stack([x, y, z], axis=-1)))
    return folder
