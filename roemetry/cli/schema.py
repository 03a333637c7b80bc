"""``roemetry schema``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer


def schema(
    kind: Annotated[str, typer.Argument(help="Of which file: recipe, rig or scene.")] = "recipe",
    out: Annotated[Path | None, typer.Option("--out", "-o", help="File to write; left out: printed.")] = None,
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
