"""What the page shows of the last product: the image and an overlay, while somebody looks."""

from __future__ import annotations

import base64
import json
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from roemetry.errors import OutputError
from roemetry.io.files import write_whole
from roemetry.records import Acquisition, Frame, Trace
from roemetry_line.outbox import NewRow

_FOLDER = "live"
_EVERY_S = 0.25
"""Four pictures a second: more than a person can read."""
_WATCHED_S = 5.0
"""So long after the page has asked last somebody is taken to look."""
_POINTS_MAX = 4000  # about so many are sent; of more every second, third, …


class LiveView:
    """Writes the last product for the page, where somebody looks and not too often."""

    def __init__(self, folder: Path, station: str) -> None:
        self._folder = folder / _FOLDER
        self._folder.mkdir(parents=True, exist_ok=True)
        self._station = station
        self._last_s = 0.0

    def show(self, acquisition: Acquisition, trace: Trace | None, rows: Sequence[NewRow]) -> None:
        """Write the image, the labelled points and the outlines of an acquisition, and what was found."""
        now = time.monotonic()
        if now - self._last_s < _EVERY_S or not watched(self._folder.parent):
            return
        self._last_s = now
        try:
            self._write(acquisition, trace, rows)
        except OutputError:  # a picture less; the disk's state is told elsewhere
            return

    def _write(self, acquisition: Acquisition, trace: Trace | None, rows: Sequence[NewRow]) -> None:
        frame = acquisition.frames[0] if trace is None or trace.frame is None else trace.frame
        # image and overlay are one file: whoever reads it gets both of the same product
        told = {
            "acquisition": acquisition.id,
            "jpeg": base64.b64encode(jpeg_of(frame)).decode(),
            "rows": frame.size[0],
            "columns": frame.size[1],
            "points": _points(trace),
            "outlines": [
                np.round(outline.xy_px, 1).tolist() for outline in (trace.outlines if trace else ())
            ],
            "products": [dict(row.summary) for row in rows],
        }
        write_whole(self._folder / f"{self._station}.json", json.dumps(told))


def _points(trace: Trace | None) -> list[list[float]]:
    """Give x, y and product (0: belt) of the labelled points, thinned out, px in the turned image."""
    stripes = None if trace is None else trace.stripes
    if stripes is None:
        return []
    stripe, row = np.nonzero(stripes.seen & np.isfinite(stripes.x_px))
    step = max(1, len(stripe) // _POINTS_MAX)
    stripe, row = stripe[::step], row[::step]
    product = np.maximum(stripes.product[stripe, row], 0)
    found: list[list[float]] = np.column_stack(
        [np.round(stripes.x_px[stripe, row], 1), row, product]
    ).tolist()
    return found


def watch(folder: Path) -> None:
    """Note that somebody looks."""
    (folder / _FOLDER).mkdir(parents=True, exist_ok=True)
    (folder / _FOLDER / "watched").touch()


def watched(folder: Path) -> bool:
    """Say whether somebody has looked just now."""
    try:
        return time.time() - (folder / _FOLDER / "watched").stat().st_mtime < _WATCHED_S
    except OSError:
        return False


def picture_file(folder: Path, station: str) -> Path:
    """Give where the last image of a station is, with its overlay, as JSON."""
    return folder / _FOLDER / f"{station}.json"


def jpeg_of(frame: Frame) -> bytes:
    """Encode a frame for people: grey, 8 bit, white at the sensor's white."""
    import simplejpeg

    pixels = frame.pixels
    grey = pixels if pixels.ndim == 2 else pixels.mean(axis=2)
    shown = np.clip(grey * (255.0 / frame.white), 0, 255).astype(np.uint8)[:, :, None]
    data: bytes = simplejpeg.encode_jpeg(np.ascontiguousarray(shown), quality=80, colorspace="GRAY")
    return data
