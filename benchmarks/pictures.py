"""Pictures as SVG files that stand alone: curves by name, and what else is drawn of elements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from markupsafe import Markup

from roemetry.html import plots as svg

Points = Sequence[tuple[float, float]]

_COLOURS = ("#0d689c", "#a65a00", "#187059", "#b71d7c", "#5a4fcf", "#726317", "#7a3b1d", "#44525f", "#d0453b")
_STYLE = (
    "text{font:12px system-ui,sans-serif;fill:#3c434c;text-anchor:middle}"
    ".start{text-anchor:start}.end{text-anchor:end}.grid{stroke:#d9dee4;fill:none}"
    ".axis{stroke:#8a93a0;fill:none}.line{fill:none;stroke-width:2}.ground{fill:#fff}"
    ".goal{stroke:#8a93a0;stroke-dasharray:4 3;fill:none}"
)
_WIDTH, _LEFT, _TOP, _FLOOR = 660.0, 72.0, 28.0, 262.0


def curves(
    path: Path, lines: Mapping[str, Points], across: str, up: str, *, low: float | None = None
) -> None:
    """Draw a line for each name.

    Parameters
    ----------
    path
        File to write.
    lines
        Points (x, share) by name; with `low`, shares are drawn on a scale of powers of ten from there on, and
        what is 0 or below it stands on the floor.
    across, up
        What the axes are.
    """
    xs = [x for points in lines.values() for x, _ in points]
    ys = [y for points in lines.values() for _, y in points]
    right = _WIDTH - 12.0
    x_axis = svg.Axis.over(min(xs), max(xs), _LEFT, right)
    parts: list[Markup] = []
    if low is None:
        y_axis = svg.Axis(0.0, 1.0, _FLOOR, _TOP)
        marks = y_axis.ticks(5)
        place = {y: y_axis(y) for y in ys}
    else:
        first, last = math.log10(low), math.ceil(math.log10(max(*ys, low * 10.0)))
        y_axis = svg.Axis(first, float(last), _FLOOR, _TOP)
        marks = [(float(k), _power(k)) for k in range(round(first), last + 1)]
        place = {y: y_axis(math.log10(max(y, low))) for y in ys}
    for value, words in marks:
        parts += [
            svg.line(_LEFT, y_axis(value), right, y_axis(value), "grid"),
            svg.text(_LEFT - 6.0, y_axis(value) + 4.0, words, "end"),
        ]
    for value, words in x_axis.ticks(8):
        parts.append(svg.text(x_axis(value), _FLOOR + 17.0, words))
    parts.append(svg.line(_LEFT, _FLOOR, right, _FLOOR, "axis"))
    for number, (name, points) in enumerate(lines.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        drawn = "M" + "L".join(f"{svg.number(x_axis(x))} {svg.number(place[y])}" for x, y in points)
        parts.append(Markup('<path class="line" stroke="{}" d="{}"/>').format(colour, drawn))
        parts += [svg.dot(x_axis(x), place[y], "", f"{name}: {x:g}, {y:.3g}", colour, 3.0) for x, y in points]
        y_key = _FLOOR + 54.0 + 18.0 * number
        parts += [svg.dot(_LEFT + 6.0, y_key - 4.0, "", name, colour, 4.0)]
        parts += [svg.text(_LEFT + 16.0, y_key, name, "start")]
    parts += [
        svg.text(0.5 * (_LEFT + right), _FLOOR + 34.0, across),
        svg.text(_LEFT, _TOP - 12.0, up, "start"),
    ]
    svg_file(path, parts, (_WIDTH, _FLOOR + 50.0 + 18.0 * len(lines)), f"{up} over {across}", _STYLE)


def svg_file(path: Path, body: Sequence[Markup], size: tuple[float, float], label: str, style: str) -> None:
    """Write elements on white ground, of a width and a height, with their style sheet."""
    parts = [Markup("<style>{}</style>").format(Markup(style)), svg.box(0.0, 0.0, *size, "ground"), *body]
    text = str(svg.picture(parts, size[1], label, width=size[0]))
    path.parent.mkdir(parents=True, exist_ok=True)
    named = text.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    path.write_text(named + "\n", encoding="utf-8")


def _power(k: int) -> str:
    return f"{100.0 * 10.0**k:g} %"
