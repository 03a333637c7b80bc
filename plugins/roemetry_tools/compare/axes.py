"""``--vary KEY=value,value``: what is varied, checked before anything is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from roemetry.config.recipe_file import RecipeFile, SourceChoice, StageChoices
from roemetry.config.validation import unknown_key
from roemetry.errors import ConfigurationError, PluginError
from roemetry.stages.registry import Registry

KINDS = tuple(StageChoices.model_fields)
"""Kinds of stage that can be varied, in the order of the chain."""

_SHARED: dict[tuple[str, ...], str] = {
    ("source", name): "all variants are compared on the same images; name them by --data or --set"
    for name in ("use", "path", "options", "bit_depth")
}
_UNVARIED = _SHARED | {
    ("roemetry",): "there is one version of the format",
    ("product",): "it decides no number",
    ("sinks",): "sinks decide no number",
}


@dataclass(frozen=True, slots=True)
class Axis:
    """One thing that is varied.

    Attributes
    ----------
    key
        A kind of stage, or the dotted path of a value in the recipe.
    values
        What it takes, as written on the command line.
    """

    key: str
    values: tuple[str, ...]

    @property
    def is_stage(self) -> bool:
        """Whether a whole stage is exchanged, not a value."""
        return self.key in KINDS

    @property
    def path(self) -> tuple[str, ...]:
        """Where in the recipe."""
        return ("stages", self.key) if self.is_stage else tuple(self.key.split("."))

    def change(self, value: str) -> str:
        """Write the change to the recipe, as ``--set`` takes it."""
        return f"{'.'.join(self.path)}={value}"

    def said(self, value: str) -> str:
        """Write the change as it was asked for."""
        return f"--vary {self.key}={value}"


def read_axes(texts: Sequence[str], registry: Registry) -> tuple[Axis, ...]:
    """Read what is to be varied, whole stages first.

    Parameters
    ----------
    texts
        Of the form ``extractor=dominant-peak,local-maximum`` or
        ``stages.extractor.options.threshold=15,60``. Commas inside brackets or quotes do not part values.
    registry
        What is installed.

    Raises
    ------
    ConfigurationError
        With every fault: a kind, a key or a stage nobody knows (with a close match), a value missing.
    """
    faults: list[str] = []
    axes: list[Axis] = []
    for text in texts:
        key, equals, rest = text.partition("=")
        axis = Axis(key.strip(), _parted(rest))
        fault = _fault(axis, bool(equals), registry)
        if fault is None and any(axis.key == other.key for other in axes):
            fault = f"`{axis.key}` is varied twice; give all its values at once"
        if fault is None:
            axes.append(axis)
        else:
            faults.append(f"--vary {text}: {fault}")
    if faults:
        raise ConfigurationError(faults)
    return tuple(sorted(axes, key=lambda axis: not axis.is_stage))


def _fault(axis: Axis, has_equals: bool, registry: Registry) -> str | None:
    if not has_equals or not axis.key:
        kinds = [found.entry.kind for found in registry.stages if found.entry.name == axis.key]
        mean = f"; did you mean `{kinds[0]}={axis.key}`?" if kinds else ""
        return f"expected KIND=name,name or key.key=value,value{mean}"
    if not axis.values or "" in axis.values:
        return "a value is missing"
    if not axis.is_stage:
        return _key_fault(axis.path)
    return next((fault for value in axis.values if (fault := _name_fault(axis.key, value, registry))), None)


def _key_fault(path: tuple[str, ...]) -> str | None:
    """Say what is wrong with the path of a value; options are checked with the stage that has them."""
    if path[0] not in RecipeFile.model_fields:
        return unknown_key(
            path[0], [*KINDS, *(name for name in RecipeFile.model_fields if name != "roemetry")]
        )
    for length in (1, 2):
        if path[:length] in _UNVARIED:
            return f"`{'.'.join(path[:length])}` cannot be varied: {_UNVARIED[path[:length]]}"
    if path[0] == "calibration":
        return None if len(path) == 1 else unknown_key(path[1], ["calibration"])
    known = tuple(SourceChoice.model_fields) if path[0] == "source" else KINDS
    if len(path) == 1 or path[1] not in known:
        return unknown_key(path[1], known) if len(path) > 1 else f"say which: {', '.join(known)}"
    if path[0] == "source":
        return None if len(path) == 2 else unknown_key(path[2], [])
    if len(path) == 2:
        return f"write `{path[1]}=…` to exchange the whole stage"
    if path[2] != "options":
        return unknown_key(path[2], ["options"])
    return None if len(path) > 3 else "say which option"


def _name_fault(kind: str, use: str, registry: Registry) -> str | None:
    """Say what is wrong with a stage's name; one that only lacks an extra is a failing variant, no fault."""
    try:
        registry.find(kind, use)
    except PluginError as error:
        provider, _, name = use.rpartition("/")
        found = [
            stage
            for stage in registry.of_kind(kind)
            if stage.entry.name == name and provider in ("", stage.provider.name)
        ]
        if len(found) != 1:
            return str(error)
    return None


def _parted(text: str) -> tuple[str, ...]:
    """Part at the commas that stand outside brackets and quotes."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        depth += (letter in "[{(") - (letter in ")}]") if not quote else 0
        if letter == "," and depth == 0 and not quote:
            parts.append("")
        else:
            parts[-1] += letter
    return tuple(part.strip() for part in parts) if text.strip() else ()
