"""Stages chosen by a file: names first, against the registry, then the chosen stages' options."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from roemetry.config.validation import Place, checked
from roemetry.errors import RoemetryError
from roemetry.io.files import is_file, sha256_of
from roemetry.io.yaml_source import Step
from roemetry.stages import INTERFACES, Stage, StageOptions
from roemetry.stages.registry import Registered, Registry


class Choice(Protocol):
    """What a file says of a stage."""

    use: str
    options: dict[str, Any]


@dataclass(frozen=True, repr=False)
class ResolvedStage:
    """A stage that was chosen: who provides it, its class, its checked options."""

    registered: Registered
    stage: type[Stage[Any]]
    options: StageOptions

    def __repr__(self) -> str:
        """Give the plugin's name, and the options that differ from their defaults."""
        told = self.options.model_dump(mode="json", exclude_defaults=True)
        options = ", ".join(f"{name}: {value}" for name, value in told.items())
        return self.registered.entry.name + (f" ({options})" if options else "")

    def make(self) -> Any:
        """Make the stage."""
        return self.stage(self.options)

    def described(self) -> dict[str, Any]:
        """Name, provider with version, and every option with its value; of a file its name and its hash."""
        return dict(self._described)

    @cached_property
    def _described(self) -> dict[str, Any]:
        """Made once: every row of a run asks, and files are hashed for it."""
        options = self.options.model_dump(mode="json")
        for name, path in _paths(self.options).items():
            options[name] = f"{path.name} sha256 {sha256_of(path)}"
        return {
            "use": self.registered.entry.name,
            "provider": str(self.registered.provider),
            "options": options,
        }


class StageResolver:
    """Resolves a file's choices and collects every fault.

    `place` gives ``file:line:column`` of a path in the file; relative paths in options begin at `folder`.
    """

    def __init__(self, registry: Registry, place: Place, folder: Path) -> None:
        self.faults: list[str] = []
        self._registry = registry
        self._place = place
        self._folder = folder

    def choose(self, kind: str, choice: Choice, *at: Step) -> ResolvedStage | None:
        """Find, import and configure a stage that stands at a path of the file; None where that fails."""
        try:
            registered = self._registry.find(kind, choice.use)
            stage = self._registry.load(registered)
        except RoemetryError as error:
            self.fault(str(error), *at, "use")
            return None
        misfit = misfit_of(stage, kind)
        if misfit is not None:
            self.fault(f"{choice.use} of {registered.provider} cannot be used: {misfit}", *at)
            return None
        options, wrong = checked(stage.Options, choice.options, self._place, (*at, "options"))
        self.faults += wrong
        if options is None:
            return None
        files = {name: self._folder / path for name, path in _paths(options).items()}
        for name, path in files.items():
            if not is_file(path):
                self.fault(f"there is no file {path}", *at, "options", name)
        return ResolvedStage(registered, stage, options.model_copy(update=files) if files else options)

    def fault(self, sentence: str, *at: Step) -> None:
        """Note a fault at a path of the file."""
        self.faults.append(f"{self._place(at)}: {'.'.join(map(str, at))}: {sentence}")


def make_stage(kind: str, use: str, *, registry: Registry | None = None, **options: Any) -> Any:
    """Make one stage by name, without a recipe.

    Parameters
    ----------
    kind, use
        What a recipe says: ``volume``, ``slice-pchip``; ``roemetry plugins`` lists them.
    registry
        Stages to choose from; default: all that are installed.
    options
        Of the stage, by name; those left out have their defaults.

    Returns
    -------
    Stage
        With the method of its kind: ``extract``, ``code``, ``triangulate``, ``estimate``, ``weigh``, ….

    Raises
    ------
    ConfigurationError
        No such stage, or options that it does not have or that are out of range.
    """
    from roemetry.errors import ConfigurationError
    from roemetry.stages.registry import discover

    resolver = StageResolver(registry or discover(), lambda at: "make_stage", Path())
    chosen = resolver.choose(kind, _Given(use, options), kind)
    if chosen is None:
        raise ConfigurationError("\n".join(resolver.faults))
    return chosen.make()


def choice_of(kind: str, stage: Stage[Any], registry: Registry) -> dict[str, Any]:
    """Give what a recipe would say of a stage that was made; ConfigurationError where it is not installed."""
    from roemetry.errors import ConfigurationError

    target = f"{type(stage).__module__}:{type(stage).__qualname__}"
    found = next((one for one in registry.of_kind(kind) if one.entry.target == target), None)
    if found is None:
        raise ConfigurationError(
            f"{kind}: {type(stage).__name__} is no {kind} of an installed plugin",
            hint="`Pipeline(recipe, stages={...})` takes any object with the method of its kind",
        )
    return {"use": found.entry.name, "options": stage.options.model_dump()}


@dataclass
class _Given:
    use: str
    options: dict[str, Any]


def misfit_of(stage: type[Any], kind: str) -> str | None:
    """Say why a class cannot be a stage of a kind, and what its author has to do; None if it can."""
    interface = INTERFACES[kind]
    if not issubclass(stage, interface):
        return f"class {stage.__name__} does not inherit from `roemetry.stages.{interface.__name__}`"
    if stage.__abstractmethods__:
        lacking = ", ".join(f"`{name}`" for name in sorted(stage.__abstractmethods__))
        return f"class {stage.__name__} does not define {lacking}"
    return None


def _paths(options: StageOptions) -> dict[str, Path]:
    """Options that name files: those whose values are paths."""
    given = {name: getattr(options, name) for name in type(options).model_fields}
    return {name: value for name, value in given.items() if isinstance(value, Path)}
