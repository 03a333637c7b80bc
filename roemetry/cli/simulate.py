"""``roemetry simulate``."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class CalibrationImages(StrEnum):
    """Which calibration images to make."""

    none = "none"
    basic = "basic"
    charuco = "charuco"
    all = "all"


def simulate(
    scene: Annotated[Path, typer.Argument(help="A scene file, or a folder with a scene.yaml in it.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the data set, made if need be.")],
    count: Annotated[int, typer.Option("--count", "-n", min=0, help="Number of items.")] = 10,
    seed: Annotated[
        int,
        typer.Option(
            "--seed",
            min=0,
            help="Item number k is drawn from the seed plus k; the same seed gives the same bytes.",
        ),
    ] = 1,
    product: Annotated[
        str | None,
        typer.Option(
            "--product",
            metavar="FAMILY",
            help="A family of products, with that family's defaults; left out: the scene's.",
        ),
    ] = None,
    calibration: Annotated[
        CalibrationImages,
        typer.Option(
            "--calibration",
            help="Calibration images; basic: block and empty belt, charuco: a board in poses too, all: "
            "everything.",
        ),
    ] = CalibrationImages.basic,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            help="Worker processes; the bytes are the same for any number; left out: all cores.",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a set that was stopped, or make it longer.")
    ] = False,
    sets: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change the scene, e.g. simulator.options.samples=5; may stand several times.",
        ),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Make a data set of stripe images whose answer is known, with its calibration images.

    The same scene, seed and count give the same bytes with any number of jobs. An item counts once its line
    stands in items.jsonl, so a set that was stopped holds no half item.
    """
    from roemetry.cli.progress import progress
    from roemetry.config.scene import Scene
    from roemetry.run.simulate import simulate as simulate_scene

    changes = list(sets or ())
    if product is not None:
        changes.append(f"simulator.options.product={{family: {product}}}")
    loaded = Scene.load(scene, sets=changes)
    with progress("simulating", quiet=False) as on_progress:
        made = simulate_scene(
            loaded,
            out,
            count=count,
            seed=seed,
            jobs=jobs or os.cpu_count() or 1,
            resume=resume,
            calibration=calibration.value,
            on_progress=on_progress,
        )
    were = f", {made.kept} of them were there" if made.kept else ""
    typer.echo(f"{made.folder}: {made.items} items{were}, {made.views} calibration images")
