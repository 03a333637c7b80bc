"""``roemetry tune``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def tune(
    recipe: Annotated[Path, typer.Argument(help="A recipe file, or a folder with a recipe.yaml in it.")],
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="Port on this machine; 0: any that is free.")
    ] = 0,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the web browser.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Adjust a recipe's options on a local web page, see at once what changes, and save the recipe.

    Only this machine can reach the page, and the page loads nothing from elsewhere.
    """
    import contextlib

    from roemetry_tools.tune.server import serve
    from roemetry_tools.tune.session import Session

    session = Session(recipe, debug=debug)
    session.warm_up()

    def ready(address: str) -> None:
        typer.echo(f"{session.path}: open {address} (Ctrl-C stops)")
        if show:
            import webbrowser

            webbrowser.open(address)

    with contextlib.suppress(KeyboardInterrupt):
        serve(session, port, ready)
