"""What benchmarks write and keep: tables and shares as Markdown, and rows in files."""

from __future__ import annotations

import datetime
import hashlib
import importlib.metadata
import json
import math
import platform
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.records import Estimate
from roemetry.records.arrays import Floats
from roemetry_study.certificate import software_sha256
from roemetry_tools.compare.agreement import Interval

EXTRACTION = Path("docs/measurements/extraction.md")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(cells) + " |\n" for cells in lines)


@dataclass(frozen=True)
class Table:
    """A title, column names, rows of cells."""

    title: str
    columns: list[str]
    rows: list[list[str]]

    def __str__(self) -> str:
        return f"**{self.title}**\n\n{table(self.columns, self.rows)}"


def number(value: float, digits: int) -> str:
    """Write a number; a dash where there is none."""
    return "–" if math.isnan(value) else f"{value:.{digits}f}".replace("-", "−")


def percent(part: int, whole: int) -> str:
    """Write a share in percent, with two digits behind the point where it is small."""
    value = 100.0 * part / max(whole, 1)
    return f"{value:.2f}" if value < 10.0 else f"{value:.0f}"


def share(part: int, whole: int) -> str:
    """Write part of whole as a share, with the whole."""
    return f"{100.0 * part / whole:.1f} % of {whole}" if whole else "–"


def ends(interval: Interval, digits: int = 3) -> str:
    """Write an interval."""
    return f"{interval.low:.{digits}f} to {interval.high:.{digits}f}"


@dataclass
class Against:
    """Estimates beside what is true of them: (estimate,) values, ends of 95 % intervals, truths."""

    rows: list[tuple[float, float, float, float]] = field(default_factory=list)

    def add(self, found: Estimate, true: float) -> None:
        """Add an estimate."""
        self.rows.append((found.value, *found.interval, true))

    @property
    def off(self) -> Floats:
        """Relative errors."""
        value, _, _, true = np.array(self.rows).reshape(-1, 4).T
        return np.asarray(value / true - 1.0)

    @property
    def held(self) -> int:
        """How many intervals hold the truth."""
        return sum(low <= true <= high for _, low, high, true in self.rows)

    @property
    def width(self) -> float:
        """Median width of the intervals over the truth."""
        return float(np.median([(high - low) / true for _, low, high, true in self.rows]))

    @property
    def half(self) -> float:
        """Median half width of the intervals over the estimate."""
        return float(np.median([(high - low) / 2.0 / value for value, low, high, _ in self.rows]))


def confusion(
    found: Counter[tuple[str, str]], order: Sequence[str], what: str, true: Sequence[str] = ()
) -> str:
    """Write what it is against what it was called; `true` is the order of what it is, if another."""
    true = [name for name in true or order if any(pair[0] == name for pair in found)]
    given = [name for name in order if any(pair[1] == name for pair in found)]
    rows = [[name, *(str(found[name, other] or "·") for other in given)] for name in true]
    return table([what, *given], rows)


def kept_rows(path: Path, keys: Iterable[Any], make: Callable[[Any], Any]) -> dict[Any, Any]:
    """Make what belongs to each key, or read it from the file: a line of JSON each, written when made.

    The file's name gets a hash of our code: a row that other code has made is made again.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path = path.with_stem(f"{path.stem}_{_code()}")
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    known = {tuple(key) if isinstance(key, list) else key: row for key, row in map(json.loads, lines)}
    with path.open("a", encoding="utf-8") as file:
        for done, key in enumerate(keys, start=1):
            if key not in known:
                known[key] = make(key)
                file.write(json.dumps([key, known[key]]) + "\n")
                file.flush()
                print(f"\r{path.stem}: {done}", end="", file=sys.stderr, flush=True)
    return known


@cache
def _code() -> str:
    """Give twelve digits of a hash over the sources of roemetry, its plugins, and the benchmarks."""
    told = hashlib.sha256(software_sha256().encode())
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        told.update(source.read_bytes())
    return told.hexdigest()[:12]


def put_into(page: Path, parts: Mapping[str, str]) -> None:
    """Put each part into a page between ``<!-- measured: NAME -->`` and the next ``<!-- end -->``.

    Raises
    ------
    ValueError
        The page has no such place.
    """
    text = page.read_text("utf-8")
    for name, part in parts.items():
        begin, end = f"<!-- measured: {name} -->\n", "<!-- end -->\n"
        before, found, after = text.partition(begin)
        _, closed, rest = after.partition(end)
        if not found or not closed:
            raise ValueError(f"{page}: there is no `{begin.strip()}` with `{end.strip()}` below it")
        text = f"{before}{begin}\n{part.rstrip()}\n\n{end}{rest}"
    page.write_text(text, "utf-8")


def put_tables(tables: Iterable[Table], benchmark: str, arguments: str = "", left_out: str = "") -> None:
    """Put a benchmark's tables, and how and where they were measured, into the page of extraction."""
    command = f"python -m benchmarks {benchmark} {arguments}".rstrip()
    how = f"Measured by `{command}` on {machine()}.{left_out}"
    put_into(EXTRACTION, {benchmark: "\n".join([how + "\n", *map(str, tables)])})


def machine() -> str:
    """Say when and on what."""
    versions = ", ".join(
        f"{name} {importlib.metadata.version(name)}"
        for name in ("numpy", "numba", "scipy", "opencv-contrib-python-headless")
    )
    day = datetime.datetime.now(datetime.UTC).date().isoformat()
    return f"{day}, {platform.machine()}, Python {platform.python_version()}, {versions}"
