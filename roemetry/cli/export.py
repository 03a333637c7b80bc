"""``roemetry export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    folder: Annotated[Path, typer.Argument(help="Folder of a run; or a calibration file.")],
    sink: Annotated[
        str,
        typer.Argument(
            help="What to write: parquet, point-cloud, height-map, or any other installed sink; "
            "of a calibration: opencv."
        ),
    ],
    sets: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="An option of the sink; may stand several times."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Of a calibration: file to write, .yaml, .json or .xml; "
            "left out: NAME-opencv.yaml beside NAME.yaml.",
        ),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Write a finished run, or a calibration's camera, for other programs; nothing is measured again."""
    from roemetry.errors import ConfigurationError, OutputError
    from roemetry.run.batch import derive
    from roemetry.run.record import recipe_of

    if folder.is_file():
        typer.echo(str(_camera(folder, sink, out)))
        return
    options = []
    for text in sets or ():
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise ConfigurationError(
                f"--set {text}: expected key=value", hint="for example --set pixel_mm=0.5"
            )
        options.append(f"{key}: {value}")
    with_sink = [f"sinks=[{{use: {sink}, options: {{{', '.join(options)}}}}}]"]
    recipe, provenance = recipe_of(folder, sets=with_sink)
    files, faults = derive(recipe, folder, provenance, debug=debug)
    for file in files:
        typer.echo(str(file))
    if faults:
        raise OutputError("; ".join(faults))
    if not files:
        raise OutputError(
            f"{folder}: {sink} found nothing to write",
            hint="no acquisition of the run got as far as it needs",
        )


def _camera(path: Path, form: str, out: Path | None) -> Path:
    """Write a calibration's camera and planes as OpenCV's file."""
    from roemetry.errors import CalibrationError, ConfigurationError
    from roemetry.records.calibration import Calibration
    from roemetry.records.view import write_camera

    if form != "opencv":
        raise ConfigurationError(
            f"{path} is a file: of a calibration only `opencv` can be written, not `{form}`",
            hint="name the folder of a run for a sink",
        )
    view = Calibration.load(path).view
    if view is None:
        raise CalibrationError(
            f"{path}: this calibration knows no camera", hint="calibrate with pinhole-plane"
        )
    written = out or path.with_name(f"{path.stem}-opencv.yaml")
    write_camera(written, view)
    return written
