"""``roemetry lint``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def lint(
    file: Annotated[Path, typer.Argument(help="A recipe, a rig file or a calibration.")],
    sets: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Check it with this change.")
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Check a recipe, a rig file or a calibration; run nothing."""
    from roemetry.calibration import Calibration
    from roemetry.errors import ConfigurationError
    from roemetry.recipe import Recipe
    from roemetry.rig import Rig
    from roemetry.yaml_source import read

    path = file / "recipe.yaml" if file.is_dir() else file
    data = read(path).data
    keys = data if isinstance(data, dict) else {}
    if "roemetry_calibration" in keys:
        calibration = Calibration.load(path)
        typer.echo(
            f"{path}: a calibration by {calibration.method} of {calibration.stripe_count} stripes: sound"
        )
    elif "roemetry_rig" in keys:
        rig = Rig.load(path, sets=sets or ())
        images = sum(len(paths) for paths in rig.images.values())
        typer.echo(f"{path}: a rig with {rig.file.stripes} stripes and {images} images: sound")
    elif "roemetry" in keys:
        recipe = Recipe.load(path, sets=sets or ())
        found = len(recipe.source.make().references(recipe.source_path))
        stages = ", ".join(f"{kind} {chosen.registered.entry.name}" for kind, chosen in recipe.stages.items())
        typer.echo(f"{path}: a recipe for {recipe.product}: sound\n  {found} acquisitions; {stages}")
    else:
        raise ConfigurationError(
            f"{path}:1:1: neither a recipe (`roemetry: 1`), nor a rig (`roemetry_rig: 1`), "
            "nor a calibration (`roemetry_calibration: 1`)",
            hint="the first key of the file says what it is",
        )
