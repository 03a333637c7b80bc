"""``roemetry optimise``: search the options of a recipe for the nearest to the truth in the least time."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from roemetry.cli.options import cluster_option, executor_of, next_folder, out_option, place, set_option
from roemetry.cli.progress import progress
from roemetry.errors import ConfigurationError, DataError, InterruptedRunError
from roemetry.io.files import write_whole
from roemetry.io.remote import folder_for
from roemetry.stages.registry import discover
from roemetry_tools.compare import say
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.comparison import Measuring, compare
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.score import Scored
from roemetry_tools.compare.tables import WORDS, warning_of
from roemetry_tools.compare.variants import Space, Variant
from roemetry_tools.compare.write import KEPT, ItemsFile, StoredScores, write_comparison
from roemetry_tools.optimise.search import (
    TRIED,
    Search,
    StoredTrials,
    Trial,
    Trueness,
    field_of,
    finalists,
    to_csv,
)

TRIALS = "trials.csv"


class Quantity(StrEnum):
    """What is to be near the truth."""

    visible_volume = "visible-volume"
    true_volume = "true-volume"
    weight = "weight"


_FIELDS = {
    Quantity.visible_volume: "visible_mm3",
    Quantity.true_volume: "true_mm3",
    Quantity.weight: "mass_g",
}


def optimise(
    recipe: Annotated[Path, typer.Argument(help="A recipe file, or a folder with a recipe.yaml in it.")],
    vary: Annotated[
        list[str],
        typer.Option(
            "--vary",
            metavar="KEY=LOW..HIGH",
            help="`key.key=LOW..HIGH` searches a range: of whole numbers if both ends are, evenly in the "
            "logarithm with `:log` after it; `key.key=value,value` and `KIND=name,name` a choice; may stand "
            "several times.",
        ),
    ],
    trials: Annotated[int, typer.Option("--trials", min=1, help="Recipes to try.")] = 50,
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            parser=place,
            metavar="PATH",
            help="A data set with truth, or its URL; default: the one that the images belong to.",
        ),
    ] = None,
    by: Annotated[
        Quantity | None,
        typer.Option(
            "--by", help="What is to be near the truth; default: the first that the data set knows."
        ),
    ] = None,
    held_out: Annotated[
        float,
        typer.Option(
            "--held-out",
            min=0.05,
            max=0.8,
            help="Share of the acquisitions that only the last word is given by.",
        ),
    ] = 0.3,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Seed of the search, of what is held out, of resampling.")
    ] = 1,
    out: Annotated[
        Path | None,
        out_option(
            "Folder for the results, created if needed, or its URL; default: results/NAME-optimise-1, then "
            "-2, …",
            parser=place,
        ),
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Worker processes.")] = 1,
    cluster: Annotated[str | None, cluster_option()] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a stopped search in --out.")] = False,
    sets: Annotated[list[str] | None, set_option("Change the recipe for all trials")] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Search a recipe's options for those that are nearest to the truth and fastest.

    Optuna proposes recipes, which are tried on a part of the acquisitions. The best of them are compared with
    the recipe as it is on the held-out part, which nothing was chosen by.

    Exit code: 0 searched; 1 the data do not suffice, or no trial measured anything; 2 the recipe or the
    command line is wrong.
    """
    if resume and out is None:
        raise ConfigurationError(
            "--resume needs --out", hint="name the folder of the search that was stopped"
        )
    if cluster is not None:  # the workers stand in folders of their own
        recipe, data = recipe.absolute(), None if data is None else data.absolute()
    executor = executor_of(cluster, jobs)
    space = Space(recipe, vary, sets=sets or (), registry=discover())
    base = space.as_it_is
    assert base.recipe is not None
    every = Data(base.recipe, data)
    field = field_of(every, None if by is None else _FIELDS[by])
    search = Search(space, seed)
    choosing, rest = every.parted(held_out, seed)
    destination = out or next_folder(base.recipe.path, "-optimise")
    began, last, terms = datetime.now(UTC), Trueness(field), Terms(seed=seed)
    with folder_for(destination) as folder:
        try:
            with (
                ItemsFile(folder, resume=resume) as items,
                StoredTrials(folder, space, choosing, (seed, field), resume=resume) as kept,
            ):
                with progress("trying", quiet=False) as shown:
                    for tried in search.run(trials, choosing, field, executor, kept, shown):
                        write_whole(folder / TRIALS, to_csv(tried, space.axes))
                chosen = finalists(search.trials)
                if not chosen:
                    (folder / TRIED).unlink()
                    raise DataError(f"no trial measured anything: {search.trials[0].fault}")

                def add(variant: Variant, scored: Scored) -> None:
                    items.add(variant, scored)
                    last.add(variant, scored)

                variants = [base, *(one.variant for one in chosen if one.variant.number)]
                with (
                    StoredScores(folder, variants, rest, terms, resume=resume) as scores,
                    progress("comparing", quiet=False) as shown,
                ):
                    how: Measuring = {"executor": executor, "kept": scores, "on_scored": add}
                    compared = compare(variants, rest, terms=terms, **how | {"on_progress": shown})
        except KeyboardInterrupt as stop:
            raise InterruptedRunError(
                f"stopped; what was tried is kept in {folder}",
                hint=f"go on with --out {destination} --resume",
            ) from stop
        files = write_comparison(folder, compared, rest, terms=terms, command=sys.argv[1:], began=began)
        for name in (TRIED, KEPT):
            (folder / name).unlink()
    Console().print(_table(search.trials[0], chosen, last, compared))
    say(_last_word(chosen[0], field, last, compared))
    say(f"  {destination / file.relative_to(folder)}" for file in (folder / TRIALS, *files))


def _table(as_it_is: Trial, chosen: Sequence[Trial], last: Trueness, compared: Sequence[Compared]) -> Table:
    """Set what was found in the search beside what the held-out part says."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("variant", overflow="fold", min_width=16)
    for heading in ("|err| %\nsearch", "|err| %\nheld out", "missing", "ms\nsearch", "ms\nheld out"):
        table.add_column(heading, justify="right", no_wrap=True)
    figures = {one.variant.number: one.figures for one in compared}
    for one in dict.fromkeys((as_it_is, *chosen)):
        number = one.variant.number
        error_pct, missing = last.of(number)
        found = figures[number]
        frame = None if found is None else found.seconds.get("frame")
        time_ms = math.nan if frame is None else 1000.0 * frame.median
        cells = f"{one.error_pct:.2f} {error_pct:.2f} {missing} {one.time_ms:.2f} {time_ms:.2f}"
        table.add_row(Text(one.variant.name), *cells.replace("nan", "").split(" "))
    return table


def _last_word(best: Trial, field: str, last: Trueness, compared: Sequence[Compared]) -> list[str]:
    """Say what the nearest trial comes to on the held-out part, which it was not chosen by."""
    if best.variant.number == 0:
        return ["no recipe that was tried is nearer to the truth than the recipe as it is"]
    what = WORDS[field]
    error_pct, before_pct = last.of(best.variant.number)[0], last.of(0)[0]
    said = (
        f"`{best.variant.name}` was nearest to the truth in the search; held out, its mean absolute error of "
        f"the {what} is {error_pct:.2f} %, that of the recipe as it is {before_pct:.2f} %"
    )
    (found,) = (one for one in compared if one.variant.number == best.variant.number)
    shift = found.standing.nearer.get(field)
    if shift is not None and math.isfinite(shift.interval.low):
        value, (low, high) = shift
        said += (
            f"; on products that both measured {value:+.2f} percentage points (95 % interval {low:+.2f} to "
            f"{high:+.2f})"
        )
    assert best.variant.recipe is not None
    specimens = {} if found.figures is None else found.figures.values[field]
    warning = warning_of(len({one.specimen for one in specimens.values()}))
    return [
        said,
        *warning,
        "to use it: " + " ".join(f"--set {shlex.quote(text)}" for text in best.variant.recipe.sets),
    ]
