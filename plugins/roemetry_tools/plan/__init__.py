"""``roemetry plan``."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from roemetry.cli.options import set_option

_CHECKED = 5  # rows of the table shown in the terminal; the page has all

if TYPE_CHECKING:
    from rich.table import Table

    from roemetry.records import Plan, PlanTable


def plan(
    scene: Annotated[Path, typer.Argument(help="A scene file, or a folder with a scene.yaml in it.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The page to write; default: plan.html, with --json none."),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Put short simulations of flat plates beside the prediction.")
    ] = False,
    sets: Annotated[
        list[str] | None, set_option("Change the scene, e.g. simulator.options.laser.planes=15")
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option(
            "--json",
            help="Print the whole plan as JSON: figures, maps, tables, curves, reasons; units "
            "beside every number.",
        ),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Predict what a rig will measure before it is built: whether it measures the product, and how well.

    The scene file describes rig and product as for `roemetry simulate`.
    """
    import json
    import shlex
    from datetime import UTC, datetime

    from roemetry.config.scene import Scene
    from roemetry.io.files import make_folder, write_whole
    from roemetry_tools.plan.page import as_plain, page, plan_of

    loaded = Scene.load(scene, sets=sets or ())
    made = plan_of(loaded, simulate=simulate)
    path = out if out is not None or as_json else Path("plan.html")
    if path is not None:
        make_folder(path.parent)
        command = shlex.join(["roemetry", *sys.argv[1:]])
        write_whole(path, page(made, loaded, command=command, made=datetime.now(UTC)))
    if as_json:
        typer.echo(json.dumps({"name": loaded.file.name, **as_plain(made)}, indent=1))
    else:
        _show(loaded.file.name, made, path)


def _show(name: str, plan: Plan, path: Path | None) -> None:
    from rich.console import Console

    console = Console()
    say = partial(console.print, highlight=False, markup=False, soft_wrap=True)
    if plan.answer is not None:
        for line in (plan.answer.text, *(f"  or: {change}" for change in plan.answer.changes[1:])):
            say(line)
    console.print(_figures(name, plan))
    for table in plan.tables:
        if table.name == "check":
            console.print(_table(table))
    for reason in plan.reasons:
        say(reason.text)
    if path is not None:
        say(f"  {path}")


def _figures(name: str, plan: Plan) -> Table:
    from rich.table import Column, Table

    from roemetry_tools.plan.page import written

    table = Table("", Column(justify="right"), "", title=name, title_justify="left", box=None)
    for figure in plan.figures:
        table.add_row(figure.title, written(figure), "" if figure.unit == "1" else figure.unit)
    return table


def _table(given: PlanTable) -> Table:
    from rich.table import Table

    from roemetry.html.plots import plain

    table = Table(title=given.title, title_justify="left", box=None)
    shown = given.columns[:_CHECKED]
    for column in shown:
        unit = "" if column.unit == "1" else f"\n{column.unit}"
        table.add_column(f"{column.title}{unit}", justify="right")
    for k in range(len(given.columns[0].values)):
        table.add_row(*(plain(float(c.values[k]), c.digits) for c in shown))
    return table
