"""Tables of products whose class or mass is known, from CSV files; every fault with its line."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Samples


def read_samples(path: Path, labels: Path | None = None) -> Samples:
    """Read labelled products.

    Parameters
    ----------
    path
        A CSV file with a column `id` (or `acquisition`) and one column for each feature, as the `csv` sink
        writes it with ``features: true``; with a column `label` unless `labels` is given.
    labels
        A CSV file with `id` (or `acquisition`) and `label`; only products named there are taken.

    Raises
    ------
    DataError
        The file is missing, empty, or no table; a column is missing; no feature is there; a number cannot
        be read; a product stands there twice; labels that differ only in case or spaces.
    """
    header, rows = read_table(path)
    if labels is None and LABEL not in header:
        raise DataError(
            f"{path}: there is no column `{LABEL}`", hint="add one, or name a file of labels with --labels"
        )
    key = key_of(path, header)
    known = (
        {row[key].strip(): row[LABEL].strip() for _, row in rows} if labels is None else read_labels(labels)
    )
    known = {name: label for name, label in known.items() if label}
    common = _measured(path, header, rows, known, "classifier `shape-limits`")
    found = tuple(known[name] for name in common["ids"])
    _check_names(path, common["ids"], found)
    return Samples(**common, labels=found)


def read_labels(path: Path) -> Mapping[str, str]:
    """Read classes by product, ``acquisition#1``, and by acquisition, which stands for its one product.

    Raises
    ------
    DataError
        The file is missing, empty, or no table; the column `label` is missing; a product stands there twice.
    """
    header, rows = read_table(path)
    key = key_of(path, header)
    if LABEL not in header:
        raise DataError(f"{path}: there is no column `{LABEL}`", hint=f"the columns are {', '.join(header)}")
    found: dict[str, str] = {}
    for line, row in rows:
        name = row[key].strip()
        if name in found:
            raise DataError(f"{path}:{line}: {name} stands there a second time", hint="one line a product")
        found[name] = row[LABEL].strip()
    # A label of an acquisition goes for its one product, too.
    return {**{f"{name}#1": label for name, label in found.items() if "#" not in name}, **found}


def _check_names(path: Path, ids: Sequence[str], labels: Sequence[str]) -> None:
    if not ids:
        raise DataError(f"{path}: no product has a label", hint="do the ids of table and labels agree?")
    twice = sorted({name for name in ids if ids.count(name) > 1})
    if twice:
        raise DataError(
            f"{path}: {twice[0]} stands there {ids.count(twice[0])} times", hint="one line a product"
        )
    alike: dict[str, set[str]] = {}
    for label in labels:
        alike.setdefault("".join(label.lower().split()), set()).add(label)
    for spellings in alike.values():
        if len(spellings) > 1:
            raise DataError(
                f"{path}: the labels {' and '.join(f'`{name}`' for name in sorted(spellings))} differ in "
                "spelling only",
                hint="write one class one way",
            )


class Weighed(NamedTuple):
    """What a scale said of a product: mass and its standard uncertainty (NaN: not stated), grams."""

    mass_g: float
    std_g: float


def read_weights(path: Path) -> Mapping[str, Weighed]:
    """Read what a scale said.

    Parameters
    ----------
    path
        A CSV file with `id` (or `acquisition`) and `mass_g`, optionally `mass_std_g`; a line a product. Lines
        without a mass are products that were not weighed.

    Returns
    -------
    Mapping
        By id; an acquisition's mass goes for its product 1, too.

    Raises
    ------
    DataError, ConfigurationError
        The file is missing, empty, or no table; a column is missing; a mass is no positive number; a
        product stands there twice; nothing is weighed.
    """
    header, rows = read_table(path)
    key = key_of(path, header)
    if MASS not in header:
        raise DataError(
            f"{path}: there is no column `{MASS}`",
            hint=f"the columns are {', '.join(header)}; weights are in grams, and the name says so",
        )
    found: dict[str, Weighed] = {}
    faults: list[str] = []
    for line, row in rows:
        mass = number_in(row[MASS], f"{path}:{line}: {MASS}", faults)
        std = number_in(row.get(MASS_STD, ""), f"{path}:{line}: {MASS_STD}", faults)
        if math.isnan(mass):
            continue
        name = row[key].strip()
        if not 0.0 < mass < math.inf:
            faults.append(f"{path}:{line}: {MASS}: found {row[MASS].strip()}, expected a mass above 0")
        if name in found:
            faults.append(f"{path}:{line}: {name} stands there a second time; one line a product")
        found[name] = Weighed(mass, std)
    refuse(faults)
    if not found:
        raise DataError(f"{path}: no product has a mass", hint=f"fill in the column `{MASS}`, in grams")
    return {**{f"{name}#1": one for name, one in found.items() if "#" not in name}, **found}


def read_weighed(path: Path, weights: Path | None = None) -> Samples:
    """Read weighed products with what was measured of them.

    Parameters
    ----------
    path
        A CSV file as the `csv` sink writes it with ``features: true``, with a column `mass_g` unless
        `weights` is given.
    weights
        What a scale said; see `read_weights`.

    Raises
    ------
    DataError, ConfigurationError
        As `read_weights`; no measured product has a mass; there are no features.
    """
    known = read_weights(path if weights is None else weights)
    header, rows = read_table(path)
    common = _measured(path, header, rows, known, "weigher `fitted`")
    if not common["ids"]:
        raise DataError(
            f"{path}: none of its products was weighed: the ids of the two tables do not meet",
            hint=f"a product here is called {rows[0][1][key_of(path, header)]!r}, "
            f"there {next(iter(known))!r}",
        )
    found = [known[name] for name in common["ids"]]
    return Samples(
        **common,
        mass_g=np.array([one.mass_g for one in found]),
        mass_std_g=np.array([one.std_g for one in found]),
    )


def _measured(
    path: Path, header: Sequence[str], rows: Rows, known: Mapping[str, object], stage: str
) -> dict[str, Any]:
    """Give ids, groups, features and values of the products that something is known of.

    Products of one `group` (without such a column: one acquisition) are never on both sides of a fold.
    `stage` measures features.
    """
    key, features = key_of(path, header), features_in(header, rows)
    if not features:
        raise DataError(
            f"{path}: there is no column of features",
            hint=f"make the table with `sinks: [{{use: csv, options: {{features: true}}}}]` and the {stage}",
        )
    group = "group" if "group" in header else GROUP if GROUP in header else key
    taken = [(line, row) for line, row in rows if row[key].strip() in known]
    faults: list[str] = []
    values = [
        [number_in(row[name], f"{path}:{line}: {name}", faults) for name in features] for line, row in taken
    ]
    refuse(faults)
    return {
        "ids": tuple(row[key].strip() for _, row in taken),
        "groups": tuple(row[group].strip() for _, row in taken),
        "features": tuple(features),
        "values": np.array(values, np.float64).reshape(len(taken), len(features)),
    }


ID, LABEL, GROUP = "id", "label", "acquisition"
MASS, MASS_STD = "mass_g", "mass_std_g"
_NEVER_FEATURES = (
    *(ID, LABEL, GROUP, MASS, MASS_STD),
    *("product", "status", "grade", "decision", "lane", "group", "peaks", "reasons"),
)
"""Columns of the `csv` sink that may hold numbers and are no feature, and those that people add."""

_NEVER_BEGIN = ("probability_", "truth_", "novelty", "strangeness")
_FAULTS_SHOWN = 10  # of a table: more at once nobody reads


Rows = Sequence[tuple[int, Mapping[str, str]]]
"""Lines of a table, each with its number and its cells by column."""


def read_table(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Give the names of the columns, and each row with its line; raise DataError where that is no table."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, strict=True)
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


def features_in(header: Sequence[str], rows: Rows) -> list[str]:
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
