"""Basler cameras by pylon, and pylon's emulated camera, which plays image files bit by bit.

What was measured of the emulator (pypylon 26.9): its frame numbers begin at 0 and have no gaps even where a
slow reader must have lost frames, its time stamps are 0, and a file that is smaller than the region of
interest gives a frame of the file's size. So losses show with real cameras only.
"""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
from pydantic import Field

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.records.live import LiveFrame
from roemetry.stages import Capabilities, Feed
from roemetry_line.feeds.camera import HINT, CameraOptions, FrameNumbers, first_line, no_node, refused

_BITS = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono16": 16}
_TICK_MS = 500  # that a frame is waited for before the feed says that none has come


class BaslerOptions(CameraOptions):
    """Which camera, and how it is set."""

    serial: str = Field(default="", description="serial number; empty: the first camera that is found")
    emulated: bool = Field(
        default=False,
        description="pylon's emulated camera instead of a real one; `nodes` say which files it plays",
    )
    trigger: Literal["as-set", "free", "software"] = Field(
        default="as-set",
        description="`as-set`: as the camera or `nodes` say (a light barrier on a line); `free`: as fast as "
        "it may; `software`: this feed triggers at `rate_hz`",
    )
    rate_hz: float = Field(default=10.0, gt=0, le=10_000, description="software triggers in a second")


class Basler(Feed[BaslerOptions]):
    """Takes frames with pylon. A frame that did not arrive whole is told with the driver's reason."""

    capabilities = Capabilities(fixture="roemetry_line.conformance:basler")

    @contextmanager
    def open(self) -> Iterator[Iterator[LiveFrame | None]]:
        """Connect and set the camera; ConfigurationError for a node it has not or a value it refuses."""
        if self.options.emulated:
            os.environ.setdefault("PYLON_CAMEMU", "1")
        with warnings.catch_warnings():
            # SWIG's modules warn while they are made, and crash where a warning is an error
            warnings.simplefilter("ignore", DeprecationWarning)
            from pypylon import genicam, pylon

        try:
            camera = pylon.InstantCamera(_device(pylon, self.options))
            camera.Open()
        except genicam.GenericException as error:
            raise DataError(f"the camera cannot be opened: {first_line(error)}", hint=HINT) from error
        try:
            self._set(camera, genicam)
            camera.MaxNumBuffer.Value = self.options.buffers
            try:
                camera.StartGrabbing(pylon.GrabStrategy_OneByOne)
            except genicam.GenericException as error:
                raise DataError(f"the camera does not start: {first_line(error)}") from error
            yield self._frames(camera, pylon, genicam)
        finally:
            camera.Close()

    def _set(self, camera: Any, genicam: Any) -> None:
        nodes = dict(self.options.nodes)
        if self.options.trigger != "as-set":
            software = self.options.trigger == "software"
            nodes |= {"TriggerSelector": "FrameStart", "TriggerMode": "On" if software else "Off"}
            nodes |= {"TriggerSource": "Software"} if software else {}
        known = {one.GetNode().GetName() for one in camera.GetNodeMap().GetNodes()}
        for name, value in nodes.items():
            if name not in known:
                raise no_node(name, known)
            try:
                getattr(camera, name).Value = value
            except (genicam.GenericException, TypeError) as error:
                raise refused(name, value, error) from error

    def _frames(self, camera: Any, pylon: Any, genicam: Any) -> Iterator[LiveFrame | None]:
        numbers = FrameNumbers(self.options.counting)
        next_trigger = time.monotonic()
        software = self.options.trigger == "software"
        try:
            while True:
                if software:
                    time.sleep(max(0.0, next_trigger - time.monotonic()))
                    next_trigger = max(next_trigger, time.monotonic() - 1.0) + 1.0 / self.options.rate_hz
                    camera.WaitForFrameTriggerReady(_TICK_MS, pylon.TimeoutHandling_ThrowException)
                    camera.ExecuteSoftwareTrigger()
                with camera.RetrieveResult(_TICK_MS, pylon.TimeoutHandling_Return) as result:
                    if not result.IsValid():
                        if camera.IsCameraDeviceRemoved():
                            raise DataError("the camera was unplugged", hint=HINT)
                        yield None
                        continue
                    live = self._live(result, numbers)
                yield live
        except genicam.GenericException as error:
            raise DataError(f"the camera does not answer: {first_line(error)}", hint=HINT) from error

    def _live(self, result: Any, numbers: FrameNumbers) -> LiveFrame:
        number = int(result.BlockID)
        lost = numbers.lost_before(number) + int(result.NumberOfSkippedImages)
        device_s = result.TimeStamp / 1e9 if result.TimeStamp else math.nan
        if not result.GrabSucceeded():
            return LiveFrame(None, number, lost, device_s, result.ErrorDescription or "not whole")
        pixels = np.array(result.Array)
        kind = str(result.PixelType)
        bits = next((bits for name, bits in _BITS.items() if name in kind), 8 * pixels.dtype.itemsize)
        count = math.nan
        if self.options.encoder_node:
            count = float(getattr(result, self.options.encoder_node).Value)
        frame = Frame(pixels, bit_depth=bits, time_s=time.time(), encoder_count=count)
        return LiveFrame(frame, number, lost, device_s)


def _device(pylon: Any, options: BaslerOptions) -> Any:
    factory = pylon.TlFactory.GetInstance()
    found = [
        one for one in factory.EnumerateDevices() if (one.GetModelName() == "Emulation") == options.emulated
    ]
    for one in found:
        if options.serial in ("", one.GetSerialNumber()):
            return factory.CreateDevice(one)
    there = ", ".join(one.GetSerialNumber() for one in found) or "none"
    raise DataError(f"there is no camera {options.serial or ''}".rstrip() + f"; found: {there}", hint=HINT)
