"""``roemetry fit-weight``, ``fit-classifier``, ``check-weight``: tables of products whose answer is known."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from roemetry.cli.options import out_option

if TYPE_CHECKING:
    from roemetry.records import Fitted


def fit_weight(
    data: Annotated[Path, typer.Argument(help="Table (CSV) of what was measured, one row per product.")],
    weights: Annotated[
        Path | None,
        typer.Option(
            "--weights",
            help="Table of `id` (or `acquisition`) and `mass_g`, optionally `mass_std_g`; only "
            "products named there are used; default: DATA's column `mass_g`.",
        ),
    ] = None,
    out: Annotated[Path, out_option("File to write; the weigher's option `model` names it.")] = Path(
        "weight.json"
    ),
    form: Annotated[
        str,
        typer.Option(
            "--form",
            help="Model; auto: the best one on held-out products, among equals the simplest.",
        ),
    ] = "auto",
    weigher: Annotated[str, typer.Option("--weigher", help="Name of the weigher that learns.")] = "fitted",
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Learn masses from weighed products; test on held-out products.

    Exit code: 0 written; 1 the table cannot be learned from; 2 a cell or the command line is wrong.
    """
    from roemetry.calibrating.known_products import read_weighed
    from roemetry.stages.registry import discover

    registry = discover()
    stage = registry.load(registry.find("weigher", weigher))
    fitted = stage.fit(read_weighed(data, weights), form=form)
    _keep(fitted, out)


def fit_classifier(
    data: Annotated[Path, typer.Argument(help="Table (CSV) of features, one row per product.")],
    labels: Annotated[
        Path | None,
        typer.Option(
            "--labels",
            help="Table of `id` (or `acquisition`) and `label`; only products named there are "
            "used; default: DATA's column `label`.",
        ),
    ] = None,
    good: Annotated[
        str,
        typer.Option(
            "--good",
            help="The class of good products: a limit for its probability is chosen on held-out products.",
        ),
    ] = "",
    out: Annotated[Path, out_option("File to write; the classifier's option `model` names it.")] = Path(
        "classifier.json"
    ),
    begin: Annotated[
        Path | None,
        typer.Option(
            "--begin",
            help="A model trained elsewhere, such as a recipe's: it is adapted to these products and "
            "tested on them, instead of learned from them alone.",
        ),
    ] = None,
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
    """Learn classes from five good products or more; state what a sample of that size can promise.

    Exit code: 0 written; 1 the table cannot be learned from; 2 the command line is wrong.
    """
    from roemetry.calibrating.known_products import read_samples
    from roemetry.stages.registry import discover

    registry = discover()
    stage = registry.load(registry.find("classifier", classifier))
    fitted = stage.fit(read_samples(data, labels), good=good, smoothing_mm=smoothing_mm, begin=begin)
    _keep(fitted, out)


def _keep(fitted: Fitted, out: Path) -> None:
    """Write what was learned, and tell how well it did."""
    from roemetry.io.files import write_whole

    write_whole(out, fitted.content)
    for sentence in fitted.words:
        typer.echo(sentence)
    for name, value in fitted.figures.items():
        typer.echo(f"  {name}: {value:.4g}")
    typer.echo(f"{out}")


def check_weight(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    scale: Annotated[Path, typer.Argument(help="Table (CSV) of `id` and `mass_g`: what a scale said.")],
    tolerance: Annotated[
        float, typer.Option("--tolerance", min=0.0, max=1.0, help="Bias that is tolerated, as a fraction.")
    ] = 0.01,
    as_json: Annotated[bool, typer.Option("--json", help="Print the check as JSON.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Compare a run's weights with a scale's, and say whether to fit them again.

    Exit code: 0 they hold, or there are too few to tell; 1 fit again, or the tables cannot be compared; 2 a
    cell or the command line is wrong.
    """
    from roemetry.calibrating.known_products import read_weights
    from roemetry.calibrating.weight_check import WeighedPair, check_weights
    from roemetry.io.files import json_values
    from roemetry.run.record import read_record

    known = read_weights(scale)
    pairs = [
        WeighedPair(row.id, row.weight.mass_g.value, row.weight.mass_g.std, *known[row.id])
        for row in read_record(run)
        if row.id in known and row.weight is not None and math.isfinite(row.weight.mass_g.value)
    ]
    check = check_weights(pairs, tolerance)
    if as_json:
        typer.echo(json.dumps(json_values(check._asdict()), indent=2))
    else:
        typer.echo(f"{check.verdict}: {check.pairs} products weighed by both")
        typer.echo(f"  line over scale {check.bias_share:+.2%}, scatter {check.scatter_share:.2%}")
        if not math.isnan(check.within_share):
            typer.echo(f"  within 1.96 stated uncertainties {check.within_share:.0%}")
        for sentence in check.words:
            typer.echo(f"  {sentence}")
    if check.verdict == "refit":
        raise typer.Exit(1)
