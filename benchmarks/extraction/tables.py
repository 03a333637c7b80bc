"""Tables, as Markdown, and the page that holds them."""

from __future__ import annotations

import datetime
import importlib.metadata
import math
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

PAGE = Path("docs/measurements/extraction.md")
BEGIN = "<!-- figures: python -m benchmarks {} --page -->"
END = "<!-- end of figures -->"


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


def put_into_page(tables: Sequence[Table], how: str, benchmark: str = "extract") -> None:
    """Replace the figures of the page by these, with date and machine."""
    written = PAGE.read_text(encoding="utf-8")
    mark = BEGIN.format(benchmark)
    begin = written.index(mark) + len(mark)
    end = written.index(END, begin)
    body = "\n".join(str(table) for table in tables)
    PAGE.write_text(f"{written[:begin]}\n\n{how}\n\n{body}\n{written[end:]}", encoding="utf-8")


def machine() -> str:
    """Say when and on what."""
    versions = ", ".join(
        f"{name} {importlib.metadata.version(name)}"
        for name in ("numpy", "numba", "scipy", "opencv-contrib-python-headless")
    )
    day = datetime.datetime.now(datetime.UTC).date().isoformat()
    return f"{day}, {platform.machine()}, Python {platform.python_version()}, {versions}"
