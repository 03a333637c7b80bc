"""``roemetry run`` with its table, and what is derived of a run again: ``report`` and ``export``."""

from __future__ import annotations

import contextlib
import json
import math
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from roemetry.cli.options import cluster_option, executor_of, next_folder, out_option, place, set_option
from roemetry.records import Estimate, Measurement
from roemetry.records.units import MM3_PER_CM3, stated

if TYPE_CHECKING:
    from roemetry.config.recipe import Recipe
    from roemetry.run.batch import Outcome


def run(
    recipe: Annotated[Path, typer.Argument(help="A recipe file, or a folder with a recipe.yaml in it.")],
    out: Annotated[
        Path | None,
        out_option(
            "Folder for the results, created if needed, or a URL such as s3://plant/monday; default: "
            "results/NAME-1, then -2, …",
            parser=place,
        ),
    ] = None,
    jobs: Annotated[
        int,
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            help="Worker processes; the record is the same, byte for byte, for any number.",
        ),
    ] = 1,
    cluster: Annotated[str | None, cluster_option()] = None,
    sets: Annotated[
        list[str] | None, set_option("Change the recipe for this run, e.g. source.path=images")
    ] = None,
    draws: Annotated[
        int | None,
        typer.Option(
            "--draws",
            min=0,
            help="Monte Carlo draws for the uncertainty of volume, weight and grade; default: the recipe's.",
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a stopped run in --out.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the outcome as JSON instead of the table; no progress bar.")
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Print the time of each stage, and the memory, at the end.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show tracebacks; the first failed acquisition ends the run.")
    ] = False,
) -> None:
    """Measure everything a recipe's source has; write the record, the tables and the report.

    Exit code: 0 all measured; 1 some products failed (their rows say why); 2 the recipe, the calibration or
    the command line is wrong.
    """
    from roemetry.cli.progress import COMPILING, progress
    from roemetry.cli.warm_up import warm_up
    from roemetry.config.overrides import Implied
    from roemetry.config.recipe import Recipe
    from roemetry.errors import ConfigurationError, InterruptedRunError
    from roemetry.run.batch import run_recipe

    if resume and out is None:
        raise ConfigurationError("--resume needs --out", hint="name the folder of the run that was stopped")
    drawn = [] if draws is None else [Implied(f"draws={draws}", f"--draws {draws}")]
    changes = [*(sets or ()), *drawn]
    # what a plugin prints must not stand among the JSON
    executor = executor_of(cluster, jobs)
    printed = contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()
    with printed:
        # the workers of a cluster stand in folders of their own
        loaded = Recipe.load(recipe if cluster is None else recipe.absolute(), sets=changes)
        folder = out or next_folder(loaded.path)
        try:
            with progress(COMPILING, quiet=as_json) as compiled:
                warm_up(loaded.stages, compiled)
            with _stopped_by_signals() as stop_if_asked, progress("measuring", quiet=as_json) as show:

                def on_progress(done: int, of: int) -> None:
                    show(done, of)
                    stop_if_asked()

                outcome = run_recipe(
                    loaded, folder, executor=executor, resume=resume, debug=debug, on_progress=on_progress
                )
        except KeyboardInterrupt as stop:
            raise InterruptedRunError(
                f"stopped{stop}; what was measured is whole in {folder}",
                hint=f"go on with --out {folder} --resume",
            ) from stop
    if as_json:
        for text in _written(outcome):
            typer.echo(text, nl=False)
    else:
        _show(loaded, outcome)
        if profile:
            _show_profile(outcome)
    for fault in (*outcome.sink_faults, *outcome.warnings):
        sys.stderr.write(f"roemetry: {fault}\n")
    if outcome.counts["failed"] or outcome.sink_faults:
        raise typer.Exit(1)


@contextlib.contextmanager
def _stopped_by_signals() -> Iterator[Callable[[], None]]:
    """Let the system's wish to end, and a closed terminal, stop a run after the product that is at work.

    Gives what raises KeyboardInterrupt once that was asked for. Raised at once, it might surface in compiled
    code, which turns it into a fault of the stage; a second wish is granted at once.
    """
    asked: list[str] = []

    def stop(number: int, _: object) -> None:
        asked.append(signal.Signals(number).name)
        if len(asked) > 1:
            stop_if_asked()

    def stop_if_asked() -> None:
        if asked:
            raise KeyboardInterrupt(f" by {asked[0]}")

    if threading.current_thread() is not threading.main_thread():  # only there signals can be handled
        yield stop_if_asked
        return
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    # nohup ignores SIGHUP: so shall we
    wanted = [
        signal.Signals[name] for name in names if signal.getsignal(signal.Signals[name]) != signal.SIG_IGN
    ]
    before = {number: signal.signal(number, stop) for number in wanted}
    try:
        yield stop_if_asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _written(outcome: Outcome) -> Iterator[str]:
    """Give an outcome as JSON, row by row: thousands of rows, slices and all, are not held at once."""
    from roemetry.run.record import read_record

    told: dict[str, object] = {
        "folder": str(outcome.folder),
        "record": str(outcome.record),
        "counts": dict(outcome.counts),
        "files": [str(file) for file in outcome.files],
        "faults": list(outcome.sink_faults),
        "warnings": list(outcome.warnings),
        "drift": None if outcome.drift is None else outcome.drift.text,
    }
    yield json.dumps(told, indent=2).removesuffix("\n}") + ',\n  "measurements": ['
    before = "\n"
    for row in read_record(outcome.folder):
        text = json.dumps(json.loads(row.to_json()), indent=2)
        yield before + "\n".join(f"    {line}" for line in text.splitlines())
        before = ",\n"
    yield ("]" if before == "\n" else "\n  ]") + "\n}\n"


def _show(recipe: Recipe, outcome: Outcome) -> None:
    from rich.console import Console

    from roemetry.run.record import read_record

    console = Console()
    console.print(table_of(recipe.product, read_record(outcome.folder), sum(outcome.counts.values())))
    for problem in problems_of(read_record(outcome.folder)):
        console.print(problem, highlight=False, markup=False, soft_wrap=True)
    counts = ", ".join(f"{number} {status}" for status, number in outcome.counts.items() if number)
    console.print(f"{counts or 'nothing measured'}", highlight=False)
    if outcome.drift is not None:
        console.print(f"drifting: {outcome.drift.text}", highlight=False, markup=False, soft_wrap=True)
    for file in (outcome.record, *outcome.files[:10]):
        console.print(f"  {file}", highlight=False, soft_wrap=True)


def _show_profile(outcome: Outcome) -> None:
    """Print where the time of an acquisition goes, and how much memory was held at most."""
    from rich.console import Console

    from roemetry.run.record import PROVENANCE

    told = json.loads((outcome.folder / PROVENANCE).read_text("utf-8"))
    seconds: dict[str, float] = told["seconds_median"]
    if not seconds:
        typer.echo("no profile: times are medians from the second acquisition on, which there is not")
        return
    whole = sum(seconds.values())
    table = Table(box=SIMPLE_HEAD)
    table.add_column("stage")
    table.add_column("ms", justify="right")
    table.add_column("%", justify="right")
    for stage, value in seconds.items():
        table.add_row(stage, f"{1e3 * value:.1f}", f"{100.0 * value / whole:.0f}")
    table.add_row("all", f"{1e3 * whole:.1f}", "100")
    console = Console()
    console.print(table)
    console.print("median of an acquisition's stages, without the first acquisition", highlight=False)
    if (held := _memory_mb()) is not None:
        console.print(f"memory of the main process at most: {held:.0f} MB", highlight=False)


def _memory_mb() -> float | None:
    """Give the most memory this process has held; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return held / (2.0**20 if sys.platform == "darwin" else 2.0**10)


def report(
    folder: Annotated[Path, typer.Argument(parser=place, metavar="FOLDER", help="Folder or URL of a run.")],
    product: Annotated[
        str | None,
        typer.Option(
            "--product", metavar="ID", help="Only of this product or image, in a folder of its own."
        ),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Make the tables and the report of a run again from its record."""
    from roemetry.errors import OutputError
    from roemetry.run.batch import derive
    from roemetry.run.record import recipe_of

    recipe, provenance = recipe_of(folder)
    files, faults, warnings = derive(recipe, folder, provenance, debug=debug, product=product)
    for file in files:
        typer.echo(str(file))
    for warning in warnings:
        typer.echo(f"roemetry: {warning}", err=True)
    if faults:
        raise OutputError("; ".join(faults))


def export(
    folder: Annotated[
        Path,
        typer.Argument(parser=place, metavar="FOLDER", help="Folder or URL of a run; or a calibration file."),
    ],
    sink: Annotated[
        str,
        typer.Argument(
            help="What to write: point-cloud, parquet or height-map (these two need roemetry\\[export]), or "
            "any other installed sink; for a calibration: opencv."
        ),
    ],
    sets: Annotated[list[str] | None, set_option("An option of the sink")] = None,
    out: Annotated[
        Path | None,
        out_option(
            "For a calibration: file to write, .yaml, .json or .xml; "
            "default: NAME-opencv.yaml beside NAME.yaml."
        ),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Write a finished run, or a calibration's camera, for other programs; nothing is measured again."""
    from roemetry.config.overrides import Implied
    from roemetry.errors import ConfigurationError, OutputError
    from roemetry.run.batch import derive
    from roemetry.run.record import recipe_of

    if folder.is_file():
        typer.echo(str(_camera(folder, sink, out)))
        return
    options = []
    for text in sets or ():
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise ConfigurationError(
                f"--set {text}: expected key=value", hint="for example --set pixel_mm=0.5"
            )
        options.append(f"{key}: {value}")
    with_sink = f"sinks=[{{use: {sink}, options: {{{', '.join(options)}}}}}]"
    typed = " ".join(["export", sink, *(f"--set {text}" for text in sets or ())])
    recipe, provenance = recipe_of(folder, sets=[Implied(with_sink, typed)])
    files, faults, warnings = derive(recipe, folder, provenance, debug=debug)
    for warning in warnings:
        typer.echo(f"roemetry: {warning}", err=True)
    for file in files:
        typer.echo(str(file))
    if faults:
        raise OutputError("; ".join(faults))
    if not files:
        raise OutputError(
            f"{folder}: {sink} found nothing to write",
            hint="no acquisition of the run got as far as it needs",
        )


def _camera(path: Path, form: str, out: Path | None) -> Path:
    """Write a calibration's camera and planes as OpenCV's file."""
    from roemetry.errors import CalibrationError, ConfigurationError
    from roemetry.records.calibration import Calibration
    from roemetry.records.view import write_camera

    if form != "opencv":
        raise ConfigurationError(
            f"{path} is a file: of a calibration only `opencv` can be written, not `{form}`",
            hint="name the folder of a run for a sink",
        )
    view = Calibration.load(path).view
    if view is None:
        raise CalibrationError(
            f"{path}: this calibration knows no camera", hint="calibrate with pinhole-plane"
        )
    written = out or path.with_name(f"{path.stem}-opencv.yaml")
    write_camera(written, view)
    return written


def problems_of(measurements: Iterable[Measurement]) -> list[str]:
    """Write a line for each reason why rows lack a number, an uncertainty or a fit, with the rows."""
    rows_by_text: dict[str, list[str]] = {}
    count: Counter[str] = Counter()

    def note(text: str, row: str) -> None:
        count[text] += 1
        if count[text] <= _NAMED_MAX:
            rows_by_text.setdefault(text, []).append(row)

    for row in measurements:
        if row.status != "measured":
            text = row.reasons[0].text if row.reasons else row.status
            note(text, row.id)
            continue
        weighed = () if row.weight is None or math.isnan(row.weight.mass_g.value) else row.weight.reasons
        fitted = row.weight is None or bool(row.weight.features)  # which only a fitted weigher has
        for reason in (*weighed, *(row.volume.reasons if row.volume else ())):
            if reason.code in _NOT_FITTED and not fitted:
                note(f"weight not fitted: {reason.text}", row.id)
            elif reason.code in _NOT_STATED:
                note(f"no uncertainty: {reason.text}", row.id)
    return [
        f"{', '.join(rows)}{f' and {more} more' if (more := count[text] - len(rows)) else ''}: {text}"
        for text, rows in islice(rows_by_text.items(), _ROWS_MAX)
    ]


_NOT_FITTED = ("visible-taken-for-true", "underside-assumed")
"""Reasons that make a weight wrong by a tenth, and that weighed samples mend."""
_NOT_STATED = (
    "peak-noise-not-stated",
    "outline-error-not-stated",
    "volume-model-not-stated",
    "weight-model-not-stated",
    "calibration-model-not-stated",
)
"""Reasons that leave uncertainties out where they were asked for."""
_ROWS_MAX = 40  # of a table in a terminal; the files have all
_NAMED_MAX = 3  # products named before "and n more"
_COLOURS = {"measured": "default", "empty": "yellow", "failed": "red"}


def table_of(title: str, measurements: Iterable[Measurement], rows: int) -> Table:
    """Make the table; of a long run it shows the first rows and says how many there are."""
    caption = f"the first {_ROWS_MAX} of {rows} rows" if rows > _ROWS_MAX else None
    # Eighty columns, the width of a pipe, hold it all.
    table = Table(title=Text(title), caption=caption, title_justify="left", box=SIMPLE_HEAD)
    table.pad_edge, table.collapse_padding = False, True
    table.add_column("product", min_width=10, overflow="fold")
    shown = list(islice(measurements, _ROWS_MAX))
    graded = any(row.grade is not None or row.decision is not None for row in shown)
    table.add_column("grade" if graded else "status", min_width=6)
    of_pixels = any(_displacement(row) for row in shown) and not any(any(_in_units(row)) for row in shown)
    headings = ("px displaced",) if of_pixels else ("g", "cm³", "mm high")
    for heading in (*headings, "stripes", "ambi-\nguous"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in shown:
        coding = row.coding
        table.add_row(
            Text(row.id),
            Text(_verdict(row, graded=graded), style=_COLOURS[row.status]),
            *((_displacement(row),) if of_pixels else _in_units(row)),
            "" if coding is None else f"{coding.stripes_seen}/{coding.stripes}",
            "" if coding is None else str(coding.ambiguous),
        )
    return table


def _in_units(row: Measurement) -> tuple[str, str, str]:
    """Write mass, volume and height; empty where they are missing."""
    return (
        "" if row.weight is None else _figure(row.weight.mass_g, 1),
        "" if row.volume is None else _figure(row.volume.visible_mm3, 2, MM3_PER_CM3),
        _figure(row.height_max_mm, 2),
    )


def _displacement(row: Measurement) -> str:
    """Write the largest displacement, which is all there is without a calibration."""
    found = math.nan if row.coding is None else row.coding.displacement_max_px
    return "" if math.isnan(found) else f"{found:.1f}"


def _figure(estimate: Estimate, digits: int, per: float = 1.0) -> str:
    """Write a value and, where it is stated, ± its standard uncertainty; nothing where there is no value."""
    if math.isnan(estimate.value):
        return ""
    value = stated(estimate.value / per, digits)
    return value if math.isnan(estimate.std) else f"{value} ± {estimate.std / per:.{digits}f}"


def _verdict(row: Measurement, *, graded: bool) -> str:
    """Say what a product is like, and what is to be done with it; "measured" is no grade."""
    shape = "" if row.grade is None else row.grade.label
    if row.decision is None:
        return shape or ("not graded" if graded and row.status == "measured" else row.status)
    lane = f" ({row.decision.lane})" if row.decision.lane else ""
    return f"{shape}{' → ' if shape else ''}{row.decision.label}{lane}"
