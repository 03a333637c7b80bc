"""Control charts as pictures, for the operator's page and for ``roemetry history --report``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from markupsafe import Markup

from roemetry.html.plots import WIDTH, Axis, Floats, dot, line, path, picture, plain, polyline, text
from roemetry.run.control_chart import QUANTITIES, WORDS, Check, chart_plot
from roemetry_line.control_charts import Chart

_LEFT, _RIGHT, _TOP, _FLOOR = 62.0, WIDTH - 12.0, 10.0, 120.0
_IN, _OUT = "#0d689c", "#c8202a"
_POINTS_MAX = 600
"""Products that are drawn, the last ones: more than a picture has pixels."""


def history_page(
    name: str,
    station: str | None,
    since_s: float,
    counts: Mapping[str, int],
    charts: Mapping[str, Chart],
    checks: Mapping[str, Sequence[Check]],
) -> str:
    """Write the page of a line's history: counts, a chart for each product, the checks of each station."""
    from roemetry.html.page import environment_of

    now = datetime.now(UTC)
    return (
        environment_of("roemetry_line")
        .get_template("history.html.j2")
        .render(
            line=name,
            station=station,
            since=f"{datetime.fromtimestamp(since_s, UTC):%Y-%m-%d %H:%M}",
            until=f"{now:%Y-%m-%d %H:%M} UTC",
            counts=counts,
            charts=[
                (product, chart, means_plot(chart), ewma_plot(chart)) for product, chart in charts.items()
            ],
            drift=[
                (name, f"{of[-1].made}, {of[-1].verdict}", drift_plots(of))
                for name, of in checks.items()
                if of
            ],
            version=version("roemetry"),
        )
    )


def drift_plots(checks: Sequence[Check]) -> list[tuple[str, Markup]]:
    """Draw each length of the known block over the checks, oldest first."""
    return [(WORDS[name], chart_plot(checks, name)) for name in QUANTITIES]


def means_plot(chart: Chart) -> Markup:
    """Draw the means by hour between their limits."""
    if not chart.hours:
        return Markup("<p>too few products</p>")
    begins, counts, means, limits = (np.array(column) for column in zip(*chart.hours, strict=True))
    words = [
        f"{datetime.fromtimestamp(begin).astimezone():%d %b %H:00}: {count} products, mean {plain(mean, 3)}"
        for begin, count, mean in zip(begins, counts, means, strict=True)
    ]
    hours = (begins - begins[0]) / 3600.0
    return _plot(chart, hours, means, limits, words, "hours since the first", "means by hour", mark=True)


def ewma_plot(chart: Chart) -> Markup:
    """Draw the moving mean product by product between its limits."""
    if not len(chart.ewma) or math.isnan(chart.std_within):
        return Markup("<p>too few products</p>")
    numbers = np.arange(1.0, chart.count + 1.0)[-_POINTS_MAX:]
    last = slice(chart.count - len(numbers), None)
    return _plot(
        chart,
        numbers,
        chart.ewma[last],
        chart.ewma_limit[last],
        [],
        "product",
        "moving mean by product",
        mark=False,
    )


def _plot(
    chart: Chart,
    at: Floats,
    values: Floats,
    limits: Floats,
    words: Sequence[str],
    under: str,
    label: str,
    *,
    mark: bool,
) -> Markup:
    ends = [*values, *(chart.mean - limits), *(chart.mean + limits)]
    room = 0.06 * (max(ends) - min(ends))
    across = Axis.over(float(at[0]), float(at[-1]), _LEFT, _RIGHT)
    up = Axis.over(min(ends) - room, max(ends) + room, _FLOOR, _TOP)
    x = np.array([across(float(one)) for one in at])
    body = [*up.level(_LEFT, _RIGHT, 4), line(_LEFT, up(chart.mean), _RIGHT, up(chart.mean), "zero")]
    for side in (-1.0, 1.0):
        y = np.array([up(float(one)) for one in chart.mean + side * limits])
        ways = (x, y) if len(x) > 1 else (np.array([_LEFT, _RIGHT]), np.repeat(y, 2))
        body.append(path("limit", polyline(*ways)))
    body.append(path("mean", polyline(x, np.array([up(float(one)) for one in values]))))
    out_of_it = np.flatnonzero(np.abs(values - chart.mean) > limits).tolist()
    for i in range(len(values)) if mark else out_of_it:
        out = abs(values[i] - chart.mean) > limits[i]
        body.append(
            dot(x[i], up(float(values[i])), "point", words[i] if words else "", _OUT if out else _IN, 3.0)
        )
    ticks = [(v, w) for v, w in across.ticks(6) if v == round(v)] if len(at) > 1 else []
    body += [text(across(value), _FLOOR + 14.0, written) for value, written in ticks]
    body.append(text(_RIGHT, _FLOOR + 28.0, under, "end"))
    return picture(body, _FLOOR + 34.0, label)


def told(counts: Mapping[str, int], charts: Mapping[str, Chart]) -> dict[str, Any]:
    """Give counts and charts as pictures, for the operator's page."""
    return {
        "counts": dict(counts),
        "charts": [
            {
                "product": product,
                "said": chart.said,
                "means": str(means_plot(chart)),
                "ewma": str(ewma_plot(chart)),
            }
            for product, chart in charts.items()
        ],
    }
