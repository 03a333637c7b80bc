"""A table of products whose class is known, from a CSV file; every fault with its line."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Samples

ID, LABEL, GROUP = "id", "label", "acquisition"
_NEVER_FEATURES = ("id", "label", "acquisition", "product", "status", "grade", "group", "reasons")
_NEVER_BEGIN = ("probability_", "truth_", "strangeness")
_FAULTS_SHOWN = 10


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
    header, rows = _read(path)
    key = _key(path, header)
    known = None if labels is None else _labels(labels)
    if known is None and LABEL not in header:
        raise DataError(
            f"{path}: there is no column `{LABEL}`", hint="add one, or name a file of labels with --labels"
        )
    features = _features(header, rows)
    if not features:
        raise DataError(
            f"{path}: there is no column of features",
            hint="make the table with `sinks: [{use: csv, options: {features: true}}]` and the classifier "
            "`shape-limits`",
        )
    taken: list[tuple[str, str, str, list[float]]] = []
    faults: list[str] = []
    for line, row in rows:
        label = row[LABEL].strip() if known is None else known.get(row[key].strip(), "")
        if not label:
            continue
        values = [_number(row[name], f"{path}:{line}: {name}", faults) for name in features]
        taken.append((row[key].strip(), row.get(GROUP, row[key]).strip(), label, values))
    if faults:
        more = len(faults) - _FAULTS_SHOWN
        raise ConfigurationError([*faults[:_FAULTS_SHOWN], *([f"and {more} more"] if more > 0 else [])])
    _check(path, [sample[0] for sample in taken], [sample[2] for sample in taken])
    return Samples(
        ids=tuple(sample[0] for sample in taken),
        groups=tuple(sample[1] for sample in taken),
        features=tuple(features),
        values=np.array([sample[3] for sample in taken], np.float64).reshape(len(taken), len(features)),
        labels=tuple(sample[2] for sample in taken),
    )


def _read(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
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


def _key(path: Path, header: Sequence[str]) -> str:
    for name in (ID, GROUP):
        if name in header:
            return name
    raise DataError(f"{path}: there is no column `{ID}`", hint=f"the columns are {', '.join(header)}")


def _labels(path: Path) -> Mapping[str, str]:
    header, rows = _read(path)
    key = _key(path, header)
    if LABEL not in header:
        raise DataError(f"{path}: there is no column `{LABEL}`", hint=f"the columns are {', '.join(header)}")
    found = {row[key].strip(): row[LABEL].strip() for _, row in rows}
    # A label of an acquisition goes for its one product, too.
    return {**{f"{name}#1": label for name, label in found.items() if "#" not in name}, **found}


def _features(header: Sequence[str], rows: Sequence[tuple[int, Mapping[str, str]]]) -> list[str]:
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


def _number(cell: str, where: str, faults: list[str]) -> float:
    if not cell.strip():
        return math.nan
    try:
        return float(cell)
    except ValueError:
        faults.append(f"{where}: found {cell!r}, expected a number (with a point, not a comma)")
        return math.nan


def _check(path: Path, ids: Sequence[str], labels: Sequence[str]) -> None:
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
