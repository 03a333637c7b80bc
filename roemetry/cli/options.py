"""Options that many verbs have, each with a help of its own, and where results go without one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer


def set_option(told: str) -> Any:
    """Give ``--set KEY=VALUE``, which may be given several times."""
    return typer.Option("--set", metavar="KEY=VALUE", help=f"{told}; may be given several times.")


def out_option(told: str) -> Any:
    """Give ``--out``."""
    return typer.Option("--out", "-o", help=told)


def next_folder(recipe: Path, ending: str = "") -> Path:
    """Give the first results folder of a recipe's name that is not there yet."""
    path = recipe.resolve()
    name = (path.parent.name if path.stem == "recipe" else path.stem) + ending
    number = 1
    while (folder := Path("results") / f"{name}-{number}").exists():
        number += 1
    return folder
