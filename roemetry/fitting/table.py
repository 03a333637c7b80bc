"""A table of products whose class is known, from a CSV file; every fault with its line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from roemetry.errors import DataError
from roemetry.fitting.cells import GROUP, LABEL, features_in, key_of, number_in, read_table, refuse
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
    key = key_of(path, header)
    known = None if labels is None else read_labels(labels)
    if known is None and LABEL not in header:
        raise DataError(
            f"{path}: there is no column `{LABEL}`", hint="add one, or name a file of labels with --labels"
        )
    features = features_in(header, rows)
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
        values = [number_in(row[name], f"{path}:{line}: {name}", faults) for name in features]
        taken.append((row[key].strip(), row.get(GROUP, row[key]).strip(), label, values))
    refuse(faults)
    _check(path, [sample[0] for sample in taken], [sample[2] for sample in taken])
    return Samples(
        ids=tuple(sample[0] for sample in taken),
        groups=tuple(sample[1] for sample in taken),
        features=tuple(features),
        values=np.array([sample[3] for sample in taken], np.float64).reshape(len(taken), len(features)),
        labels=tuple(sample[2] for sample in taken),
    )


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
