"""The hooks a plugin may implement, and the records they yield.

A plugin package looks like this, whole::

    # my_plugin/__init__.py
    from roemetry.stages.hookspecs import StageEntry, hookimpl

    @hookimpl
    def roemetry_stages():
        yield StageEntry(
            kind="extractor",
            name="my-peaks",
            target="my_plugin.peaks:MyPeaks",
            summary="Centre of the brightest third",
            reference="our own",
        )

and in its pyproject.toml::

    [project.entry-points.roemetry]
    my-plugin = "my_plugin"

A hook registers and does nothing else: `target` is a word, and the class behind it is imported only when
a recipe uses it, so listing plugins stays cheap. A plugin that adds a command to ``roemetry`` yields a
`VerbEntry` from ``roemetry_verbs`` in the same way.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import pluggy

PROJECT = "roemetry"
API = 1

KINDS = (
    "source",
    "extractor",
    "aligner",
    "coder",
    "smoother",
    "calibrator",
    "triangulator",
    "assembler",
    "outliner",
    "volume",
    "weigher",
    "classifier",
    "grader",
    "sink",
    "simulator",
    "planner",
    "feed",
    "outlet",
)

Verdict = Literal["ok", "missing", "wrong"]

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@dataclass(frozen=True, slots=True)
class StageEntry:
    """One stage that a plugin offers."""

    kind: str
    """One of `KINDS`."""
    name: str
    """Kebab-case name that recipes use."""
    target: str
    """``package.module:Class``."""
    summary: str
    reference: str
    """Where the method comes from: a paper, an equation, "our own"."""
    requires: tuple[tuple[str, str], ...] = ()
    """Modules and shared libraries (``libNAME.so.N``) it needs beyond the core's, each with the line that
    installs it."""
    api: int = API
    """The version of this interface it was written for."""


@dataclass(frozen=True, slots=True)
class VerbEntry:
    """One command that a plugin adds to the command line: ``roemetry NAME``."""

    name: str
    target: str
    """``package.module:function``; the function's parameters are annotated as for `typer.Typer.command`. Or a
    `typer.Typer` with commands of its own."""
    summary: str
    """What it does, in one line: what ``roemetry --help`` lists. The function's docstring is the help of the
    command itself."""
    file_key: str = ""
    """First key of the files that the command takes, such as ``roemetry_line``; empty: it takes none."""
    doctor: str = ""
    """``package.module:function`` of what ``roemetry doctor FILE`` does with such a file: it takes the file's
    path and gives `Finding`s as they are known; a `RoemetryError` where the file itself is at fault."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that the doctor looked at, what was found, and what to do about it, if anything.

    ``missing``: something optional is not there; ``wrong``: numbers cannot be made or trusted.
    """

    what: str
    verdict: Verdict
    found: str
    remedy: str = ""


class Hooks:
    """The hooks a plugin may implement."""

    @hookspec
    def roemetry_stages(self) -> Iterable[StageEntry]:
        """Yield an entry for each stage the plugin offers."""
        raise NotImplementedError  # pragma: no cover - a specification is never called

    @hookspec
    def roemetry_verbs(self) -> Iterable[VerbEntry]:
        """Yield an entry for each command the plugin adds to the command line."""
        raise NotImplementedError  # pragma: no cover - a specification is never called
