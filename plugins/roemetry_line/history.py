"""What the history tells: counts by class, control charts by product, drift of calibrations."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from roemetry.config.recipe import Recipe
from roemetry.errors import ConfigurationError, OutputError, RoemetryError
from roemetry.io.files import write_whole
from roemetry.run.control_chart import Check
from roemetry_line import line_file
from roemetry_line.control import Control
from roemetry_line.control_charts import Chart, chart_of
from roemetry_line.line_file import Line, Station
from roemetry_line.outbox import FILE, Outbox
from roemetry_line.outlets.database import PostgresTable, SqliteTable, connect

Figure = Literal["mass_g", "volume_mm3", "height_mm", "latency_ms"]
FIGURES: tuple[Figure, ...] = ("mass_g", "volume_mm3", "height_mm", "latency_ms")

_ROWS_MAX = 200_000  # newest rows that a chart is drawn of


def charts_of(
    table: SqliteTable | PostgresTable, figure: Figure, line: str, station: str | None, since_s: float
) -> dict[str, Chart]:
    """Make a figure's control chart for each product that a line, or a station, has measured since a time.

    Products are what recipes call them; one limit over two of them would be no limit. The one that was
    measured last comes first.
    """
    which, given = _where(table, line, station, since_s)
    found = table.ask(
        f"select product, time_s, {figure} from roemetry_rows where kind = 'product' "
        f"and {figure} is not null and {which} order by time_s desc limit {_ROWS_MAX}",
        given,
    )
    by_product: dict[str, list[tuple[float, float]]] = {}
    for product, time_s, value in found:
        by_product.setdefault(product or "", []).append((time_s, value))
    charts = {}
    for product, pairs in by_product.items():
        both: NDArray[np.float64] = np.array(pairs[::-1], np.float64)
        charts[product] = chart_of(figure, both[:, 0], both[:, 1])
    return charts


def checks_of(line: Line, station: Station) -> tuple[Check, ...]:
    """Give the checks of the calibration that a station measures with now, oldest first."""
    from roemetry_line.block_checks import chart_of as checks_file

    recipe = recipe_at_work(line, station)
    sha256 = None if recipe.calibration is None else recipe.calibration.sha256
    return checks_file(recipe, line.folder, station.name).checks(sha256)


def recipe_at_work(line: Line, station: Station) -> Recipe:
    """Load the recipe that a station measures with: the one that was chosen, else its first."""
    path = station.recipes[0]
    if (line.folder / FILE).exists():
        with closing(Outbox(line.folder)) as outbox:
            path = Path(Control(line, outbox).recipes()[station.name][0])
    return line_file.load_recipe(path, line.folder)


def counts_of(
    table: SqliteTable | PostgresTable, line: str, station: str | None, since_s: float
) -> Mapping[str, int]:
    """Count products by decision, else grade, else status; and what gave no product by what it was."""
    which, given = _where(table, line, station, since_s)
    found = table.ask(
        f"select coalesce(decision, grade, status), count(*) from roemetry_rows where {which} "
        "group by 1 order by 2 desc",
        given,
    )
    return {str(name): int(count) for name, count in found}


def _where(
    table: SqliteTable | PostgresTable, line: str, station: str | None, since_s: float
) -> tuple[str, list[Any]]:
    which, given = f"line = {table.mark} and time_s >= {table.mark}", [line, since_s]
    if station is not None:
        return f"{which} and station = {table.mark}", [*given, station]
    return which, given


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
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Write it as a page (HTML) with its charts to this file."),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Say what a line has measured: counts, means by hour, what is out of control, how calibrations drift."""
    loaded = Line.load(line, with_recipes=False)
    table = history_of(loaded)
    if parquet is not None:
        from roemetry_line.days import write_days

        written = write_days(table, loaded.name, parquet)
        typer.echo("\n".join(map(str, written)) or f"{parquet}: no completed day (UTC) that it does not have")
        return
    since_s = time.time() - 3600.0 * hours
    counts = counts_of(table, loaded.name, station, since_s)
    charts = charts_of(table, figure, loaded.name, station, since_s)
    checks = {one.name: _checks(loaded, one) for one in loaded.stations if station in (None, one.name)}
    if report is not None:
        from roemetry_line.control_charts import history_page

        write_whole(report, history_page(loaded.name, station, since_s, counts, charts, checks))
        typer.echo(f"{report}", err=as_json)
    if as_json:
        typer.echo(json.dumps(described(counts, charts, checks), indent=2))
        return
    typer.echo(", ".join(f"{name} {count}" for name, count in counts.items()) or "nothing measured")
    for product, chart in charts.items():
        typer.echo(f"{product}: {chart.said}")
        for begin, count, mean, limit in chart.hours:
            out = "  OUT OF CONTROL" if begin in chart.hours_out else ""
            at = datetime.fromtimestamp(begin).astimezone()
            typer.echo(f"  {at:%Y-%m-%d %H:00}  {count:6} products  mean {mean:.6g}  (± {limit:.3g}){out}")
    for name, of in checks.items():
        if of:
            many = "1 check" if len(of) == 1 else f"{len(of)} checks"
            typer.echo(f"calibration of {name}: {many}, the last {of[-1].made}: {of[-1].verdict}")
            for reason in of[-1].reasons:
                typer.echo(f"  {reason.text}")


def _checks(line: Line, station: Station) -> tuple[Check, ...]:
    """Give a station's checks; none where its recipe cannot be read now: it may be edited just now."""
    try:
        return checks_of(line, station)
    except RoemetryError:
        return ()


def described(
    counts: Mapping[str, int], charts: Mapping[str, Chart], checks: Mapping[str, tuple[Check, ...]]
) -> dict[str, Any]:
    """Give counts, charts and checks as plain values."""
    return {
        "counts": dict(counts),
        "charts": [
            {
                "product": product,
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
            for product, chart in charts.items()
        ],
        "checks": {
            name: [{"made": one.made, "verdict": one.verdict} for one in of] for name, of in checks.items()
        },
    }


def history_of(line: Line) -> SqliteTable | PostgresTable:
    """Open a line's history."""
    url = line.history_url
    if url is None:
        raise ConfigurationError(f"{line.path}: the line keeps no history", hint="take `history: null` out")
    if not line.history_begun:
        raise OutputError(f"{url}: nothing has been measured yet", hint="`roemetry serve` makes it")
    return connect(url)
