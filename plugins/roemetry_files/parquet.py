"""results.parquet: the table of products with types, for data frames and databases."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from roemetry.io.files import write_bytes
from roemetry.records.units import NOT_STATED
from roemetry.stages import Run, Sink, StageOptions
from roemetry_files.csv_table import COLUMNS, features_of, given_features


class Parquet(Sink[StageOptions]):
    """Writes ``results.parquet``: the columns of ``results.csv`` and every feature, numbers unrounded.

    Column names are the headings in small letters with the unit at the end (``weight_g``). What is not known
    or not stated is null; the unit stands in each field's metadata too.
    """

    def write(self, run: Run) -> Sequence[Path]:
        """Write the table from the run's measurements."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        rows = list(run.measurements())
        found: dict[str, list[Any]] = {
            heading: [_cell(column(row)) for row in rows] for heading, column in COLUMNS.items()
        }
        for feature in features_of(run):
            found[f"feature {feature}"] = [_cell(given_features(row).get(feature)) for row in rows]
        fields, arrays = [], []
        for heading, values in found.items():
            array = pa.array(values)
            array = array.cast(pa.float64()) if pa.types.is_null(array.type) else array
            unit = _unit(heading)
            fields.append(pa.field(_name(heading), array.type, metadata={"unit": unit, "heading": heading}))
            arrays.append(array)
        provenance = {"title": run.title, "recipe_sha256": str(run.provenance.get("recipe_sha256", ""))}
        table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=provenance))
        sink = io.BytesIO()
        pq.write_table(table, sink)
        path = run.folder / "results.parquet"
        write_bytes(path, sink.getvalue())
        return [path]


def _cell(value: Any) -> Any:
    return None if value == NOT_STATED or (isinstance(value, float) and math.isnan(value)) else value


def _unit(heading: str) -> str:
    inside = re.search(r"\((.+)\)$", heading)
    return inside.group(1) if inside else ""


def _name(heading: str) -> str:
    plain = heading.lower().replace("³", "3").replace("%", "percent").replace("share", "")
    return "_".join(re.findall(r"[a-z0-9]+", plain))
