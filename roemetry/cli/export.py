"""``roemetry export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    folder: Annotated[Path, typer.Argument(help="Folder of a run.")],
    sink: Annotated[
        str,
        typer.Argument(help="What to write: parquet, point-cloud, height-map, or any other installed sink."),
    ],
    sets: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="An option of the sink; may stand several times."),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Write a finished run for other programs; nothing is measured again."""
    from roemetry.errors import ConfigurationError, OutputError
    from roemetry.finished import recipe_of
    from roemetry.runner import derive

    options = []
    for text in sets or ():
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise ConfigurationError(
                f"--set {text}: expected key=value", hint="for example --set pixel_mm=0.5"
            )
        options.append(f"{key}: {value}")
    with_sink = [f"sinks=[{{use: {sink}, options: {{{', '.join(options)}}}}}]"]
    recipe, provenance = recipe_of(folder, sets=with_sink)
    files, faults = derive(recipe, folder, provenance, debug=debug)
    for file in files:
        typer.echo(str(file))
    if faults:
        raise OutputError("; ".join(faults))
    if not files:
        raise OutputError(
            f"{folder}: {sink} found nothing to write",
            hint="no acquisition of the run got as far as it needs",
        )
