"""Tables and shares as Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from roemetry_tools.compare.agreement import Interval


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def share(part: int, whole: int) -> str:
    """Write part of whole as a share, with the whole."""
    return f"{100.0 * part / whole:.1f} % of {whole}" if whole else "–"


def ends(interval: Interval, digits: int = 3) -> str:
    """Write an interval."""
    return f"{interval.low:.{digits}f} to {interval.high:.{digits}f}"


def confusion(
    found: Counter[tuple[str, str]], order: Sequence[str], what: str, true: Sequence[str] = ()
) -> str:
    """Write what it is against what it was called; `true` is the order of what it is, if another."""
    true = [name for name in true or order if any(pair[0] == name for pair in found)]
    given = [name for name in order if any(pair[1] == name for pair in found)]
    rows = [[name, *(str(found[name, other] or "·") for other in given)] for name in true]
    return table([what, *given], rows)
