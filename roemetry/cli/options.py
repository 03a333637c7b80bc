"""Options that many verbs have, each with a help of its own."""

from __future__ import annotations

from typing import Any

import typer


def set_option(told: str) -> Any:
    """Give ``--set KEY=VALUE``, which may stand several times."""
    return typer.Option("--set", metavar="KEY=VALUE", help=f"{told}; may stand several times.")


def out_option(told: str) -> Any:
    """Give ``--out``."""
    return typer.Option("--out", "-o", help=told)
