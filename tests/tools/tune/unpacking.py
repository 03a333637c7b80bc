"""What the page's JavaScript does with a packed answer, in Python."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
