"""``roemetry lint`` and ``roemetry simulate``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from roemetry.cli.options import cluster_option, executor_of, out_option, place, set_option

if TYPE_CHECKING:
    from roemetry.config.recipe import Recipe
    from roemetry.records import AcquisitionReference


def lint(
    file: Annotated[Path, typer.Argument(help="A recipe, a rig, calibration or scene file, or a data set.")],
    sets: Annotated[list[str] | None, set_option("Check the recipe or the rig with this change")] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Check a recipe, a rig, calibration or scene file, or a data set; run nothing."""
    from roemetry.config.overrides import Overridden
    from roemetry.config.recipe import Recipe
    from roemetry.config.rig import Rig
    from roemetry.errors import ConfigurationError
    from roemetry.io.yaml_source import read
    from roemetry.records.calibration import Calibration

    path = _within(file) if file.is_dir() else file
    data = read(path).data
    keys = data if isinstance(data, dict) else {}
    if "roemetry_calibration" in keys:
        calibration = Calibration.load(path)
        typer.echo(
            f"{path}: a calibration by {calibration.method} of {calibration.stripe_count} stripes: sound"
        )
    elif "roemetry_rig" in keys:
        rig = Rig.load(path, sets=sets or ())
        images = sum(len(paths) for paths in rig.images.values())
        typer.echo(f"{path}: a rig with {rig.file.stripes or 'no'} stripes and {images} images: sound")
    elif "roemetry" in keys:
        recipe = Recipe.load(path, sets=sets or ())
        references = recipe.references()
        _has_dark(recipe, references, Overridden(read(path), sets or ()).place(("source", "subtract")))
        found = len(references)
        stages = ", ".join(f"{kind} {chosen.registered.entry.name}" for kind, chosen in recipe.stages.items())
        typer.echo(f"{path}: a recipe for {recipe.product}: sound\n  {found} acquisitions; {stages}")
        if recipe.calibration is not None and "aligner" not in recipe.stages:
            typer.echo(_NO_ALIGNER)
    elif "roemetry_scene" in keys:
        _scene(path, sets or ())
    elif "roemetry_dataset" in keys:
        _dataset(path)
    else:
        raise ConfigurationError(
            f"{path}:1:1: neither a recipe (`roemetry: 1`), nor a rig (`roemetry_rig: 1`), nor a calibration "
            "(`roemetry_calibration: 1`), nor a scene (`roemetry_scene: 1`), nor a data set "
            "(`roemetry_dataset: 1`)",
            hint="the first key of the file says what it is",
        )


_NO_ALIGNER = (
    "  There is no aligner: a camera or a laser that has moved is not noticed, and volumes are then wrong.\n"
    "  Name one under stages.aligner; `roemetry plugins` lists them."
)


def _has_dark(recipe: Recipe, references: Sequence[AcquisitionReference], place: str) -> None:
    """Raise ConfigurationError where dark images are to be subtracted and one is missing."""
    from roemetry.errors import ConfigurationError

    if recipe.source_choice.subtract == "none":
        return
    without = [reference.id for reference in references if "dark" not in reference.files]
    if without:
        raise ConfigurationError(
            f"{place}: source.subtract: `dark`, but {len(without)} of {len(references)} acquisitions have no "
            f"dark image, the first is {without[0]}",
            hint="name the dark images in source.options.dark, or set source.subtract to none",
        )


def _within(folder: Path) -> Path:
    """Give the file that a folder is checked by: its recipe, else its data set, else its scene."""
    names = ("recipe.yaml", "dataset.yaml", "scene.yaml")
    return next((folder / name for name in names if (folder / name).exists()), folder / names[0])


def _scene(path: Path, sets: Sequence[str]) -> None:
    from roemetry.config.scene import Scene

    scene = Scene.load(path, sets=sets)
    scene.make()
    typer.echo(f"{path}: a scene for {scene.simulator.registered.entry.name}: sound")


def _dataset(path: Path) -> None:
    from roemetry.config.dataset import Dataset
    from roemetry.errors import DataError

    data = Dataset(path.parent)
    faults = 0
    for fault in data.faults():
        typer.echo(fault, err=True)
        faults += 1
    if faults:
        raise DataError(f"{path}: {faults} faults", hint="make the data set again, or restore its files")
    items = sum(1 for _ in data.items())
    typer.echo(f"{path}: a data set of {_many(items, 'item')}, {data.description.licence}: sound")


class CalibrationImages(StrEnum):
    """Which calibration images to make."""

    none = "none"
    basic = "basic"
    charuco = "charuco"
    all = "all"


def simulate(
    scene: Annotated[Path, typer.Argument(help="A scene file, or a folder with a scene.yaml in it.")],
    out: Annotated[Path, out_option("Folder of the data set, created if needed, or its URL.", parser=place)],
    count: Annotated[int, typer.Option("--count", "-n", min=0, help="Number of items.")] = 10,
    seed: Annotated[
        int,
        typer.Option(
            "--seed",
            min=0,
            help="Item number k is drawn from the seed plus k, unless the scene lists it with a seed of its "
            "own; the same seed gives the same bytes.",
        ),
    ] = 1,
    product: Annotated[
        str | None,
        typer.Option(
            "--product",
            metavar="FAMILY",
            help="A family of products, with that family's defaults; default: the scene's.",
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
            help="Worker processes; the bytes are the same for any number; default: all cores.",
        ),
    ] = None,
    cluster: Annotated[str | None, cluster_option()] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a set that was stopped, or make it longer.")
    ] = False,
    sets: Annotated[
        list[str] | None, set_option("Change the scene, e.g. simulator.options.samples=5")
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Simulate a data set of stripe images with known truth, and its calibration images.

    The same scene, seed and count give the same bytes with any number of jobs. An item counts once its line
    is in items.jsonl, so an interrupted set contains no half items.
    """
    from roemetry.cli.progress import COMPILING, progress
    from roemetry.cli.warm_up import warm_up
    from roemetry.config.scene import Scene
    from roemetry.errors import ConfigurationError
    from roemetry.io.remote import Url, folder_for
    from roemetry.run.simulate import simulate as simulate_scene

    changes = list(sets or ())
    if product is not None:
        changes.append(f"simulator.options.product={{family: {product}}}")
    loaded = Scene.load(scene if cluster is None else scene.absolute(), sets=changes)
    if cluster not in (None, "local") and isinstance(out, Url):
        raise ConfigurationError(
            f"{out}: the workers of {cluster} write the images, and need a folder that they share",
            hint="give --out a folder that all machines see",
        )
    if cluster is None:
        with progress(COMPILING, quiet=False) as on_progress:
            warm_up({"simulator": loaded.simulator}, on_progress)
    with folder_for(out) as folder, progress("simulating", quiet=False) as on_progress:
        made = simulate_scene(
            loaded,
            folder if cluster is None else folder.absolute(),
            count=count,
            seed=seed,
            executor=executor_of(cluster, jobs or os.cpu_count() or 1),
            resume=resume,
            calibration=calibration.value,
            on_progress=on_progress,
        )
    were = f", {made.kept} of them were there" if made.kept else ""
    items, views = _many(made.items, "item"), _many(made.views, "calibration image")
    typer.echo(f"{out}: {items}{were}, {views}")


def _many(count: int, thing: str) -> str:
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
