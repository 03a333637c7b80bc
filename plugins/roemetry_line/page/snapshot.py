"""What the page shows, read from the outbox: products, alarms, and how each part of the line is."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from roemetry_line import runs
from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox

_SILENT_S = 3.0
"""A process that has said nothing for so long is shown as silent."""
_REJECTS = 12
_FULL_GB = 0.02


def snapshot_of(line: Line, outbox: Outbox) -> dict[str, Any]:
    """Give the state of a line, as plain values."""
    now = time.time()
    health = outbox.health()
    rows = outbox.last_rows(200)
    return {
        "line": line.name,
        "time_s": now,
        "stations": [
            _station(one.name, health.get(f"station {one.name}"), rows, now)
            | {
                "deadline_ms": one.section.deadline_ms,
                "recipes": [str(path) for path in one.recipes],
                "recipe": outbox.wished(one.name) or str(one.recipes[0]),
                "check": outbox.last_check(one.name),
            }
            for one in line.stations
        ],
        "outlets": _outlets(line, health.get("outlets"), now),
        "alarms": [*_disk_full(line.folder, now), *outbox.alarms()],
    }


def _disk_full(folder: Path, now: float) -> list[dict[str, Any]]:
    """Give an alarm where the disk is full: then none can be written that would say so."""
    free_gb = runs.disk_free(folder)
    if not free_gb < _FULL_GB:
        return []
    left = f"{1e3 * free_gb:.0f} MB are free for {folder}"
    said = f"the disk is full: {left}; frames wait until there is room"
    return [
        {
            "n": 0,
            "at": now,
            "station": "disk",
            "code": "disk-full",
            "text": said,
            "level": "alarm",
            "ended": None,
            "acknowledged": now,
            "acknowledged_by": "nobody: it cannot be written",
        }
    ]


def _station(
    name: str, told: Mapping[str, Any] | None, rows: list[dict[str, Any]], now: float
) -> dict[str, Any]:
    own = [row for row in rows if row["station"] == name]
    products = [row for row in own if row["kind"] == "product"]
    rejects = [row for row in products if _is_reject(row["summary"])][:_REJECTS]
    figures = {} if told is None else dict(told["figures"])
    silent_s = None if told is None else now - told["at"]
    state = "not started" if told is None else str(told["state"])
    if silent_s is not None and silent_s > _SILENT_S and state != "stopped":
        state = f"silent for {silent_s:.0f} s"
    return {
        "name": name,
        "state": state,
        "figures": figures,
        "frame_age_s": now - figures["last_frame_s"] if "last_frame_s" in figures else None,
        "last": products[0] if products else None,
        "rejects": rejects,
    }


def _is_reject(told: Mapping[str, Any]) -> bool:
    """Say whether a person will want to look: not measured, undecided, or of no good class."""
    word = told.get("decision") or told.get("grade")
    return told.get("status") == "failed" or (word is not None and word not in ("good", "A", "ok"))


def _outlets(line: Line, told: Mapping[str, Any] | None, now: float) -> list[dict[str, Any]]:
    figures = {} if told is None else told["figures"]
    silent = told is None or now - told["at"] > _SILENT_S
    return [
        {"name": one.name, "kind": one.outlet.registered.entry.name}
        | dict(figures.get(one.name, {"state": "not started", "delivered": 0, "waiting": 0}))
        | ({"state": "silent"} if silent else {})
        for one in line.outlets
    ]
