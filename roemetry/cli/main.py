"""The command line's entry: gathers the verbs, and turns errors into messages and exit codes."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from roemetry.cli import (
    calibrate,
    check_calibration,
    check_plugin,
    check_weight,
    compare,
    doctor,
    export,
    fit_classifier,
    fit_penetration,
    fit_weight,
    init,
    lint,
    new_plugin,
    plan,
    plugins,
    report,
    run,
    schema,
    simulate,
    target,
    tune,
)
from roemetry.errors import RoemetryError

app = typer.Typer(
    name="roemetry",
    help="Calibration and metrology for laser-stripe inspection of curved products.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line; a fault the user can mend is told without a traceback."""
    try:
        app()
    except RoemetryError as error:
        if "--debug" in sys.argv:
            raise
        sys.stderr.write(f"roemetry: {error}\n")
        sys.exit(error.exit_code)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # takes as long as the rest of this module

        typer.echo(f"roemetry {version('roemetry')}")
        raise typer.Exit


@app.callback()
def _options(
    show: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and stop."),
    ] = False,
) -> None:
    """Calibration and metrology for laser-stripe inspection of curved products."""


app.command()(init.init)
app.command()(run.run)
app.command()(calibrate.calibrate)
app.command()(lint.lint)
app.command()(plugins.plugins)
app.command()(report.report)
app.command()(export.export)
app.command()(simulate.simulate)
app.command()(compare.compare)
app.command()(check_plugin.check_plugin)
app.command()(new_plugin.new_plugin)
app.command()(check_calibration.check_calibration)
app.command()(check_weight.check_weight)
app.command()(plan.plan)
app.command()(fit_classifier.fit_classifier)
app.command()(fit_weight.fit_weight)
app.command()(fit_penetration.fit_penetration)
app.command()(target.target)
app.command()(schema.schema)
app.command()(doctor.doctor)
app.command()(tune.tune)
