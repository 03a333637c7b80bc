"""The product lines that come with roemetry: where they lie, and what of them is copied."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from pathlib import Path

from roemetry.errors import ConfigurationError

COPIED = ("recipe.yaml", "rig.yaml", "scene.yaml", "calibration.yaml")
"""What a line's folder must hold to be begun from."""

_SHARED_TARGET = re.compile(r"\.\./\.\./calib_targets/([\w.-]+)")


def shipped_lines() -> dict[str, Path]:
    """Give the folders of the lines by name: in the installed package, or in the checkout."""
    import roemetry

    package = Path(roemetry.__file__).parent
    folders = (package / "recipes", package.parent / "recipes")
    home = next((folder for folder in folders if folder.is_dir()), folders[0])
    return {
        folder.name: folder
        for folder in sorted(home.glob("*"))
        if all((folder / name).is_file() for name in COPIED)
    }


def line_of(name: str) -> Path:
    """Find a line by name; raise ConfigurationError with a close match."""
    lines = shipped_lines()
    plain = name.strip().lower().replace("-", "_").replace(" ", "_")
    if plain in lines:
        return lines[plain]
    close = difflib.get_close_matches(plain, lines, n=1, cutoff=0.5)
    mean = f"did you mean `{close[0]}`?; " if close else ""
    raise ConfigurationError(
        f"--like: there is no product line `{name}`", hint=f"{mean}there are {', '.join(lines)}"
    )


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
