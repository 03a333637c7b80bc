"""``roemetry check-plugin``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from roemetry.stages.registry import Registered
    from roemetry.testing.checks import Check
    from roemetry.testing.kit import Result

    Row = tuple[Registered, Check, Result]


def check_plugin(
    name: Annotated[
        str,
        typer.Argument(help="A stage (dominant-peak, extractor/dominant-peak), or a plugin: all its stages."),
    ],
    as_json: Annotated[
        bool,
        typer.Option(
            "--json", help="Print as JSON: a list of kind, stage, provider, check, sentence, result, reason."
        ),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Hold a plugin's stages to the contract of their kinds, on scenes whose answer is known.

    Exit code: 0 every check passed or failed as declared; 1 one did not; 2 there is no such plugin, or a
    stage of it cannot be made.
    """
    from roemetry.cli.progress import progress
    from roemetry.testing.kit import conformance, stages_named

    stages = stages_named(name)
    rows: list[Row] = []
    with progress("checking", quiet=as_json) as moved:
        for done, stage in enumerate(stages):
            moved(done, len(stages))
            rows += [(stage, check, result) for check, result in conformance(stage)]
    if as_json:
        typer.echo(json.dumps([_described(row) for row in rows], indent=2))
    else:
        _show(rows)
    if not all(result.as_declared for _, _, result in rows):
        raise typer.Exit(1)


def _described(row: Row) -> dict[str, str]:
    from roemetry.testing.checks import name_of, sentence_of

    stage, check, result = row
    return {
        "kind": stage.entry.kind,
        "stage": stage.entry.name,
        "provider": str(stage.provider),
        "check": name_of(check),
        "sentence": sentence_of(check),
        "result": result.outcome,
        "reason": result.message,
    }


_STYLES = {"passed": "green", "failed": "red", "expected failure": "yellow", "unexpectedly passed": "red"}


def _show(rows: list[Row]) -> None:
    from collections import Counter

    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from roemetry.testing.checks import name_of

    console = Console()
    for stage in dict.fromkeys(stage for stage, _, _ in rows):
        title = f"{stage.entry.kind} {stage.entry.name}, {stage.provider}"
        table = Table(title=Text(title), title_justify="left", box=SIMPLE_HEAD)
        table.add_column("check", overflow="fold")
        table.add_column("result", no_wrap=True)
        table.add_column("reason", overflow="fold")
        for whose, check, result in rows:
            if whose == stage:
                name = name_of(check).removeprefix("check_").replace("_", " ")
                table.add_row(name, Text(result.outcome, style=_STYLES[result.outcome]), Text(result.message))
        console.print(table)
    counts = Counter(result.outcome for _, _, result in rows)
    console.print(", ".join(f"{count} {outcome}" for outcome, count in counts.items()), highlight=False)
