"""``roemetry new-plugin``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def new_plugin(
    name: Annotated[str, typer.Argument(help="Its name, e.g. my-peaks: small letters, digits, hyphens.")],
    kind: Annotated[str, typer.Option("--kind", "-k", help="Kind of its stage.")] = "extractor",
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="Folder to make the package's folder in; left out: the working directory."
        ),
    ] = Path(),
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Write an installable plugin package: a working stage, and tests of the contract of its kind."""
    from roemetry.stages.registry import discover
    from roemetry_tools.init_plugin import new_plugin as written

    for file in written(name, kind, out, discover()):
        typer.echo(str(file))
    typer.echo(f"next: pip install -e '{out / name}[test]' && roemetry check-plugin {name}")
