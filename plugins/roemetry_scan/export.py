"""``roemetry export``: the slices of a recipe's acquisitions as files that other programs read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    recipe: Annotated[Path, typer.Argument(help="A recipe, or the folder of one.")],
    to: Annotated[str, typer.Option("--to", help="tif, png, npy, csv, ply, pcd, las or x3p.")] = "ply",
    out: Annotated[Path, typer.Option("--out", help="Folder of the files; made if need be.")] = Path(
        "exported"
    ),
    sets: Annotated[list[str] | None, typer.Option("--set", help="Change the recipe.")] = None,
) -> None:
    """Write every acquisition's slices, belt and products, in mm: clouds, or height maps."""
    from roemetry.config.recipe import Recipe
    from roemetry.errors import DataError
    from roemetry.io.files import make_folder
    from roemetry.run.pipeline import Pipeline
    from roemetry_scan.formats import SUFFIXES, write
    from roemetry_scan.formats.points import Measured

    suffix = "." + to.lower().lstrip(".")
    if suffix not in SUFFIXES:
        raise DataError(f"--to {to}: no format of heights or points", hint=f"known are {', '.join(SUFFIXES)}")
    loaded = Recipe.load(recipe, sets=sets or ())
    source, pipeline = loaded.source.make(), Pipeline(loaded, draws=0)
    make_folder(out)
    for reference in loaded.references():
        trace = pipeline.trace(source.read(reference))
        profiles = trace.profiles
        if profiles is None:
            why = next(
                (reason.text for reason in trace.absent.values()), "the recipe ends before millimetres"
            )
            typer.echo(f"{reference.id}: nothing to write: {why}", err=True)
            continue
        name = reference.id.replace("/", "_").replace("\\", "_")
        for path in write(out / f"{name}{suffix}", Measured(profiles.xyz_mm, profiles.seen)):
            typer.echo(str(path))
