"""The variants of a recipe: every combination of what is varied, each loaded or with the reason why not.

What is varied (``--vary KEY=value,value``) is checked before anything is loaded.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from roemetry.config.recipe import Recipe
from roemetry.config.recipe_file import RecipeFile, SourceChoice, StageChoices
from roemetry.config.validation import unknown_key
from roemetry.errors import ConfigurationError, PluginError, RoemetryError
from roemetry.stages import Stage
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
    """One thing that is varied: a kind of stage, or a value by its dotted path in the recipe."""

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


AS_IT_IS = "recipe"
"""Name of the first variant."""


@dataclass(frozen=True)
class Variant:
    """One recipe to compare; number 0 is the recipe as it is, and `name` says what differs from it.

    `settings` has by axis the value here; an option that its stage does not have is left out. Where the
    recipe could not be loaded it is None, and `fault` says why.
    """

    number: int
    name: str
    settings: Mapping[str, str]
    recipe: Recipe | None
    fault: str = ""
    left_out: tuple[str, ...] = ()
    """Names of combinations that come to this recipe, too."""


class Space:
    """Everything that a recipe may be changed to.

    Each of `vary` is ``KIND=name,name`` or ``key.key=value,value``; an option that a stage does not have is
    not varied with that stage. `sets` change all variants alike.

    Raises
    ------
    ConfigurationError
        The recipe as it is is wrong, or a kind, a name or a key of `vary` is.
    """

    def __init__(self, path: Path, vary: Sequence[str], *, sets: Sequence[str], registry: Registry) -> None:
        self.axes = read_axes(vary, registry)
        base = Recipe.load(path, sets=sets, registry=registry)
        _check_options(self.axes, base, registry)
        self._path, self._sets, self._registry, self._base = path, sets, registry, base
        self.as_it_is = Variant(0, AS_IT_IS, {axis.key: _value(base, axis) for axis in self.axes}, base)

    def variant(self, values: Sequence[str]) -> Variant:
        """Make the variant of (axis,) values; its number is to be given."""
        base, registry = self._base, self._registry
        every = list(zip(self.axes, values, strict=True))
        uses = {axis.key: value for axis, value in every if axis.is_stage}
        chosen = [(axis, value) for axis, value in every if _applies(axis, uses, base, registry)]
        changed = [(axis, value) for axis, value in chosen if not _is_own(axis, value, base, registry)]
        kept = [text for axis, value in changed for text in _kept(axis, value, base, registry)]
        return _variant(self._path, self._sets, chosen, changed, kept, registry)


def make_variants(
    path: Path, vary: Sequence[str], *, sets: Sequence[str] = (), registry: Registry
) -> tuple[Variant, ...]:
    """Make the recipe as it is, then every combination of what is varied, each once; see `Space`."""
    space = Space(path, vary, sets=sets, registry=registry)
    variants = [space.as_it_is]
    known: dict[object, int] = {recipe_of(space.as_it_is): 0}
    for values in product(*(axis.values for axis in space.axes)):
        variant = space.variant(values)
        same = recipe_of(variant)
        if same not in known:
            known[same] = len(variants)
            variants.append(replace(variant, number=len(variants)))
            continue
        first = variants[known[same]]
        asked = ", ".join(f"{axis.key}={value}" for axis, value in zip(space.axes, values, strict=True))
        variants[first.number] = replace(first, left_out=(*first.left_out, asked))
    return tuple(variants)


def recipe_of(variant: Variant) -> object:
    """Give what two variants of one recipe have in common, and no others."""
    return tuple(variant.settings.items()) if variant.recipe is None else variant.recipe.sha256


def _applies(axis: Axis, uses: Mapping[str, str], base: Recipe, registry: Registry) -> bool:
    if axis.is_stage or axis.path[0] != "stages":
        return True
    kind, option = axis.path[1], axis.path[3]
    own = [base.stages[kind].stage] if kind in base.stages else []
    stages = _classes(kind, [uses[kind]], registry) if kind in uses else own
    return any(option in stage.Options.model_fields for stage in stages)


def _variant(
    path: Path,
    sets: Sequence[str],
    chosen: Sequence[tuple[Axis, str]],
    changed: Sequence[tuple[Axis, str]],
    kept: Sequence[str],
    registry: Registry,
) -> Variant:
    settings = {axis.key: value for axis, value in chosen}
    name = ", ".join(_shown(axis, value, chosen) for axis, value in changed) or AS_IT_IS
    stages = [axis.change(value) for axis, value in changed if axis.is_stage]
    options = [axis.change(value) for axis, value in changed if not axis.is_stage]
    try:
        recipe = Recipe.load(path, sets=[*sets, *stages, *kept, *options], registry=registry)
    except RoemetryError as error:
        return Variant(-1, name, settings, None, _in_words_of_vary(str(error), changed))
    return Variant(-1, name, settings, recipe)


def _kept(axis: Axis, value: str, base: Recipe, registry: Registry) -> list[str]:
    """Give the recipe's options that say what the product is, where the stage put in its place has them."""
    if not axis.is_stage or axis.key not in base.stages:
        return []
    own = base.stages[axis.key].options
    given = own.model_dump(mode="json", include=set(own.about_product & own.model_fields_set))
    return [
        f"stages.{axis.key}.options.{name}={json.dumps(said)}"
        for stage in _classes(axis.key, [value], registry)
        for name, said in given.items()
        if name in stage.Options.about_product
    ]


def _shown(axis: Axis, value: str, chosen: Sequence[tuple[Axis, str]]) -> str:
    """Write a change as short as is clear."""
    if axis.is_stage:
        alone = sum(other.is_stage and named == value for other, named in chosen) == 1
        return value if alone else f"{axis.key} {value}"
    last = axis.path[-1]
    alone = sum(other.path[-1] == last for other, _ in chosen) == 1
    return f"{last if alone else axis.key}={value}"


def _is_own(axis: Axis, value: str, base: Recipe, registry: Registry) -> bool:
    """Tell whether a value is the recipe's own stage, whose options then stay."""
    if not axis.is_stage or axis.key not in base.stages:
        return False
    try:
        return registry.find(axis.key, value) == base.stages[axis.key].registered
    except PluginError:
        return False


def _value(recipe: Recipe, axis: Axis) -> str:
    """Give what the recipe as it is has at an axis."""
    if axis.is_stage:
        chosen = recipe.stages.get(axis.key)
        return "" if chosen is None else chosen.registered.entry.name
    if axis.path == ("calibration",):
        return "" if recipe.calibration_path is None else recipe.calibration_path.name
    node: Any = recipe.resolved()
    for step in axis.path:
        node = node.get(step) if isinstance(node, dict) else None
    if isinstance(node, float) and node.is_integer():
        node = int(node)
    return "" if node is None else str(node)


def _check_options(axes: Sequence[Axis], base: Recipe, registry: Registry) -> None:
    """Refuse an option that no compared stage of its kind has: it is a slip, not a variant."""
    faults = []
    for axis in axes:
        if axis.is_stage or axis.path[0] != "stages":
            continue
        kind, option = axis.path[1], axis.path[3]
        uses = [use for other in axes if other.key == kind for use in other.values]
        stages = _classes(kind, uses, registry)
        if kind in base.stages:
            stages.append(base.stages[kind].stage)
        elif not stages:
            faults.append(f"--vary {axis.key}: the recipe has no {kind}")
            continue
        known = list(dict.fromkeys(name for stage in stages for name in stage.Options.model_fields))
        if option not in known:
            said = unknown_key(option, known) if known else f"the {kind} has no options"
            faults.append(f"--vary {axis.key}: {said}")
    if faults:
        raise ConfigurationError(faults)


def _classes(kind: str, uses: Sequence[str], registry: Registry) -> list[type[Stage[Any]]]:
    found = []
    for use in uses:
        try:
            found.append(registry.load(registry.find(kind, use)))
        except PluginError:
            continue  # it becomes a failing variant, with its reason
    return found


def _in_words_of_vary(fault: str, changed: Sequence[tuple[Axis, str]]) -> str:
    """Name a fault's place by what was written on the command line."""
    for axis, value in changed:
        start = f"--set {'.'.join(axis.path)}="
        while start in fault:
            before, _, rest = fault.partition(start)
            after = rest[rest.index(": ") :] if ": " in rest else ""
            fault = before + axis.said(value) + after
    return fault


def read_axes(texts: Sequence[str], registry: Registry) -> tuple[Axis, ...]:
    """Read what is to be varied, whole stages first; commas inside brackets or quotes do not part values.

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
    keys = [name for name in RecipeFile.model_fields if name != "roemetry"]
    if path[0] not in RecipeFile.model_fields:
        return unknown_key(path[0], [*KINDS, *keys])
    for length in (1, 2):
        if path[:length] in _UNVARIED:
            return f"`{'.'.join(path[:length])}` cannot be varied: {_UNVARIED[path[:length]]}"
    if path[0] not in ("source", "stages"):
        return None if len(path) == 1 else unknown_key(path[1], [path[0]])
    known = tuple(SourceChoice.model_fields) if path[0] == "source" else KINDS
    if len(path) == 1:
        return f"say which: {', '.join(known)}"
    if path[1] not in known:
        return unknown_key(path[1], known)
    if path[0] == "source":
        return None if len(path) == 2 else unknown_key(path[2], [])
    if len(path) == 2:
        return f"write `{path[1]}=…` to exchange the whole stage"
    return unknown_key(path[2], ["options"]) if path[2] != "options" or len(path) == 3 else None


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
