"""A folder to begin with: a shipped product line's, or one for an own product and an own rig.

It holds recipe, rig, calibration and a few simulated products to try them on.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roemetry.cli.progress import COMPILING, Move
from roemetry.cli.warm_up import warm_up
from roemetry.errors import ConfigurationError, OutputError, did_you_mean
from roemetry.io.files import make_folder, shipped, write_whole
from roemetry_tools.init_project.layout import Answers, Layout, lay_out

if TYPE_CHECKING:
    from roemetry.config.scene import Scene
    from roemetry.run.pace import OnProgress

_SEED = 1  # any: the same folder each time
_DATA = "data"
_BOARDS = "simulating calibration images"


Step = Callable[[str], AbstractContextManager[Move]]


def _silent(_: str) -> AbstractContextManager[Move]:
    return nullcontext(lambda done, of, left_s=math.nan, /: None)


@dataclass(frozen=True, slots=True)
class NewProject:
    """What was begun: files without the images, and how many simulated acquisitions to try it on.

    `layout` is the rig of an own product; None where a shipped line was copied.
    """

    folder: Path
    files: tuple[Path, ...]
    items: int
    layout: Layout | None


def start_like(
    name: str,
    folder: Path,
    *,
    items: int = 3,
    jobs: int = 1,
    step: Step = _silent,
) -> NewProject:
    """Begin from a shipped line: its recipe, rig, calibration and scene, and products drawn anew.

    The folder must be empty or not there yet. `step` is entered with the name of each step that takes time,
    and gives what is called with (steps done, of how many, the time left, s).

    Raises
    ------
    ConfigurationError
        There is no such line.
    OutputError
        The folder holds something, or cannot be written.
    """
    line = line_of(name)
    _check_empty(folder)
    texts = dict(copied(line))
    boards = "board:" in texts["rig.yaml"]
    texts["README.md"] = _text(
        "like.md.j2", line=line.name, items=items, views="charuco" if boards else "basic", boards=boards
    )
    with _all_or_nothing(folder):
        written = _write(folder, texts)
        scene = _compiled(folder, step)
        with step("simulating products") as shown:
            _simulate(scene, folder, items, "none", jobs, shown)
    return NewProject(folder, written, items, None)


def start_own(
    answers: Answers,
    folder: Path,
    *,
    items: int = 3,
    jobs: int = 1,
    step: Step = _silent,
    tell: Callable[[str], None] = lambda said: None,
) -> NewProject:
    """Begin with an own product: a rig that can measure it, products like it, and a calibration of that rig.

    Parameters and errors as of `start_like`; ConfigurationError where no such rig measures the product.
    `tell` is called with what can be looked at before all is done.
    """
    layout = lay_out(answers)
    _check_empty(folder)
    with _all_or_nothing(folder):
        written = _write(folder, texts_of(answers, layout, items))
        scene = _compiled(folder, step)
        with ExitStack() as bar:
            shown = bar.enter_context(step("simulating products" if items else _BOARDS))

            def on_progress(done: int, of: int, left_s: float) -> None:
                nonlocal shown
                if done == items > 0:
                    bar.close()
                    tell(f"to look at already: {folder / _DATA / 'images'}")
                    shown = bar.enter_context(step(_BOARDS))
                # the time is that of all images, whichever bar is shown
                shown(*((done, items) if done < items else (done - items, of - items)), left_s)

            _simulate(scene, folder, items, "charuco", jobs, on_progress)
        with step("calibrating") as shown:
            written = (*written, _calibrate(folder, shown))
    return NewProject(folder, written, items, layout)


def texts_of(answers: Answers, layout: Layout, items: int) -> dict[str, str]:
    """Give the files of an own product by name."""
    told = {"answers": asdict(answers), "rig": asdict(layout), "alike": _alike(answers), "items": items}
    return {
        name: _text(f"{name}.j2", **told)
        for name in ("scene.yaml", "rig.yaml", "board.yaml", "block.yaml", "recipe.yaml", "README.md")
    }


def _alike(answers: Answers) -> dict[str, Any]:
    """Name the simulator's family whose proportions the product has, and what goes under its images."""
    length, width, height = answers.size_mm
    letters = unicodedata.normalize("NFKD", answers.product.casefold())
    plain = "".join(letter for letter in letters if not unicodedata.combining(letter))
    item = re.sub(r"[^a-z0-9]+", "_", plain).strip("_") or "product"
    flat = height / width
    family = "fillet" if flat <= 0.45 else "bread-roll" if flat <= 0.7 else "potato"
    narrow = {"fillet": 0.7 * length, "bread-roll": length, "potato": 0.9 * length}[family]
    return {
        "family": family,
        "item": item,
        "ranges": [(round(0.85 * side, 1), side) for side in (length, min(width, narrow), height)],
    }


def _check_empty(folder: Path) -> None:
    if folder.is_file():
        raise OutputError(f"{folder}: is a file; expected a folder that is empty or not there yet")
    if folder.is_dir() and (found := sorted(path.name for path in folder.iterdir())):
        raise OutputError(
            f"{folder}: the folder is not empty ({', '.join(found[:3])}{' …' if len(found) > 3 else ''}); "
            "nothing is overwritten",
            hint="name another folder",
        )


@contextmanager
def _all_or_nothing(folder: Path) -> Iterator[None]:
    """Empty the folder again when its writing comes to no end: half of it would only be in the way."""
    there = folder.is_dir()
    try:
        yield
    except BaseException:
        if folder.is_dir():
            for path in folder.iterdir():
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
            if not there:
                folder.rmdir()
        raise


def _write(folder: Path, texts: Mapping[str, str]) -> tuple[Path, ...]:
    make_folder(folder)
    for name, text in texts.items():
        write_whole(folder / name, text)
    return tuple(folder / name for name in texts)


def _simulate(scene: Scene, folder: Path, items: int, views: Any, jobs: int, on_progress: OnProgress) -> None:
    from roemetry.run.simulate import simulate

    given: dict[str, Any] = {"count": items, "seed": _SEED, "jobs": jobs, "calibration": views}
    simulate(scene, folder / _DATA, **given, on_progress=on_progress)


def _compiled(folder: Path, step: Step) -> Scene:
    """Load the scene of a folder, and compile what its simulator needs under a bar of its own."""
    from roemetry.config.scene import Scene

    scene = Scene.load(folder)
    with step(COMPILING) as shown:
        warm_up({"simulator": scene.simulator}, shown)
    return scene


def _calibrate(folder: Path, on_progress: OnProgress) -> Path:
    from roemetry.calibrating import calibrate, default_path
    from roemetry.config.rig import Rig

    rig = Rig.load(folder / "rig.yaml")
    path = default_path(rig)
    calibrate(rig, on_progress=on_progress).save(path)
    return path


def _text(template: str, **told: Any) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("roemetry_tools.init_project", "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    # JSON's quotes: YAML reads them whatever the text holds
    environment.filters |= {"quoted": partial(json.dumps, ensure_ascii=False), "number": "{:g}".format}
    return environment.get_template(template).render(**told)


COPIED = ("recipe.yaml", "rig.yaml", "scene.yaml", "calibration.yaml")
"""What a line's folder must hold to be begun from."""

_SHARED_TARGET = re.compile(r"\.\./\.\./calib_targets/([\w.-]+)")


def shipped_lines() -> dict[str, Path]:
    """Give the folders of the lines by name: in the installed package, or in the checkout."""
    return {
        folder.name: folder
        for folder in sorted(shipped("recipes").glob("*"))
        if all((folder / name).is_file() for name in COPIED)
    }


def line_of(name: str) -> Path:
    """Find a line by name; raise ConfigurationError with a close match."""
    lines = shipped_lines()
    plain = name.strip().lower().replace("-", "_").replace(" ", "_")
    if plain in lines:
        return lines[plain]
    meant = did_you_mean(plain, lines, cutoff=0.5)
    hint = "; ".join([*([meant] if meant else []), f"there are {', '.join(lines)}"])
    raise ConfigurationError(f"--like: there is no product line `{name}`", hint=hint)


def copied(line: Path) -> Mapping[str, str]:
    """Give the texts of a line by file name, with paths that hold in a folder with its images in ``data``.

    A target that lines share lies in ``calib_targets``; it is laid beside the rig.
    """
    texts = {name: (line / name).read_text("utf-8") for name in COPIED}
    tables = sorted([*line.glob("*.csv"), *line.glob("*.json")])
    texts |= {path.name: path.read_text("utf-8") for path in tables if path.name in texts["recipe.yaml"]}
    shared = line.parent.parent / "calib_targets"
    for name in set(_SHARED_TARGET.findall(texts["rig.yaml"])):
        texts[name] = (shared / name).read_text("utf-8")
    texts["rig.yaml"] = _SHARED_TARGET.sub(r"\1", texts["rig.yaml"])
    # The first line keeps its images beside its recipe, the others in `data`.
    texts["rig.yaml"] = texts["rig.yaml"].replace("[calibration/", "[data/calibration/")
    texts["recipe.yaml"] = re.sub(r"(?m)^(  path: )images$", r"\1data/images", texts["recipe.yaml"])
    here = re.compile(rf"recipes/{line.name}(?=[\s/]|$)")
    return {name: here.sub(".", text) for name, text in texts.items()}
