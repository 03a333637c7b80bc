"""``roemetry plugins``, ``check-plugin`` and ``schema``: what is installed, and what of it a file may say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from roemetry.cli.options import out_option

if TYPE_CHECKING:
    from roemetry.stages.registry import Registered
    from roemetry.testing.checks import Check
    from roemetry.testing.kit import Result

    Row = tuple[Registered, Check, Result]


def plugins(
    as_json: Annotated[
        bool,
        typer.Option(
            "--json",
            help="Print as JSON: `stages` (kind, name, provider, summary, reference, status) and "
            "`broken` (provider, why).",
        ),
    ] = False,
) -> None:
    """List the installed stages, who provides them, and what is wrong with those that cannot be used."""
    from roemetry.stages.registry import discover

    registry = discover()
    if as_json:
        typer.echo(
            json.dumps(
                {
                    "stages": [
                        {
                            "kind": stage.entry.kind,
                            "name": stage.entry.name,
                            "provider": str(stage.provider),
                            "summary": stage.entry.summary,
                            "reference": stage.entry.reference,
                            "status": stage.missing or "ok",
                        }
                        for stage in registry.stages
                    ],
                    "broken": [{"provider": str(item.provider), "why": item.why} for item in registry.broken],
                },
                indent=2,
            )
        )
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table()
    for heading in ("kind", "name", "what it does", "provider", "status"):
        # A name is typed from here into a recipe: it stays whole, however narrow the window.
        table.add_column(heading, overflow="fold", no_wrap=heading in ("kind", "name"))
    for stage in registry.stages:
        claimed = [
            other for other in registry.of_kind(stage.entry.kind) if other.entry.name == stage.entry.name
        ]
        status = stage.missing or (
            "ok" if len(claimed) == 1 else f"claimed twice: use {stage.provider.name}/…"
        )
        entry = stage.entry
        table.add_row(entry.kind, entry.name, Text(entry.summary), str(stage.provider), Text(status))
    for item in registry.broken:
        table.add_row("?", "?", "", str(item.provider), Text(f"broken: {item.why}", style="red"))
    Console().print(table)


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
    """Check a plugin's stages against the contract of their kinds, on scenes with known answers.

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


def schema(
    kind: Annotated[str, typer.Argument(help="Kind of file: recipe, rig or scene.")] = "recipe",
    out: Annotated[Path | None, out_option("File to write; default: standard output.")] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Write the JSON schema of a file, with the options of every installed stage, for editors."""
    from typing import get_args

    from roemetry.config.schemas import FileKind, schema_of
    from roemetry.errors import ConfigurationError
    from roemetry.io.files import write_whole
    from roemetry.stages.registry import discover

    known: dict[str, FileKind] = {name: name for name in get_args(FileKind)}
    if kind not in known:
        raise ConfigurationError(f"there is no schema of a {kind!r}", hint=f"one of {', '.join(known)}")
    text = json.dumps(schema_of(known[kind], discover()), indent=2, ensure_ascii=False) + "\n"
    if out is None:
        typer.echo(text, nl=False)
    else:
        write_whole(out, text)
        typer.echo(str(out))
