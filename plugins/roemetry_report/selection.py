"""One pass over a run's record: what to say of all, and which products to show."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from roemetry.records import Measurement, Reason
from roemetry.stages import Run

ROWS_MAX = 2000
"""Rows of the summary table; a page with more is no help to anyone."""

_SUSPECTS_PER_PLACE = 64
"""So many rows are kept in mind for each place among the worst: an acquisition may have many rows."""


@dataclass(frozen=True, slots=True)
class Shown:
    """An acquisition that gets a section, with all its rows of the record."""

    acquisition: str
    rows: tuple[Measurement, ...]
    worst: bool


@dataclass(frozen=True, slots=True)
class Overview:
    """A run at a glance.

    Attributes
    ----------
    total
        Number of rows of the record.
    statuses, grades
        How many rows have each status, how many products each grade.
    rows
        The first rows, for the table.
    common
        Reasons that stand on every measured row: said once.
    shown
        Acquisitions that get a section.
    calibrated
        Whether any number is in millimetres or grams.
    """

    total: int
    statuses: Mapping[str, int]
    grades: Mapping[str, int]
    rows: tuple[Measurement, ...]
    common: tuple[Reason, ...]
    shown: tuple[Shown, ...]
    calibrated: bool


def overview(run: Run, products_max: int, worst_max: int) -> Overview:
    """Look through the record.

    Parameters
    ----------
    run
        What was measured.
    products_max
        So many rows from the first on are shown.
    worst_max
        So many more are shown from among the others: failed, most ambiguous or least seen.
    """
    statuses: Counter[str] = Counter()
    grades: Counter[str] = Counter()
    rows: list[Measurement] = []
    first: dict[str, None] = {}
    suspects: list[tuple[float, int, str]] = []
    common: tuple[Reason, ...] | None = None
    finite = False
    for index, row in enumerate(run.measurements()):
        statuses[row.status] += 1
        if row.grade is not None:
            grades[row.grade.label] += 1
        if index < ROWS_MAX:
            rows.append(row)
        if index < products_max:
            first[row.acquisition] = None
        elif worst_max and row.acquisition not in first and (bad := badness(row)) > 0:
            suspects.append((-bad, index, row.acquisition))
            if len(suspects) > _SUSPECTS_PER_PLACE * worst_max:
                suspects = sorted(suspects)[: len(suspects) // 2]
        finite |= row.volume is not None or math.isfinite(row.height_max_mm.value)
        if row.status == "measured":
            common = row.all_reasons if common is None else tuple(r for r in common if r in row.all_reasons)
    worst = list(dict.fromkeys(name for _, _, name in sorted(suspects)))[:worst_max]
    total = sum(statuses.values())
    return Overview(
        total=total,
        statuses=statuses,
        grades=grades,
        rows=tuple(rows),
        common=common if common and statuses["measured"] > 1 else (),
        shown=_with_rows(run, list(first), worst),
        calibrated=_calibrated(run.provenance, finite),
    )


def badness(row: Measurement) -> float:
    """How much a row wants looking at: failed most, then the larger of ambiguous and not seen shares."""
    if row.status == "failed":
        return 2.0
    if row.status == "empty":
        return 0.0
    coding = row.coding
    ambiguous = coding.ambiguous / coding.peaks if coding is not None and coding.peaks else 0.0
    if row.volume is not None and math.isfinite(row.volume.shares.seen):
        unseen = 1.0 - row.volume.shares.seen
    elif coding is not None and coding.rows_seen + coding.rows_interpolated:
        unseen = coding.rows_interpolated / (coding.rows_seen + coding.rows_interpolated)
    else:
        unseen = 0.0
    return max(ambiguous, unseen)


def _with_rows(run: Run, first: list[str], worst: list[str]) -> tuple[Shown, ...]:
    """Collect each chosen acquisition's rows, wherever they stand."""
    chosen: dict[str, list[Measurement]] = {name: [] for name in (*first, *worst)}
    if chosen:
        for row in run.measurements():
            if row.acquisition in chosen:
                chosen[row.acquisition].append(row)
    return tuple(Shown(name, tuple(rows), name in worst) for name, rows in chosen.items())


def _calibrated(provenance: Mapping[str, object], finite: bool) -> bool:
    for key in ("calibration_sha256", "calibration"):
        if key in provenance:
            return provenance[key] is not None
    return finite
