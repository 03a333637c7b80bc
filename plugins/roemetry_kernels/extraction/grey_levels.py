"""What an extractor asks of a frame before it looks for stripes: one channel, levels within the bit depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError
from roemetry.records import Frame

_WHITE_8_BIT = 255


def grey(frame: Frame) -> NDArray[Any]:
    """Give the frame's (row, column) pixels.

    Raises
    ------
    DataError
        The frame has colours, or a pixel brighter than its bit depth allows.
    """
    pixels = frame.pixels
    if pixels.ndim != 2:
        raise DataError(
            f"Frame {frame.name!r} has colours ({pixels.shape[2]} values a pixel), expected one channel",
            hint="choose one by source.channel in the recipe (red, max, grey)",
        )
    if frame.white < np.iinfo(pixels.dtype).max and (brightest := int(pixels.max())) > frame.white:
        raise DataError(
            f"Frame {frame.name!r} holds grey level {brightest}, "
            f"but its bit depth of {frame.bit_depth} ends at {frame.white}",
            hint="set the source's bit depth to what the camera gives",
        )
    return pixels


def plain_layout(pixels: NDArray[Any]) -> NDArray[Any]:
    """Give pixels row by row and read-only: kernels are compiled for no other memory layout.

    Every further one would be compiled anew, at half a second or more.
    """
    plain = np.ascontiguousarray(pixels).view()
    plain.flags.writeable = False
    return plain


def scaled_level(level: float, frame: Frame) -> float:
    """Scale a grey level of the 8-bit scale to the frame's own.

    To compare whole grey levels: ``> floor(scaled)`` is the same as ``> scaled``, ``>= ceil`` as ``>=``.
    """
    return level * frame.white / _WHITE_8_BIT
