"""The variants of a recipe: every combination of what is varied, each loaded or with the reason why not."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from roemetry.config.recipe import Recipe
from roemetry.config.validation import unknown_key
from roemetry.errors import ConfigurationError, PluginError, RoemetryError
from roemetry.stages import Stage
from roemetry.stages.registry import Registry
from roemetry_tools.compare.axes import Axis, read_axes

AS_IT_IS = "recipe"
"""Name of the first variant."""


@dataclass(frozen=True)
class Variant:
    """One recipe to compare.

    Attributes
    ----------
    number
        0 for the recipe as it is.
    name
        What differs from the recipe as it is.
    settings
        By axis, the value it has here; an option that its stage does not have is left out.
    recipe
        Loaded and checked; None where that was not possible.
    fault
        Why not.
    """

    number: int
    name: str
    settings: Mapping[str, str]
    recipe: Recipe | None
    fault: str = ""


def make_variants(
    path: Path, vary: Sequence[str], *, sets: Sequence[str] = (), registry: Registry
) -> tuple[Variant, ...]:
    """Make the recipe as it is, then every combination of what is varied, each once.

    An option that a stage does not have is not varied with that stage.

    Parameters
    ----------
    path
        The recipe.
    vary
        Each ``KIND=name,name`` or ``key.key=value,value``.
    sets
        Changes to all variants alike.
    registry
        What is installed.

    Raises
    ------
    ConfigurationError
        The recipe as it is is wrong, or a kind, a name or a key of `vary` is.
    """
    axes = read_axes(vary, registry)
    base = Recipe.load(path, sets=sets, registry=registry)
    _check_options(axes, base, registry)
    own = {axis.key: _value(base, axis) for axis in axes}
    variants = [Variant(0, AS_IT_IS, own, base)]
    known: set[object] = {base.sha256}
    for values in product(*(axis.values for axis in axes)):
        chosen = _that_apply(list(zip(axes, values, strict=True)), base, registry)
        changed = [(axis, value) for axis, value in chosen if not _is_own(axis, value, base, registry)]
        kept = [text for axis, value in changed for text in _kept(axis, value, base, registry)]
        variant = _variant(path, sets, chosen, changed, kept, registry)
        same = tuple(variant.settings.items()) if variant.recipe is None else variant.recipe.sha256
        if same not in known:
            known.add(same)
            variants.append(replace(variant, number=len(variants)))
    return tuple(variants)


def _that_apply(chosen: list[tuple[Axis, str]], base: Recipe, registry: Registry) -> list[tuple[Axis, str]]:
    """Leave out options that the chosen stage of their kind does not have."""
    uses = {axis.key: value for axis, value in chosen if axis.is_stage}
    return [(axis, value) for axis, value in chosen if _applies(axis, uses, base, registry)]


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
        stages: list[type[Stage[Any]]] = []
        for other in axes:
            if other.is_stage and other.key == kind:
                stages += _classes(kind, other.values, registry)
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
