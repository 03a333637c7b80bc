"""A picture that a scene file names: read, and refused in words where it is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def check_picture(file: Path) -> None:
    """Raise ValueError, in words, for a file that is missing or is no image of 8 or 16 bit."""
    if not file.is_file():
        raise ValueError("there is no such file")
    image = read_picture(file)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise ValueError("not an image of 8 or 16 bit that can be read (PNG, TIFF, JPEG, …)")
    if min(image.shape[:2]) < 2:
        raise ValueError("an image of at least 2 × 2 pixels is needed")


def read_picture(file: Path) -> NDArray[Any] | None:
    """Return the picture, colours in the order blue, green, red; None where it cannot be read."""
    import cv2

    data = np.fromfile(file, dtype=np.uint8)
    return None if data.size == 0 else cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
