"""Any camera with a GenTL producer (a .cti file, which its maker gives), by harvesters."""

from __future__ import annotations

import ctypes
import math
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Frame
from roemetry.records.live import LiveFrame
from roemetry.stages import Capabilities, Feed
from roemetry_line.feeds.camera import HINT, CameraOptions, FrameNumbers, no_node, refused

_TICK_S = 0.5  # that a frame is waited for before the feed says that none has come
_GREY_BITS = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono14": 14, "Mono16": 16}
_COLOURS = {"RGB8": (0, 1, 2), "BGR8": (2, 1, 0), "RGBa8": (0, 1, 2), "BGRa8": (2, 1, 0)}
"""By pixel format, where red, green and blue stand."""
_PROCESSORS = {3: "32-bit x86", 40: "32-bit ARM", 62: "64-bit x86", 183: "64-bit ARM", 243: "RISC-V"}
"""Machines of the ELF header (System V gABI, e_machine)."""


class GenICamOptions(CameraOptions):
    """Which producer and camera, and how it is set."""

    producer: Path | None = Field(
        default=None, description="GenTL producer file (.cti); none: the first that GENICAM_GENTL64_PATH has"
    )
    device: str = Field(
        default="", description="id, serial number or model of the camera; empty: the first that is found"
    )


class GenICam(Feed[GenICamOptions]):
    """Takes frames of grey or colour formats; of a payload of several parts the first that is an image.

    harvesters throws frames away that did not arrive whole: they show as lost.
    """

    capabilities = Capabilities(fixture="roemetry_line.conformance:genicam")

    @contextmanager
    def open(self) -> Iterator[Iterator[LiveFrame | None]]:
        """Connect and set the camera; ConfigurationError for a producer or node that does not suit."""
        with warnings.catch_warnings():
            # SWIG's modules warn while they are made, and crash where a warning is an error
            warnings.simplefilter("ignore", DeprecationWarning)
            from harvesters.core import Harvester

        producer = self._producer()
        _check_processor(producer)
        harvester = Harvester()
        try:
            harvester.add_file(str(producer))
            harvester.update()
            camera = self._camera(harvester, producer)
            try:
                self._set(camera.remote_device.node_map)
                camera.num_buffers = self.options.buffers
                camera.start()
                yield self._frames(camera)
            finally:
                camera.destroy()
        finally:
            harvester.reset()

    def _producer(self) -> Path:
        import os

        if self.options.producer is not None:
            return self.options.producer
        folders = os.environ.get("GENICAM_GENTL64_PATH", "").split(os.pathsep)
        found = [path for folder in folders if folder for path in sorted(Path(folder).glob("*.cti"))]
        if not found:
            raise ConfigurationError(
                "no GenTL producer", hint="name the maker's .cti file in feed.options.producer"
            )
        return found[0]

    def _camera(self, harvester: Any, producer: Path) -> Any:
        wanted = self.options.device
        infos = list(harvester.device_info_list)
        for number, info in enumerate(infos):
            if wanted in ("", info.id_, info.model, _told(info, "serial_number")):
                try:
                    return harvester.create(number)
                except Exception as error:  # the producer's own errors have no common class
                    raise DataError(f"{info.id_}: cannot be opened: {error}", hint=HINT) from error
        there = ", ".join(str(info.id_) for info in infos) or "none"
        raise DataError(
            f"{producer.name}: there is no camera {wanted}".rstrip() + f"; found: {there}", hint=HINT
        )

    def _set(self, nodes: Any) -> None:
        for name, value in self.options.nodes.items():
            if not hasattr(nodes, name):
                raise no_node(name, dir(nodes))
            try:
                getattr(nodes, name).value = value
            except Exception as error:  # the node map's errors have no common class
                raise refused(name, value, error) from error

    def _frames(self, camera: Any) -> Iterator[LiveFrame | None]:
        numbers = FrameNumbers(self.options.counting)
        failures = 0
        while True:
            try:
                buffer = camera.try_fetch(timeout=_TICK_S)
            except Exception as error:  # the producer's own errors have no common class
                raise DataError(f"the camera does not answer: {error}", hint=HINT) from error
            if buffer is None:
                failures += 1
                if failures > 4 and not camera.is_acquiring():
                    raise DataError("the camera has stopped", hint=HINT)
                yield None
                continue
            failures = 0
            with buffer:
                live = self._live(buffer, camera, numbers)
            yield live

    def _live(self, buffer: Any, camera: Any, numbers: FrameNumbers) -> LiveFrame:
        number = int(_told(buffer, "frame_id") or 0)
        lost = numbers.lost_before(number)
        stamp = _told(buffer, "timestamp_ns") or 0
        device_s = stamp / 1e9 if stamp else math.nan
        for part in buffer.payload.components:
            pixels = _pixels(part)
            if pixels is not None:
                bits = _GREY_BITS.get(str(part.data_format), 8 * pixels.dtype.itemsize)
                count = self._count(camera)
                frame = Frame(pixels, bit_depth=bits, time_s=time.time(), encoder_count=count)
                return LiveFrame(frame, number, lost, device_s)
        formats = ", ".join(str(part.data_format) for part in buffer.payload.components) or "nothing"
        return LiveFrame(None, number, lost, device_s, f"no image of a known format in it: {formats}")

    def _count(self, camera: Any) -> float:
        if not self.options.encoder_node:
            return math.nan
        return float(getattr(camera.remote_device.node_map, self.options.encoder_node).value)


def _pixels(part: Any) -> Any:
    """Give a part's pixels, copied; None where it is no image of a known format."""
    kind = str(part.data_format)
    if kind in _GREY_BITS:
        return np.array(part.data).reshape(part.height, part.width)
    if kind in _COLOURS:
        pixels = np.array(part.data).reshape(part.height, part.width, -1)
        red, green, blue = _COLOURS[kind]
        return np.ascontiguousarray(pixels[:, :, [blue, green, red]])
    return None


def _check_processor(producer: Path) -> None:
    """Refuse a producer file that this processor cannot load, in words that help."""
    if not producer.is_file():
        raise ConfigurationError(f"there is no producer file {producer}", at=("producer",))
    try:
        ctypes.CDLL(str(producer))
    except OSError as error:
        # Linux says of a library for another processor that there is no such file.
        its, own = _processor(producer), _processor(Path(sys.executable))
        said = f"it is for {its}, this machine is {own}" if its and its != own else str(error)
        raise ConfigurationError(
            f"{producer}: cannot be loaded: {said}",
            hint="it must be the maker's producer for this system and processor",
            at=("producer",),
        ) from error


def _processor(program: Path) -> str:
    """Name the processor that a Linux program or library (ELF) is for; empty for other files."""
    with program.open("rb") as file:
        head = file.read(20)
    number = int.from_bytes(head[18:20], "little")
    return _PROCESSORS.get(number, f"a processor of number {number}") if head[:4] == b"\x7fELF" else ""


def _told(record: Any, name: str, otherwise: Any = None) -> Any:
    """Give what a producer tells; not every one tells everything."""
    try:
        return getattr(record, name)
    except Exception:  # the producer's own errors have no common class
        return otherwise
