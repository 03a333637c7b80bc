"""``roemetry query``: SQL on the products of a run, or of a data set of runs, by DuckDB."""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from roemetry.errors import ConfigurationError, OutputError, PluginError
from roemetry.io.remote import Url, path_of
from roemetry.run.record import RECORD

_ROWS_MAX = 40
"""Rows of a table in a terminal; --csv writes all."""


def query(
    folder: Annotated[
        str,
        typer.Argument(help="Folder of a run with results.parquet; or folder or URL of a data set of runs."),
    ],
    sql: Annotated[
        str, typer.Argument(help="What to ask of the table `products`; default: all of it.")
    ] = "select * from products",
    product: Annotated[
        str | None,
        typer.Option("--product", metavar="ID", help="Show one product's row instead, line by line."),
    ] = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="Write all rows as comma-separated values.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Ask the Parquet tables of a run, or of many runs, by SQL; their columns are those of results.parquet.

    `roemetry export FOLDER parquet` writes the table of a run, with `--set folder=…` into a data set.
    """
    try:
        import duckdb
    except ImportError as error:
        raise PluginError("roemetry query needs DuckDB", hint="pip install 'roemetry[query]'") from error
    place, files = _tables(path_of(folder, Path()))
    with duckdb.connect() as asked:
        if isinstance(place, Url):
            import fsspec

            asked.register_filesystem(fsspec.filesystem(place.parts[0].rstrip(":")))
        try:
            asked.read_parquet(files, union_by_name=True, hive_partitioning=True).create_view("products")
            if product is not None:
                _show_upright(asked.execute(_ONE, [product, product]))
            elif as_csv:
                _write_csv(asked.execute(sql))
            else:
                asked.sql(sql).show(max_rows=_ROWS_MAX, max_width=10_000)
        except duckdb.Error as error:
            raise ConfigurationError(
                f"{folder}: {error}", hint="`describe products` names the columns"
            ) from error


_ONE = "select * from products where id = ? or acquisition = ?"


def _tables(place: Path) -> tuple[Path, str]:
    """Give where the tables lie, and the pattern that names them."""
    record, table = place / RECORD, place / "results.parquet"
    if not isinstance(place, Url) and record.exists():
        if not table.exists() or table.stat().st_mtime < record.stat().st_mtime:
            was = "is older than its record" if table.exists() else "is not there"
            raise OutputError(f"{table}: {was}", hint=f"`roemetry export {place} parquet` writes it")
        return place, str(table)
    if not place.is_dir():
        raise OutputError(f"{place}: there is no such folder")
    return place, f"{place}/**/*.parquet"


def _write_csv(found: Any) -> None:
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(column[0] for column in found.description)
    while rows := found.fetchmany(10_000):
        writer.writerows(rows)


def _show_upright(found: Any) -> None:
    """Print each row line by line, without what it does not have."""
    names = [column[0] for column in found.description]
    rows = found.fetchall()
    if not rows:
        raise OutputError("there is no such product", hint="an id is that of a row or of an image")
    for row in rows:
        for name, value in zip(names, row, strict=True):
            if value is not None:
                typer.echo(f"{name:40} {value}")
        typer.echo("")
