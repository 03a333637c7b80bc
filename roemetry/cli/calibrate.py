"""``roemetry calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def calibrate(
    rig: Annotated[Path, typer.Argument(help="A rig file: which images, which target, how many stripes.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The calibration file; left out: calibration.yaml beside the rig."),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change the rig, e.g. working_distance_mm=320."),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Make a calibration from images of known things, or refuse with the reason."""
    from roemetry.calibrating import calibrate as calibrate_rig
    from roemetry.calibrating import default_path
    from roemetry.rig import Rig

    loaded = Rig.load(rig, sets=sets or ())
    calibration = calibrate_rig(loaded)
    path = out or default_path(loaded)
    calibration.save(path)
    typer.echo(f"{path}: {calibration.method}, {calibration.stripe_count} stripes")
    for name, value in calibration.residuals.items():
        typer.echo(f"  {name}: {value:.4g}")
    for note in calibration.notes:
        typer.echo(f"  {note}")
