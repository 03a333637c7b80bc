"""Tables of the reference pages that the code itself gives: verbs, keys of a recipe, contracts of stages.

``python -m docs.reference_tables docs/reference`` writes them anew: between the marks in the pages, and the
pages of the kinds whole.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from typer import Typer
from typer.models import ArgumentInfo, OptionInfo

from roemetry.cli.main import app, load_verb, plugin_verbs
from roemetry.config.recipe_file import NEEDS, RecipeFile, SensorFile, SourceChoice, StageChoice, StageChoices
from roemetry.stages import INTERFACES
from roemetry.stages.hookspecs import KINDS
from roemetry.stages.registry import Registry, discover
from roemetry.testing.checks import ANY, OF_KIND, OF_PATTERN, Check, name_of, sentence_of

_BLOCK = re.compile(r"(<!-- from the code: (.+?) -->\n)(.*?)(<!-- to here -->)", flags=re.DOTALL)
# what a help text says of a default that is no plain value; `--help` shows it at the end
_LEFT_OUT = re.compile(r"; default: (?P<what>.+?)\.?$")


def rewritten(page: str) -> str:
    """Give a page's text with everything between its marks made anew.

    Parameters
    ----------
    page
        Text of a page with marks such as ``<!-- from the code: roemetry run -->`` and ``<!-- to here -->``.

    Returns
    -------
    str
        The same text, the tables between the marks as the code is now.
    """
    return _BLOCK.sub(lambda found: found[1] + "\n" + _made(found[2]) + "\n" + found[4], page)


def verbs() -> dict[str, Callable[..., Any]]:
    """Give each command's function, in the order in which the help lists them."""
    functions = [command.callback for command in app.registered_commands if command.callback is not None]
    own = {function.__name__.replace("_", "-"): function for function in functions}
    for name, entry in plugin_verbs().items():
        loaded = load_verb(entry)
        parts = loaded.registered_commands if isinstance(loaded, Typer) else ()
        own |= {
            f"{name} {part.callback.__name__}": part.callback for part in parts if part.callback is not None
        }
        if not parts:
            own.setdefault(name, loaded)
    return own


def main() -> None:
    """Write the tables of every page in the folder that the command line names."""
    for path in sorted(Path(sys.argv[1]).glob("*.md")):
        text = path.read_text("utf-8")
        if _BLOCK.search(text):
            path.write_text(rewritten(text), encoding="utf-8")
    registry = discover()
    for kind in KINDS:
        page = Path(sys.argv[1]) / "contracts" / f"{kind}.md"
        page.write_text(contract(kind, registry), encoding="utf-8")


def _made(what: str) -> str:
    if what == "verbs":
        return _table(
            ["command", "does"],
            (
                [f"[`{name}`]({_anchor(name)})", _plain(_first(inspect.getdoc(verb) or ""))]
                for name, verb in verbs().items()
            ),
        )
    if what == "keys of a recipe":
        return _keys(RecipeFile, "")
    if what == "keys of a source":
        return _keys(SourceChoice, "source.", (SensorFile, "source.sensor."))
    if what == "keys of a choice":
        return _keys(StageChoice, "")
    if what == "stages":
        return _stages()
    return _verb(what.removeprefix("roemetry "))


def _anchor(name: str) -> str:
    return f"#roemetry-{name.replace(' ', '-')}"


def _verb(name: str) -> str:
    usage, rows = ["roemetry", name], []
    function = verbs()[name]
    hints = get_type_hints(function, include_extras=True)
    for parameter in inspect.signature(function).parameters.values():
        annotation, info = get_args(hints[parameter.name])[:2]
        if isinstance(info, ArgumentInfo):
            called = parameter.name.upper()
            many = "..." if "list" in str(annotation) else ""
            usage.append(f"{called}{many}" if parameter.default is parameter.empty else f"[{called}]{many}")
            rows.append([f"`{called}`", *_meaning(annotation, info, parameter.default)])
        else:
            ways = _listed(way for way in (info.default, *(info.param_decls or ())) if isinstance(way, str))
            rows.append([ways, *_meaning(annotation, info, parameter.default)])
    rows.append(["`--help`, `-h`", "", "show the help"])
    return f"```\n{' '.join([*usage, '[OPTIONS]'])}\n```\n\n" + _table(["", "default", "means"], rows)


def _meaning(annotation: Any, info: ArgumentInfo | OptionInfo, default: Any) -> list[str]:
    """Give the cells for a parameter's default and its meaning, with the values that are legal."""
    told = info.help or ""
    left_out = _LEFT_OUT.search(told)
    if left_out is not None:
        shown, told = left_out["what"], told[: left_out.start()]
    elif default is inspect.Parameter.empty:
        shown = "required"
    elif annotation is bool:
        shown = "off"
    else:
        shown = "" if default in (None, "") else f"`{_value(default)}`"
    legal: Any = get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        legal = [_value(one) for one in annotation]
    if legal and all(isinstance(one, str) for one in legal):
        told = f"{told.rstrip('.')} ({_listed(legal)})"
    return [shown, _plain(told) + _range(info.min, info.max)]


def _keys(model: type[BaseModel], before: str, *inner: tuple[type[BaseModel], str]) -> str:
    rows = list(_rows(model, before))
    for part, prefix in inner:
        place = next(index for index, row in enumerate(rows) if row[0] == f"`{prefix[:-1]}`")
        rows[place + 1 : place + 1] = _rows(part, prefix)
    return _table(["key", "default", "means"], rows)


def _rows(model: type[BaseModel], before: str) -> Iterator[list[str]]:
    for name, field in model.model_fields.items():
        yield [f"`{before}{name}`", _default(field), _told(field)]
        if model is RecipeFile and name == "calibration_check":
            yield from _rows(_section(field), f"{before}{name}.")


def _section(field: FieldInfo) -> type[BaseModel]:
    parts: tuple[type[BaseModel], ...] = get_args(field.annotation)
    return next(part for part in parts if issubclass(part, BaseModel))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if default is None:
        return "none"
    if isinstance(default, list):
        return f"`[{', '.join(one.use for one in default)}]`"
    return f"`{default}`"


def _told(field: FieldInfo) -> str:
    annotation = field.annotation
    legal = get_args(annotation) if get_origin(annotation) is Literal else ()
    told = _plain(field.description or "")
    if legal:
        told += f" ({_listed(str(one) for one in legal)})"
    low: Any = None
    high: Any = None
    above = False
    for bound in field.metadata:
        if isinstance(bound, annotated_types.Gt):
            low, above = bound.gt, True
        elif isinstance(bound, annotated_types.Ge):
            low = bound.ge
        elif isinstance(bound, annotated_types.Le):
            high = bound.le
    return told + (f" (above {low})" if above else _range(low, high))


def _stages() -> str:
    rows = []
    for kind, field in StageChoices.model_fields.items():
        needed = "required" if field.is_required() else "optional"
        after = f"`{NEEDS[kind]}`" if kind in NEEDS else ""
        rows.append([f"`stages.{kind}`", needed, after, _plain(field.description or "")])
    return _table(["key", "", "needs", "does"], rows)


def _table(head: list[str], rows: Any) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(line.replace("|  |", "| |") for line in lines) + "\n"


def _range(low: Any, high: Any) -> str:
    if low is None:
        return ""
    return f" ({low:g} or more)" if high is None else f" ({low:g} to {high:g})"


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _value(value: Any) -> str:
    return str(getattr(value, "value", value))


def _first(text: str) -> str:
    return text.split("\n\n")[0].replace("\n", " ")


def _plain(text: str) -> str:
    """Make a sentence of the help a cell: no capital at its start, no full stop at its end."""
    text = " ".join(text.split()).rstrip(".")
    begins_with_a_name = text[1:2].isupper() or text.startswith(("Monte Carlo", "`"))
    return text if begins_with_a_name else text[:1].lower() + text[1:]


def markdown() -> str:
    """Write a heading and a table for the checks of every stage, and of each kind."""
    parts = [_checks("Every stage", ANY)]
    parts += [_checks(kind.capitalize(), checks) for kind, checks in OF_KIND.items()]
    for pattern, light in (("dots", "dots"), ("grid", "a grid"), ("circles", "circles")):
        of_kind = OF_PATTERN[pattern].items()
        parts += [_checks(f"{kind.capitalize()} of {light}", checks) for kind, checks in of_kind]
    return "\n".join(parts)


def contract(kind: str, registry: Registry) -> str:
    """Write the page of a kind: its class, methods and checks, and the stages of that kind."""
    interface = INTERFACES[kind]
    methods = [
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
        f"Class: `roemetry.stages.{interface.__name__}`. Checks for all stages are listed under "
        "[Conformance](../conformance.md), records under [Records](../records.md).",
        "",
        "## Methods",
        "",
        *(line for one in methods for line in _method(one)),
        "## Checks",
        "",
        "`roemetry check-plugin` runs them.",
        "",
        "| check | what must be true |",
        "|---|---|",
        *(f"| `{name_of(check)}` | {sentence_of(check)} |" for check in OF_KIND.get(kind, ())),
        "",
        "## Stages that come with roemetry",
        "",
        "| stage | what it does |",
        "|---|---|",
        *stages,
        "",
    ]
    return "\n".join(parts)


def _method(member: Any) -> list[str]:
    function: Callable[..., Any] = getattr(member, "__func__", member)
    must = "required" if getattr(function, "__isabstractmethod__", False) else "optional"
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


def _checks(title: str, checks: Iterable[Check]) -> str:
    rows = [f"| `{name_of(check)}` | {sentence_of(check)} |" for check in checks]
    return "\n".join([f"### {title}", "", "| check | what must be true |", "|---|---|", *rows, ""])


if __name__ == "__main__":
    main()
