"""``roemetry compare``: variants of a recipe on one data set, or side by side on several."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from roemetry.calibrating.known_products import read_labels
from roemetry.cli.options import cluster_option, executor_of, next_folder, out_option, place, set_option
from roemetry.cli.progress import progress
from roemetry.errors import ConfigurationError, InterruptedRunError
from roemetry.io.files import write_whole
from roemetry.io.remote import folder_for
from roemetry.run.executors import Executor
from roemetry.stages.registry import discover
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.comparison import Measuring
from roemetry_tools.compare.comparison import compare as compared_on
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.tables import (
    across_sets,
    across_table,
    across_to_csv,
    first_lines_of,
    problems_of,
    tables_of,
    verdicts_of,
)
from roemetry_tools.compare.variants import Variant, make_variants
from roemetry_tools.compare.write import KEPT, PAGE, SUMMARY, ItemsFile, StoredScores, write_comparison


def compare(
    recipe: Annotated[Path, typer.Argument(help="A recipe file, or a folder with a recipe.yaml in it.")],
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=VALUE,VALUE",
            help="`KIND=name,name` exchanges a stage, `key.key=value,value` a value of the recipe; may "
            "stand several times: every combination is compared.",
        ),
    ] = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(
            "--data",
            parser=place,
            metavar="PATH",
            help="A data set with truth, or its URL; all of its items are measured; may be given several "
            "times: their figures are shown side by side; default: where the images are.",
        ),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(
            "--labels",
            help="Table of `id` and `label`: true classes, in place of the data set's.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        out_option(
            "Folder for the results, or its URL; one that holds a comparison is refused; default: "
            "results/NAME-compare-1, then -2, …",
            parser=place,
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance",
            min=0.0,
            metavar="PCT",
            help="Mean differences below this many per cent count as none; gives each variant a verdict.",
        ),
    ] = None,
    folds: Annotated[
        int, typer.Option("--folds", min=2, max=100, help="Folds for the choice among variants.")
    ] = 5,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of resampling and folds.")] = 1,
    stop_early: Annotated[
        bool,
        typer.Option(
            "--stop-early",
            help="Stop measuring a variant once another is certainly nearer to the truth (the best one is "
            "stopped with a probability of 1 % at most).",
        ),
    ] = False,
    jobs: Annotated[
        int,
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            help="Worker processes; the numbers are the same for any number, times aside.",
        ),
    ] = 1,
    cluster: Annotated[str | None, cluster_option()] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a stopped comparison in --out.")
    ] = False,
    sets: Annotated[list[str] | None, set_option("Change the recipe for all variants")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print comparison.json instead of the tables; no progress bar.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Compare variants of a recipe on the same data: trueness against what is known, and time.

    Exit code: 0 all compared; 1 a variant could not be made or measured nothing (its row says why); 2 the
    recipe, the data set or the command line is wrong.
    """
    if resume and out is None:
        raise ConfigurationError(
            "--resume needs --out", hint="name the folder of the comparison that was stopped"
        )
    executor = executor_of(cluster, jobs)
    if cluster is not None:  # the workers stand in folders of their own
        recipe, data = recipe.absolute(), [one.absolute() for one in data or ()]
    variants = make_variants(recipe, vary or (), sets=sets or (), registry=discover())
    base = variants[0].recipe
    assert base is not None
    true_labels = None if labels is None else read_labels(labels)
    terms = Terms(tolerance, folds, seed, stop_early)
    given: list[Path | None] = list(data) if data else [None]
    names = ["" if one is None else one.resolve().name for one in given]
    if len(set(names)) < len(names):
        raise ConfigurationError(f"two data sets are called {max(names, key=names.count)}", hint="rename one")
    every: dict[str, Sequence[Compared]] = {}
    told = {}
    destination = out or next_folder(base.path, "-compare")
    with folder_for(destination) as folder:
        for name, one in zip(names, given, strict=True):
            into = folder / name if len(given) > 1 else folder
            try:
                every[name] = _one_set(
                    variants, Data(base, one, labels=true_labels), terms, executor, into, resume, as_json
                )
            except KeyboardInterrupt as stop:
                raise InterruptedRunError(
                    f"stopped; what was scored is kept in {folder}",
                    hint=f"go on with --out {destination} --resume",
                ) from stop
            told[name] = json.loads((into / SUMMARY).read_text("utf-8"))
        for name in names:  # until then a comparison on several sets that is stopped goes on with all of them
            (folder / name / KEPT if len(given) > 1 else folder / KEPT).unlink(missing_ok=True)
        across = across_sets(every)
        if len(given) > 1:
            write_whole(folder / "between.csv", across_to_csv(across))
    if as_json:
        typer.echo(json.dumps(told if len(given) > 1 else told[names[0]], indent=2))
    elif len(given) > 1:
        Console().print(across_table(across))
    if not as_json:
        typer.echo(f"  {destination / ('between.csv' if len(given) > 1 else PAGE)}")
    if any(one.failure for compared in every.values() for one in compared):
        raise typer.Exit(1)


def _one_set(
    variants: Sequence[Variant], data: Data, terms: Terms, executor: Executor, folder: Path, resume: bool,
    as_json: bool,
) -> Sequence[Compared]:  # fmt: skip
    """Compare on one data set, write its files, and show them."""
    began = datetime.now(UTC)
    with (
        ItemsFile(folder, resume=resume) as items,
        StoredScores(folder, variants, data, terms, resume=resume) as kept,
        progress("comparing", quiet=as_json) as shown,
    ):
        how: Measuring = {"executor": executor, "kept": kept, "on_scored": items.add, "on_progress": shown}
        compared = compared_on(variants, data, terms=terms, **how)
    write_comparison(folder, compared, data, terms=terms, command=sys.argv[1:], began=began)
    if not as_json:
        _show(compared, terms, data.without_truth)
    return compared


def _show(compared: Sequence[Compared], terms: Terms, without_truth: str) -> None:
    recipe = compared[0].variant.recipe
    assert recipe is not None
    say(first_lines_of(compared, terms, without_truth))
    for table in tables_of(recipe.product, compared):
        Console().print(table)
    say([*verdicts_of(compared, terms.tolerance_pct), *problems_of(compared), without_truth])


def say(lines: Iterable[str]) -> None:
    """Print lines as they are, except empty ones."""
    for line in filter(None, lines):
        Console().print(line, highlight=False, markup=False, soft_wrap=True)
