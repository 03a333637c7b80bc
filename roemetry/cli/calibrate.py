"""``roemetry calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from roemetry.records import Evidence
    from roemetry.records.calibration import Calibration


def calibrate(
    rig: Annotated[Path, typer.Argument(help="A rig file: which images, which target, how many stripes.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="The calibration file; an old one is replaced; left out: calibration.yaml beside the rig.",
        ),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change the rig, e.g. working_distance_mm=320; may stand several times.",
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            help="Write a page (HTML) about the calibration to this file: verdict, figures, "
            "residuals, coverage, height uncertainty.",
        ),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Make a calibration from images of known things, or refuse with the reason."""
    from roemetry.calibrating import calibrate as calibrate_rig
    from roemetry.calibrating import calibrate_with_evidence, default_path
    from roemetry.config.rig import Rig
    from roemetry.records import Evidence

    loaded = Rig.load(rig, sets=sets or ())
    evidence = Evidence()
    if report is None:
        calibration = calibrate_rig(loaded)
    else:
        calibration, evidence = calibrate_with_evidence(loaded)
    path = out or default_path(loaded)
    calibration.save(path)
    typer.echo(f"{path}: {calibration.method}, {calibration.stripe_count} stripes")
    for name, value in calibration.residuals.items():
        typer.echo(f"  {name}: {value:.4g}")
    for note in calibration.notes:
        typer.echo(f"  {note}")
    for sentence in evidence.verdict:
        typer.echo(f"  {sentence}")
    if report is not None:
        _write_page(report, calibration, evidence, loaded.file.name)
        typer.echo(f"{report}")


def _write_page(path: Path, calibration: Calibration, evidence: Evidence, name: str) -> None:
    from roemetry.calibrating import evidence_page
    from roemetry.io.files import write_whole
    from roemetry.stages.registry import discover

    registry = discover()
    triangulator = registry.load(registry.find("triangulator", calibration.method))()
    write_whole(path, evidence_page(calibration, evidence, triangulator, name=name))
