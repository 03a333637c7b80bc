"""The table of products: results.csv for spreadsheets, results.parquet for data frames and databases."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import count, islice
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from pydantic import Field

from roemetry.io.files import make_folder, whole_file
from roemetry.io.remote import Url, path_of
from roemetry.records import Estimate, Measurement
from roemetry.records.units import NOT_STATED, mm3_to_cm3
from roemetry.stages import Run, Sink, StageOptions

Cell = str | float | int
Column = Callable[[Measurement], Cell | None]


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

    def write(self, run: Run) -> Sequence[Path]:
        """Write the table from the run's measurements."""
        path = run.folder / "results.csv"
        features = features_of(run) if self.options.features else []
        with whole_file(path) as file, io.TextIOWrapper(file, "utf-8", newline="") as text:
            writer = csv.writer(text, lineterminator="\n")
            writer.writerow(map(_cell, [*COLUMNS, *features]))
            for measurement in run.measurements():
                given = given_features(measurement)
                cells = [column(measurement) for column in COLUMNS.values()]
                writer.writerow(map(_cell, [*cells, *(given.get(name) for name in features)]))
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
    if isinstance(value, str) and value.startswith(_FORMULA):
        return f"'{value}"  # a spreadsheet would reckon it
    return rounded(value) if isinstance(value, float) else value


_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def rounded(value: float) -> float:
    """Round to four decimals; below 1 to five significant digits: curvatures per mm are small."""
    if value == 0.0 or not math.isfinite(value):
        return value
    return round(value, 4 + max(0, -math.floor(math.log10(abs(value)))))


def _estimate(
    name: str, unit: str, of: Callable[[Measurement], Estimate | None], scale: float = 1.0
) -> dict[str, Column]:
    """Give an estimate's columns: value, standard uncertainty, ends of the interval, parts by cause."""

    def given(read: Callable[[Estimate], Cell | None]) -> Column:
        return lambda row: None if (one := of(row)) is None else read(one)

    def by_cause(one: Estimate) -> str | None:
        """Write the budget as text, the largest part first: causes differ from row to row."""
        parts = sorted(one.budget.items(), key=lambda part: -part[1])
        return "; ".join(f"{cause} {std * scale:.4g}" for cause, std in parts) or None

    return {
        f"{name} ({unit})": given(lambda one: one.value * scale),
        f"{name} standard uncertainty ({unit})": given(
            lambda one: NOT_STATED if math.isnan(one.std) else one.std * scale
        ),
        f"{name} 95 % low ({unit})": given(lambda one: one.interval[0] * scale),
        f"{name} 95 % high ({unit})": given(lambda one: one.interval[1] * scale),
        f"{name} by cause ({unit})": given(by_cause),
    }


def _attribute(part: str, name: str) -> Column:
    """Give the column of an attribute of a part of the row, which may be missing."""
    return lambda row: None if (of := getattr(row, part)) is None else getattr(of, name)


def _height(row: Measurement) -> Estimate | None:
    return None if math.isnan(row.height_max_mm.value) else row.height_max_mm


COLUMNS: dict[str, Column] = {
    **{name: attrgetter(name) for name in ("id", "acquisition", "product", "status")},
    "grade": _attribute("grade", "label"),
    "decision": _attribute("decision", "label"),
    "lane": _attribute("decision", "lane"),
    **_estimate("weight", "g", lambda row: None if row.weight is None else row.weight.mass_g),
    **_estimate(
        "visible volume",
        "cm³",
        lambda row: None if row.volume is None else row.volume.visible_mm3,
        mm3_to_cm3(1.0),
    ),
    **_estimate(
        "true volume", "cm³", lambda row: None if row.volume is None else row.volume.true_mm3, mm3_to_cm3(1.0)
    ),
    **_estimate("largest height", "mm", _height),
    "volume seen (share)": lambda row: None if row.volume is None else row.volume.shares.seen,
    "volume interpolated (share)": lambda row: None if row.volume is None else row.volume.shares.interpolated,
    "volume assumed (share)": lambda row: None if row.volume is None else row.volume.shares.assumed,
    "stripes expected": _attribute("coding", "stripes"),
    "stripes seen": _attribute("coding", "stripes_seen"),
    "peaks": _attribute("coding", "peaks"),
    "peaks labelled": _attribute("coding", "labelled"),
    "peaks ambiguous": _attribute("coding", "ambiguous"),
    "product rows seen": _attribute("coding", "rows_seen"),
    "product rows interpolated": _attribute("coding", "rows_interpolated"),
    "largest displacement (px)": _attribute("coding", "displacement_max_px"),
    "saturated (share)": _attribute("coding", "saturated_share"),
    "reasons": lambda row: "; ".join(reason.text.replace("\n", " ") for reason in row.all_reasons),
    "recipe sha256": lambda row: row.provenance.get("recipe_sha256"),
    "calibration sha256": lambda row: row.provenance.get("calibration_sha256"),
}


class ParquetOptions(StageOptions):
    """Options of `Parquet`."""

    folder: str | None = Field(
        default=None,
        description="folder or URL (s3://…) of a data set of many runs, to which this run is added as "
        "day=<date>/run=<name>/results.parquet; default: results.parquet in the run's folder",
    )


class Parquet(Sink[ParquetOptions]):
    """Writes ``results.parquet``: the columns of ``results.csv`` and every feature, numbers unrounded.

    Column names are the headings in small letters with the unit at the end (``weight_g``). What is not known
    or not stated is null; the unit stands in each field's metadata too. With a `folder`, the table becomes
    one file of a data set by day, which DuckDB, pandas and Polars read as one table; written again, it takes
    its own place. Rows go through memory in blocks, however many there are.
    """

    def write(self, run: Run) -> Sequence[Path]:
        """Write the table from the run's measurements."""
        folder = run.folder
        make_folder(folder)
        if self.options.folder is not None:
            day = str(run.provenance.get("started") or "unknown")[:10]
            folder = path_of(self.options.folder, Path()) / f"day={day}" / f"run={run.folder.resolve().name}"
            if not isinstance(folder, Url):
                make_folder(folder)
        path = folder / "results.parquet"
        with TemporaryDirectory(prefix=".parquet-", dir=run.folder) as blocks:
            schema = _write_blocks(run, Path(blocks))
            with whole_file(path) as file:
                _join(Path(blocks), schema, file)
        return [path]


def _write_blocks(run: Run, folder: Path) -> Any:
    """Write the rows in blocks, each with the columns that it has; give the columns of all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows, schemas = run.measurements(), list[Any]()
    units: dict[str, dict[str, str]] = {}
    for number in count():
        found: dict[str, list[Any]] = {heading: [] for heading in COLUMNS}
        rows_of = 0
        for row in islice(rows, _BLOCK):
            for heading, column in COLUMNS.items():
                found[heading].append(_known(column(row)))
            for feature, value in given_features(row).items():
                values = found.setdefault(f"feature {feature}", [])
                values += [None] * (rows_of - len(values))
                values.append(_known(value))
            rows_of += 1
        if not rows_of and schemas:
            break
        for values in found.values():
            values += [None] * (rows_of - len(values))
        for heading in found:
            units[_name(heading)] = {"unit": _unit(heading), "heading": heading}
        table = pa.table({_name(one): pa.array(values, _type(one)) for one, values in found.items()})
        pq.write_table(table, folder / f"{number:06d}")
        schemas.append(table.schema)
    provenance = {"title": run.title, "recipe_sha256": str(run.provenance.get("recipe_sha256", ""))}
    fields = [pa.field(one.name, one.type, metadata=units[one.name]) for one in pa.unify_schemas(schemas)]
    return pa.schema(fields, metadata=provenance)


def _join(folder: Path, schema: Any, file: IO[bytes]) -> None:
    """Write the blocks as one table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetWriter(file, schema) as writer:
        for path in sorted(folder.iterdir()):
            block = pq.read_table(path)
            missing = pa.nulls(block.num_rows)
            columns = [
                (block[name] if name in block.column_names else missing).cast(schema.field(name).type)
                for name in schema.names
            ]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))


_BLOCK = 20_000
"""Rows whose cells are held at once: 100 MB."""


def _known(value: Any) -> Any:
    return None if value == NOT_STATED or (isinstance(value, float) and math.isnan(value)) else value


def _unit(heading: str) -> str:
    inside = re.search(r"\((.+)\)$", heading)
    return inside.group(1) if inside else ""


def _type(heading: str) -> str:
    """Give the type of a column, the same in every run: what no row has would have none by its values."""
    if heading in _TEXT or "by cause" in heading:
        return "string"
    return "int64" if heading in _COUNTS else "float64"


_TEXT = frozenset(
    {"id", "acquisition", "status", "grade", "decision", "lane", "reasons", "recipe sha256"}
    | {"calibration sha256"}
)
_COUNTS = frozenset(
    {"product", "stripes expected", "stripes seen", "peaks", "peaks coded", "peaks ambiguous"}
    | {"product rows seen", "product rows interpolated"}
)


def _name(heading: str) -> str:
    plain = heading.lower().replace("³", "3").replace("%", "percent").replace("share", "")
    return "_".join(re.findall(r"[a-z0-9]+", plain))
