"""Cells of a CSV table of products: rows with their lines, columns of features, numbers."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from roemetry.errors import ConfigurationError, DataError

ID, LABEL, GROUP = "id", "label", "acquisition"
MASS, MASS_STD = "mass_g", "mass_std_g"
_NEVER_FEATURES = (
    *(ID, LABEL, GROUP, MASS, MASS_STD),
    *("product", "status", "grade", "decision", "lane", "group", "peaks", "reasons"),
)
"""Columns of the `csv` sink that may hold numbers and are no feature, and those that people add."""

_NEVER_BEGIN = ("probability_", "truth_", "novelty", "strangeness")
_FAULTS_SHOWN = 10


def read_table(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Give the names of the columns, and each row with its line; raise DataError where that is no table."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            header = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = header
            rows = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read: {error}", hint="a CSV file in UTF-8 is expected") from error
    if not header or not rows:
        raise DataError(f"{path}: the table is empty", hint="it needs a line of names and a line a product")
    for line, row in rows:
        if None in row or None in row.values():
            raise DataError(
                f"{path}:{line}: this line has another number of cells than the first",
                hint="a comma too many or too few? texts with commas need quotes",
            )
    return header, rows


def key_of(path: Path, header: Sequence[str]) -> str:
    """Name the column that says which product a row is of; raise DataError where there is none."""
    for name in (ID, GROUP):
        if name in header:
            return name
    raise DataError(f"{path}: there is no column `{ID}`", hint=f"the columns are {', '.join(header)}")


def features_in(header: Sequence[str], rows: Sequence[tuple[int, Mapping[str, str]]]) -> list[str]:
    """Columns that hold numbers in most lines, and are nobody's answer."""
    found = []
    for name in header:
        if name in _NEVER_FEATURES or name.startswith(_NEVER_BEGIN) or "(" in name or " " in name:
            continue
        cells = [row[name].strip() for _, row in rows]
        if sum(_is_number(cell) for cell in cells) > len(cells) / 2:
            found.append(name)
    return found


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def number_in(cell: str, where: str, faults: list[str]) -> float:
    """Give a cell's number, NaN for an empty one; what is none is noted among the faults."""
    if not cell.strip():
        return math.nan
    try:
        return float(cell)
    except ValueError:
        faults.append(f"{where}: found {cell!r}, expected a number (with a point, not a comma)")
        return math.nan


def refuse(faults: Sequence[str]) -> None:
    """Raise ConfigurationError with the first of the faults, if there are any."""
    if faults:
        more = len(faults) - _FAULTS_SHOWN
        raise ConfigurationError([*faults[:_FAULTS_SHOWN], *([f"and {more} more"] if more > 0 else [])])
