"""results.csv: a line a product, for spreadsheets."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from pydantic import Field

from roemetry.io.files import write_whole
from roemetry.records import Estimate, Measurement
from roemetry.records.units import NOT_STATED, mm3_to_cm3
from roemetry.stages import Run, Sink, StageOptions

Cell = str | float | int


class CsvTableOptions(StageOptions):
    """Options of `CsvTable`."""

    features: bool = Field(
        default=False,
        description="add a column for each feature of the classifier and of the weigher",
    )


class CsvTable(Sink[CsvTableOptions]):
    """Writes ``results.csv``; units stand in the headings.

    An empty cell means there is no such number, and the column of reasons says why; an uncertainty that is
    not modelled is ``not stated``.
    """

    Options: ClassVar[type[StageOptions]] = CsvTableOptions

    def write(self, run: Run) -> Sequence[Path]:
        """Write the table from the run's measurements."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        features = features_of(run) if self.options.features else []
        writer.writerow([*COLUMNS, *features])
        for measurement in run.measurements():
            given = given_features(measurement)
            writer.writerow(
                [
                    *(_cell(column(measurement)) for column in COLUMNS.values()),
                    *(_cell(given.get(name)) for name in features),
                ]
            )
        path = run.folder / "results.csv"
        write_whole(path, text.getvalue())
        return [path]


def features_of(run: Run) -> list[str]:
    """Names of all features in the run, in the order in which they appear."""
    found: dict[str, None] = {}
    for measurement in run.measurements():
        found.update(dict.fromkeys(given_features(measurement)))
    return list(found)


def given_features(row: Measurement) -> Mapping[str, float]:
    """Features of classifier and weigher by name."""
    grade = {} if row.grade is None else row.grade.features
    return grade if row.weight is None else {**grade, **row.weight.features}


def _cell(value: Cell | None) -> Cell:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return rounded(value) if isinstance(value, float) else value


def rounded(value: float) -> float:
    """Round to four decimals; below 1 to five significant digits: curvatures per mm are small."""
    if value == 0.0 or not math.isfinite(value):
        return value
    return round(value, 4 + max(0, -math.floor(math.log10(abs(value)))))


def _value(estimate: Estimate | None, scale: float = 1.0) -> float | None:
    return None if estimate is None else estimate.value * scale


def _std(estimate: Estimate | None, scale: float = 1.0) -> Cell | None:
    if estimate is None:
        return None
    return NOT_STATED if math.isnan(estimate.std) else estimate.std * scale


def _end(estimate: Estimate | None, which: int, scale: float = 1.0) -> float | None:
    return None if estimate is None else estimate.interval[which] * scale


def _by_cause(estimate: Estimate | None, scale: float = 1.0) -> str | None:
    """Write the budget as text, the largest part first: causes differ from row to row."""
    if estimate is None or not estimate.budget:
        return None
    parts = sorted(estimate.budget.items(), key=lambda part: -part[1])
    return "; ".join(f"{cause} {std * scale:.4g}" for cause, std in parts)


def _mass(row: Measurement) -> Estimate | None:
    return None if row.weight is None else row.weight.mass_g


def _visible(row: Measurement) -> Estimate | None:
    return None if row.volume is None else row.volume.visible_mm3


def _true(row: Measurement) -> Estimate | None:
    return None if row.volume is None else row.volume.true_mm3


def _height(row: Measurement) -> Estimate | None:
    return None if math.isnan(row.height_max_mm.value) else row.height_max_mm


_CM3 = mm3_to_cm3(1.0)

COLUMNS: dict[str, Callable[[Measurement], Cell | None]] = {
    "id": lambda row: row.id,
    "acquisition": lambda row: row.acquisition,
    "product": lambda row: row.product,
    "status": lambda row: row.status,
    "grade": lambda row: None if row.grade is None else row.grade.label,
    "decision": lambda row: None if row.decision is None else row.decision.label,
    "lane": lambda row: None if row.decision is None else row.decision.lane,
    "weight (g)": lambda row: _value(_mass(row)),
    "weight standard uncertainty (g)": lambda row: _std(_mass(row)),
    "weight 95 % low (g)": lambda row: _end(_mass(row), 0),
    "weight 95 % high (g)": lambda row: _end(_mass(row), 1),
    "weight by cause (g)": lambda row: _by_cause(_mass(row)),
    "visible volume (cm³)": lambda row: _value(_visible(row), _CM3),
    "visible volume standard uncertainty (cm³)": lambda row: _std(_visible(row), _CM3),
    "visible volume 95 % low (cm³)": lambda row: _end(_visible(row), 0, _CM3),
    "visible volume 95 % high (cm³)": lambda row: _end(_visible(row), 1, _CM3),
    "visible volume by cause (cm³)": lambda row: _by_cause(_visible(row), _CM3),
    "true volume (cm³)": lambda row: _value(_true(row), _CM3),
    "true volume standard uncertainty (cm³)": lambda row: _std(_true(row), _CM3),
    "true volume 95 % low (cm³)": lambda row: _end(_true(row), 0, _CM3),
    "true volume 95 % high (cm³)": lambda row: _end(_true(row), 1, _CM3),
    "true volume by cause (cm³)": lambda row: _by_cause(_true(row), _CM3),
    "largest height (mm)": lambda row: row.height_max_mm.value,
    "largest height standard uncertainty (mm)": lambda row: _std(_height(row)),
    "largest height 95 % low (mm)": lambda row: _end(_height(row), 0),
    "largest height 95 % high (mm)": lambda row: _end(_height(row), 1),
    "largest height by cause (mm)": lambda row: _by_cause(_height(row)),
    "volume seen (share)": lambda row: None if row.volume is None else row.volume.shares.seen,
    "volume interpolated (share)": lambda row: None if row.volume is None else row.volume.shares.interpolated,
    "volume assumed (share)": lambda row: None if row.volume is None else row.volume.shares.assumed,
    "stripes expected": lambda row: None if row.coding is None else row.coding.stripes,
    "stripes seen": lambda row: None if row.coding is None else row.coding.stripes_seen,
    "peaks": lambda row: None if row.coding is None else row.coding.peaks,
    "peaks coded": lambda row: None if row.coding is None else row.coding.coded,
    "peaks ambiguous": lambda row: None if row.coding is None else row.coding.ambiguous,
    "product rows seen": lambda row: None if row.coding is None else row.coding.rows_seen,
    "product rows interpolated": lambda row: None if row.coding is None else row.coding.rows_interpolated,
    "largest displacement (px)": lambda row: None if row.coding is None else row.coding.displacement_max_px,
    "saturated (share)": lambda row: None if row.coding is None else row.coding.saturated_share,
    "reasons": lambda row: "; ".join(reason.text.replace("\n", " ") for reason in row.all_reasons),
    "recipe sha256": lambda row: row.provenance.get("recipe_sha256"),
    "calibration sha256": lambda row: row.provenance.get("calibration_sha256"),
}
