"""On the line: frames of live cameras in, decisions out, nothing lost.

Four kinds of process share the work: a station each camera (`station.py`) takes frames, measures them and
puts their rows into the outbox; one process (`deliver.py`) takes rows from the outbox to the outlets; one
shows the operator's page (`page`); and the one that was started (`serve.py`) watches over them. What they
share is a SQLite file (`outbox.py`), so that any of them may die at any moment.
"""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, VerbEntry, hookimpl

_LINE = "pip install 'roemetry[line]'"
_OF_THEIR_OWN = {
    "pypylon": "pip install 'roemetry[basler]'",
    "libaravis-0.8.so.0": "apt install libaravis-0.8-0",
}
"""How what `roemetry[line]` does not bring is installed."""


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the feeds and the outlets."""
    for kind, name, target, summary, reference, *needs in (
        ("feed", "folder-watch", "feeds.folder_watch:FolderWatch",
         "Image files as they are put into a folder", "our own"),
        ("feed", "video", "feeds.video:Video",
         "A video file or a USB camera by OpenCV: for the bench", "OpenCV"),
        ("feed", "basler", "feeds.basler:Basler",
         "Basler cameras, and pylon's emulated camera", "pylon C++ API by pypylon", "pypylon"),
        ("feed", "genicam", "feeds.genicam:GenICam",
         "Any camera with a GenTL producer", "GenICam GenTL by harvesters", "harvesters"),
        ("feed", "aravis", "feeds.aravis:Aravis",
         "GigE and USB3 Vision cameras by the system's library Aravis", "Aravis 0.8", "libaravis-0.8.so.0"),
        ("outlet", "tcp", "outlets.acknowledged_lines:Tcp",
         "Lines of JSON over TCP, each acknowledged", "our own"),
        ("outlet", "serial", "outlets.acknowledged_lines:Serial",
         "Lines of JSON over a serial line, each acknowledged", "our own"),
        ("outlet", "mqtt", "outlets.mqtt:Mqtt",
         "Messages to an MQTT broker, QoS 1", "MQTT 3.1.1 by paho-mqtt", "paho"),
        ("outlet", "modbus", "outlets.modbus:Modbus",
         "Registers of a Modbus TCP server: last result, heartbeat", "our own"),
        ("outlet", "opcua", "outlets.opcua:OpcUa",
         "An OPC UA server: results as events and values", "OPC 40100-1 by asyncua", "asyncua"),
        ("outlet", "webhook", "outlets.webhook:Webhook",
         "Rows posted to an HTTP address", "our own"),
        ("outlet", "database", "outlets.database:Database",
         "The history: SQLite or PostgreSQL", "our own"),
    ):  # fmt: skip
        yield StageEntry(
            kind,
            name,
            f"roemetry_line.{target}",
            summary,
            reference,
            requires=tuple((needed, _OF_THEIR_OWN.get(needed, _LINE)) for needed in needs),
        )


@hookimpl
def roemetry_verbs() -> Iterable[VerbEntry]:
    """Register the commands."""
    yield VerbEntry(
        "serve",
        "roemetry_line.serve:serve",
        "Measure live camera images and send the results on, until stopped.",
        file_key="roemetry_line",
        doctor="roemetry_line.preflight:examine",
    )
    yield VerbEntry(
        "history",
        "roemetry_line.history:history",
        "Show what a line has measured, and what is out of control.",
    )
