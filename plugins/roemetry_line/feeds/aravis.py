"""GigE Vision and USB3 Vision cameras by the system's library Aravis, without a maker's driver.

Aravis 0.8 is called as it is (ctypes): no Python package of it is needed, only the shared library. What was
measured of its fake camera (0.8.26): frame numbers follow the camera's own, so that a slow reader sees its
losses; it ignores triggers and runs free.
"""

from __future__ import annotations

import ctypes
import math
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any

import numpy as np
from pydantic import Field

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.records.live import LiveFrame
from roemetry.stages import Capabilities, Feed
from roemetry_line.feeds.camera import HINT, CameraOptions, FrameNumbers, no_node, refused

LIBRARY = "libaravis-0.8.so.0"
_TICK_US = 500_000  # that a frame is waited for before the feed says that none has come
_BITS = {0x01080001: 8, 0x01100003: 10, 0x01100005: 12, 0x01100025: 14, 0x01100007: 16}
"""Bits of grey formats by their code in the Pixel Format Naming Convention: Mono8, 10, 12, 14, 16."""
_RGB8, _BGR8 = 0x02180014, 0x02180015  # of colours, by the same convention
_STATUS = {
    2: "it did not arrive in time",
    3: "packets are missing",
    4: "packets came in the wrong order",
    5: "it is larger than its buffer",
    7: "it was broken off",
}
_SUCCESS, _CLEARED = 0, 1  # of ArvBufferStatus


class AravisOptions(CameraOptions):
    """Which camera, and how it is set."""

    device: str = Field(
        default="", description="id, serial number or address of the camera; empty: the first that is found"
    )
    emulated: bool = Field(default=False, description="Aravis' built-in fake camera instead of a real one")


class Aravis(Feed[AravisOptions]):
    """Takes frames of grey or colour formats. A frame that did not arrive whole is told with the reason."""

    capabilities = Capabilities(fixture="roemetry_line.conformance:aravis")

    @contextmanager
    def open(self) -> Iterator[Iterator[LiveFrame | None]]:
        """Connect and set the camera; ConfigurationError for a node it has not or a value it refuses."""
        arv = _library()
        if self.options.emulated:
            arv.arv_enable_interface(b"Fake")
        wanted = "Fake_1" if self.options.emulated else self.options.device
        arv.arv_update_device_list()
        camera = _Camera(arv, wanted.encode() or None)
        try:
            for name, value in self.options.nodes.items():
                camera.set(name, value)
            stream = camera.started(self.options.buffers)
            try:
                yield self._frames(camera, stream)
            finally:
                camera.stop(stream)
        finally:
            camera.close()

    def _frames(self, camera: _Camera, stream: int) -> Iterator[LiveFrame | None]:
        arv, numbers = _library(), FrameNumbers(self.options.counting)
        while True:
            buffer = arv.arv_stream_timeout_pop_buffer(stream, _TICK_US)
            if not buffer:
                camera.ask_whether_there()
                yield None
                continue
            try:
                live = self._live(camera, buffer, numbers)
            finally:
                arv.arv_stream_push_buffer(stream, buffer)
            if live is not None:
                yield live

    def _live(self, camera: _Camera, buffer: int, numbers: FrameNumbers) -> LiveFrame | None:
        arv = _library()
        status = arv.arv_buffer_get_status(buffer)
        if status == _CLEARED:
            return None
        number = int(arv.arv_buffer_get_frame_id(buffer))
        lost = numbers.lost_before(number)
        device_ns = int(arv.arv_buffer_get_timestamp(buffer))
        device_s = device_ns / 1e9 if device_ns else math.nan
        if status != _SUCCESS:
            return LiveFrame(
                None, number, lost, device_s, _STATUS.get(status, f"Aravis says status {status}")
            )
        kind = int(arv.arv_buffer_get_image_pixel_format(buffer))
        if kind not in (*_BITS, _RGB8, _BGR8):
            return LiveFrame(None, number, lost, device_s, f"no known format: 0x{kind:08x}")
        size = ctypes.c_size_t()
        begin = arv.arv_buffer_get_image_data(buffer, ctypes.byref(size))
        rows, columns = arv.arv_buffer_get_image_height(buffer), arv.arv_buffer_get_image_width(buffer)
        shape = (rows, columns) if kind in _BITS else (rows, columns, 3)
        dtype = np.dtype(np.uint16 if _BITS.get(kind, 8) > 8 else np.uint8)
        if math.prod(shape) * dtype.itemsize > size.value:
            return LiveFrame(
                None, number, lost, device_s, f"{size.value} bytes for {columns} × {rows} pixels"
            )
        data = ctypes.string_at(begin, math.prod(shape) * dtype.itemsize)
        pixels = np.frombuffer(data, dtype).reshape(shape)
        if kind == _RGB8:
            pixels = np.ascontiguousarray(pixels[:, :, ::-1])
        count = camera.chunk(buffer, self.options.encoder_node) if self.options.encoder_node else math.nan
        frame = Frame(pixels, bit_depth=_BITS.get(kind, 8), time_s=time.time(), encoder_count=count)
        return LiveFrame(frame, number, lost, device_s)


class _Camera:
    """A camera that is open, by Aravis' own functions."""

    def __init__(self, arv: Any, name: bytes | None) -> None:
        self._arv = arv
        found = (arv.arv_get_device_id(n).decode() for n in range(arv.arv_get_n_devices()))
        there = ", ".join(found) or "none"
        try:
            self._camera = _asked(arv.arv_camera_new, name)
        except _GlibError as error:
            said = f"there is no camera {(name or b'').decode()}".rstrip()
            raise DataError(f"{said}: {error}; found: {there}", hint=HINT) from error
        self._parser = 0

    def set(self, name: str, value: bool | int | float | str) -> None:
        """Set a node; raise as `no_node` and `refused` say."""
        arv, word = self._arv, name.encode()
        if not _asked(arv.arv_camera_is_feature_available, self._camera, word):
            raise no_node(name, self._nodes())
        kinds = {bool: "boolean", int: "integer", float: "float", str: "string"}
        given = value.encode() if isinstance(value, str) else value
        try:
            _asked(getattr(arv, f"arv_camera_set_{kinds[type(value)]}"), self._camera, word, given)
        except _GlibError as error:
            if type(value) is int:  # of a node of decimal numbers
                with suppress(_GlibError):
                    _asked(arv.arv_camera_set_float, self._camera, word, float(value))
                    return
            raise refused(name, value, error) from error

    def _nodes(self) -> list[str]:
        """Give the names of the camera's nodes, from its own description."""
        size = ctypes.c_size_t()
        device = self._arv.arv_camera_get_device(self._camera)
        begin = self._arv.arv_device_get_genicam_xml(device, ctypes.byref(size))
        text = ctypes.string_at(begin, size.value) if begin else b""
        return [name.decode() for name in re.findall(rb'\bName="(\w+)"', text)]

    def started(self, buffers: int) -> int:
        """Start taking frames into so many buffers; give the stream."""
        arv = self._arv
        stream = None
        try:
            stream = _asked(arv.arv_camera_create_stream, self._camera, None, None)
            size = _asked(arv.arv_camera_get_payload, self._camera)
            for _ in range(buffers):
                arv.arv_stream_push_buffer(stream, arv.arv_buffer_new_allocate(size))
            _asked(arv.arv_camera_start_acquisition, self._camera)
        except _GlibError as error:
            if stream:
                arv.g_object_unref(stream)
            raise DataError(f"the camera does not start: {error}", hint=HINT) from error
        return int(stream)

    def ask_whether_there(self) -> None:
        """Raise DataError where the camera does not answer: its being gone shows in no other way."""
        device = self._arv.arv_camera_get_device(self._camera)
        try:
            _asked(self._arv.arv_device_get_string_feature_value, device, b"DeviceVendorName")
        except _GlibError as error:
            raise DataError(f"the camera does not answer: {error}", hint=HINT) from error

    def chunk(self, buffer: int, name: str) -> float:
        """Give a whole number that was sent with a frame; NaN where it was not."""
        self._parser = self._parser or self._arv.arv_camera_create_chunk_parser(self._camera)
        try:
            return float(
                _asked(self._arv.arv_chunk_parser_get_integer_value, self._parser, buffer, name.encode())
            )
        except _GlibError:
            return math.nan

    def stop(self, stream: int) -> None:
        with suppress(_GlibError):  # it is gone
            _asked(self._arv.arv_camera_stop_acquisition, self._camera)
        self._arv.g_object_unref(stream)

    def close(self) -> None:
        for one in (self._parser, self._camera):
            if one:
                self._arv.g_object_unref(one)


class _GlibError(Exception):
    """What a function of Aravis says is wrong."""


class _GError(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", ctypes.c_int), ("message", ctypes.c_char_p))


def _asked(function: Any, *given: Any) -> Any:
    """Call a function whose last argument takes an error."""
    error = ctypes.POINTER(_GError)()
    found = function(*given, ctypes.byref(error))
    if error:
        said = (error.contents.message or b"").decode("utf-8", "replace")
        _library().g_error_free(error)
        raise _GlibError(said)
    return found


_OBJECT, _WORD, _ERROR = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_enable_interface": (None, (_WORD,)),
    "arv_update_device_list": (None, ()),
    "arv_get_n_devices": (ctypes.c_uint, ()),
    "arv_get_device_id": (_WORD, (ctypes.c_uint,)),
    "arv_camera_new": (_OBJECT, (_WORD, _ERROR)),
    "arv_camera_get_device": (_OBJECT, (_OBJECT,)),
    "arv_camera_is_feature_available": (ctypes.c_int, (_OBJECT, _WORD, _ERROR)),
    "arv_camera_set_boolean": (None, (_OBJECT, _WORD, ctypes.c_int, _ERROR)),
    "arv_camera_set_integer": (None, (_OBJECT, _WORD, ctypes.c_int64, _ERROR)),
    "arv_camera_set_float": (None, (_OBJECT, _WORD, ctypes.c_double, _ERROR)),
    "arv_camera_set_string": (None, (_OBJECT, _WORD, _WORD, _ERROR)),
    "arv_camera_create_stream": (_OBJECT, (_OBJECT, _OBJECT, _OBJECT, _ERROR)),
    "arv_camera_get_payload": (ctypes.c_uint, (_OBJECT, _ERROR)),
    "arv_camera_start_acquisition": (None, (_OBJECT, _ERROR)),
    "arv_camera_stop_acquisition": (None, (_OBJECT, _ERROR)),
    "arv_camera_create_chunk_parser": (_OBJECT, (_OBJECT,)),
    "arv_chunk_parser_get_integer_value": (ctypes.c_int64, (_OBJECT, _OBJECT, _WORD, _ERROR)),
    "arv_device_get_string_feature_value": (_WORD, (_OBJECT, _WORD, _ERROR)),
    "arv_device_get_genicam_xml": (_OBJECT, (_OBJECT, _ERROR)),
    "arv_stream_push_buffer": (None, (_OBJECT, _OBJECT)),
    "arv_stream_timeout_pop_buffer": (_OBJECT, (_OBJECT, ctypes.c_uint64)),
    "arv_buffer_new_allocate": (_OBJECT, (ctypes.c_size_t,)),
    "arv_buffer_get_status": (ctypes.c_int, (_OBJECT,)),
    "arv_buffer_get_frame_id": (ctypes.c_uint64, (_OBJECT,)),
    "arv_buffer_get_timestamp": (ctypes.c_uint64, (_OBJECT,)),
    "arv_buffer_get_image_pixel_format": (ctypes.c_uint32, (_OBJECT,)),
    "arv_buffer_get_image_width": (ctypes.c_int, (_OBJECT,)),
    "arv_buffer_get_image_height": (ctypes.c_int, (_OBJECT,)),
    "arv_buffer_get_image_data": (_OBJECT, (_OBJECT, _ERROR)),
    "g_object_unref": (None, (_OBJECT,)),
    "g_error_free": (None, (_OBJECT,)),
}
"""What each function gives and takes (Aravis 0.8, GLib 2)."""


@cache
def _library() -> Any:
    """Load Aravis; its own libraries come with it."""
    library = ctypes.CDLL(LIBRARY)
    for name, (gives, takes) in _FUNCTIONS.items():
        function = getattr(library, name)
        function.restype, function.argtypes = gives, takes
    return library
