"""Golden records: what every shipped recipe says today, so that moved code can be shown to say the same.

``python -m benchmarks golden --write`` measures anew and writes ``tests/golden/RECIPE.json``; without
``--write`` it compares and prints what differs. Write them anew only when numbers are meant to change, and
look at the difference.

Each recipe measures its first `IMAGES` images without uncertainties; those that ask for them, their first
image in the recipe's way and by `DRAWS` Monte Carlo draws as well. Kept is the whole line of the record but
hashes, versions and the areas of single slices: values, budgets, labels, grades, reasons. Nothing in it is a
time or a path.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.command import parser_of
from roemetry import Recipe
from roemetry.run.pipeline import Pipeline
from roemetry.run.rows import measurements_of

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = ROOT / "tests" / "golden"
RECIPES = (
    "belt_scan/height_map", "belt_scan/recipe", "bread_roll/recipe", "egg/recipe", "fish_fillet/recipe",
    "herring_roe/by_words", "herring_roe/recipe", "herring_roe/with_outline", "potato/recipe",
    "potato_circles/recipe", "potato_dots/recipe", "potato_grid/recipe", "potato_two_colours/recipe",
    "weld_groove/recipe",
)  # fmt: skip
IMAGES = 4
"""Of a recipe's images: what moves a number moves it in the first few, and the files stay small."""
DRAWS = 4
RELATIVE = 1e-7
"""Largest relative difference: libraries of linear algebra differ by 1e-12, a changed rule by far more."""
ABSOLUTE = 1e-9
"""For values that are zero but for rounding, in the value's own unit."""


def main() -> None:
    """Compare, or write."""
    parser = parser_of(__doc__)
    parser.add_argument("--write", action="store_true", help="take what is measured now for right")
    parser.add_argument(
        "--images", type=int, choices=range(1, IMAGES + 1),
        help="compare only so many of each recipe's images, without uncertainties",
    )  # fmt: skip
    given = parser.parse_args()
    if given.write and given.images:
        parser.error("--images does not go with --write: a record holds all images")
    different = 0
    for name in RECIPES:
        found = records(name) if given.images is None else first_lines(name, given.images)
        if given.write:
            GOLDEN.mkdir(exist_ok=True)
            file_of(name).write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
            continue
        expected = json.loads(file_of(name).read_text("utf-8"))
        for line in differences(expected if given.images is None else expected[: len(found)], found, name):
            print(line)
            different += 1
    if different:
        sys.exit(f"{different} values differ")


def file_of(name: str) -> Path:
    """Give the file that keeps a recipe's records."""
    return GOLDEN / f"{name.replace('/', '-')}.json"


def records(name: str) -> list[dict[str, Any]]:
    """Measure a shipped recipe's images."""
    path = ROOT / "recipes" / f"{name}.yaml"
    found = first_lines(name, IMAGES)
    own = Recipe.load(path, sets=["sinks=[]"])
    if own.uncertainty != "none":
        found += _lines(own, 1)
        found += _lines(Recipe.load(path, sets=[f"draws={DRAWS}", "sinks=[]"]), 1)
    return found


def first_lines(name: str, images: int) -> list[dict[str, Any]]:
    """Measure a shipped recipe's first images without uncertainties."""
    path = ROOT / "recipes" / f"{name}.yaml"
    return list(_lines(Recipe.load(path, sets=["draws=0", "sinks=[]"]), images))


def _lines(recipe: Recipe, count: int) -> Iterator[dict[str, Any]]:
    source, pipeline = recipe.source.make(), Pipeline(recipe)
    for reference in islice(source.references(recipe.source_path), count):
        trace = pipeline.trace(source.read(reference))
        for row in measurements_of(trace, recipe, {}):
            line = json.loads(row.to_json())
            line["uncertainty"], line["draws"] = recipe.uncertainty, recipe.draws
            if line["volume"]:
                del line["volume"]["slices"]
            yield line


def differences(expected: Any, found: Any, where: str) -> Iterator[str]:
    """Say where two records differ."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for key in sorted(expected.keys() | found.keys()):
            if key not in expected or key not in found:
                yield f"{where}.{key}: only {'found' if key in found else 'expected'}"
            else:
                yield from differences(expected[key], found[key], f"{where}.{key}")
    elif isinstance(expected, list) and isinstance(found, list):
        if len(expected) != len(found):
            yield f"{where}: {len(found)} entries, expected {len(expected)}"
        for k, (a, b) in enumerate(zip(expected, found, strict=False)):
            yield from differences(a, b, f"{where}[{k}]")
    elif _number(expected) and _number(found):
        if not math.isclose(expected, found, rel_tol=RELATIVE, abs_tol=ABSOLUTE):
            yield f"{where}: {found!r}, expected {expected!r}"
    elif expected != found:
        yield f"{where}: {found!r}, expected {expected!r}"


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
