"""``roemetry init``."""

from __future__ import annotations

import os
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from roemetry.cli.progress import progress
from roemetry.errors import ConfigurationError
from roemetry_tools.init_project import NewProject, shipped_lines, start_like, start_own
from roemetry_tools.init_project.layout import Answers


def init(
    folder: Annotated[
        Path | None, typer.Argument(help="Folder to write; must be empty or not exist yet.")
    ] = None,
    like: Annotated[
        str | None,
        typer.Option(
            "--like",
            metavar="LINE",
            help="A product line that comes with roemetry: copies its recipe, rig, scene and calibration.",
        ),
    ] = None,
    product: Annotated[
        str | None, typer.Option("--product", help="Your own product: what lies on the belt.")
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            "--size",
            metavar="LxWxH",
            help="With --product: largest length across the stripes, width, height, mm.",
        ),
    ] = None,
    image: Annotated[
        str, typer.Option("--image", metavar="COLUMNSxROWS", help="The camera's image, px.")
    ] = "640x480",
    pixel_um: Annotated[float, typer.Option("--pixel-um", help="Pitch of the camera's pixels, µm.")] = 10.0,
    focal_mm: Annotated[float, typer.Option("--focal-mm", help="Focal length of the lens, mm.")] = 16.0,
    distance_mm: Annotated[
        float | None,
        typer.Option("--distance-mm", help="Camera to belt, mm; default: as near as the product allows."),
    ] = None,
    stripes: Annotated[
        int | None,
        typer.Option(
            "--stripes",
            help="Stripes of light, 5 to 40; default: up to 15, as many as leave room for the projector.",
        ),
    ] = None,
    measure: Annotated[
        str, typer.Option("--measure", help="What to measure, separated by commas: volume, weight, shape.")
    ] = "volume",
    density: Annotated[
        float | None, typer.Option("--density", help="Density of the product, g/cm³; needed for weight.")
    ] = None,
    plain_light: Annotated[
        bool,
        typer.Option(
            "--plain-light",
            help="Take a second image of each product in plain light, laser off: its outline makes the "
            "volume more accurate.",
        ),
    ] = False,
    items: Annotated[
        int,
        typer.Option(
            "--items",
            min=0,
            help="Simulated products to try it on; with --product also calibration images.",
        ),
    ] = 3,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Write a folder to start from: recipe, rig, calibration, simulated images, the next three commands.

    Asks what it needs in a terminal, unless --like or --product is given. Nothing is overwritten.
    """
    asking = folder is None or (like is None and product is None)
    if asking and not in_terminal():
        lines = ", ".join(shipped_lines())
        missing = [*([] if folder else ["the folder to write"]), "--like or --product with --size"]
        raise ConfigurationError(
            f"init: there is no terminal to ask in; {' and '.join(missing)} must be given",
            hint=f"for example `roemetry init potatoes --like potato` (there are {lines}), or "
            "`roemetry init plums --product plums --size 50x40x35`",
        )
    folder = folder or Path(typer.prompt("Folder to write"))
    if like is not None and product is not None:
        raise ConfigurationError("--like and --product exclude each other", hint="leave one of both out")
    step = partial(progress, quiet=False)
    given: dict[str, Any] = {"items": items, "jobs": os.cpu_count() or 1, "step": step}
    if like is not None:
        _tell(start_like(like, folder, **given))
        return
    if product is None:
        answers = _ask()
    else:
        size_mm, columns, rows = _sizes(size, image)
        camera = (columns, rows, pixel_um, focal_mm)
        measures = _words(measure)
        answers = Answers(product, size_mm, *camera, distance_mm, stripes, measures, density, plain_light)
    _tell(start_own(answers, folder, **given, tell=typer.echo))


def in_terminal() -> bool:
    """Tell whether there is somebody to ask."""
    return sys.stdin.isatty()


def _ask() -> Answers:
    product = typer.prompt("Product")
    size = typer.prompt("Largest one: length across the stripes x width x height, mm")
    image = typer.prompt("Image of the camera, px", default="640x480")
    size_mm, columns, rows = _sizes(size, image)
    pixel_um = typer.prompt("Pitch of its pixels, µm", default=10.0)
    focal_mm = typer.prompt("Focal length, mm", default=16.0)
    distance = typer.prompt("Camera to belt, mm (0: as near as the product allows)", default=0.0)
    stripes = typer.prompt("Stripes of light (0: as many as fit)", default=0)
    measures = _words(typer.prompt("Wanted: volume, weight, shape (with commas)", default="volume"))
    density = typer.prompt("Density, g/cm³", type=float) if "weight" in measures else None
    plain = typer.confirm("Is a second image taken in plain light, laser off?", default=False)
    camera = (columns, rows, pixel_um, focal_mm)
    return Answers(product, size_mm, *camera, distance or None, stripes or None, measures, density, plain)


def _sizes(size: str | None, image: str) -> tuple[tuple[float, float, float], int, int]:
    """Read the product's size, mm, and the image's, px."""
    length, width, height = _numbers("--size", size, 3, "LxWxH in mm, e.g. 90x60x45")
    columns, rows = _numbers("--image", image, 2, "COLUMNSxROWS in px, e.g. 1280x1024")
    return (length, width, height), int(columns), int(rows)


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _numbers(flag: str, said: str | None, count: int, expected: str) -> tuple[float, ...]:
    if said is None:
        raise ConfigurationError(f"{flag}: this is missing", hint=f"give {expected}")
    parts = said.lower().replace("×", "x").replace("mm", "").replace(" ", "").split("x")
    try:
        found = tuple(float(part) for part in parts)
    except ValueError:
        found = ()
    if len(found) != count or not all(abs(value) < 1e9 for value in found):
        raise ConfigurationError(f"{flag}: found `{said}`; expected {count} numbers: {expected}")
    return found


def _tell(started: NewProject) -> None:
    if started.layout is not None:
        rig = started.layout
        typer.echo(
            f"camera {rig.distance:g} mm over the belt, {rig.mm_per_px:.3f} mm a pixel; "
            f"{rig.stripes} stripes {rig.spacing:g} mm apart; projector "
            f"{rig.projector_x:g} mm beside, {rig.projector_z:g} mm over the belt"
        )
        typer.echo(f"1 mm of height displaces a stripe by {rig.px_per_mm:.2f} px")
    typer.echo(
        f"{started.folder}: {', '.join(path.name for path in started.files)}; "
        f"{started.items} simulated acquisitions in data"
    )
    typer.echo(
        f"next: cd {shlex.quote(str(started.folder))} && roemetry run .   (README.md says how to go on)"
    )
