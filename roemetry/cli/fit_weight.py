"""``roemetry fit-weight``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def fit_weight(
    data: Annotated[Path, typer.Argument(help="Table (CSV) of what was measured, a line a product.")],
    weights: Annotated[
        Path | None,
        typer.Option(
            "--weights",
            help="Table of `id` (or `acquisition`) and `mass_g`, maybe `mass_std_g`; only products "
            "named there are taken; left out: DATA's column `mass_g`.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File to write; the weigher's option `model` names it.")
    ] = Path("weight.json"),
    form: Annotated[
        str,
        typer.Option(
            "--form",
            help="Model; auto: the one that does best on held-out products, of like ones the plainest.",
        ),
    ] = "auto",
    weigher: Annotated[str, typer.Option("--weigher", help="Name of the weigher that learns.")] = "fitted",
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Learn masses from weighed products; judge on folds by product.

    Exit code: 0 written; 1 the table cannot be learned from; 2 a cell or the command line is wrong.
    """
    from roemetry.calibrating.known_products import read_weighed
    from roemetry.io.files import write_whole
    from roemetry.stages.registry import discover

    registry = discover()
    stage = registry.load(registry.find("weigher", weigher))
    fitted = stage.fit(read_weighed(data, weights), form=form)
    write_whole(out, fitted.content)
    for sentence in fitted.words:
        typer.echo(sentence)
    for name, value in fitted.figures.items():
        typer.echo(f"  {name}: {value:.4g}")
    typer.echo(f"{out}")
