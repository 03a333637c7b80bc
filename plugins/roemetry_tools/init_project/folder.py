"""The folder that `roemetry init` writes: files, a few simulated products, a calibration."""

from __future__ import annotations

import json
import re
import shutil
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from roemetry.errors import OutputError
from roemetry.io.files import make_folder, write_whole
from roemetry_tools.init_project.answers import Answers, Layout, lay_out
from roemetry_tools.init_project.product_lines import copied, line_of

_SEED = 1
_DATA = "data"


@dataclass(frozen=True, slots=True)
class Started:
    """What was begun.

    Attributes
    ----------
    folder
        Where.
    files
        What was written, without the images.
    items
        How many simulated acquisitions there are to try it on.
    layout
        The rig of an own product; None where a shipped line was copied.
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
    on_progress: Callable[[int, int], None] = lambda done, of: None,
) -> Started:
    """Begin from a shipped line: its recipe, rig, calibration and scene, and products drawn anew.

    Parameters
    ----------
    name
        The line's, see `shipped_lines`.
    folder
        Empty, or not there yet.
    items
        Simulated acquisitions to make.
    jobs
        Processes to make them with.
    on_progress
        Called with (images done, of how many).

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
        _simulate(folder, items, "none", jobs, on_progress)
    return Started(folder, written, items, None)


def start_own(
    answers: Answers,
    folder: Path,
    *,
    items: int = 3,
    jobs: int = 1,
    on_progress: Callable[[int, int], None] = lambda done, of: None,
) -> Started:
    """Begin with an own product: a rig that can measure it, products like it, and a calibration of that rig.

    Parameters and errors as of `start_like`; ConfigurationError where no such rig measures the product.
    """
    layout = lay_out(answers)
    _check_empty(folder)
    with _all_or_nothing(folder):
        written = _write(folder, texts_of(answers, layout, items))
        _simulate(folder, items, "charuco", jobs, on_progress)
        written = (*written, _calibrate(folder))
    return Started(folder, written, items, layout)


def texts_of(answers: Answers, layout: Layout, items: int) -> dict[str, str]:
    """Give the files of an own product by name."""
    told = {"answers": asdict(answers), "rig": asdict(layout), "alike": _alike(answers), "items": items}
    return {
        name: _text(f"{name}.j2", **told) for name in ("scene.yaml", "rig.yaml", "recipe.yaml", "README.md")
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


def _simulate(
    folder: Path, items: int, views: Any, jobs: int, on_progress: Callable[[int, int], None]
) -> None:
    from roemetry.config.scene import Scene
    from roemetry.run.simulate import simulate

    scene = Scene.load(folder)
    simulate(
        scene,
        folder / _DATA,
        count=items,
        seed=_SEED,
        jobs=jobs,
        calibration=views,
        on_progress=on_progress,
    )


def _calibrate(folder: Path) -> Path:
    from roemetry.calibrating import calibrate, default_path
    from roemetry.config.rig import Rig

    rig = Rig.load(folder / "rig.yaml")
    path = default_path(rig)
    calibrate(rig).save(path)
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
    environment.filters |= {"quoted": _quoted, "number": "{:g}".format}
    return environment.get_template(template).render(**told)


def _quoted(text: str) -> str:
    """Write a text as YAML reads it whatever it holds."""
    return json.dumps(text, ensure_ascii=False)
