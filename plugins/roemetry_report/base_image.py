"""The camera's picture as a data URI small enough to stand in the page."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Frame, Trace

_BYTES_MAX = 72_000
_TRIES = ((1280, 85), (1280, 70), (960, 70), (720, 65), (640, 50), (480, 40))
"""Longest side (px) and JPEG quality, from best to least."""


@dataclass(frozen=True, slots=True)
class BaseImage:
    """A picture to draw on.

    Attributes
    ----------
    rows, columns
        Size of the frame that the overlays' coordinates belong to.
    uri
        The picture as a ``data:`` address.
    notes
        What was done to it for display, in words.
    """

    rows: int
    columns: int
    uri: str
    notes: tuple[str, ...]


def base_image(trace: Trace) -> BaseImage | None:
    """Make the picture of a trace's laser frame; in colour where it was taken in colour."""
    frame = trace.frame
    if frame is None:
        return None
    notes = []
    if frame.turn_deg:
        notes.append(f"turned by {frame.turn_deg}° (counter-clockwise) from how it was taken")
    pixels, white = _as_taken(trace, frame)
    shown, gain = _eight_bit(pixels, white)
    if gain > 1:
        notes.append(f"brightened {gain:.1f} × for display")
    coded, scaled_to = _jpeg(shown)
    if scaled_to is not None:
        notes.append(f"scaled to {scaled_to[1]} × {scaled_to[0]} px for display")
    rows, columns = frame.size
    uri = "data:image/jpeg;base64," + base64.b64encode(coded).decode("ascii")
    return BaseImage(rows, columns, uri, tuple(notes))


def _as_taken(trace: Trace, frame: Frame) -> tuple[NDArray[Any], int]:
    """Give the colour image, turned like the frame, where there is one; else the frame itself."""
    taken = None if trace.acquisition is None else trace.acquisition.frame("laser")
    if taken is not None and taken.pixels.ndim == 3:
        turned = np.rot90(taken.pixels, (frame.turn_deg - taken.turn_deg) // 90 % 4)
        if turned.shape[:2] == frame.size:
            return turned, taken.white
    return frame.pixels, frame.white


def _eight_bit(pixels: NDArray[Any], white: int) -> tuple[NDArray[np.uint8], float]:
    """Scale the sensor's range to 0…255; a picture too dark to see is brightened."""
    top = float(np.percentile(pixels[::2, ::2], 99.9))
    gain = min(8.0, 0.8 * white / top) if 0 < top < 0.35 * white else 1.0
    if gain == 1.0 and white == 255 and pixels.dtype == np.uint8:
        return np.ascontiguousarray(pixels), 1.0
    shown = np.clip(pixels * (gain * 255.0 / white), 0, 255)
    return np.rint(shown).astype(np.uint8), gain


def _jpeg(pixels: NDArray[np.uint8]) -> tuple[bytes, tuple[int, int] | None]:
    """Code as JPEG, at the first setting that keeps within the size; the last one counts anyway."""
    import cv2

    coded, size = b"", None
    for side, quality in _TRIES:
        scale = side / max(pixels.shape[:2])
        image = pixels
        if scale < 1:
            columns, rows = (max(1, round(n * scale)) for n in (pixels.shape[1], pixels.shape[0]))
            image = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA)
        _, buffer = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        coded = buffer.tobytes()
        size = (int(image.shape[0]), int(image.shape[1])) if image is not pixels else None
        if len(coded) <= _BYTES_MAX:
            break
    return coded, size
