"""The table of a run, for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import islice

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from roemetry.records import Estimate, Measurement
from roemetry.records.units import MM3_PER_CM3, stated


def problems_of(measurements: Iterable[Measurement]) -> list[str]:
    """Write a line for each reason why rows were not measured or weigh wrong, with the rows it holds for."""
    rows_by_text: dict[str, list[str]] = {}
    for row in measurements:
        if row.status != "measured":
            text = row.reasons[0].text if row.reasons else row.status
            rows_by_text.setdefault(text, []).append(row.id)
        elif row.weight is not None and not row.weight.features:  # which only a fitted weigher has
            for reason in (*row.weight.reasons, *(row.volume.reasons if row.volume else ())):
                if reason.code in _NOT_FITTED:
                    rows_by_text.setdefault(f"weight not fitted: {reason.text}", []).append(row.id)
    return [f"{_few(rows)}: {text}" for text, rows in islice(rows_by_text.items(), _ROWS_MAX)]


def _few(rows: list[str]) -> str:
    """Name the first rows, and count the others."""
    named = ", ".join(rows[:_NAMED_MAX])
    return f"{named} and {len(rows) - _NAMED_MAX} more" if len(rows) > _NAMED_MAX else named


_NOT_FITTED = ("visible-taken-for-true", "underside-assumed")
"""Reasons that make a weight wrong by a tenth, and that weighed samples mend."""
_ROWS_MAX = 40
_NAMED_MAX = 3
_COLOURS = {"measured": "default", "empty": "yellow", "failed": "red"}


def table_of(title: str, measurements: Iterable[Measurement], rows: int) -> Table:
    """Make the table; of a long run it shows the first rows and says how many there are."""
    caption = f"the first {_ROWS_MAX} of {rows} rows" if rows > _ROWS_MAX else None
    # Eighty columns, the width of a pipe, hold it all.
    table = Table(title=Text(title), caption=caption, title_justify="left", box=SIMPLE_HEAD)
    table.pad_edge, table.collapse_padding = False, True
    table.add_column("product", min_width=10, overflow="fold")
    shown = list(islice(measurements, _ROWS_MAX))
    graded = any(row.grade is not None or row.decision is not None for row in shown)
    table.add_column("grade" if graded else "status", min_width=6)
    of_pixels = any(_displacement(row) for row in shown) and not any(any(_in_units(row)) for row in shown)
    headings = ("px displaced",) if of_pixels else ("g", "cm³", "mm high")
    for heading in (*headings, "stripes", "ambi-\nguous"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in shown:
        coding = row.coding
        table.add_row(
            Text(row.id),
            Text(_verdict(row), style=_COLOURS[row.status]),
            *((_displacement(row),) if of_pixels else _in_units(row)),
            "" if coding is None else f"{coding.stripes_seen}/{coding.stripes}",
            "" if coding is None else str(coding.ambiguous),
        )
    return table


def _in_units(row: Measurement) -> tuple[str, str, str]:
    """Write mass, volume and height; empty where they are missing."""
    return (
        "" if row.weight is None else _figure(row.weight.mass_g, 1),
        "" if row.volume is None else _figure(row.volume.visible_mm3, 2, MM3_PER_CM3),
        _figure(row.height_max_mm, 2),
    )


def _displacement(row: Measurement) -> str:
    """Write the largest displacement, which is all there is without a calibration."""
    found = math.nan if row.coding is None else row.coding.displacement_max_px
    return "" if math.isnan(found) else f"{found:.1f}"


def _figure(estimate: Estimate, digits: int, per: float = 1.0) -> str:
    """Write a value and, where it is stated, ± its standard uncertainty; nothing where there is no value."""
    if math.isnan(estimate.value):
        return ""
    value = stated(estimate.value / per, digits)
    return value if math.isnan(estimate.std) else f"{value} ± {estimate.std / per:.{digits}f}"


def _verdict(row: Measurement) -> str:
    """Say what a product is like, and what is to be done with it."""
    shape = "" if row.grade is None else row.grade.label
    if row.decision is None:
        return shape or row.status
    lane = f" ({row.decision.lane})" if row.decision.lane else ""
    return f"{shape}{' → ' if shape else ''}{row.decision.label}{lane}"
