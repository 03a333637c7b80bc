"""Tables, as Markdown."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A title, column names, rows of cells."""

    title: str
    columns: list[str]
    rows: list[list[str]]

    def __str__(self) -> str:
        lines = [self.columns, ["---"] * len(self.columns), *self.rows]
        text = "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
        return f"**{self.title}**\n\n{text}\n"


def number(value: float, digits: int) -> str:
    """Write a number; a dash where there is none."""
    return "–" if math.isnan(value) else f"{value:.{digits}f}".replace("-", "−")


def percent(part: int, whole: int) -> str:
    """Write a share in percent, with two digits behind the point where it is small."""
    value = 100.0 * part / max(whole, 1)
    return f"{value:.2f}" if value < 10.0 else f"{value:.0f}"
