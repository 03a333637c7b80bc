"""The page of the documentation that holds the figures, and its plot of speed against precision."""

from __future__ import annotations

import datetime
import importlib.metadata
import math
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from benchmarks.extraction.tables import Table
from roemetry.html.plots import box, dot, line, number, text

PAGE = Path("docs/measurements/extraction.md")
PLOT = Path("docs/images/extraction.svg")
BEGIN = "<!-- figures: python -m benchmarks {} --page -->"
END = "<!-- end of figures -->"
_STYLE = """
text { font: 12px sans-serif; fill: #333; } .title { font-weight: bold; } .end { text-anchor: end; }
.middle { text-anchor: middle; } .grid { stroke: #ddd; } .frame { fill: none; stroke: #888; }
.bound { stroke: #2a7; stroke-dasharray: 5 4; } .ours { stroke: #fff; } .name { font-size: 11px; }
.own { fill: #9a3412; font-weight: bold; }
"""
_PANEL, _HEIGHT, _LEFT, _TOP = 420.0, 400.0, 50.0, 34.0
_LINE = 11.0
_OURS, _PEERS = "#c2410c", "#64748b"


@dataclass(frozen=True)
class Point:
    """A method in the plot."""

    name: str
    ours: bool
    megapixels_per_s: float
    over_bound: float


def put_into_page(tables: Sequence[Table], how: str, benchmark: str = "extract") -> None:
    """Replace the figures of the page by these, with date and machine."""
    written = PAGE.read_text(encoding="utf-8")
    mark = BEGIN.format(benchmark)
    begin = written.index(mark) + len(mark)
    end = written.index(END, begin)
    body = "\n".join(str(table) for table in tables)
    PAGE.write_text(f"{written[:begin]}\n\n{how}\n\n{body}\n{written[end:]}", encoding="utf-8")


def machine() -> str:
    """Say when and on what."""
    versions = ", ".join(
        f"{name} {importlib.metadata.version(name)}"
        for name in ("numpy", "numba", "scipy", "opencv-contrib-python-headless")
    )
    day = datetime.datetime.now(datetime.UTC).date().isoformat()
    return f"{day}, {processor()}, Python {platform.python_version()}, {versions}"


def processor() -> str:
    """Name the processor, as well as the system tells it."""
    try:
        found = re.search(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text("utf-8"), flags=re.M)
    except OSError:
        found = None
    return found[1] if found else platform.processor() or platform.machine()


def points(
    speeds: Table, precisions: Table, ours: Mapping[str, bool], *, size: str, kind: str
) -> list[Point]:
    """Join the two tables by method: Mpixel/s at a size, RMS over the bound of a set."""
    across, up = speeds.columns.index(f"{size}, Mpixel/s"), precisions.columns.index(f"{kind} ×")
    fast = {row[0]: row[across] for row in speeds.rows}
    return [
        Point(row[0], ours[row[0]], float(fast[row[0]]), float(row[up]))
        for row in precisions.rows
        if "–" not in (fast.get(row[0], "–"), row[up]) and float(fast[row[0]]) > 0.0
    ]


def plot(panels: Mapping[str, Sequence[Point]], size: str) -> str:
    """Draw speed (right is faster) against precision (down is better), both logarithmic, a panel a set."""
    body = [
        Markup("<style>{}</style>").format(Markup(_STYLE)),
        box(0, 0, _PANEL * len(panels) + 60, 470, "", fill="#fff"),
    ]
    everything = [point for each in panels.values() for point in each]
    speeds = [point.megapixels_per_s for point in everything]
    errors = [point.over_bound for point in everything]
    across = (math.floor(math.log10(min(speeds))), math.ceil(math.log10(max(speeds))))
    up = (math.log10(min(0.7, 0.9 * min(errors))), math.log10(1.2 * max(errors)))
    for index, (title, shown) in enumerate(panels.items()):
        body += panel(_LEFT + index * _PANEL, title, shown, across, up)
    body.append(
        text(
            _LEFT,
            462,
            f"Mpixel/s, {size}, one thread (right: faster); RMS error over the bound (down: better)",
        )
    )
    return str(
        Markup('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {} 470" role="img">{}</svg>\n').format(
            number(_PANEL * len(panels) + 60), Markup("").join(body)
        )
    )


def panel(
    left: float,
    title: str,
    shown: Sequence[Point],
    across: tuple[float, float],
    up: tuple[float, float],
) -> list[Markup]:
    """Draw one panel."""
    width = _PANEL - 50.0

    def x(speed: float) -> float:
        return left + width * (math.log10(speed) - across[0]) / (across[1] - across[0])

    def y(error: float) -> float:
        return _TOP + _HEIGHT * (up[1] - math.log10(error)) / (up[1] - up[0])

    body = [text(left, 20, title, "title")]
    for power in range(int(across[0]), int(across[1]) + 1):
        body.append(line(x(10.0**power), _TOP, x(10.0**power), _TOP + _HEIGHT, "grid"))
        body.append(text(x(10.0**power), _TOP + _HEIGHT + 15, f"{10**power:g}", "middle"))
    for value in (0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0):
        if up[0] <= math.log10(value) <= up[1]:
            body.append(line(left, y(value), left + width, y(value), "bound" if value == 1.0 else "grid"))
            body.append(text(left - 5, y(value) + 4, f"{value:g}", "end"))
    body.append(box(left, _TOP, width, _HEIGHT, "frame"))
    places = [(x(point.megapixels_per_s), y(point.over_bound)) for point in shown]
    taken = [Room(px - 5.0, py - 5.0, 10.0) for px, py in places]
    for point, at in sorted(zip(shown, places, strict=True), key=lambda each: each[1]):
        label = room_for(point.name, at, taken, (left, left + width))
        taken.append(label)
        title_ = f"{point.name}: {point.megapixels_per_s:.0f} Mpixel/s, {point.over_bound:.2f} × the bound"
        body.append(dot(*at, "ours", title_, _OURS if point.ours else _PEERS, 4.5))
        body.append(text(label.x, label.y + 9.0, point.name, "name own" if point.ours else "name"))
    return body


@dataclass(frozen=True)
class Room:
    """A rectangle one line high that a name or a dot takes."""

    x: float
    y: float
    width: float

    def meets(self, other: Room) -> bool:
        """Tell whether two rectangles overlap."""
        across = self.x < other.x + other.width and other.x < self.x + self.width
        return across and abs(self.y - other.y) < _LINE


def room_for(name: str, at: tuple[float, float], taken: Sequence[Room], ends: tuple[float, float]) -> Room:
    """Find the nearest free place for a name beside its dot; the last one tried if all is taken."""
    long = 5.7 * len(name)
    for off in (0.0, -11.0, 11.0, -22.0, 22.0, -33.0, 33.0):
        for begin in (at[0] + 7.0, at[0] - 7.0 - long):
            place = Room(begin, at[1] - 5.0 + off, long)
            if ends[0] < begin and begin + long < ends[1] and not any(place.meets(each) for each in taken):
                return place
    return place
