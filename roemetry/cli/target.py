"""``roemetry target``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class SheetFormat(StrEnum):
    """File formats of a printed sheet."""

    SVG = "svg"
    PDF = "pdf"


def target(
    targets: Annotated[
        list[Path] | None,
        typer.Argument(help="Target files, or names of shipped ones; left out: list the shipped ones."),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="Folder to write to, made if need be; left out: the working directory."
        ),
    ] = Path(),
    sheet_format: Annotated[
        SheetFormat,
        typer.Option("--format", help="Of a printed sheet; PDF needs the extra `targets`."),
    ] = SheetFormat.SVG,
    page: Annotated[
        str | None,
        typer.Option(
            "--page",
            help="Page size of a printed sheet: a4, letter, a3, a2, a1, a0; left out: the smallest "
            "of A4 to A0 that fits.",
        ),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Make calibration targets: flat ones as sheets to print at true scale, solid ones as STL.

    Exit code: 0 made; 2 a description or the command line is wrong.
    """
    from roemetry.targets import make_target

    if not targets:
        _list_shipped()
        return
    for given in targets:
        made = make_target(_found(given), out, sheet_format=sheet_format.value, page=page)
        size = " × ".join(f"{side:g}" for side in made.size_mm)
        typer.echo(f"{made.file}  ({size} mm, id {made.identity})")


def _shipped() -> dict[str, Path]:
    """Shipped descriptions by name: beside the installed package, or in the checkout."""
    from roemetry.io.files import shipped

    folder = shipped("calib_targets")
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def _list_shipped() -> None:
    from roemetry.io.yaml_source import read

    for name, path in _shipped().items():
        typer.echo(f"{name:32} {read(path).data['kind']}")


def _found(given: Path) -> Path:
    import difflib

    from roemetry.errors import ConfigurationError

    if given.is_file():
        return given
    shipped = _shipped()
    if given.name in shipped and given.parent == Path():
        return shipped[given.name]
    close = difflib.get_close_matches(given.name, shipped, n=1)
    raise ConfigurationError(
        f"there is no file {given}, and no shipped target of that name",
        hint=f"did you mean `{close[0]}`?" if close else "`roemetry target` lists the shipped ones",
    )
