"""``roemetry report``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer


def report(
    folder: Annotated[Path, typer.Argument(help="Folder of a run.")],
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Derive the tables and the report of a run again from its record."""
    from roemetry.errors import OutputError
    from roemetry.recipe import Recipe
    from roemetry.record import PROVENANCE
    from roemetry.runner import derive

    path = folder / PROVENANCE
    try:
        provenance = json.loads(path.read_text(encoding="utf-8"))
        recipe_path, sets = provenance["recipe"], provenance["sets"]
        recipe_sha256 = provenance["recipe_sha256"]
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be read: {error.strerror or error}", hint="name the folder of a run"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: damaged ({error})", hint="name the folder of a run") from error
    recipe = Recipe.load(recipe_path, sets=sets)
    if recipe.sha256 != recipe_sha256:
        raise OutputError(
            f"{folder}: the recipe, calibration or a plugin has changed since the run",
            hint="the pictures would show something else than was measured; run again",
        )
    files, faults = derive(recipe, folder, provenance, debug=debug)
    for file in files:
        typer.echo(str(file))
    if faults:
        raise OutputError("; ".join(faults))
