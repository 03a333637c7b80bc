"""Figures of a line in the text format that Prometheus reads (exposition format 0.0.4)."""

from __future__ import annotations

import time
from collections.abc import Iterator

from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox
from roemetry_line.station import LATENCY_MS

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
