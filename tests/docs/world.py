"""The folder in which a reader of the pages stands: a clone, a line of their own, results of yesterday."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import numpy as np

from tests.command import typed

ROOT = Path(__file__).resolve().parents[2]
SKEINS = ("skein_01", "skein_02", "skein_03")


def make_world(folder: Path) -> None:
    """Make it: the shipped recipes with three images, and the same as a line of one's own."""
    home = ROOT / "recipes" / "herring_roe"
    unused = [f"skein_{number:02d}.*" for number in range(4, 11)]
    shutil.copytree(home, folder / "recipes" / "herring_roe", ignore=shutil.ignore_patterns(*unused))
    few = folder / "recipes" / "herring_roe" / "items.jsonl"
    few.write_text("".join(few.read_text("utf-8").splitlines(keepends=True)[: len(SKEINS)]), "utf-8")
    _fewer_pixels(folder / "recipes" / "herring_roe" / "scene.yaml")
    shutil.copytree(ROOT / "recipes" / "weld_groove", folder / "recipes" / "weld_groove")
    shutil.copytree(ROOT / "calib_targets", folder / "calib_targets")
    for own in (folder / "my-line", folder / "line"):
        shutil.copytree(folder / "recipes" / "herring_roe", own)
        for file in own.glob("*.yaml"):
            file.write_text(
                file.read_text("utf-8").replace("../../calib_targets", "../calib_targets"), "utf-8"
            )
    shutil.copytree(folder / "recipes" / "herring_roe", folder / "skeins")
    _beside(folder)


def _fewer_pixels(scene: Path) -> None:
    """Make the simulated camera's pixels four times as large: an image then takes a tenth of a second."""
    text = scene.read_text("utf-8")
    for old, new in (("width_px: 640", "width_px: 160"), ("height_px: 480", "height_px: 120")):
        assert old in text
        text = text.replace(old, new)
    size = re.search(r"pixel_size_um: ([\d.]+)", text)
    assert size is not None
    scene.write_text(text.replace(size.group(0), f"pixel_size_um: {4.0 * float(size.group(1))}"), "utf-8")


def _beside(folder: Path) -> None:
    """Put a recipe, its rig, images and tables into the folder itself, as the pages name them."""
    home = folder / "recipes" / "herring_roe"
    for name in ("recipe.yaml", "rig.yaml", "scene.yaml", "calibration.yaml"):
        text = (home / name).read_text("utf-8").replace("../../calib_targets", "calib_targets")
        (folder / name).write_text(text, "utf-8")
    shutil.copytree(home / "images", folder / "images")
    shutil.copytree(home / "images", folder / "images" / "today")
    shutil.copytree(home / "calibration", folder / "calibration")
    shutil.copy(home / "calibration" / "block.png", folder / "block.png")
    graded = zip(SKEINS, ("good", "dent", "twist"), strict=True)
    _write(folder / "labels.csv", [{"id": skein, "label": label} for skein, label in graded])
    for name in ("today", "monday"):
        typed("run", home, "--out", folder / "results" / name)


def multiply(folder: Path, rng: np.random.Generator) -> None:
    """Turn a run's few products into two dozen, each a little another one, as a day on a line would."""
    table = folder / "results.csv"
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    many = []
    for number in range(24):
        row = dict(rows[number % len(rows)])
        row["acquisition"] = f"product_{number + 1:02d}"
        row["id"] = f"{row['acquisition']}#1"
        for name, value in row.items():
            if name not in ("id", "acquisition", "product") and _is_number(value):
                row[name] = f"{float(value) * rng.normal(1.0, 0.05):.6g}"
        many.append(row)
    _write(table, many)
    volume = "visible volume (cm³)"
    _write(
        folder.parent.parent / "weighed.csv",
        [
            {"id": row["acquisition"], "mass_g": f"{float(row[volume]) * rng.normal(0.95, 0.02):.2f}"}
            for row in many
        ],
    )
    _write(
        folder.parent.parent / "labels.csv",
        [
            {"id": row["acquisition"], "label": "good" if number % 2 else "dent"}
            for number, row in enumerate(many)
        ],
    )


def scale(folder: Path) -> None:
    """Weigh the products of a run on a scale that agrees with it."""
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    weighed = [{"id": row["acquisition"], "mass_g": row["weight (g)"]} for row in rows]
    _write(folder.parent.parent / "scale.csv", weighed)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _write(path: Path, rows: list[dict[str, str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
