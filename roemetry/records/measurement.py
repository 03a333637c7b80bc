"""One product's row in the record of a run, and its JSON form."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from roemetry.errors import DataError, RecordError
from roemetry.io.files import first_fault, json_values
from roemetry.records.arrays import Number
from roemetry.records.display import Shown, estimate, picture_of_surface, table
from roemetry.records.outcome import Decision, Estimate, Grade, Volume, Weight
from roemetry.records.reasons import Reason

Status = Literal["measured", "empty", "failed"]
_UNKNOWN = Estimate(math.nan)
_ORDER = (
    *("id", "acquisition", "product", "products", "status", "decision", "grade", "weight", "volume"),
    *("height_max_mm", "coding", "absent", "reasons", "provenance"),
)
"""The fields of a line: first what a person looks for."""


@dataclass(frozen=True, slots=True)
class Coding:
    """How well the stripes of the acquisition were found and labelled."""

    stripes: int
    stripes_seen: int
    """Number of stripes with at least one peak."""
    peaks: int
    labelled: int
    ambiguous: int
    unlabelled: int
    """peaks, labelled, ambiguous, unlabelled: peaks extracted; of them with a stripe; with several possible
    stripes; with none."""
    rows_seen: int
    rows_interpolated: int
    """rows_seen, rows_interpolated: (stripe, row) cells on this product with a seen point and with a bridged
    one. Without a product (an uncalibrated run, an empty belt) those of everything that is not belt."""
    saturated_share: Number = math.nan
    displacement_max_px: Number = math.nan
    """Largest displacement from the rest line on the product, px, with its sign; NaN where unknown."""
    motion_px: tuple[float, ...] = ()
    """What shift, roll, zoom and tilt of the camera since the calibration do at the image's edge, px, as
    the aligner found them, corrected or not; empty without one."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Measurement(Shown):
    """All that was found of one product."""

    id: str
    """``<acquisition>#<product>``; ``#0`` where the acquisition gave no product."""
    acquisition: str
    product: int
    """acquisition, product: id of the acquisition; number of the product, 0 for none."""
    status: Status
    """``measured``: what the recipe asked for is there, or stands in `absent` with a reason. ``empty``: the
    image was read and labelled, and shows no product. ``failed``: it could not be measured."""
    products: int = 1
    """Number of rows this acquisition has in the record."""
    coding: Coding | None = None
    """How the stripes were found; None where extraction or coding failed."""
    height_max_mm: Estimate = _UNKNOWN
    """Largest height of a point above the belt, mm; its value is NaN where unknown."""
    volume: Volume | None = None
    weight: Weight | None = None
    grade: Grade | None = None
    absent: Mapping[str, Reason] = field(default_factory=dict)
    """By stage kind, why its result is missing."""
    reasons: tuple[Reason, ...] = ()
    """What must be known to believe the numbers."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Hashes of recipe, calibration and image, and version of every plugin that had a part."""
    decision: Decision | None = None
    seen_xyz_mm: Any = field(default=None, repr=False)
    """Points that were seen, mm, (slice, point, 3), which a notebook draws: all from `Recipe.measure`, a
    coarse grid of them from `Recipe.run`, None from a record."""

    @property
    def all_reasons(self) -> tuple[Reason, ...]:
        """Every reason on this row, each once: its own, then volume's, weight's, grade's, decision's."""
        parts = (self, self.volume, self.weight, self.grade, self.decision)
        return tuple(dict.fromkeys(reason for part in parts if part is not None for reason in part.reasons))

    def _repr_html_(self) -> str:
        """Give the numbers that a person looks for, as a table for notebooks."""
        rows = [("status", str(self.status)), ("height, mm", estimate(self.height_max_mm))]
        if self.volume is not None:
            rows.append(("visible volume, cm³", estimate(self.volume.visible_mm3, scale=1e-3)))
            rows.append(("true volume, cm³", estimate(self.volume.true_mm3, scale=1e-3)))
        if self.weight is not None:
            rows.append(("mass, g", estimate(self.weight.mass_g)))
        if self.grade is not None:
            likely = (
                "" if math.isnan(self.grade.probability) else f", probability {self.grade.probability:.2f}"
            )
            rows.append(("grade", self.grade.label + likely))
        if self.decision is not None:
            rows.append(("decision", self.decision.label))
        rows += [(f"no {kind}", reason.text) for kind, reason in self.absent.items()]
        rows += [(reason.code, reason.text) for reason in self.all_reasons]
        picture = "" if self.seen_xyz_mm is None else picture_of_surface(self.seen_xyz_mm)
        return table(self.id, rows, picture)

    def to_json(self) -> str:
        """One line of JSON; NaN is written as null."""
        row = {name: _plain(getattr(self, name)) for name in _ORDER}
        if self.volume is not None:
            volume = row["volume"]
            columns = (volume.pop(f"slice_{name}") for name in _SLICE)
            reasons = volume.pop("reasons")
            volume["slices"] = [dict(zip(_SLICE, one, strict=True)) for one in zip(*columns, strict=True)]
            volume["reasons"] = reasons
        return json.dumps(row, ensure_ascii=False, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Measurement:
        """Read a line that `to_json` wrote, or an older version; arrows are not stored and come back None."""
        try:
            row = _parsed(line)
            if row["coding"] is not None:
                row["coding"] = {_RENAMED.get(name, name): one for name, one in row["coding"].items()}
            if row["volume"] is not None:
                slices = row["volume"].pop("slices")
                row["volume"] |= {
                    f"slice_{name}": [math.nan if one[name] is None else one[name] for one in slices]
                    for name in _SLICE
                }
            found: Measurement = _reader().validate_python(row)
            return found
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, RecordError) as error:
            raise DataError(
                f"not a measurement: {line[:60]!r}… ({first_fault(error)})",
                hint="the line was written by another version of roemetry, or edited by hand",
            ) from error


_SLICE = ("stripe", "area_mm2", "spacing_mm")
_RENAMED = {"coded": "labelled", "uncoded": "unlabelled"}
"""Fields of `Coding` by the names they had in older records, which can still be read."""
_NOT_KEPT = ("arrows", "relief", "solution")
"""What of a grade is drawn, and what an estimator goes on from."""


def _plain(value: Any) -> Any:
    """Make a record the values of its line: reasons last, without what is not kept, NaN as null."""
    kind = type(value)  # compared itself: each row of a run comes by here, number by number
    if kind is float:
        return value if math.isfinite(value) else None
    if kind is str or kind is int or value is None:
        return value
    if kind is Reason:
        return {"code": value.code, "text": value.text}
    if kind is tuple:
        return [_plain(item) for item in value]
    if kind is dict:
        return {key: _plain(item) for key, item in value.items()}
    if is_dataclass(kind):
        return {name: _plain(getattr(value, name)) for name in _names(kind)}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return json_values(value.tolist() if kind is np.ndarray else value)


@cache
def _names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(sorted((f.name for f in fields(kind) if f.name not in _NOT_KEPT), key="reasons".__eq__))


def _parsed(line: str) -> Any:
    """Parse a line, four times as fast as Python's own parser does."""
    from pydantic_core import from_json

    try:
        return from_json(line, cache_strings="keys")
    except ValueError:  # half a surrogate pair, which names of files may hold, only Python's takes
        return json.loads(line)


@cache
def _reader() -> Any:
    """Make pydantic's reader of a line when the first one is read: it takes a while."""
    from pydantic import TypeAdapter

    return TypeAdapter(Measurement)
