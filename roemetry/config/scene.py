"""The scene file: which simulator, with which options; what ``roemetry simulate`` makes images from."""

from __future__ import annotations

import hashlib
import json
import string
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from roemetry.config.overrides import Overridden
from roemetry.config.pattern_file import PatternFile, read_pattern
from roemetry.config.recipe_file import Choice, Section
from roemetry.config.resolve import ResolvedStage, StageResolver
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError, RoemetryError
from roemetry.io.files import is_file, sha256_of
from roemetry.io.yaml_source import Step, read
from roemetry.stages import Simulator
from roemetry.stages.registry import Registry, discover

SCENE_FILES = "scene_files"
"""Folder of the files that a scene names, beside the scene that a data set keeps."""


class SceneFile(Section):
    """What a scene file says."""

    roemetry_scene: Literal[1] = Field(description="version of the scene format")
    name: str = Field(min_length=1, description="what to call the data set")
    licence: str = Field(min_length=1, description="licence of the data set (SPDX identifier)")
    item: str = Field(
        default="item_{number:06d}", description="id of an item; {number} counts from 1, e.g. {number:03d}"
    )
    pattern: str | PatternFile | None = Field(
        default=None,
        description="the light's pattern: a file, or the pattern itself; the simulator's laser is made of it",
    )
    simulator: Choice

    @field_validator("item")
    @classmethod
    def _counts(cls, item: str) -> str:
        try:
            fields = [name for _, name, _, _ in string.Formatter().parse(item) if name is not None]
            said = item.format(number=1)
        except (ValueError, KeyError, IndexError) as error:
            raise ValueError(f"not a pattern with {{number}} ({error})") from None
        if fields != ["number"] or not said.replace("-", "").replace("_", "").replace(".", "").isalnum():
            raise ValueError("expected letters, digits, -, _ and one {number}")
        return item


@dataclass(frozen=True)
class Scene:
    """A checked scene file, its simulator imported."""

    path: Path
    sets: tuple[str, ...]
    file: SceneFile
    simulator: ResolvedStage

    @classmethod
    def load(cls, path: Path | str, *, sets: Sequence[str] = (), registry: Registry | None = None) -> Scene:
        """Read and check a scene file; raise ConfigurationError with every fault, each with its place."""
        path = Path(path)
        path = path / "scene.yaml" if path.is_dir() else path
        document = Overridden(read(path), sets)
        data = document.data
        for at, name in _files_in(data):
            folder = Path() if document.place(at).startswith("--set ") else path.parent
            _put(data, at, str((folder / name).absolute()))
        file, faults = checked(SceneFile, data, document.place)
        if file is None:
            raise ConfigurationError(faults)
        if file.pattern is not None:
            try:
                drawn = read_pattern(file.pattern, path.parent).drawn_by(file.simulator)
            except RoemetryError as error:
                raise ConfigurationError(
                    f"{document.place(('pattern',))}: pattern: {error.message}", hint=error.hint
                ) from error
            file = file.model_copy(update={"pattern": None, "simulator": drawn})
        chooser = StageResolver(registry or discover(), document.place, path.parent)
        simulator = chooser.choose("simulator", file.simulator, "simulator")
        if chooser.faults or simulator is None:
            raise ConfigurationError(chooser.faults)
        return cls(path, tuple(document.sets), file, simulator)

    def make(self) -> Simulator[Any]:
        """Make the simulator; raise ConfigurationError, with the place, for a scene that cannot be."""
        try:
            made: Simulator[Any] = self.simulator.make()
        except RoemetryError as error:
            at = ("simulator", "options", *error.at)
            place = Overridden(read(self.path), self.sets).place(at)
            said = f"{place}: {'.'.join(map(str, at))}: {error.message}"
            raise ConfigurationError(said, hint=error.hint) from error
        return made

    def kept(self) -> tuple[dict[str, Any], dict[str, Path]]:
        """Give the scene as a file again, defaults filled in, and the files to lay beside it, by name."""
        return self._told(exclude_defaults=False)

    @cached_property
    def sha256(self) -> str:
        """Hash of all that decides an image, but seed and version.

        An option at its default is left out, so that the hash outlives options that come later.
        """
        deciding, files = self._told(exclude_defaults=True)
        for at, name in list(_files_in(deciding)):
            _put(deciding, at, sha256_of(files[name]) if is_file(files[name]) else "")
        return hashlib.sha256(json.dumps(deciding, sort_keys=True).encode()).hexdigest()

    def _told(self, *, exclude_defaults: bool) -> tuple[dict[str, Any], dict[str, Path]]:
        options = self.simulator.options.model_dump(mode="json", exclude_defaults=exclude_defaults)
        told = {
            **self.file.model_dump(
                mode="json", exclude={"simulator", "pattern"}, exclude_defaults=exclude_defaults
            ),
            "simulator": {"use": self.file.simulator.use, "options": options},
        }
        files: dict[str, Path] = {}
        for at, path in list(_files_in(told)):
            name = f"{SCENE_FILES}/{Path(path).name}"
            if files.get(name, Path(path)) != Path(path):
                name = f"{SCENE_FILES}/{len(files) + 1}-{Path(path).name}"
            files[name] = Path(path)
            _put(told, at, name)
        return told, files


def _files_in(data: Any) -> Iterator[tuple[Any, str]]:
    """Give every key called ``file`` among a simulator's options, and the path it names."""
    at = ("simulator", "options")
    for step in at:
        data = data.get(step) if isinstance(data, dict) else None
    waiting: list[tuple[tuple[Step, ...], Any]] = [(at, data)]
    while waiting:
        here, value = waiting.pop(0)
        if isinstance(value, dict):
            waiting += [((*here, key), below) for key, below in value.items()]
        elif isinstance(value, list):
            waiting += [((*here, index), below) for index, below in enumerate(value)]
        elif here[-1] == "file" and isinstance(value, str):
            yield here, value


def _put(data: Any, at: Sequence[Step], value: str) -> None:
    for step in at[:-1]:
        data = data[step]
    data[at[-1]] = value
