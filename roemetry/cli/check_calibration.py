"""``roemetry check-calibration``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from roemetry.calibrating import Check


def check_calibration(
    recipe: Annotated[Path, typer.Argument(help="The line's recipe file, or its folder.")],
    image: Annotated[Path, typer.Argument(help="The block on the belt under the stripes.")],
    target: Annotated[
        Path | None,
        typer.Option(
            "--target", help="The block's description; left out: the block the calibration was made from."
        ),
    ] = None,
    chart: Annotated[
        Path | None,
        typer.Option(
            "--chart",
            help="Control chart (SQLite): earlier checks are looked at, this one is added; left "
            "out: the recipe's `calibration_check.chart`, else nothing is kept.",
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Write the chart of this calibration as a page (HTML) to this file."),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change the recipe for this check; may stand several times."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the check as JSON.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Measure a known block again and say whether the line's calibration still holds.

    Exit code: 0 in order, or drifting within its limits; 1 out; 2 the recipe or the command line is wrong.
    """
    from dataclasses import asdict

    from roemetry.calibrating import Chart, block_of, chart_page, check_calibration
    from roemetry.config.recipe import Recipe
    from roemetry.errors import ConfigurationError
    from roemetry.io.files import json_values, write_whole

    loaded = Recipe.load(recipe, sets=sets or ())
    asked = loaded.calibration_check
    kept = chart or (loaded.path.parent / asked.chart if asked is not None and asked.chart else None)
    if report is not None and kept is None:
        raise ConfigurationError(
            "there is no chart to write a page of", hint="name one with --chart, or calibration_check.chart"
        )
    check = check_calibration(loaded, image, block_of(loaded, target), kept)
    if as_json:
        typer.echo(json.dumps(json_values(asdict(check)), indent=2))
    else:
        show(check)
    if report is not None and kept is not None:
        write_whole(report, chart_page(Chart(kept).checks(check.calibration_sha256), loaded.product))
        typer.echo(f"{report}", err=as_json)
    if check.verdict == "out":
        raise typer.Exit(1)


def show(check: Check) -> None:
    """Print a check: a line each for what was measured, then its reasons."""
    from roemetry.calibrating import QUANTITIES

    typer.echo(f"{check.target}: {check.verdict}")
    for name in QUANTITIES:
        found = check.quantity(name)
        if math.isnan(found.value):
            typer.echo(f"  {name:10} not measured")
            continue
        difference = found.value - found.expected
        typer.echo(
            f"  {name:10} {found.value:9.3f}  expected {found.expected:9.3f}  "
            f"difference {difference:+.3f}  limit {2 * found.std:.3f}"
        )
    typer.echo(
        f"  {check.stripes} stripes on the block, their heights spread by {check.stripe_spread_mm:.3f} mm"
    )
    for reason in check.reasons:
        typer.echo(f"  {reason.text}")
