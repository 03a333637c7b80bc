"""``roemetry fit-penetration``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class HalfName(StrEnum):
    """Half of a block in the image."""

    top = "top"
    bottom = "bottom"


def fit_penetration(
    recipe: Annotated[Path, typer.Argument(help="The line's recipe file, or its folder.")],
    bare: Annotated[
        Path,
        typer.Argument(help="Image of the block as it is, matt and opaque; or of both halves, with --half."),
    ],
    film: Annotated[
        float,
        typer.Option(
            "--film", min=0, help="Thickness of the cover, mm; 0 for paint of the product's colour."
        ),
    ],
    covered: Annotated[
        Path | None,
        typer.Argument(help="Image of the block under the product's own material; not with --half."),
    ] = None,
    half: Annotated[
        HalfName | None,
        typer.Option("--half", help="One image: which half of the block in it is covered or painted."),
    ] = None,
    film_std: Annotated[
        float, typer.Option("--film-std", min=0, help="Standard uncertainty of that thickness, mm.")
    ] = 0.0,
    target: Annotated[
        Path | None,
        typer.Option(
            "--target", help="The block's description; left out: the block the calibration was made from."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="File to write; left out: penetration.yaml beside the recipe."),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change the recipe; may stand several times."),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Measure how much lower a product is seen than it is, because light enters it.

    Exit code: 0 written; 1 the block is not found; 2 the recipe or the command line is wrong.
    """
    from roemetry.calibrating import block_of, fit_penetration, fit_penetration_in_one
    from roemetry.config.recipe import Recipe
    from roemetry.errors import ConfigurationError

    if (covered is None) == (half is None):
        raise ConfigurationError(
            "expected a second image or --half",
            hint="BARE COVERED: two images of one block; BARE --half top: one image of a block whose half "
            "towards the image's top is covered",
        )

    loaded = Recipe.load(recipe, sets=[*(sets or ()), "penetration="])
    block = block_of(loaded, target)
    if covered is not None:
        found = fit_penetration(loaded, bare, covered, block, film_mm=film, film_std_mm=film_std)
    elif half is not None:
        found = fit_penetration_in_one(loaded, bare, block, half.value, film_mm=film, film_std_mm=film_std)
    path = out or loaded.path.with_name("penetration.yaml")
    found.save(path)
    typer.echo(f"{path}: {found.product} is seen {found.offset_mm:.3f} mm too low, ± {found.std_mm:.3f} mm")
    if abs(found.offset_mm) < 2.0 * found.std_mm:
        typer.echo("  that is not told from nothing by this measurement")
