"""A frame as a browser can show it."""

from __future__ import annotations

import numpy as np

from roemetry.records import Frame


def picture_of(frame: Frame) -> bytes:
    """Give a frame as an 8-bit PNG; deeper grey levels are scaled so that white stays white."""
    import cv2

    pixels = frame.pixels
    if frame.white != 255:
        pixels = np.minimum(pixels.astype(np.float64) * (255.0 / frame.white), 255.0).astype(np.uint8)
    done, encoded = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:  # pragma: no cover - an array of bytes can always be encoded
        raise ValueError("the frame cannot be encoded")
    return encoded.tobytes()
