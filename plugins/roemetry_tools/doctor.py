"""``roemetry doctor``: what is installed and what is missing, and whether this machine gives its numbers."""

from __future__ import annotations

import csv
import json
import math
import os
import platform
import re
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from importlib import import_module
from importlib.metadata import PackageNotFoundError, packages_distributions, requires, version
from pathlib import Path
from typing import Annotated

import typer

from roemetry.cli.warm_up import warm_up
from roemetry.errors import ConfigurationError, RoemetryError
from roemetry.io.files import shipped
from roemetry.io.yaml_source import read
from roemetry.records import Measurement
from roemetry.run.api import Recipe
from roemetry.stages.hookspecs import PROJECT, Finding
from roemetry.stages.registry import Registry, discover

Row = tuple[float, float, float, str]
"""Visible volume (mm³), weight (g), largest height (mm), grade; NaN and "" where there is none."""

REFERENCE_VALUES = "reference_values.csv"
COLUMNS = ("id", "visible volume (mm³)", "weight (g)", "largest height (mm)", "grade")

_RELATIVE_MAX = 1e-4
"""Libraries and processors may add in another order; what differs by more is another result."""
_NOT_FOR_USERS = {"test", "docs", "benchmarks", "all"}


def doctor(
    file: Annotated[
        Path | None,
        typer.Argument(help="A file that describes what runs, such as a line file: what it names is tried."),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option(
            "--json",
            help="Print as JSON: a list of `what`, `verdict` (`ok`, `missing`, `wrong`), `found`, `remedy`.",
        ),
    ] = False,
    warm: Annotated[
        Path | None,
        typer.Option(
            "--warm", help="Only compile the kernels of this recipe, so that its first run is quick."
        ),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Check what is installed and what is missing, and whether this machine reproduces known results.

    With a line file: whether each camera, broker, server and database that it names is there.

    Exit code: 0 nothing is wrong (something optional may be missing); 2 something is.
    """
    if warm is not None:
        begin = time.perf_counter()
        stages = warm_up(
            Recipe.load(warm).stages,
            lambda done, of: typer.echo(f"compiled {done} of {of} kernels", err=True),
        )
        typer.echo(
            f"kernels of {', '.join(stages)}: ready in {time.perf_counter() - begin:.0f} s"
            if stages
            else "every kernel is ready"
        )
        return
    findings = []
    for finding in examine() if file is None else examine_file(file):
        findings.append(finding)
        if not as_json:
            _show(finding)
    if as_json:
        typer.echo(json.dumps([asdict(finding) for finding in findings], indent=2))
    wrong = sum(finding.verdict == "wrong" for finding in findings)
    if wrong:
        if not as_json:
            typer.echo(f"{wrong} wrong")
        raise typer.Exit(2)
    if not as_json:
        typer.echo("all well")


def _show(one: Finding) -> None:
    marks = {"ok": ("ok", "green"), "missing": ("missing", "yellow"), "wrong": ("WRONG", "red")}
    mark, colour = marks[one.verdict]
    typer.secho(f"{mark:7}", nl=False, fg=colour)
    typer.echo(f"  {one.what}: {one.found}" + (f"\n           → {one.remedy}" if one.remedy else ""))


def examine(registry: Registry | None = None) -> Iterator[Finding]:
    """Look at everything, the quick things first, and give each finding as soon as it is known."""
    registry = registry or discover()
    machine = f"Python {platform.python_version()}, {platform.platform()}, {os.cpu_count()} processors"
    yield Finding("roemetry", "ok", f"{version(PROJECT)}, {machine}")
    yield from _libraries()
    yield _one_opencv()
    yield from _llvm()
    yield from _plugins(registry)
    yield from _measured()


def examine_file(path: Path) -> Iterator[Finding]:
    """Let the plugin that knows files of this kind try what one names; ConfigurationError where none does."""
    data = read(path).data
    keys = list(data) if isinstance(data, Mapping) else []
    known = {verb.file_key: verb for verb in discover().verbs if verb.doctor}
    verb = next((known[key] for key in keys if key in known), None)
    if verb is None:
        raise ConfigurationError(
            f"{path}: the doctor does not know files of this kind",
            hint="it tries files that have the key " + " or ".join(f"`{key}`" for key in sorted(known)),
        )
    module, _, function = verb.doctor.partition(":")
    yield from getattr(import_module(module), function)(path)


def rows_of(recipe: Recipe) -> dict[str, Row]:
    """Measure a recipe, and give by id what reference values hold."""
    return {row.id: _numbers(row) for row in recipe.run()}


def _libraries() -> Iterator[Finding]:
    """The libraries roemetry stands on, and those that its extras name."""
    extras: dict[str, list[str]] = {}
    for line in requires(PROJECT) or ():
        name = re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0]
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)['\"]", line)
        if name != PROJECT and _for_this_machine(line):
            extras.setdefault(extra.group(1) if extra else "", []).append(name)
    for group, names in extras.items():
        if group in _NOT_FOR_USERS:
            continue
        missing = [name for name in names if _version(name) is None]
        found = ", ".join(f"{name} {_version(name) or 'not installed'}" for name in names)
        what = f"extra {group}" if group else "libraries"
        if not missing:
            yield Finding(what, "ok", found)
        elif group:
            yield Finding(what, "missing", found, f"pip install 'roemetry[{group}]', if you need it")
        else:
            yield Finding(what, "wrong", found, f"pip install {' '.join(missing)}")


def _for_this_machine(line: str) -> bool:
    """Leave out what a requirement's marker says is for other systems."""
    wanted = re.search(r"sys_platform\s*(==|!=)\s*['\"](\w+)['\"]", line)
    return wanted is None or (sys.platform == wanted.group(2)) == (wanted.group(1) == "==")


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _one_opencv() -> Finding:
    """Two packages that both bring `cv2` overwrite each other's files."""
    found = sorted(set(packages_distributions().get("cv2", [])))
    if len(found) <= 1:
        return Finding("OpenCV", "ok", f"from {', '.join(found) or 'nowhere'}")
    again = "pip install --force-reinstall opencv-contrib-python-headless"
    remedy = f"pip uninstall {' '.join(found)}; {again}"
    return Finding("OpenCV", "wrong", f"{', '.join(found)} overwrite each other", remedy)


def _llvm() -> Iterator[Finding]:
    """Mitsuba's package does not bring the library that compiles its kernels."""
    if _version("mitsuba") is None:
        return
    try:
        drjit = import_module("drjit")
        there = bool(drjit.has_backend(drjit.JitBackend.LLVM))
    except Exception as error:  # whatever a broken installation raises is what the doctor is asked for
        yield Finding("LLVM library", "missing", str(error), "pip install --force-reinstall mitsuba")
        return
    if there:
        yield Finding("LLVM library", "ok", "found: simulator mitsuba can compile its kernels")
    else:
        remedy = "install LLVM 15 or newer (apt install libllvm15), or set DRJIT_LIBLLVM_PATH to its file"
        yield Finding("LLVM library", "missing", "not found: simulator mitsuba cannot run", remedy)


def _plugins(registry: Registry) -> Iterator[Finding]:
    for broken in registry.broken:
        yield Finding(f"plugin {broken.provider}", "wrong", broken.why, "update it, or remove it")
    usable = 0
    for stage in registry.stages:
        what = f"{stage.entry.kind} {stage.entry.name}"
        same = [other for other in registry.of_kind(stage.entry.kind) if other.entry.name == stage.entry.name]
        if stage.missing is not None:
            yield Finding(what, "missing", stage.missing, "as said, if you need it")
            continue
        if len(same) > 1 and stage is same[0]:
            claims = " and ".join(str(other.provider) for other in same)
            yield Finding(what, "missing", f"claimed by {claims}", "say `use: provider/name` in recipes")
        try:
            registry.load(stage)
        except RoemetryError as error:
            yield Finding(what, "wrong", error.message, error.hint or "reinstall it")
        else:
            usable += 1
    yield Finding("plugins", "ok", f"{usable} of {len(registry.stages)} stages can be used")


def _measured() -> Iterator[Finding]:
    """Run the shipped recipe: kernels compile, a frame takes so long, and the numbers are the known ones."""
    seconds: list[float] = []
    found: dict[str, Row] = {}
    try:
        folder = shipped("recipes", "herring_roe")
        known = reference_values(folder)
        names = sorted({name.partition("#")[0] for name in known})
        for name in (names[0], *names):  # the first one twice: kernels are loaded with it
            recipe = Recipe.load(folder, sets=[f"source.path={folder / 'images' / f'{name}.png'}"])
            begin = time.perf_counter()
            found |= rows_of(recipe)
            seconds.append(time.perf_counter() - begin)
    # Whatever stops the shipped recipe is what the doctor is asked for.
    except Exception as error:
        said = str(error) if isinstance(error, RoemetryError) else f"{type(error).__name__}: {error}"
        yield Finding("shipped recipe", "wrong", said, "install roemetry, numba and numpy again")
        return
    first, again = seconds[0], min(seconds[1:])
    said = f"ready in {max(first - again, 0.0):.1f} s; then {1000 * again:.0f} ms from file to numbers"
    yield Finding("kernels", "ok", said)
    yield _compared(found, known)


def _compared(found: Mapping[str, Row], known: Mapping[str, Row]) -> Finding:
    worst, grades = 0.0, []
    for name, expected in known.items():
        got = found.get(name, (math.nan, math.nan, math.nan, "not measured"))
        for a, b in zip(got[:3], expected[:3], strict=True):
            if not (math.isnan(a) and math.isnan(b)):
                off = abs(a - b) / abs(b)
                worst = math.inf if math.isnan(off) else max(worst, off)
        if got[3] != expected[3]:
            grades.append(f"{name} is {got[3]}, expected {expected[3]}")
    if worst <= _RELATIVE_MAX and not grades:
        said = f"{len(known)} products; volume, weight and height within {worst:.0e} of the known ones"
        return Finding("shipped recipe", "ok", said)
    said = "; ".join([f"volume, weight or height off by up to {worst:.2%}", *grades])
    remedy = "compare `pip list` with a machine where it is right, and report this"
    return Finding("shipped recipe", "wrong", said, remedy)


def reference_values(folder: Path) -> dict[str, Row]:
    """Read a recipe's reference values; as `rows_of`."""
    with (folder / REFERENCE_VALUES).open(encoding="utf-8", newline="") as file:
        return {
            row["id"]: (*(float(row[name] or "nan") for name in COLUMNS[1:4]), row["grade"])  # type: ignore[misc]
            for row in csv.DictReader(file)
        }


def _numbers(row: Measurement) -> Row:
    return (
        math.nan if row.volume is None else row.volume.visible_mm3.value,
        math.nan if row.weight is None else row.weight.mass_g.value,
        row.height_max_mm.value,
        "" if row.grade is None else row.grade.label,
    )
