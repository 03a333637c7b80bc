"""``roemetry register-heads`` and ``two-sides``: heads above and below, or a product turned over."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from roemetry.records import Trace


def register_heads(
    top: Annotated[Path, typer.Argument(help="Recipe of the upper head, whose source is its plate scan.")],
    bottom: Annotated[Path, typer.Argument(help="Recipe of the lower head, likewise.")],
    plate: Annotated[Path, typer.Option("--plate", help="Target file of the sphere plate.")],
    out: Annotated[Path, typer.Option("--out", help="The registration; an existing one is replaced.")] = Path(
        "registration.yaml"
    ),
) -> None:
    """Register two heads to each other by one sphere plate whose balls both see."""
    from roemetry.config.target_file import read_sphere_plate
    from roemetry.errors import CalibrationError
    from roemetry.io.files import write_whole
    from roemetry.io.yaml_source import dump
    from roemetry_scan.closed import ball_centres, first_counts, registered

    described = read_sphere_plate(plate.name, plate.parent)
    assert described is not None
    plates = []
    for recipe in (top, bottom):
        trace = next(_traces(recipe))
        if trace.profiles is None:
            why = next((reason.text for reason in trace.absent.values()), "nothing was placed")
            raise CalibrationError(f"{recipe}: the plate was not measured: {why}")
        plates.append(trace.profiles)
    found = registered(*(ball_centres(one, described) for one in plates))
    told = {"roemetry_registration": 1, "T_top_bottom": found.T_top_bottom.tolist()}
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
    import numpy as np

    from roemetry.errors import CalibrationError, DataError, RoemetryError
    from roemetry.io.files import write_whole
    from roemetry.io.yaml_source import read_numbers
    from roemetry_scan.closed import CAUSES, Registration, closed_volume

    data = read_numbers(registration)
    try:
        pose = np.array(data["T_top_bottom"], np.float64)
        begun = data.get("first_counts")
        if begun is not None:
            upper_count, lower_count = begun
            begun = float(upper_count), float(lower_count)
        found = Registration(pose, float(data["rms_mm"]), int(data["balls"]), begun)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise ValueError("T_top_bottom is no 4 × 4 matrix of numbers")
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f"{registration}: no registration of two heads ({error})", hint="make one with register-heads"
        ) from error
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


def _traces(path: Path) -> Iterator[Trace]:
    from roemetry.config.recipe import Recipe
    from roemetry.run.pipeline import Pipeline

    recipe = Recipe.load(path)
    source, pipeline = recipe.source.make(), Pipeline(recipe, draws=0)
    for reference in recipe.references():
        yield pipeline.trace(source.read(reference))
