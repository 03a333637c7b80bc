"""Which block a check is made with."""

from __future__ import annotations

from pathlib import Path

from roemetry.errors import ConfigurationError
from roemetry.recipe import Recipe
from roemetry.records import Block
from roemetry.target_file import read_block


def block_of(recipe: Recipe, target: Path | None) -> Block:
    """Give the block described in a file, or else the one the recipe's calibration was made from.

    Raises
    ------
    ConfigurationError
        The file is at fault, or none is given and the calibration was made from something else.
    """
    if target is not None:
        given = read_block(target.name, target.parent)
        if given is not None:
            return given
    known = dict(recipe.calibration.target) if recipe.calibration is not None else {}
    if known.get("kind") != "block":
        raise ConfigurationError(
            "no block is described: the calibration was made from something else",
            hint="name the block's description with --target",
        )
    sides = ("length_mm", "width_mm", "height_mm", "tolerance_mm")
    return Block(str(known["name"]), *(float(known[side]) for side in sides))
