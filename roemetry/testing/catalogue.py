"""What a stage of each kind receives, gives and must keep, as the reference pages say it.

``python -m roemetry.testing.catalogue docs/reference/contracts`` writes the pages of the kinds anew.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from roemetry.stages import INTERFACES
from roemetry.stages.hookspecs import KINDS
from roemetry.stages.registry import Registry, discover
from roemetry.testing.checks import ANY, OF_KIND, Check, name_of, sentence_of


def markdown() -> str:
    """Write a heading and a table for the checks of every stage, and of each kind."""
    parts = [_section("Every stage", ANY)]
    parts += [_section(kind.capitalize(), checks) for kind, checks in OF_KIND.items()]
    return "\n".join(parts)


def contract(kind: str, registry: Registry) -> str:
    """Write the page of a kind: its class, its verbs, what it must keep, and who keeps it."""
    interface = INTERFACES[kind]
    verbs = [
        member
        for name, member in vars(interface).items()
        if not name.startswith("_") and callable(getattr(interface, name))
    ]
    # only what comes with roemetry: a page must not depend on what else is installed
    own = [stage for stage in registry.of_kind(kind) if stage.provider.distribution == "roemetry"]
    stages = [
        f"| [`{stage.entry.name}`](../plugins/{stage.entry.name}.md) | {stage.entry.summary} |"
        for stage in own
    ]
    parts = [
        f"# Contract: {kind}",
        "",
        f"{inspect.getdoc(interface)}",
        "",
        f"Class: `roemetry.stages.{interface.__name__}`. What is true of every stage stands under "
        "[Conformance](../conformance.md); the records under [Records](../records.md).",
        "",
        "## Verbs",
        "",
        *(line for verb in verbs for line in _verb(verb)),
        "## What it must keep",
        "",
        "Each line is a check of `roemetry check-plugin`.",
        "",
        "| check | what a stage must keep |",
        "|---|---|",
        *(f"| `{name_of(check)}` | {sentence_of(check)} |" for check in OF_KIND[kind]),
        "",
        "## Stages that come with roemetry",
        "",
        "| stage | what it does |",
        "|---|---|",
        *stages,
        "",
    ]
    return "\n".join(parts)


def main() -> None:
    """Write all pages into the folder that the command line names."""
    folder, registry = Path(sys.argv[1]), discover()
    for kind in KINDS:
        (folder / f"{kind}.md").write_text(contract(kind, registry), encoding="utf-8")


def _verb(member: Any) -> list[str]:
    function: Callable[..., Any] = getattr(member, "__func__", member)
    must = "must be written" if getattr(function, "__isabstractmethod__", False) else "may be written anew"
    parameters = re.sub(r"(: |-> )'([^']+)'", r"\1\2", str(inspect.signature(function)))
    return [
        f"### `{function.__name__}`, {must}",
        "",
        "```text",
        f"def {function.__name__}{parameters}",
        "```",
        "",
        _prose(inspect.getdoc(function) or ""),
        "",
    ]


def _prose(text: str) -> str:
    """Turn a docstring's sections into Markdown."""
    lines: list[str] = []
    given = text.splitlines()
    for line, following in zip(given, [*given[1:], ""], strict=True):
        if re.fullmatch(r"-{3,}", line):
            lines[-1] = f"{lines[-1]}:\n"
        elif line.startswith("    "):
            lines.append(f"    {line.strip()}" if lines[-1].startswith("    ") else f"  {line.strip()}")
        elif following.startswith("    "):
            lines.append(f"- `{line}`:")
        else:
            lines.append(line)
    return "\n".join(lines)


def _section(title: str, checks: Iterable[Check]) -> str:
    rows = [f"| `{name_of(check)}` | {sentence_of(check)} |" for check in checks]
    return "\n".join([f"### {title}", "", "| check | what a stage must keep |", "|---|---|", *rows, ""])


if __name__ == "__main__":
    main()
