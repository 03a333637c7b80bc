"""TIFF files that ask viewers to turn them."""

from __future__ import annotations

import struct

_ORIENTATION = 274  # TIFF's tag


def as_stored(data: bytes) -> bytes:
    """Give a TIFF file whose orientation tag says "as it is": OpenCV turns TIFF, and only TIFF, by it."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None or len(data) < 8:
        return data
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    if directory + 2 > len(data):
        return data
    (count,) = struct.unpack_from(f"{order}H", data, directory)
    for at in range(directory + 2, min(directory + 2 + 12 * count, len(data) - 11), 12):
        if struct.unpack_from(f"{order}H", data, at) == (_ORIENTATION,):
            return data[: at + 8] + struct.pack(f"{order}H", 1) + data[at + 10 :]
    return data
