"""Control charts of a figure of a line's products: means by hour, and a moving mean by product.

Control limits come from the data itself, by the usual rules (Montgomery, Introduction to Statistical
Quality Control; ISO 7870-2, 7870-6):

- standard deviation within: mean of the moving ranges of two successive products over 1.128;
- means by hour: overall mean ± 3 σ / √n, n products in the hour;
- EWMA by product, z_i = λ x_i + (1 − λ) z_(i−1): overall mean ± L σ √(λ / (2 − λ) · (1 − (1 − λ)^(2i))),
  λ = 0.2 and L = 2.86, which gives a false alarm in 370 products on average.

Products on a line are not made alike: a chart that is out of control says that the product, or the
instrument, has changed, and not which. Assumed: successive products are independent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from roemetry.html.plots import WIDTH, Axis, Floats, dot, line, path, picture, plain, polyline, text
from roemetry.run.control_chart import QUANTITIES, WORDS, Check, chart_plot

_LAMBDA, _WIDE = 0.2, 2.86
FEWEST = 10
"""Fewer products give no limits."""
_D2 = 1.128
"""Mean range of two normal values over their standard deviation."""


@dataclass(frozen=True, slots=True)
class Chart:
    """A figure's control chart."""

    figure: str
    count: int
    mean: float
    std_within: float
    """mean, std_within: over all products, and from product to product; NaN where there are too few."""
    hours: tuple[tuple[float, int, float, float], ...]
    """By hour: begin (s since 1970), products, mean, and how far the mean may be from the overall mean."""
    ewma: NDArray[np.float64]
    """(product,) moving mean."""
    ewma_limit: NDArray[np.float64]
    """(product,) how far it may be from the overall mean."""
    times_s: NDArray[np.float64]
    values: NDArray[np.float64]

    @property
    def words(self) -> str:
        """Give the figure's name and unit, as in "mass, g"."""
        name, _, unit = self.figure.rpartition("_")
        return f"{name}, {unit.replace('mm3', 'mm³')}"

    @property
    def said(self) -> str:
        """Say in a line what it shows."""
        if math.isnan(self.std_within):
            return f"{self.words}: {self.count} products, too few for a control chart ({FEWEST} or more)"
        return (
            f"{self.words}: {self.count} products, mean {self.mean:.6g}, from product to product "
            f"± {self.std_within:.3g}; out of control: {len(self.hours_out)} of {len(self.hours)} hours, the "
            f"moving mean (EWMA) at {len(self.ewma_out)} products"
        )

    @property
    def hours_out(self) -> list[float]:
        """Give the begins of the hours whose mean is out of control."""
        return [begin for begin, _, mean, limit in self.hours if abs(mean - self.mean) > limit]

    @property
    def ewma_out(self) -> NDArray[np.int64]:
        """Give the products at which the moving mean is out of control."""
        return np.flatnonzero(np.abs(self.ewma - self.mean) > self.ewma_limit)


def chart_of(figure: str, times_s: NDArray[np.float64], values: NDArray[np.float64]) -> Chart:
    """Make the control chart of (product,) values in the order of their (product,) times, s since 1970."""
    known = np.isfinite(values)
    times_s, values = times_s[known], values[known]
    count = len(values)
    none = np.full(count, math.nan)
    if count < FEWEST:
        mean = float(values.mean()) if count else math.nan
        return Chart(figure, count, mean, math.nan, (), none, none, times_s, values)
    mean, std = float(values.mean()), float(np.abs(np.diff(values)).mean() / _D2)
    begins = np.floor(times_s / 3600.0) * 3600.0
    hours = []
    for begin in np.unique(begins):
        inside = values[begins == begin]
        hours.append((float(begin), len(inside), float(inside.mean()), 3.0 * std / math.sqrt(len(inside))))
    ewma = np.empty(count)
    last = mean
    for i, value in enumerate(values):
        last = _LAMBDA * value + (1.0 - _LAMBDA) * last
        ewma[i] = last
    until = 1.0 - (1.0 - _LAMBDA) ** (2.0 * np.arange(1, count + 1))
    limit = _WIDE * std * np.sqrt(_LAMBDA / (2.0 - _LAMBDA) * until)
    return Chart(figure, count, mean, std, tuple(hours), ewma, limit, times_s, values)


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
