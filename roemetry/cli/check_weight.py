"""``roemetry check-weight``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated

import typer


def check_weight(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    scale: Annotated[Path, typer.Argument(help="Table (CSV) of `id` and `mass_g`: what a scale said.")],
    tolerance: Annotated[
        float, typer.Option("--tolerance", min=0.0, max=1.0, help="Bias that is let be, as a share.")
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
