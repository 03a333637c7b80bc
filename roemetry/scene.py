"""The scene file: which simulator, with which options; what ``roemetry simulate`` makes images from."""

from __future__ import annotations

import hashlib
import json
import string
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from roemetry.choosing import Chooser, Chosen
from roemetry.errors import ConfigurationError, RoemetryError
from roemetry.overrides import Overridden
from roemetry.recipe_file import Choice, Section
from roemetry.registry import Registry, discover
from roemetry.stages import Simulator
from roemetry.validation import checked
from roemetry.yaml_source import read


class SceneFile(Section):
    """What a scene file says."""

    roemetry_scene: Literal[1] = Field(description="version of the scene format")
    name: str = Field(min_length=1, description="what to call the data set")
    licence: str = Field(min_length=1, description="licence of the data set (SPDX identifier)")
    item: str = Field(
        default="item_{number:06d}", description="id of an item; {number} counts from 1, e.g. {number:03d}"
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
    """A checked scene file, its simulator imported.

    Attributes
    ----------
    path, sets
        The file, and the changes made to it.
    file
        What it says.
    simulator
        The chosen simulator and its options.
    place
        ``file:line:column`` of the simulator's options.
    """

    path: Path
    sets: tuple[str, ...]
    file: SceneFile
    simulator: Chosen
    place: str

    @classmethod
    def load(cls, path: Path | str, *, sets: Sequence[str] = (), registry: Registry | None = None) -> Scene:
        """Read and check a scene file; raise ConfigurationError with every fault, each with its place."""
        path = Path(path)
        path = path / "scene.yaml" if path.is_dir() else path
        document = Overridden(read(path), sets)
        data = _files_beside(document.data, path.parent)
        file, faults = checked(SceneFile, data, document.place)
        if file is None:
            raise ConfigurationError(faults)
        chooser = Chooser(registry or discover(), document.place, path.parent)
        simulator = chooser.choose("simulator", file.simulator, "simulator")
        if chooser.faults or simulator is None:
            raise ConfigurationError(chooser.faults)
        return cls(path, tuple(document.sets), file, simulator, document.place(("simulator", "options")))

    def make(self) -> Simulator[Any]:
        """Make the simulator; raise ConfigurationError, with the place, for a scene that cannot be."""
        try:
            made: Simulator[Any] = self.simulator.make()
        except RoemetryError as error:
            raise ConfigurationError(
                f"{self.place}: simulator.options: {error.message}", hint=error.hint
            ) from error
        return made

    def resolved(self) -> dict[str, Any]:
        """Everything that decides an image, with defaults filled in, as a scene file again."""
        return {
            **self.file.model_dump(mode="json", exclude={"simulator"}),
            "simulator": {
                "use": self.file.simulator.use,
                "options": self.simulator.options.model_dump(mode="json"),
            },
        }

    @cached_property
    def sha256(self) -> str:
        """Hash of all that decides an image, but the seed."""
        deciding = {"provider": str(self.simulator.registered.provider), **self.resolved()}
        return hashlib.sha256(json.dumps(deciding, sort_keys=True).encode()).hexdigest()


def _files_beside(data: Any, folder: Path) -> Any:
    """Make the file of a product, which a scene names relative to itself, a path from here."""
    try:
        options = data["simulator"]["options"]["product"]["options"]
        name = options["file"]
    except (TypeError, KeyError):
        return data
    if isinstance(name, str) and not Path(name).is_absolute():
        options["file"] = str(folder / name)
    return data
