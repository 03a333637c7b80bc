"""``roemetry report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    folder: Annotated[Path, typer.Argument(help="Folder of a run.")],
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Derive the tables and the report of a run again from its record."""
    from roemetry.errors import OutputError
    from roemetry.run.batch import derive
    from roemetry.run.record import recipe_of

    recipe, provenance = recipe_of(folder)
    files, faults = derive(recipe, folder, provenance, debug=debug)
    for file in files:
        typer.echo(str(file))
    if faults:
        raise OutputError("; ".join(faults))
