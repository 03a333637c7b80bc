"""Peaks over the image, to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_HIT, _EXTRA = (80, 255, 80), (60, 60, 255)


def overlay(
    path: Path,
    pixels: NDArray[Any],
    row: NDArray[np.int64],
    x_px: NDArray[np.float64],
    good: NDArray[np.bool_],
    scale: int = 2,
) -> None:
    """Write an image with a dot a peak: green where it is right, red where not; grey levels halved."""
    large = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    shown = cv2.cvtColor((large // 2).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    at_y = np.clip(scale * row + scale // 2, 0, shown.shape[0] - 1)
    at_x = np.clip(np.rint(scale * x_px + 0.5 * (scale - 1)).astype(int), 0, shown.shape[1] - 1)
    for y, x, right in zip(at_y, at_x, good, strict=True):
        if right:
            shown[y, x] = _HIT
        else:
            cv2.circle(shown, (int(x), int(y)), 2, _EXTRA, -1)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), shown)
