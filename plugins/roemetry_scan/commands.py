"""``roemetry register-heads``, ``two-sides``, ``side-by-side``: several heads, or a product turned over."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from roemetry.records import Trace
    from roemetry_scan.closed import Registration

_ABOVE, _BESIDE = "T_top_bottom", "T_left_right"
"""Keys of a registration: of a head above and one below, or of two side by side."""


def register_heads(
    top: Annotated[
        Path, typer.Argument(help="Recipe of the upper (left) head, whose source is its plate scan.")
    ],
    bottom: Annotated[Path, typer.Argument(help="Recipe of the lower (right) head, likewise.")],
    plate: Annotated[Path, typer.Option("--plate", help="Target file of the sphere plate.")],
    out: Annotated[Path, typer.Option("--out", help="The registration; an existing one is replaced.")] = Path(
        "registration.yaml"
    ),
    beside: Annotated[
        bool, typer.Option("--beside", help="Both heads look down, side by side: the left one first.")
    ] = False,
    apart: Annotated[
        float | None,
        typer.Option(
            "--apart",
            help="With --beside: Y of the right head's zero in the left one's frame, mm, where the balls fit "
            "in more than one way.",
        ),
    ] = None,
) -> None:
    """Register two heads to each other by one sphere plate whose balls both see."""
    from roemetry.config.target_file import read_sphere_plate
    from roemetry.errors import CalibrationError
    from roemetry.io.files import write_whole
    from roemetry.io.yaml_source import dump
    from roemetry_scan.closed import ball_centres, first_counts, refuse_other_pitch, registered
    from roemetry_scan.side_by_side import register_side_by_side, whole_ball_extent

    described = read_sphere_plate(plate.name, plate.parent)
    assert described is not None
    plates = []
    for recipe in (top, bottom):
        trace = next(_traces(recipe))
        if trace.profiles is None:
            why = next((reason.text for reason in trace.absent.values()), "nothing was placed")
            raise CalibrationError(f"{recipe}: the plate was not measured: {why}")
        plates.append(trace.profiles)
    centres = [ball_centres(one, described) for one in plates]
    for recipe, balls in zip((top, bottom), centres, strict=True):
        refuse_other_pitch(balls, described, str(recipe))
    if beside:
        looked = (
            whole_ball_extent(plates[0], described.diameter_mm / 2),
            whole_ball_extent(plates[1], described.diameter_mm / 2),
        )
        # of a ball at the end of what a head sees the centre is not known
        whole = [
            one[((one[:, :2] > low) & (one[:, :2] < high)).all(axis=1)]
            for one, (low, high) in zip(centres, looked, strict=True)
        ]
        found = register_side_by_side(whole[0], whole[1], looked, apart)
    else:
        found = registered(*centres)
    told = {"roemetry_registration": 1, _BESIDE if beside else _ABOVE: found.T_top_bottom.tolist()}
    told |= {"rms_mm": found.rms_mm, "balls": found.balls}
    counts = first_counts(*plates)
    write_whole(out, dump(told | ({"first_counts": list(counts)} if counts is not None else {})))
    typer.echo(f"{out}: {found.balls} balls seen by both heads, centres {found.rms_mm:.3f} mm apart (rms)")


def two_sides(
    top: Annotated[Path, typer.Argument(help="Recipe of the upper head.")],
    bottom: Annotated[Path, typer.Argument(help="Recipe of the lower head, or of the products turned over.")],
    registration: Annotated[Path, typer.Option("--registration", help="File that `register-heads` wrote.")],
    out: Annotated[Path, typer.Option("--out", help="Table of true volumes to write.")] = Path(
        "two_sides.csv"
    ),
) -> None:
    """Measure true volumes of products that two heads see; acquisitions are paired in order."""
    from roemetry.errors import DataError, RoemetryError
    from roemetry.io.files import write_whole
    from roemetry_scan.closed import CAUSES, closed_volume

    found = read_registration(registration, _ABOVE)
    causes = ",".join(f"{cause} (cm³)" for cause in CAUSES)
    lines = [
        f"acquisition,true volume (cm³),standard uncertainty (cm³),95 % from (cm³),to (cm³),{causes},reason"
    ]
    uppers, lowers = list(_traces(top)), list(_traces(bottom))
    if len(uppers) != len(lowers):
        raise DataError(
            f"{top} has {len(uppers)} acquisitions, {bottom} {len(lowers)}: each product once from each side"
        )
    for upper, lower in zip(uppers, lowers, strict=True):
        try:
            if upper.profiles is None or lower.profiles is None:
                reasons = [*upper.absent.values(), *lower.absent.values()]
                raise DataError(reasons[0].text if reasons else "a head measured nothing")
            volume = closed_volume(upper.profiles, lower.profiles, found)
        except RoemetryError as error:
            lines.append(f'{upper.acquisition_id},,,,{"," * len(CAUSES)},"{error.message}"')
            typer.echo(f"{upper.acquisition_id}: no volume: {error.message}")
            continue
        low, high = volume.interval
        parts = (volume.budget[cause] for cause in CAUSES)
        figures = (value / 1000.0 for value in (volume.value, volume.std, low, high, *parts))
        lines.append(f"{upper.acquisition_id}," + ",".join(f"{value:.4f}" for value in figures) + ",")
        typer.echo(f"{upper.acquisition_id}: {volume.value / 1000:.2f} ± {volume.std / 1000:.2f} cm³")
    write_whole(out, "\n".join(lines) + "\n")
    typer.echo(str(out))


def side_by_side(
    heads: Annotated[list[Path], typer.Argument(help="Recipes of the heads, from left to right.")],
    registration: Annotated[
        list[Path],
        typer.Option(
            "--registration",
            help="File that `register-heads --beside` wrote of the first and the second head; again for the "
            "second and the third, and so on.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for the wide scans and their table.")] = Path(
        "side_by_side"
    ),
) -> None:
    """Join scans of heads side by side, and measure products in them; acquisitions are paired in order."""
    from roemetry.errors import DataError, RoemetryError
    from roemetry.io.files import write_whole
    from roemetry_scan.formats import write
    from roemetry_scan.formats.points import measured_of
    from roemetry_scan.placing import BeltMotion
    from roemetry_scan.side_by_side import joined, volume_of

    if len(heads) < 2 or len(registration) != len(heads) - 1:
        raise DataError(
            f"{len(heads)} heads and {len(registration)} registrations: one for each two neighbours",
            hint="name at least two recipes, and --registration once less",
        )
    known = [read_registration(one, _BESIDE) for one in registration]
    scans = [list(_traces(one)) for one in heads]
    if len({len(one) for one in scans}) > 1:
        told = ", ".join(f"{path} {len(one)}" for path, one in zip(heads, scans, strict=True))
        raise DataError(
            f"the heads have different numbers of acquisitions ({told}): each product once of each"
        )
    lines = [
        "acquisition,product,visible volume (cm³),standard uncertainty (cm³),95 % from (cm³),to (cm³),"
        "heads differ by (mm),reason"
    ]
    out.mkdir(parents=True, exist_ok=True)
    for traces in zip(*scans, strict=True):
        name = traces[0].acquisition_id
        try:
            missing = [reason for one in traces if one.profiles is None for reason in one.absent.values()]
            profiles = [one.profiles for one in traces if one.profiles is not None]
            if len(profiles) < len(traces):
                raise DataError(missing[0].text if missing else "a head measured nothing")
            wide = joined(profiles, known)
            write(out / f"{name}.ply", measured_of(wide.profiles))
            labelled = BeltMotion().label(wide.profiles)
            differ = max(wide.level_mm, key=abs)
            for number in range(1, int(labelled.product.max(initial=0)) + 1):
                volume = volume_of(wide, labelled, number)
                figures = (value / 1000.0 for value in (volume.value, volume.std, *volume.interval))
                lines.append(
                    f"{name},{number}," + ",".join(f"{value:.4f}" for value in figures) + f",{differ:.4f},"
                )
                typer.echo(
                    f"{name}: product {number}, {volume.value / 1000:.2f} ± {volume.std / 1000:.2f} cm³, "
                    f"heads differ by {differ:+.3f} mm"
                )
        except RoemetryError as error:
            lines.append(f'{name},,,,,,,"{error.message}"')
            typer.echo(f"{name}: no volume: {error.message}")
    table = out / "side_by_side.csv"
    write_whole(table, "\n".join(lines) + "\n")
    typer.echo(str(table))


def read_registration(path: Path, kind: str) -> Registration:
    """Read what `register-heads` wrote; CalibrationError where it is none of the kind."""
    import numpy as np

    from roemetry.errors import CalibrationError
    from roemetry.io.yaml_source import read_numbers
    from roemetry_scan.closed import Registration

    data = read_numbers(path)
    try:
        pose = np.array(data[kind], np.float64)
        begun = data.get("first_counts")
        if begun is not None:
            first, second = begun
            begun = float(first), float(second)
        found = Registration(pose, float(data["rms_mm"]), int(data["balls"]), begun)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise ValueError(f"{kind} is no 4 × 4 matrix of numbers")
    except (KeyError, TypeError, ValueError) as error:
        how = " --beside" if kind == _BESIDE else ""
        raise CalibrationError(
            f"{path}: no registration of two heads ({error})", hint=f"make one with register-heads{how}"
        ) from error
    return found


def _traces(path: Path) -> Iterator[Trace]:
    from roemetry.config.recipe import Recipe
    from roemetry.run.pipeline import Pipeline

    recipe = Recipe.load(path)
    source, pipeline = recipe.source.make(), Pipeline(recipe, draws=0)
    for reference in recipe.references():
        yield pipeline.trace(source.read(reference))
