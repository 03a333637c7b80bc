"""A video file, or a USB camera by its number, read by OpenCV: for the bench and for demonstrations.

OpenCV tells neither a frame's number nor what was lost, and USB cameras compress and correct their
pictures: what is measured with one is no reference.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pydantic import Field

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.records.live import LiveFrame
from roemetry.stages import Capabilities, Feed, StageOptions


class VideoOptions(StageOptions):
    """Which video, and how fast."""

    path: str = Field(
        default="0", min_length=1, description="a video file, or the number of a camera: 0, 1, …"
    )
    rate_hz: float | None = Field(
        default=None,
        gt=0,
        le=10_000,
        description="frames of a file in a second; none: as fast as they are taken",
    )


class Video(Feed[VideoOptions]):
    """Gives the frames of a video once, or those of a USB camera."""

    capabilities = Capabilities(fixture="roemetry_line.conformance:video")

    @contextmanager
    def open(self) -> Iterator[Iterator[LiveFrame | None]]:
        """Open the video; DataError where there is none."""
        import cv2

        path = self.options.path
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        video = cv2.VideoCapture(int(path) if path.isdigit() else path)
        try:
            if not video.isOpened():
                raise DataError(
                    f"{path}: no video that can be opened", hint="name a video file, or 0 for a camera"
                )
            yield self._frames(video, cv2)
        finally:
            video.release()

    def _frames(self, video: Any, cv2: Any) -> Iterator[LiveFrame | None]:
        number, begin, is_camera = 0, time.monotonic(), self.options.path.isdigit()
        while True:
            read, pixels = video.read()
            if not read:
                if is_camera:
                    raise DataError(
                        f"camera {self.options.path} gives no more frames", hint="is it plugged in?"
                    )
                return
            number += 1
            if self.options.rate_hz is not None and not is_camera:
                time.sleep(max(0.0, begin + number / self.options.rate_hz - time.monotonic()))
            if (pixels[:, :, 0] == pixels[:, :, 1]).all() and (pixels[:, :, 1] == pixels[:, :, 2]).all():
                pixels = pixels[:, :, 0].copy()
            device_s = video.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            frame = Frame(pixels, time_s=time.time())
            yield LiveFrame(frame, number, device_time_s=device_s if device_s > 0.0 else math.nan)
