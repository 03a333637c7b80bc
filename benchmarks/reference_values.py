"""What the shipped recipe gives on its first three skeins, for `roemetry doctor` to compare with.

``python -m benchmarks reference_values`` writes ``recipes/herring_roe/reference_values.csv`` again. Run it
when the recipe or an algorithm in it changes, and look at the difference.
"""

from __future__ import annotations

import csv
from pathlib import Path

from roemetry import Recipe
from roemetry_tools.doctor import COLUMNS, REFERENCE_VALUES, rows_of

FOLDER = Path("recipes/herring_roe")
SKEINS = ("skein_01", "skein_02", "skein_03")


def main() -> None:
    """Measure, and write the file."""
    rows: dict[str, tuple[float, float, float, str]] = {}
    for name in SKEINS:
        rows |= rows_of(Recipe.load(FOLDER, sets=[f"source.path={FOLDER / 'images' / f'{name}.png'}"]))
    with (FOLDER / REFERENCE_VALUES).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for name, (*numbers, grade) in rows.items():
            writer.writerow([name, *(f"{number:.6g}" for number in numbers), grade])
    print((FOLDER / REFERENCE_VALUES).read_text("utf-8"))
