"""``roemetry fit-classifier``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def fit_classifier(
    data: Annotated[Path, typer.Argument(help="Table (CSV) of features, a line a product.")],
    labels: Annotated[
        Path | None,
        typer.Option(
            "--labels",
            help="Table of `id` (or `acquisition`) and `label`; only products named there are "
            "taken; left out: DATA's column `label`.",
        ),
    ] = None,
    good: Annotated[
        str,
        typer.Option(
            "--good",
            help="The class of good products: a limit for its probability is chosen on held-out products.",
        ),
    ] = "",
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File to write; the classifier's option `model` names it.")
    ] = Path("classifier.json"),
    classifier: Annotated[
        str, typer.Option("--classifier", help="Name of the classifier that learns.")
    ] = "learned",
    smoothing_mm: Annotated[
        float,
        typer.Option(
            "--smoothing-mm",
            min=0.0,
            help="Window the features were measured with, mm; stored with the model.",
        ),
    ] = 3.0,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Learn classes from five good products on, or from hundreds; say what so many can promise.

    Exit code: 0 written; 1 the table cannot be learned from; 2 the command line is wrong.
    """
    from roemetry.calibrating.known_products import read_samples
    from roemetry.io.files import write_whole
    from roemetry.stages.registry import discover

    registry = discover()
    stage = registry.load(registry.find("classifier", classifier))
    fitted = stage.fit(read_samples(data, labels), good=good, smoothing_mm=smoothing_mm)
    write_whole(out, fitted.content)
    for sentence in fitted.words:
        typer.echo(sentence)
    for name, value in fitted.figures.items():
        typer.echo(f"  {name}: {value:.4g}")
    typer.echo(f"{out}")
