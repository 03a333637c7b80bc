"""Image files and arrays as frames have them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError
from roemetry.io.tiff import as_stored


def decoded(path: Path) -> NDArray[Any]:
    """Decode an image file to (row, column) or (row, column, blue-green-red); DataError where it is none."""
    import cv2

    try:
        data = np.frombuffer(as_stored(path.read_bytes()), np.uint8)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    pixels: NDArray[Any] | None = cv2.imdecode(data, flags) if data.size else None
    if pixels is None:
        raise DataError(f"{path}: not an image that can be read, or damaged")
    return np.ascontiguousarray(pixels[:, :, :3]) if pixels.ndim == 3 else pixels
