"""Every check with its sentence, as the reference page lists them."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.testing.checks import ANY, OF_KIND, Check, name_of, sentence_of


def markdown() -> str:
    """Write a heading and a table for the checks of every stage, and of each kind."""
    parts = [_section("Every stage", ANY)]
    parts += [_section(kind.capitalize(), checks) for kind, checks in OF_KIND.items()]
    return "\n".join(parts)


def _section(title: str, checks: Iterable[Check]) -> str:
    rows = [f"| `{name_of(check)}` | {sentence_of(check)} |" for check in checks]
    return "\n".join([f"### {title}", "", "| check | what a stage must keep |", "|---|---|", *rows, ""])
