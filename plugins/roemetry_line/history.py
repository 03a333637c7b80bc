"""What the history tells: counts by class, trends, and control charts of a figure by product and by hour.

Control limits come from the data itself, by the usual rules (Montgomery, Introduction to Statistical
Quality Control; ISO 7870-2, 7870-6):

- standard deviation within: mean of the moving ranges of two successive products over 1.128;
- means by hour: overall mean ± 3 σ / √n, n products in the hour;
- EWMA by product, z_i = λ x_i + (1 − λ) z_(i−1): overall mean ± L σ √(λ / (2 − λ) · (1 − (1 − λ)^(2i))), λ
= 0.2 and
  L = 2.86, which gives a false alarm in 370 products on average.

Products on a line are not made alike: a chart that is out of control says that the product, or the
instrument, has changed, and not which. Assumed: successive products are independent.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from roemetry.errors import ConfigurationError, OutputError
from roemetry_line.line_file import Line
from roemetry_line.outlets.database import COLUMNS, PostgresTable, SqliteTable, connect

Figure = Literal["mass_g", "volume_mm3", "height_mm", "latency_ms"]

_LAMBDA, _WIDE = 0.2, 2.86
_FEWEST = 10
"""Fewer products give no limits."""
_D2 = 1.128
"""Mean range of two normal values over their standard deviation."""
_ROWS_MAX = 200_000


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
    if count < _FEWEST:
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


def values_of(
    table: SqliteTable | PostgresTable, figure: Figure, station: str | None, since_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give times and values of a figure since a time, the oldest first."""
    which, given = _where(table, station, since_s)
    found = table.ask(
        f"select time_s, {figure} from roemetry_rows where kind = 'product' and {figure} is not null "
        f"and {which} order by time_s desc limit {_ROWS_MAX}",
        given,
    )
    both = np.array(found[::-1], np.float64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def counts_of(table: SqliteTable | PostgresTable, station: str | None, since_s: float) -> Mapping[str, int]:
    """Count products by decision, else grade, else status; and what gave no product by what it was."""
    which, given = _where(table, station, since_s)
    found = table.ask(
        f"select coalesce(decision, grade, status), count(*) from roemetry_rows where {which} "
        "group by 1 order by 2 desc",
        given,
    )
    return {str(name): int(count) for name, count in found}


def _where(table: SqliteTable | PostgresTable, station: str | None, since_s: float) -> tuple[str, list[Any]]:
    which, given = f"time_s >= {table.mark}", [since_s]
    if station is not None:
        return f"{which} and station = {table.mark}", [*given, station]
    return which, given


def export_days(table: SqliteTable | PostgresTable, folder: Path, now: float | None = None) -> list[Path]:
    """Write each closed day (UTC) that has no file yet as DAY.parquet; give the files written."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise OutputError(
            "Parquet needs the module pyarrow", hint="install it with `pip install 'roemetry[export]'`"
        ) from error
    folder.mkdir(parents=True, exist_ok=True)
    today = math.floor((now or time.time()) / 86400.0)
    first = table.ask("select min(time_s) from roemetry_rows")[0][0]
    written = []
    for day in range(math.floor(first / 86400.0), today) if first is not None else ():
        path = folder / f"{datetime.fromtimestamp(86400.0 * day, UTC):%Y-%m-%d}.parquet"
        if path.exists():
            continue
        rows = table.ask(
            f"select {', '.join(COLUMNS)} from roemetry_rows where time_s >= {table.mark} and "
            f"time_s < {table.mark} order by time_s, line, run, id",
            (86400.0 * day, 86400.0 * (day + 1)),
        )
        if rows:
            columns = {name: [row[i] for row in rows] for i, name in enumerate(COLUMNS)}
            part = path.with_suffix(".part")
            pq.write_table(pa.table(columns), part)
            part.replace(path)
            written.append(path)
    return written


def history(
    line: Annotated[Path, typer.Argument(help="A line file.")],
    station: Annotated[str | None, typer.Option("--station", help="Only what this station measured.")] = None,
    hours: Annotated[float, typer.Option("--hours", min=0.01, help="How far back, hours.")] = 24.0,
    figure: Annotated[Figure, typer.Option("--figure", help="Figure in the control chart.")] = "mass_g",
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
    parquet: Annotated[
        Path | None,
        typer.Option("--parquet", help="Only write the completed days that this folder does not have yet."),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Say what a line has measured: counts by class, means by hour, and what is out of control."""
    loaded = Line.load(line, with_recipes=False)
    table = history_of(loaded)
    if parquet is not None:
        for path in export_days(table, parquet):
            typer.echo(str(path))
        return
    since_s = time.time() - 3600.0 * hours
    counts = counts_of(table, station, since_s)
    chart = chart_of(figure, *values_of(table, figure, station, since_s))
    if as_json:
        typer.echo(json.dumps(described(counts, chart), indent=2))
        return
    typer.echo(", ".join(f"{name} {count}" for name, count in counts.items()) or "nothing measured")
    if math.isnan(chart.std_within):
        typer.echo(f"{figure}: {chart.count} products, too few for a control chart ({_FEWEST} or more)")
        return
    typer.echo(f"{figure}: mean {chart.mean:.6g}, from product to product ± {chart.std_within:.3g}")
    for begin, count, mean, limit in chart.hours:
        out = "  OUT OF CONTROL" if begin in chart.hours_out else ""
        at = datetime.fromtimestamp(begin).astimezone()
        typer.echo(f"  {at:%Y-%m-%d %H:00}  {count:6} products  mean {mean:.6g}  (± {limit:.3g}){out}")
    typer.echo(f"moving mean (EWMA): out of control at {len(chart.ewma_out)} of {chart.count} products")


def described(counts: Mapping[str, int], chart: Chart) -> dict[str, Any]:
    """Give counts and chart as plain values."""
    return {
        "counts": dict(counts),
        "figure": chart.figure,
        "products": chart.count,
        "mean": None if math.isnan(chart.mean) else chart.mean,
        "std_within": None if math.isnan(chart.std_within) else chart.std_within,
        "hours": [
            {
                "begin_s": begin,
                "products": count,
                "mean": mean,
                "limit": limit,
                "out": begin in chart.hours_out,
            }
            for begin, count, mean, limit in chart.hours
        ],
        "ewma_out": len(chart.ewma_out),
    }


def history_of(line: Line) -> SqliteTable | PostgresTable:
    """Open a line's history."""
    url = line.history_url
    if url is None:
        raise ConfigurationError(f"{line.path}: the line keeps no history", hint="take `history: null` out")
    if not begun(line):
        raise OutputError(f"{url}: nothing has been measured yet", hint="`roemetry serve` makes it")
    return connect(url)


def begun(line: Line) -> bool:
    """Say whether a line that keeps a history may have one already: the first product makes it."""
    url = line.history_url
    return url is None or not url.startswith("sqlite:") or Path(url.removeprefix("sqlite:")).exists()
