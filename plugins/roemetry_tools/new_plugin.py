"""``roemetry new-plugin``: the files of a plugin that works from the first minute."""

from __future__ import annotations

import importlib.util
import keyword
import re
from pathlib import Path
from string import Template
from typing import Annotated

import typer

from roemetry.errors import ConfigurationError, OutputError, did_you_mean
from roemetry.io.files import make_folder, write_whole
from roemetry.stages.hookspecs import KINDS
from roemetry.stages.registry import Registry, discover

_HERE = Path(__file__).parent / "templates" / "plugin"

TEMPLATES = {
    "source": "PNG files of a folder, one an acquisition",
    "extractor": "Centre of gravity of each run of pixels above a grey level",
    "coder": "The order of the peaks in rows that show every stripe",
    "smoother": "Mean over neighbouring rows, steps kept",
    "outliner": "Bright regions of the plain-light image",
    "volume": "Trapezoid rule along and across the stripes",
    "weigher": "Visible volume times one density",
    "classifier": "Flat or good by the highest point",
    "grader": "Small or large by weight, with a guard band",
    "sink": "A summary of the run as JSON",
}
"""By kind, what the stage does that a new plugin begins with."""

_NO_TEMPLATE = {
    "calibrator": "plugins/roemetry_paper/block_linear.py",
    "aligner": "plugins/roemetry_coding/belt_lines.py",
    "triangulator": "plugins/roemetry_paper/block_linear.py",
    "assembler": "plugins/roemetry_scan/placing.py",
    "simulator": "plugins/roemetry_simulate",
    "planner": "plugins/roemetry_simulate",
    "feed": "plugins/roemetry_line/feeds/folder_watch.py",
    "outlet": "plugins/roemetry_line/outlets/webhook.py",
}
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_USE = "stages:\n  {kind}: {stage}"
_USES = {
    "source": "source: {{use: {stage}, path: images}}",
    "sink": "sinks: [csv, {stage}]",
}


def new_plugin(
    name: Annotated[
        str, typer.Argument(help="Its name, e.g. my-peaks: lower-case letters, digits, hyphens.")
    ],
    kind: Annotated[str, typer.Option("--kind", "-k", help="Kind of its stage.")] = "extractor",
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Folder in which the package's folder is created."),
    ] = Path(),
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Write an installable plugin package: a working stage, and tests of the contract of its kind."""
    for file in write_plugin(name, kind, out, discover()):
        typer.echo(str(file))
    typer.echo(f"next: pip install -e '{out / name}[test]' && roemetry check-plugin {name}")


def write_plugin(name: str, kind: str, folder: Path, registry: Registry) -> tuple[Path, ...]:
    """Write an installable package with one working stage, and tests that hold it to its kind's contract.

    `name` is that of the distribution and of the stage; one that is taken in the registry is refused. The
    kind is one of `TEMPLATES`. Gives the files written.

    Raises
    ------
    ConfigurationError
        The name or the kind cannot be; with what can.
    OutputError
        The folder cannot be written.
    """
    _check_kind(kind)
    _check_name(name)
    home = folder / name
    if home.exists():
        raise ConfigurationError(
            f"{home} is there already: nothing was written",
            hint=f"go on with it (`pip install -e {home}`), or choose another name or another --out",
        )
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder} is a file", hint="--out names a folder")
    _check_free(name, kind, registry)
    package = name.replace("-", "_")
    words = {
        "distribution": name,
        "package": package,
        "module": kind,
        "stage": name,
        "kind": kind,
        "a_kind": f"an {kind}" if kind[0] in "aeiou" else f"a {kind}",
        "Class": "".join(part.capitalize() for part in name.split("-")),
        "summary": TEMPLATES[kind],
        "use": "In a recipe:\n\n```yaml\n" + _USES.get(kind, _USE).format(kind=kind, stage=name) + "\n```",
    }
    files = {
        "pyproject.toml": "pyproject.toml.txt",
        "README.md": "readme.md.txt",
        f"{package}/__init__.py": "init.py.txt",
        f"{package}/{kind}.py": f"stages/{kind}.txt",
        "tests/test_contract.py": "test_contract.py.txt",
    }
    written = []
    for target, template in files.items():
        text = Template((_HERE / template).read_text(encoding="utf-8")).substitute(words)
        make_folder((home / target).parent)
        write_whole(home / target, text)
        written.append(home / target)
    write_whole(home / package / "py.typed", "")
    return (*written, home / package / "py.typed")


def _check_kind(kind: str) -> None:
    if kind not in KINDS:
        hint = f"{did_you_mean(kind.lower(), TEMPLATES)} one of {', '.join(TEMPLATES)}".lstrip()
        raise ConfigurationError(f"there is no kind of stage `{kind}`", hint=hint)
    if kind not in TEMPLATES:
        raise ConfigurationError(
            f"there is no template for a {kind}",
            hint=f"start from {_NO_TEMPLATE[kind]} in roemetry's sources; templates: {', '.join(TEMPLATES)}",
        )


def _check_name(name: str) -> None:
    if keyword.iskeyword(name):
        raise ConfigurationError(
            f"{name!r} cannot be a plugin's name: it is a word of Python", hint=f"for example my-{name}"
        )
    if not _NAME.fullmatch(name):
        words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower()
        better = re.sub(r"[^a-z0-9]+", "-", words).strip("-")
        if not _NAME.fullmatch(better) or keyword.iskeyword(better):
            better = f"my-{better}" if _NAME.fullmatch(f"my-{better}") else "my-peaks"
        raise ConfigurationError(
            f"{name!r} cannot be a plugin's name",
            hint=f"a small letter, then small letters, digits and hyphens: `{better}`",
        )


def _check_free(name: str, kind: str, registry: Registry) -> None:
    for stage in registry.of_kind(kind):
        if stage.entry.name == name:
            raise ConfigurationError(
                f"there is a stage `{name}` of this kind already: {stage.provider}",
                hint="choose another name",
            )
    module = name.replace("-", "_")
    if importlib.util.find_spec(module) is not None:
        raise ConfigurationError(
            f"`{module}` is installed already as a Python module", hint="choose another name"
        )
