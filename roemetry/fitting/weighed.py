"""A table of weighed products, from CSV files; every fault with its line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roemetry.errors import DataError
from roemetry.fitting.cells import (
    GROUP,
    MASS,
    MASS_STD,
    features_in,
    key_of,
    number_in,
    read_table,
    refuse,
)
from roemetry.records import Samples


class Weighed(NamedTuple):
    """What a scale said of a product: mass and its standard uncertainty (NaN: not stated), grams."""

    mass_g: float
    std_g: float


def read_weights(path: Path) -> Mapping[str, Weighed]:
    """Read what a scale said.

    Parameters
    ----------
    path
        A CSV file with `id` (or `acquisition`) and `mass_g`, maybe `mass_std_g`; a line a product. Lines
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
        `weights` is given. Products of one `group` (without such a column: one acquisition) are never on
        both sides of a fold.
    weights
        What a scale said; see `read_weights`.

    Raises
    ------
    DataError, ConfigurationError
        As `read_weights`; no measured product has a mass; there are no features.
    """
    known = read_weights(path if weights is None else weights)
    header, rows = read_table(path)
    key = key_of(path, header)
    features = features_in(header, rows)
    group = "group" if "group" in header else GROUP if GROUP in header else key
    faults: list[str] = []
    taken = [
        (
            row[key].strip(),
            row[group].strip(),
            known[row[key].strip()],
            [number_in(row[name], f"{path}:{line}: {name}", faults) for name in features],
        )
        for line, row in rows
        if row[key].strip() in known
    ]
    refuse(faults)
    if not taken:
        raise DataError(
            f"{path}: none of its products was weighed: the ids of the two tables do not meet",
            hint=f"a product here is called {rows[0][1][key]!r}, there {next(iter(known))!r}",
        )
    if not features:
        raise DataError(
            f"{path}: there is no column of features",
            hint="make the table with `sinks: [{use: csv, options: {features: true}}]` and the weigher "
            "`fitted`",
        )
    return Samples(
        ids=tuple(one[0] for one in taken),
        groups=tuple(one[1] for one in taken),
        features=tuple(features),
        values=np.array([one[3] for one in taken], np.float64).reshape(len(taken), len(features)),
        mass_g=np.array([one[2].mass_g for one in taken]),
        mass_std_g=np.array([one[2].std_g for one in taken]),
    )
