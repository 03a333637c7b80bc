"""Options for the conformance kit: feeds that give frames on any machine, and outlets at which nobody is."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from roemetry.stages import StageOptions
from roemetry.testing.cases import write_image

_NO_PORT = 1
"""tcpmux: nobody serves it, so that a connection is refused at once."""
_NOT_OURS = "192.0.2.1"
"""Of a block for documentation (RFC 5737): no machine may listen at it."""


def _images() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="roemetry-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for number in (1, 2):
        write_image(folder / f"p{number}.png", number)
    return folder


def folder_watch() -> StageOptions:
    """Give options of the feed `folder-watch`: a folder of two images."""
    from roemetry_line.feeds.folder_watch import FolderWatchOptions

    return FolderWatchOptions(path=str(_images()), existing=True, settle_ms=0.0)


def video() -> StageOptions:
    """Give options of the feed `video`: a file of two frames, without loss."""
    import cv2

    from roemetry_line.feeds.video import VideoOptions

    path = _images() / "two.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 25.0, (32, 24), isColor=False)
    for grey in (40, 200):
        writer.write(np.full((24, 32), grey, np.uint8))
    writer.release()
    return VideoOptions(path=str(path))


def basler() -> StageOptions:
    """Give options of the feed `basler`: the emulated camera's test image."""
    from roemetry_line.feeds.basler import BaslerOptions

    return BaslerOptions(emulated=True, trigger="software", nodes={"Width": 64, "Height": 48})


def aravis() -> StageOptions:
    """Give options of the feed `aravis`: its built-in fake camera."""
    from roemetry_line.feeds.aravis import AravisOptions

    return AravisOptions(emulated=True, nodes={"Width": 64, "Height": 48})


def genicam() -> StageOptions:
    """Give options of the feed `genicam`: the producer that the package genicam brings for tests."""
    from roemetry_line.feeds.genicam import GenICamOptions

    package = find_spec("genicam")
    found = None if package is None or package.origin is None else Path(package.origin).parent / "viky.cti"
    return GenICamOptions(producer=found)


def tcp() -> StageOptions:
    """Give options of the outlet `tcp`."""
    from roemetry_line.outlets.acknowledged_lines import TcpOptions

    return TcpOptions(port=_NO_PORT)


def serial() -> StageOptions:
    """Give options of the outlet `serial`."""
    from roemetry_line.outlets.acknowledged_lines import SerialOptions

    return SerialOptions(device="/dev/no-serial-line")


def mqtt() -> StageOptions:
    """Give options of the outlet `mqtt`."""
    from roemetry_line.outlets.mqtt import MqttOptions

    return MqttOptions(port=_NO_PORT)


def webhook() -> StageOptions:
    """Give options of the outlet `webhook`."""
    from roemetry_line.outlets.webhook import WebhookOptions

    return WebhookOptions(url=f"http://127.0.0.1:{_NO_PORT}/rows")


def modbus() -> StageOptions:
    """Give options of the outlet `modbus`."""
    from roemetry_line.outlets.modbus import ModbusOptions

    return ModbusOptions(host=_NOT_OURS)


def opcua() -> StageOptions:
    """Give options of the outlet `opcua`."""
    from roemetry_line.outlets.opcua import OpcUaOptions

    return OpcUaOptions(host=_NOT_OURS)


def database() -> StageOptions:
    """Give options of the outlet `database`."""
    from roemetry_line.outlets.database import DatabaseOptions

    return DatabaseOptions(url="sqlite:/nowhere/at/all/history.sqlite")
