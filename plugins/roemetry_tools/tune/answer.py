"""An answer to the page: the frame as a picture, arrays to draw over it, and places that want a look.

It is a header of JSON, then arrays that a browser uses without copying them. The header's length stands
first, 4 bytes, little-endian. The header is padded with blanks, each array with zeros, to a multiple of 8
bytes. `arrays` in the header says for each: its type, its shape, and where it begins, counted from the end of
the header.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.io.files import json_values
from roemetry.records import AMBIGUOUS, EDGE, SATURATED, UNCODED, WIDE, Frame, Peaks, StripeMap, Trace

_GAPS_TOLD = 40
"""More than anybody steps through."""


def places_of(trace: Trace, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Fill the arrays to draw, and count the places that want a look.

    Arrays are ``peaks.…``, ``stripes.…``, ``profiles.…`` and ``outline.N``. Of gaps the longest are told:
    stripe, first and last row, x at both ends, px, and whether they were bridged.
    """
    told: dict[str, Any] = {}
    if trace.peaks is not None:
        told |= _of_peaks(trace.peaks, arrays)
    if trace.stripes is not None:
        told |= _of_stripes(trace.stripes, arrays)
    for outline in trace.outlines:
        arrays[f"outline.{outline.product}"] = outline.xy_px
    if trace.profiles is not None:
        for name in ("xyz_mm", "product", "seen", "stripe", "height_std_mm"):
            arrays[f"profiles.{name}"] = getattr(trace.profiles, name)
    return told


def _of_peaks(peaks: Peaks, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    for name in ("row", "x_px", "x_std_px", "amplitude", "background", "width_px", "flags"):
        arrays[f"peaks.{name}"] = getattr(peaks, name)
    return {
        "peaks": len(peaks),
        "saturated": int(np.count_nonzero(peaks.flags & SATURATED)),
        "edge": int(np.count_nonzero(peaks.flags & EDGE)),
        "wide": int(np.count_nonzero(peaks.flags & WIDE)),
        "peak_reasons": [reason.text for reason in peaks.reasons],
    }


def _of_stripes(stripes: StripeMap, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    for name in ("x_px", "product", "seen", "margin", "ambiguous", "rest_px"):
        arrays[f"stripes.{name}"] = getattr(stripes, name)
    arrays["peaks.stripe"] = stripes.peak_stripe
    gaps = sorted(_gaps(stripes), key=lambda gap: gap["first"] - gap["last"])
    return {
        "coded": int(np.count_nonzero(stripes.peak_stripe >= 0)),
        "uncoded": int(np.count_nonzero(stripes.peak_stripe == UNCODED)),
        "ambiguous": int(np.count_nonzero(stripes.peak_stripe == AMBIGUOUS)),
        "gaps": len(gaps),
        "gap_list": gaps[:_GAPS_TOLD],
    }


def _gaps(stripes: StripeMap) -> Iterator[dict[str, Any]]:
    """Give runs of rows, between a stripe's first and last seen row, in which no peak of it was seen."""
    for stripe in range(stripes.stripe_count):
        seen = np.flatnonzero(stripes.seen[stripe])
        for before in np.flatnonzero(np.diff(seen) > 1):
            first, last = int(seen[before]) + 1, int(seen[before + 1]) - 1
            x = stripes.x_px[stripe]
            products = stripes.product[stripe, [first - 1, last + 1]]
            yield {
                "stripe": stripe,
                "first": first,
                "last": last,
                "x_first": float(x[first - 1]),
                "x_last": float(x[last + 1]),
                "bridged": bool(np.isfinite(x[first : last + 1]).all()),
                "product": int(products.max()),
            }


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
    text = json.dumps(json_values({**header, "arrays": told}), allow_nan=False).encode()
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
