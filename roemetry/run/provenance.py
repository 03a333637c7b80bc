"""What a finished (or stopped) run was made with."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from roemetry.config.recipe import Recipe
from roemetry.errors import OutputError
from roemetry.run.record import PROVENANCE


def recipe_of(folder: Path, *, sets: Sequence[str] = ()) -> tuple[Recipe, dict[str, Any]]:
    """Load the recipe of a run again.

    Parameters
    ----------
    folder
        The run's folder.
    sets
        Further changes to the recipe, of what decides no number (its sinks).

    Returns
    -------
    tuple
        The recipe, and the run's provenance.

    Raises
    ------
    OutputError
        It is no folder of a run, or what decides its numbers has changed since.
    """
    path = folder / PROVENANCE
    try:
        provenance = json.loads(path.read_text(encoding="utf-8"))
        recipe_path, made_with = provenance["recipe"], provenance["sets"]
        recipe_sha256 = provenance["recipe_sha256"]
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be read: {error.strerror or error}", hint="name the folder of a run"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: damaged ({error})", hint="name the folder of a run") from error
    recipe = Recipe.load(recipe_path, sets=[*made_with, *sets])
    if recipe.sha256 != recipe_sha256:
        raise OutputError(
            f"{folder}: the recipe, calibration or a plugin has changed since the run",
            hint="the pictures would show something else than was measured; run again",
        )
    return recipe, provenance
