"""The readings of a study: a table (CSV) of parts, operators and trials, or rows of runs with a layout.

A reading belongs to a part (the thing measured), an operator (a person, or a measuring head) and a trial. Its
value is a number with its unit in the column's name, or a class. What would make any statistic meaningless is
refused here: a cell that is no number, one image counted twice, values of mixed units.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roemetry.calibrating.known_products import read_table as read_csv
from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Estimate, Measurement
from roemetry.records.arrays import Floats
from roemetry.run.record import RECORD, read_record

MIXED_UNITS_RATIO = 8.0
"""Median of one operator's values over another's on the same parts above which their units differ: the
closest two units of one quantity in use, ounce and gram, are 28 apart, inch and centimetre 2.54; a gauge that
is off by this factor needs no study."""

RECORDED = ("visible_cm3", "true_cm3", "mass_g", "height_max_mm", "grade")
"""Values of a run's rows that a study may take, beside any feature of its grade by name."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One reading of one part."""

    part: str
    operator: str
    trial: str
    value: str
    """As written; a number where the study is of numbers."""
    place: str
    """Where it was read, for messages: file and line, or a row of a run."""
    reference: str = ""
    """The part's reference value or class; "" where unknown."""
    std: float = math.nan
    """Standard uncertainty that was stated with it; NaN where not."""
    moment: str = ""
    """When it was taken; orders a stability study."""


@dataclass(frozen=True, slots=True)
class StudyTable:
    """All readings of a study, of one value."""

    readings: tuple[Reading, ...]
    value: str
    """Name of the value, its unit in the name."""
    source: str

    @property
    def parts(self) -> tuple[str, ...]:
        """Each part once, in order."""
        return tuple(dict.fromkeys(reading.part for reading in self.readings))

    @property
    def operators(self) -> tuple[str, ...]:
        """Each operator once, in order."""
        return tuple(dict.fromkeys(reading.operator for reading in self.readings))

    def is_numeric(self) -> bool:
        """Whether every reading is a number, so that a study of variances can be made."""
        return all(_number(reading.value) is not None for reading in self.readings)

    def numbers(self) -> Floats:
        """(reading,) the values; DataError names the first that is no number."""
        return np.array([self._finite(reading.value, reading.place, self.value) for reading in self.readings])

    def references(self) -> Mapping[str, float]:
        """Reference value of each part that has one; DataError where two readings give a part two."""
        found: dict[str, float] = {}
        for reading in self.readings:
            if not reading.reference:
                continue
            value = self._finite(reading.reference, reading.place, "reference")
            if found.setdefault(reading.part, value) != value:
                raise DataError(
                    f"{reading.place}: part {reading.part} has the reference {value:g} here and "
                    f"{found[reading.part]:g} before",
                    hint="a part has one reference value",
                )
        return found

    @staticmethod
    def _finite(text: str, place: str, name: str) -> float:
        value = _number(text)
        if value is None:
            raise DataError(f"{place}: {name}: found {text!r}, expected a number")
        return value


def read_table(
    sources: Sequence[Path], value: str, layout: Path | None = None, operator: str = "operator"
) -> StudyTable:
    """Read the readings of a study.

    Parameters
    ----------
    sources
        One table (CSV) with the columns ``part`` and `value`, optionally `operator`, ``trial``,
        ``reference``, ``std``, ``time``, ``image_sha256``; or folders of runs.
    value
        Column, value of a run's rows (`RECORDED`), or a feature's name.
    layout
        For runs: a table that says of each ``id`` (or ``acquisition``) which part, operator and trial it is,
        with a column ``run`` where one id stands in several runs.
    operator
        Column of whoever or whatever measured: ``operator``, ``head``, …

    Raises
    ------
    DataError
        A cell is no number, one image or one place of the plan is counted twice, units are mixed, or nothing
        is left.
    ConfigurationError
        A column is missing.
    """
    runs = [source for source in sources if source.is_dir()]
    if runs and len(runs) < len(sources):
        raise ConfigurationError("tables and runs together", hint="name one table, or runs with --layout")
    if runs and layout is None:
        raise ConfigurationError(
            f"{runs[0]} is a run: which part, operator and trial each row is, is not said",
            hint="name a table of id, part, operator and trial with --layout",
        )
    if not runs and len(sources) != 1:
        raise ConfigurationError(f"{len(sources)} tables were named, expected one")
    if layout is not None and runs:
        found = list(_of_runs(runs, value, layout, operator))
    else:
        found = list(_of_table(sources[0], value, operator))
    readings = tuple(reading for reading, _ in found)
    table = StudyTable(readings, value, ", ".join(str(source) for source in sources))
    if not found:
        raise DataError(
            f"{table.source}: no reading of `{value}`", hint="does the layout name this run's ids?"
        )
    _refuse_repeats(found)
    if table.is_numeric():
        _refuse_mixed_units(table)
    return table


def _reading(row: Mapping[str, str], operator: str, value: str, place: str, std: float = math.nan) -> Reading:
    """Make a reading of a table's line, its value and uncertainty may come from elsewhere."""
    if row.get("std") and math.isnan(std):
        std = StudyTable._finite(row["std"], place, "std")
    part, who, trial = row["part"], row.get(operator, "") or "–", row.get("trial", "")
    return Reading(part, who, trial, value, place, row.get("reference", ""), std, row.get("time", ""))


def _of_table(path: Path, value: str, operator: str) -> Iterator[tuple[Reading, str]]:
    """Give the readings of a CSV file, each with its image's hash ("" where not said)."""
    for place, row in _rows(path, ("part", value)):
        if row[value] not in ("", "NaN", "nan"):  # else a reading that was planned and is missing
            yield _reading(row, operator, row[value], place), row.get("image_sha256", "")


def _of_runs(runs: Sequence[Path], value: str, layout: Path, operator: str) -> Iterator[tuple[Reading, str]]:
    """Give the readings of runs, in the order of the layout."""
    rows: dict[tuple[str, str], tuple[Measurement, Path]] = {}
    for run in runs:
        for row in read_record(run):
            for name in {row.id, row.acquisition} if row.products == 1 else {row.id}:
                rows[run.name, name] = rows["", name] = (row, run)
    for place, line in _rows(layout, ("part",)):
        name = line.get("id") or line.get("acquisition") or ""
        found = rows.get((line.get("run", ""), name))
        if found is None:
            raise DataError(
                f"{place}: `{name}` is in none of the runs {', '.join(str(run) for run in runs)}",
                hint="the first column is `id` as in the run's record, or `acquisition`",
            )
        row, run = found
        text, std = recorded(row, value)
        if text:  # else it was refused or is absent: a gap, which the analysis allows for
            of_run = {key: cell for key, cell in line.items() if key != "std"}
            reading = _reading(of_run, operator, text, f"{run / RECORD}: {row.id}", std)
            yield reading, row.provenance.get("laser_sha256", "")


def recorded(row: Measurement, value: str) -> tuple[str, float]:
    """Give a row's value as text ("" where absent) and its standard uncertainty."""
    if value == "grade":
        return ("" if row.grade is None else row.grade.label), math.nan
    if value in RECORDED:
        estimate, scale = estimate_of(row, value)
        if estimate is None or not math.isfinite(estimate.value):
            return "", math.nan
        return repr(scale * estimate.value), scale * estimate.std
    if row.grade is None or value not in row.grade.features:
        return "", math.nan
    return repr(float(row.grade.features[value])), float(row.grade.features_std.get(value, math.nan))


def estimate_of(row: Measurement, value: str) -> tuple[Estimate | None, float]:
    """Give a row's estimate (None where absent) and the factor to the unit in the value's name.

    DataError where the rows of a run hold no such value with an uncertainty.
    """
    volume, weight = row.volume, row.weight
    estimates = {
        "visible_cm3": (None if volume is None else volume.visible_mm3, 1e-3),
        "true_cm3": (None if volume is None else volume.true_mm3, 1e-3),
        "mass_g": (None if weight is None else weight.mass_g, 1.0),
        "height_max_mm": (row.height_max_mm, 1.0),
    }
    if value not in estimates:
        raise DataError(f"`{value}`: expected one of {', '.join(estimates)}")
    return estimates[value]


def _rows(path: Path, needed: Sequence[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Give a CSV file's lines with their places, cells stripped."""
    names, rows = read_csv(path)
    missing = [name for name in needed if name not in names]
    if missing:
        raise ConfigurationError(
            f"{path}:1: no column {' and no column '.join(f'`{name}`' for name in missing)}; "
            f"found {', '.join(names)}"
        )
    for line, row in rows:
        yield f"{path}:{line}", {key: cell.strip() for key, cell in row.items()}


def _refuse_repeats(found: Sequence[tuple[Reading, str]]) -> None:
    """Refuse one image that counts as two trials, and one place of the plan that is filled twice."""
    images: dict[str, Reading] = {}
    places: dict[tuple[str, str, str], Reading] = {}
    for reading, image in found:
        if image and images.setdefault(image, reading) is not reading:
            raise DataError(
                f"{reading.place}: its image is the same file, by its hash, as that of {images[image].place}",
                hint="a copy is no repetition: it would make the gauge look perfect",
            )
        key = (reading.part, reading.operator, reading.trial)
        if reading.trial and places.setdefault(key, reading) is not reading:
            raise DataError(
                f"{reading.place}: part {key[0]}, operator {key[1]}, trial {key[2]} stands at "
                f"{places[key].place} already"
            )


def _refuse_mixed_units(table: StudyTable) -> None:
    values = table.numbers()
    if (values <= 0.0).any():
        return  # differences from a target: their ratios say nothing
    part = np.array([reading.part for reading in table.readings])
    of = np.array([reading.operator for reading in table.readings])
    typical = {name: float(np.median(values[part == name])) for name in table.parts}
    relative = values / np.array([typical[name] for name in part.tolist()])
    for name in table.operators:
        ratio = float(np.median(relative[of == name]))
        if not 1.0 / MIXED_UNITS_RATIO < ratio < MIXED_UNITS_RATIO:
            raise DataError(
                f"{table.source}: `{table.value}` by {name} is typically {ratio:.3g} times that of all: "
                "these are not in one unit",
                hint="give every value in the unit that stands in the column's name",
            )


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
