"""``roemetry calibrate``, ``check-calibration``, ``fit-penetration`` and ``target``."""

from __future__ import annotations

import json
import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from roemetry.cli.options import out_option, set_option

if TYPE_CHECKING:
    from roemetry.calibrating import Check
    from roemetry.config.rig import Rig
    from roemetry.records import Evidence
    from roemetry.records.calibration import Calibration

_Block = Annotated[
    Path | None,
    typer.Option(
        "--target", help="The block's description; default: the block the calibration was made from."
    ),
]


def calibrate(
    rig: Annotated[Path, typer.Argument(help="A rig file: which images, which target, how many stripes.")],
    out: Annotated[
        Path | None,
        out_option(
            "The calibration file; an existing one is replaced; default: calibration.yaml beside the rig."
        ),
    ] = None,
    sets: Annotated[list[str] | None, set_option("Change the rig, e.g. working_distance_mm=320")] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            help="Write a page (HTML) about the calibration to this file: verdict, figures, "
            "residuals, coverage, height uncertainty.",
        ),
    ] = None,
    doctor: Annotated[
        Path | None,
        typer.Option(
            "--doctor",
            help="Write a page (HTML) to this file that shows each image with what was found on it, and why "
            "it was or was not used; also if the calibration is refused.",
        ),
    ] = None,
    accept_poor: Annotated[
        bool,
        typer.Option(
            "--accept-poor",
            help="Write a calibration that its own checks refuse; every number measured with it says so.",
        ),
    ] = False,
    camera_only: Annotated[
        bool,
        typer.Option(
            "--camera-only",
            help="Find only camera and lens, from the boards; written in OpenCV's format, to "
            "camera.yaml beside the rig unless --out says otherwise.",
        ),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Make a calibration from images of known objects and check it, or refuse it with the reason."""
    from roemetry.calibrating import calibrate_with_evidence, default_path
    from roemetry.cli.progress import progress
    from roemetry.config.rig import Rig
    from roemetry.errors import CalibrationError

    loaded = Rig.load(rig, sets=sets or ())
    if camera_only:
        _camera(loaded, out or loaded.path.with_name("camera.yaml"))
        return
    with progress("calibrating", quiet=False) as shown:
        calibration, evidence = calibrate_with_evidence(loaded, doctor=doctor, on_progress=shown)
    path = out or default_path(loaded)
    if not evidence.usable:
        if not accept_poor:
            if report is not None:
                _write_page(report, calibration, evidence, loaded.file.name)
            raise CalibrationError(
                "\n  ".join([f"{path} is not written. {' '.join(evidence.verdict)}", *calibration.notes]),
                hint="--report PAGE.html shows where it fails; --accept-poor writes it nevertheless, marked",
            )
        calibration = calibration.accepted_as_poor(evidence.verdict[0])
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


def _camera(rig: Rig, path: Path) -> None:
    from roemetry.calibrating import calibrate_camera

    found = calibrate_camera(rig, path)
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    values = [*found.focal_px, *found.principal_px, *found.distortion]
    typer.echo(f"{path}: camera from {found.images} images, board corners off by {found.rms_px:.3f} px (rms)")
    for name, value, std in zip(names, values, found.std, strict=True):
        if std > 0.0:
            typer.echo(f"  {name}: {value:.6g} ± {std:.2g}{' px' if name[0] in 'fc' else ''}")
    for name, why in found.left_out.items():
        typer.echo(f"  not used: {name}: {why}")


def _write_page(path: Path, calibration: Calibration, evidence: Evidence, name: str) -> None:
    from roemetry.calibrating import evidence_page
    from roemetry.io.files import write_whole
    from roemetry.stages.registry import discover

    registry = discover()
    triangulator = registry.load(registry.find("triangulator", calibration.method))()
    write_whole(path, evidence_page(calibration, evidence, triangulator, name=name))


def check_calibration(
    recipe: Annotated[Path, typer.Argument(help="The line's recipe file, or its folder.")],
    image: Annotated[Path, typer.Argument(help="The block on the belt under the stripes.")],
    target: _Block = None,
    chart: Annotated[
        Path | None,
        typer.Option(
            "--chart",
            help="Control chart (SQLite): earlier checks are read and this one is added; "
            "default: the recipe's `calibration_check.chart`, else nothing is kept.",
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Write the chart of this calibration as a page (HTML) to this file."),
    ] = None,
    sets: Annotated[list[str] | None, set_option("Change the recipe for this check")] = None,
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
    from roemetry.run.control_chart import due

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
        if asked is not None and asked.max_age_days is not None:
            typer.echo(f"  next check due {due(check, asked.max_age_days):%Y-%m-%d %H:%M} UTC")
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
    target: _Block = None,
    out: Annotated[
        Path | None, out_option("File to write; default: penetration.yaml beside the recipe.")
    ] = None,
    sets: Annotated[list[str] | None, set_option("Change the recipe")] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Measure how much too low a product appears because light enters it.

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


class SheetFormat(StrEnum):
    """File formats of a printed sheet."""

    SVG = "svg"
    PDF = "pdf"


def target(
    targets: Annotated[
        list[Path] | None,
        typer.Argument(help="Target files, or names of shipped ones; default: the shipped ones are listed."),
    ] = None,
    out: Annotated[Path, out_option("Folder to write to, created if needed.")] = Path(),
    sheet_format: Annotated[
        SheetFormat, typer.Option("--format", help="Of a printed sheet; PDF needs the extra `targets`.")
    ] = SheetFormat.SVG,
    page: Annotated[
        str | None,
        typer.Option(
            "--page",
            help="Page size of a printed sheet: a4, letter, a3, a2, a1, a0; default: the smallest "
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
    from roemetry.errors import ConfigurationError, did_you_mean

    if given.is_file():
        return given
    shipped = _shipped()
    if given.name in shipped and given.parent == Path():
        return shipped[given.name]
    raise ConfigurationError(
        f"there is no file {given}, and no shipped target of that name",
        hint=did_you_mean(given.name, shipped) or "`roemetry target` lists the shipped ones",
    )
