"""Size of disturbance against error: a panel for each, with every case, the interval, what is refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from benchmarks.disturbances import DISTURBANCES, Disturbance
from benchmarks.moved_rigs import MOTIONS, Motion
from roemetry.html import plots as svg

if TYPE_CHECKING:
    from benchmarks.faults import Case

_STYLE = Markup(
    "<style>text{font:10px system-ui,sans-serif;fill:#3c434c;text-anchor:middle}"
    ".start{text-anchor:start}.end{text-anchor:end}.title{font-weight:600;text-anchor:start}"
    ".grid{stroke:#d9dee4;fill:none}.zero{stroke:#8a93a0;fill:none}.ground{fill:#fff}"
    ".interval{fill:#cfe3ef}.held{fill:#0d689c;fill-opacity:.55}.lie{fill:#d0453b}.refused{fill:#b9c0c9}</style>"
)
_ACROSS, _WIDE, _HIGH, _LEFT = 3, 300.0, 168.0, 40.0
_BINS = 8
_FARTHEST = 0.06
"""Errors beyond stand at the panel's edge."""


def draw(path: Path, found: Sequence[Case]) -> None:
    """Draw a panel for each disturbance that has sizes and cases."""
    sized = [
        name
        for name, kind in kinds().items()
        if kind.low < kind.high and any(case.disturbance == name for case in found)
    ]
    high = 26.0 + _HIGH * math.ceil(len(sized) / _ACROSS)
    parts = [_STYLE, svg.box(0.0, 0.0, _ACROSS * _WIDE, high, "ground")]
    parts.append(
        svg.text(
            8.0, 16.0,
            "dots: error of the volume (red: outside its interval by the disturbance); blue: median interval "
            "(95 %); grey, from below: share refused", "start",
        )
    )  # fmt: skip
    for number, name in enumerate(sized):
        left, top = _WIDE * (number % _ACROSS), 26.0 + _HIGH * (number // _ACROSS)
        parts += _panel(name, [case for case in found if case.disturbance == name], left, top)
    whole = svg.picture(parts, high, "error of the volume over the size of each disturbance", _ACROSS * _WIDE)
    text = str(whole).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    path.write_text(f"{text}\n", "utf-8")


def kinds() -> dict[str, Disturbance | Motion]:
    """Give all disturbances, warped and rendered, by name."""
    return {**DISTURBANCES, **MOTIONS}


def _panel(name: str, cases: Sequence[Case], left: float, top: float) -> list[Markup]:
    kind = kinds()[name]
    low, high = math.log10(kind.low), math.log10(kind.high)
    x = svg.Axis(low, high, left + _LEFT, left + _WIDE - 10.0)
    y = svg.Axis(-_FARTHEST, _FARTHEST, top + _HIGH - 34.0, top + 20.0)
    parts = [svg.text(left + 8.0, top + 12.0, name, "title")]
    edges = np.linspace(low, high, _BINS + 1)
    for first, last in pairwise(edges):
        here = [case for case in cases if first <= math.log10(case.size) <= last]
        halves = [case.half for case in here if math.isfinite(case.half)]
        wide = x(last) - x(first) - 1.0
        if halves:
            half = min(float(np.median(halves)), _FARTHEST)
            parts.append(svg.box(x(first), y(half), wide, y(-half) - y(half), "interval"))
        if here:
            share = sum(case.verdict == "refused" for case in here) / len(here)
            tall = share * (y(-_FARTHEST) - y(_FARTHEST))
            parts.append(
                svg.box(x(first), y(-_FARTHEST) - tall, 4.0, tall, "refused", f"{share:.0%} refused")
            )
    for share, words in ((-0.05, "-5 %"), (0.0, "0"), (0.05, "+5 %")):
        kind_of_line = "zero" if share == 0.0 else "grid"
        parts.append(svg.line(left + _LEFT, y(share), left + _WIDE - 10.0, y(share), kind_of_line))
        parts.append(svg.text(left + _LEFT - 4.0, y(share) + 4.0, words, "end"))
    for power in range(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1):
        parts.append(svg.text(x(power), top + _HIGH - 20.0, f"{10.0**power:g}"))
    parts.append(svg.text(left + 0.5 * (_LEFT + _WIDE), top + _HIGH - 7.0, kind.unit))
    for case in sorted(cases, key=lambda case: case.lies):
        if math.isfinite(case.error):
            what = "lie" if case.lies else "held"
            parts.append(
                svg.dot(x(math.log10(case.size)), y(case.error), what, "", "", 2.6 if case.lies else 1.5)
            )
    return parts
