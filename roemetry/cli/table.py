"""The table of a run, for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import islice

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from roemetry.records import Measurement
from roemetry.units import mm3_to_cm3, stated


def problems_of(measurements: Iterable[Measurement]) -> list[str]:
    """Write a line for each row that was not measured, with the reason."""
    return [
        f"{row.id}: {row.reasons[0].text if row.reasons else row.status}"
        for row in islice((row for row in measurements if row.status != "measured"), _ROWS_MAX)
    ]


_ROWS_MAX = 40
_COLOURS = {"measured": "default", "empty": "yellow", "failed": "red"}


def table_of(title: str, measurements: Iterable[Measurement], rows: int) -> Table:
    """Make the table; of a long run it shows the first rows and says how many there are."""
    caption = f"the first {_ROWS_MAX} of {rows} rows" if rows > _ROWS_MAX else None
    table = Table(title=Text(title), caption=caption, title_justify="left", box=SIMPLE_HEAD)
    table.add_column("product", no_wrap=True)
    table.add_column("grade")
    for heading in ("g", "cm³", "mm high", "stripes", "ambiguous"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in islice(measurements, _ROWS_MAX):
        coding = row.coding
        table.add_row(
            Text(row.id),
            Text(_verdict(row), style=_COLOURS[row.status]),
            "" if row.weight is None else stated(row.weight.mass_g.value, 1),
            "" if row.volume is None else stated(mm3_to_cm3(row.volume.visible_mm3.value)),
            "" if math.isnan(row.height_max_mm) else stated(row.height_max_mm, 1),
            "" if coding is None else f"{coding.stripes_seen}/{coding.stripes}",
            "" if coding is None else str(coding.ambiguous),
        )
    return table


def _verdict(row: Measurement) -> str:
    """Say what a product is like, and what is to be done with it."""
    shape = row.grade.label if row.grade is not None else row.status
    if row.decision is None:
        return shape
    lane = f" ({row.decision.lane})" if row.decision.lane else ""
    return f"{shape} → {row.decision.label}{lane}"
