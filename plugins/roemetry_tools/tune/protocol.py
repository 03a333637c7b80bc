"""An answer as bytes: a header of JSON, then arrays that a browser uses without copying them.

The header's length stands first, 4 bytes, little-endian. The header is padded with blanks, each array with
zeros, to a multiple of 8 bytes. `arrays` in the header says for each: its type, its shape, and where it
begins, counted from the end of the header.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES = {"f": "float32", "i": "int16", "u": "uint8", "b": "uint8"}


def packed(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Pack an answer. Floats become 32 bit, whole numbers 16 bit, flags 8 bit."""
    parts: list[bytes] = []
    told: dict[str, Any] = {}
    place = 0
    for name, array in arrays.items():
        kind = _TYPES[array.dtype.kind]
        data = np.ascontiguousarray(array, dtype=np.dtype(kind).newbyteorder("<")).tobytes()
        told[name] = {"type": kind, "shape": list(array.shape), "at": place}
        parts.append(data + bytes(-len(data) % 8))
        place += len(parts[-1])
    text = json.dumps(_sound({**header, "arrays": told}), allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % 8)
    return struct.pack("<I", len(text)) + text + b"".join(parts)


def unpacked(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Give back header and arrays."""
    (length,) = struct.unpack("<I", data[:4])
    header: dict[str, Any] = json.loads(data[4 : 4 + length])
    arrays = {}
    for name, told in header.pop("arrays").items():
        count = math.prod(told["shape"])
        found = np.frombuffer(data, np.dtype(told["type"]).newbyteorder("<"), count, 4 + length + told["at"])
        arrays[name] = found.reshape(told["shape"])
    return header, arrays


def _sound(value: Any) -> Any:
    """Put null for what JSON has no word for."""
    if isinstance(value, Mapping):
        return {str(key): _sound(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_sound(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
