"""``roemetry study gauge | accept | uncertainty | plan | key`` and ``roemetry verify``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from roemetry.cli.options import cluster_option, executor_of, out_option

if TYPE_CHECKING:
    from roemetry_study.certificate import Certificate

study = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Gauge studies, acceptance tests, uncertainty budgets, and plans for them.",
)


def _option(name: str, words: str, **more: Any) -> Any:
    return typer.Option(name, help=words, **more)


Out = Annotated[Path | None, out_option("Folder for the certificate: a JSON file and a page; default: none.")]
Key = Annotated[Path | None, _option("--key", "Private key that signs it: `roemetry study key` makes one.")]
Environment = Annotated[
    str, _option("--environment", "Temperature and whatever else matters, for the certificate.")
]
Jobs = Annotated[
    int, typer.Option("--jobs", "-j", min=1, help="Worker processes; the values are the same for any number.")
]
Cluster = Annotated[str | None, cluster_option()]
RunValue = Annotated[str, _option("--value", "Of a run: visible_cm3, true_cm3, mass_g or height_max_mm.")]
Debug = Annotated[bool, _option("--debug", "Show tracebacks.")]


class Method(StrEnum):
    """How variation is split."""

    anova = "anova"
    average_range = "average-range"


@study.command()
def gauge(
    sources: Annotated[
        list[Path],
        typer.Argument(help="A table (CSV: part, operator, trial and the value), or folders of runs."),
    ],
    value: Annotated[
        str,
        _option(
            "--value",
            "Column of the table; for runs: visible_cm3, true_cm3, mass_g, height_max_mm, grade, or a "
            "feature's name.",
        ),
    ],
    layout: Annotated[
        Path | None,
        _option(
            "--layout",
            "For runs: a table (CSV) of id, part, operator, trial, optionally run and reference.",
        ),
    ] = None,
    by: Annotated[
        str, _option("--by", "Column that says who or what measured: operator, head, …")
    ] = "operator",
    tolerance: Annotated[
        float | None, _option("--tolerance", "Width of the tolerance, in the value's unit.", min=0.0)
    ] = None,
    nested: Annotated[bool, _option("--nested", "Each operator had parts of their own.")] = False,
    method: Annotated[Method, _option("--method", "How variation is split.")] = Method.anova,
    good: Annotated[str, _option("--good", "For classes: the class of good parts.")] = "good",
    out: Out = None,
    key: Key = None,
    environment: Environment = "",
    debug: Debug = False,
) -> None:
    """Judge a gauge by repeated readings: variation, bias, linearity, stability, or agreement of classes.

    What the table holds decides: numbers of several parts give repeatability and reproducibility; references
    give bias and linearity; one part with a reference gives a type-1 study (with --tolerance); times give a
    control chart of each part; words give agreement.

    Exit code: 0 accepted, conditional, or nothing to decide; 1 not accepted, or the readings cannot be
    judged; 2 the command line or a table is wrong.
    """
    from roemetry_study.reports import of_classes, of_numbers
    from roemetry_study.table import read_table

    table = read_table(sources, value, layout, by)
    if table.is_numeric():
        width = math.nan if tolerance is None else tolerance
        made = of_numbers(table, tolerance=width, nested=nested, method=method.value, by=by)
    else:
        made = of_classes(table, good)
    _tell(replace(made, environment=environment), out, "gauge", key)


@study.command()
def accept(
    file: Annotated[
        Path, typer.Argument(help="The acceptance test (YAML): recipe, artefacts, images, limits.")
    ],
    out: Out = None,
    key: Key = None,
    jobs: Jobs = 1,
    cluster: Cluster = None,
    debug: Debug = False,
) -> None:
    """Test an instrument by artefacts against maximum permissible errors.

    Exit code: 0 accepted; 1 rejected, undecided, or an artefact cannot be measured; 2 a file is wrong.
    """
    from roemetry_study.reports import of_acceptance
    from roemetry_study.study_files import read_acceptance

    file = file if cluster is None else file.absolute()  # the workers stand in folders of their own
    made = of_acceptance(read_acceptance(file), file, executor_of(cluster, jobs))
    _tell(made, out, "acceptance", key)


@study.command()
def calibration(
    file: Annotated[Path, typer.Argument(help="A calibration that `roemetry calibrate` wrote.")],
    out: Out = None,
    key: Key = None,
    environment: Environment = "",
    debug: Debug = False,
) -> None:
    """Certify a calibration: residuals, and the uncertainty of heights over its range.

    Exit code: 0 usable; 1 it was accepted though refused; 2 the file is wrong.
    """
    from roemetry_study.reports import of_calibration

    _tell(of_calibration(file, environment), out, "calibration", key)


@study.command()
def uncertainty(
    source: Annotated[Path, typer.Argument(help="Folder of a run; or a measurement model (YAML).")],
    value: RunValue = "visible_cm3",
    references: Annotated[
        Path | None,
        _option(
            "--references", "Table (CSV) of id, value and std: your own reference values, to compare with."
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Show what an uncertainty is made of, what would halve it, and whether reference values confirm it.

    Exit code: 0 done; 1 the run states no uncertainty, or the comparison does not confirm it; 2 a file is
    wrong.
    """
    from roemetry_study import reports

    if source.is_dir():
        lines, confirmed = reports.of_run(source, value, references)
    else:
        lines, confirmed = reports.of_model(source), True
    for line in lines:
        typer.echo(line)
    if not confirmed:
        raise typer.Exit(1)


@study.command()
def plan(
    part_std: Annotated[
        float | None, _option("--part-std", "How much parts vary: standard deviation of the process.")
    ] = None,
    repeatability_std: Annotated[
        float | None,
        _option(
            "--repeatability-std", "How much readings of one part vary; default with --run: as it states."
        ),
    ] = None,
    operator_std: Annotated[
        float, _option("--operator-std", "How much operators or heads differ.", min=0.0)
    ] = 0.0,
    run: Annotated[
        Path | None,
        _option("--run", "Folder of a run: variation of its products, and the uncertainty it states."),
    ] = None,
    value: RunValue = "visible_cm3",
    half_width: Annotated[
        float | None,
        _option("--half-width", "Desired half width of the interval of %GRR, per cent.", min=0.0),
    ] = None,
    weigh_std: Annotated[
        float | None, _option("--weigh-std", "Scatter of mass over volume, as a fraction.", min=0.0)
    ] = None,
    weigh_half_width: Annotated[
        float, _option("--weigh-half-width", "Desired half width of their mean, as a fraction.", min=0.0)
    ] = 0.01,
    jobs: Jobs = 1,
    cluster: Cluster = None,
    debug: Debug = False,
) -> None:
    """Find out how many parts, operators, trials or weighed samples a study needs, by simulation.

    Exit code: 0 said; 1 the run states no uncertainty; 2 the command line is wrong.
    """
    from roemetry_study.reports import of_plan

    stds, weighing = (part_std, repeatability_std, operator_std), (weigh_std, weigh_half_width)
    for line in of_plan(*stds, run, value, half_width, *weighing, executor_of(cluster, jobs)):
        typer.echo(line)


@study.command()
def key(
    path: Annotated[Path, typer.Argument(help="File for the private key; keep it secret.")],
    debug: Debug = False,
) -> None:
    """Make a key that signs certificates, and print the public one.

    Exit code: 0 made; 1 the file is there already.
    """
    from roemetry_study.certificate import new_key

    typer.echo(new_key(path))


def verify(
    certificate: Annotated[Path, typer.Argument(help="The certificate's JSON file.")],
    signed_by: Annotated[
        str, _option("--signed-by", "Public key that must have signed it; default: any.")
    ] = "",
    page: Annotated[Path | None, _option("--page", "Its page, to be compared with the file.")] = None,
    debug: Debug = False,
) -> None:
    """Prove that a certificate is unchanged and who signed it.

    Exit code: 0 unchanged; 1 changed, unsigned, or signed by another key.
    """
    from roemetry_study.certificate import verify as check

    typer.echo(f"{certificate}: {check(certificate, signed_by, page).words}")


def _tell(made: Certificate, out: Path | None, name: str, key: Path | None) -> None:
    """Print a study, write its certificate, and end with its exit code."""
    from roemetry.errors import ConfigurationError
    from roemetry_study.certificate import write

    if key is not None and out is None:
        raise ConfigurationError(
            "--key signs a certificate, and none is written", hint="name a folder with --out"
        )
    for words in made.statements:
        typer.echo(words)
    for table in made.tables:
        typer.echo(f"\n{table.title}")
        _table(table.head, table.rows)
    if out is not None:
        for path in write(made, out, name, key):
            typer.echo(f"  {path}")
    if made.verdict in ("not accepted", "rejected", "undecided", "not capable", "not usable"):
        raise typer.Exit(1)


def _table(head: Sequence[str], rows: Sequence[Sequence[str | float | int]]) -> None:
    cells = [list(head), *([_cell(cell) for cell in row] for row in rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    for first, *rest in cells:
        aligned = [cell.rjust(width) for cell, width in zip(rest, widths[1:], strict=True)]
        typer.echo("  " + "  ".join([first.ljust(widths[0]), *aligned]))


def _cell(cell: str | float | int) -> str:
    if isinstance(cell, float):
        return "–" if math.isnan(cell) else f"{cell:.4g}"
    return str(cell)
