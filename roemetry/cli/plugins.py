"""``roemetry plugins``."""

from __future__ import annotations

import json
from typing import Annotated

import typer


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
