"""Which stages and commands are installed, who provides them, and what is wrong with those that fail.

A broken plugin costs one warning and one missing name, never the program. A name that two plugins claim is
refused until the recipe says whose it means: the order of a search path must not choose an algorithm.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import os
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

import pluggy

from roemetry.errors import FAULTS, PluginError, did_you_mean
from roemetry.stages.hookspecs import API, KINDS, PROJECT, Hooks, StageEntry, VerbEntry


@dataclass(frozen=True, slots=True)
class Provider:
    """The distribution and entry point that a stage comes from."""

    distribution: str
    version: str
    entry_point: str

    @property
    def name(self) -> str:
        """How a recipe names this provider."""
        return self.distribution if self.distribution != PROJECT else self.entry_point

    def __str__(self) -> str:
        return f"{self.distribution} {self.version} ({self.entry_point})"


@dataclass(frozen=True, slots=True)
class Broken:
    """A plugin that could not be loaded, and why."""

    provider: Provider
    why: str

    def __str__(self) -> str:
        return f"plugin {self.provider} cannot be used: {self.why}"


@dataclass(frozen=True, slots=True)
class Registered:
    """A stage and who provides it."""

    entry: StageEntry
    provider: Provider

    @property
    def missing(self) -> str | None:
        """Why it cannot be used on this machine, with what to do; None if it can."""
        for needed, remedy in self.entry.requires:
            if ".so" in needed:
                try:
                    ctypes.CDLL(needed)
                except OSError:
                    return f"needs the library {needed}; install it with `{remedy}`"
            elif importlib.util.find_spec(needed) is None:
                return f"needs the module {needed}; install it with `{remedy}`"
        return None


@dataclass(frozen=True, slots=True)
class Registry:
    """Every stage found, every plugin that failed, and the commands that plugins add to the command line."""

    stages: tuple[Registered, ...]
    broken: tuple[Broken, ...]
    verbs: tuple[VerbEntry, ...] = ()

    def of_kind(self, kind: str) -> tuple[Registered, ...]:
        """Give the stages of one kind."""
        return tuple(stage for stage in self.stages if stage.entry.kind == kind)

    def find(self, kind: str, use: str) -> Registered:
        """Find the stage that a recipe means by ``name`` or ``provider/name``.

        PluginError where there is no such name (with a close match) or two providers, or something it needs
        is missing.
        """
        wanted_provider, _, name = use.rpartition("/")
        found = [
            stage
            for stage in self.of_kind(kind)
            if stage.entry.name == name and wanted_provider in ("", stage.provider.name)
        ]
        if not found:
            raise self._unknown(kind, use)
        if len(found) > 1:
            whose = ", ".join(str(stage.provider) for stage in found)
            choice = " or ".join(f"`use: {stage.provider.name}/{name}`" for stage in found)
            raise PluginError(f"{kind} `{name}` is provided by {whose}", hint=f"say which: {choice}")
        missing = found[0].missing
        if missing is not None:
            raise PluginError(f"{kind} `{use}` {missing}")
        return found[0]

    def load(self, stage: Registered) -> type[Any]:
        """Import the class behind a stage; PluginError repeats the reason where that cannot be done."""
        module_name, _, class_name = stage.entry.target.partition(":")
        try:
            found = getattr(importlib.import_module(module_name), class_name)
        except FAULTS as error:
            raise PluginError(
                f"{stage.entry.kind} `{stage.entry.name}` of {stage.provider}: "
                f"`{stage.entry.target}` cannot be imported: {type(error).__name__}: {error}",
                hint="if the plugin is yours, mend its code, or `target` in its StageEntry; "
                "else reinstall it, or report this to its author",
            ) from error
        if not isinstance(found, type):
            raise PluginError(f"{stage.entry.target} of {stage.provider} is not a class")
        return found

    def _unknown(self, kind: str, use: str) -> PluginError:
        names = sorted({stage.entry.name for stage in self.of_kind(kind)})
        install = not_installed(use)
        if install is not None:
            return PluginError(f"there is no {kind} `{use}` yet", hint=install)
        parts = [meant] if (meant := did_you_mean(use, names)) else []
        parts += [
            f"`{use}` belongs under `{other.entry.kind}`" for other in self.stages if other.entry.name == use
        ]
        parts.append(f"installed: {', '.join(names) or 'none'}")
        parts += [str(broken) for broken in self.broken]
        return PluginError(f"there is no {kind} `{use}`", hint="; ".join(parts).replace("?; ", "? "))


def discover(found: Iterable[EntryPoint] | None = None) -> Registry:
    """Ask every installed plugin (or these entry points) for its stages.

    ``ROEMETRY_PLUGINS=""`` in the environment leaves out what does not come with roemetry itself;
    ``ROEMETRY_STRICT=1`` makes a broken plugin an error.
    """
    points = entry_points(group=PROJECT) if found is None else found
    only_built_in = os.environ.get("ROEMETRY_PLUGINS") == ""
    stages: list[Registered] = []
    verbs: list[VerbEntry] = []
    broken: list[Broken] = []
    for point in sorted(points, key=lambda p: (p.dist.name if p.dist else "", p.name)):
        provider = Provider(
            point.dist.name if point.dist else "unknown",
            point.dist.version if point.dist else "?",
            point.name,
        )
        if only_built_in and provider.distribution != PROJECT:
            continue
        try:
            entries, commands = _entries(point)
            stages += [Registered(entry, provider) for entry in entries]
            verbs += commands
        # Whatever a foreign module raises while it is imported must not stop the others.
        except FAULTS as error:
            why = str(error) if isinstance(error, PluginError) else f"{type(error).__name__}: {error}"
            broken.append(Broken(provider, why))
        except KeyboardInterrupt as error:
            raise PluginError(
                f"interrupted while the plugin {provider} was imported",
                hint="if nobody pressed Ctrl-C, the plugin did it itself: take it out",
            ) from error
    if broken and os.environ.get("ROEMETRY_STRICT") == "1":
        raise PluginError("; ".join(str(item) for item in broken), hint="ROEMETRY_STRICT=1 is set")
    stages.sort(key=lambda s: (KINDS.index(s.entry.kind), s.entry.name, s.provider.name))
    return Registry(tuple(stages), tuple(broken), tuple(verbs))


def not_installed(name: str) -> str | None:
    """Say how to install a package whose folder, by its path from here, was named; None if there is none."""
    try:
        project = tomllib.loads((Path(name) / "pyproject.toml").read_text(encoding="utf-8"))
        distribution(project["project"]["name"])
    except PackageNotFoundError:
        return f"the package in the folder {name} is not installed: `pip install -e {name}`"
    # A folder without a sound project is no plugin that waits to be installed.
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return None


def _entries(point: EntryPoint) -> tuple[list[StageEntry], list[VerbEntry]]:
    """Load one plugin in a plugin manager of its own, so that it cannot disturb another."""
    module: ModuleType = point.load()
    manager = pluggy.PluginManager(PROJECT)
    manager.add_hookspecs(Hooks)
    try:
        manager.register(module)
        manager.check_pending()
    except pluggy.PluginValidationError as error:
        raise PluginError(f"a hook is misspelt or has wrong arguments: {error}") from error
    verbs = [verb for result in manager.hook.roemetry_verbs() for verb in result]
    results = manager.hook.roemetry_stages()
    if not results and not verbs:
        raise PluginError(_without_stages(module, called=bool(manager.hook.roemetry_stages.get_hookimpls())))
    entries = [entry for result in results for entry in result]
    for entry in entries:
        if not isinstance(entry, StageEntry):
            raise PluginError(f"`roemetry_stages` gave a {type(entry).__name__}, expected StageEntry")
        if entry.kind not in KINDS:
            meant = did_you_mean(entry.kind, KINDS)
            said = f"stage `{entry.name}` is of the unknown kind `{entry.kind}`"
            raise PluginError(f"{said}; {meant}" if meant else said)
        if entry.api > API:
            raise PluginError(
                f"stage `{entry.name}` needs interface version {entry.api}, this roemetry has {API}: "
                "update roemetry"
            )
    for verb in verbs:
        if not isinstance(verb, VerbEntry):
            raise PluginError(f"`roemetry_verbs` gave a {type(verb).__name__}, expected VerbEntry")
    return entries, verbs


def _without_stages(module: ModuleType, *, called: bool) -> str:
    if called:
        return "its `roemetry_stages` gives nothing: `yield` a StageEntry, or return a list of them"
    mend = "put `@hookimpl` above it" if hasattr(module, "roemetry_stages") else "define it"
    return f"it implements no `roemetry_stages` hook: {mend} in {module.__name__}"
