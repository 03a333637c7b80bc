"""What the page shows and what Prometheus reads (its text format 0.0.4), both taken from the outbox."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from roemetry_line import runs
from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox
from roemetry_line.station import LATENCY_MS

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
                "recipe": outbox.requested_recipe(one.name) or str(one.recipes[0]),
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


_STATION = (
    ("frames", "frames_total", "counter", "Frames taken"),
    ("products", "products_total", "counter", "Rows told of products"),
    ("lost", "frames_lost_total", "counter", "Frames that the camera took and that did not arrive"),
    ("incomplete", "frames_incomplete_total", "counter", "Frames that did not arrive whole"),
    ("late", "frames_late_total", "counter", "Frames that were measured after their deadline"),
    ("reconnects", "camera_reconnects_total", "counter", "How often the camera was gone"),
    ("waited_s", "camera_waited_seconds_total", "counter", "How long taking frames waited for measuring"),
    ("queue", "queue_frames", "gauge", "Frames that wait to be measured"),
    ("disk_free_gb", "disk_free_gigabytes", "gauge", "Free space for the line's folder"),
)


def metrics_of(line: Line, outbox: Outbox) -> str:
    """Give all figures as text."""
    return "".join(f"{text}\n" for text in _lines(line, outbox))


def _lines(line: Line, outbox: Outbox) -> Iterator[str]:
    health = outbox.health()
    told = {one.name: health.get(f"station {one.name}") for one in line.stations}
    stations = {name: one["figures"] for name, one in told.items() if one is not None}
    for key, name, kind, meaning in _STATION:
        yield from _head(name, kind, meaning)
        for station, figures in stations.items():
            if key in figures:
                yield f'roemetry_{name}{{line="{line.name}",station="{station}"}} {figures[key]}'
    yield from _head("station_silent_seconds", "gauge", "Time since the station's process said something")
    for station, one in told.items():
        if one is not None:
            at = f'{{line="{line.name}",station="{station}"}}'
            yield f"roemetry_station_silent_seconds{at} {time.time() - one['at']:.3f}"
    yield from _head("results_total", "counter", "Products by decision, grade or status")
    for station, figures in stations.items():
        for result, count in figures.get("results", {}).items():
            label = f'{{line="{line.name}",station="{station}",result="{_escaped(result)}"}}'
            yield f"roemetry_results_total{label} {count}"
    yield from _head("latency_seconds", "histogram", "From a frame's arrival to its rows in the outbox")
    for station, figures in stations.items():
        yield from _histogram(f'line="{line.name}",station="{station}"', figures)
    for key, kind, meaning in (
        ("delivered", "counter", "Rows delivered since the process started"),
        ("waiting", "gauge", "Rows that wait to be delivered"),
        ("reconnects", "counter", "How often the receiver was not there"),
    ):
        name = f"outlet_{key}" + ("_total" if kind == "counter" else "")
        yield from _head(name, kind, meaning)
        for outlet, figures in health.get("outlets", {"figures": {}})["figures"].items():
            yield f'roemetry_{name}{{line="{line.name}",outlet="{outlet}"}} {figures[key]}'


def _head(name: str, kind: str, meaning: str) -> Iterator[str]:
    yield f"# HELP roemetry_{name} {meaning}"
    yield f"# TYPE roemetry_{name} {kind}"


def _histogram(labels: str, figures: dict[str, object]) -> Iterator[str]:
    counts = figures.get("latency_counts")
    if not isinstance(counts, list):
        return
    so_far = 0
    for upper_ms, count in zip((*LATENCY_MS, None), counts, strict=True):
        so_far += count
        upper = "+Inf" if upper_ms is None else f"{upper_ms / 1e3:g}"
        yield f'roemetry_latency_seconds_bucket{{{labels},le="{upper}"}} {so_far}'
    yield f"roemetry_latency_seconds_sum{{{labels}}} {float(str(figures['latency_ms_sum'])) / 1e3:.6f}"
    yield f"roemetry_latency_seconds_count{{{labels}}} {so_far}"


def _escaped(label: str) -> str:
    return label.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
