"""``roemetry optimise``: search the options of a recipe for the nearest to the truth in the least time.

Optuna proposes recipes in batches, from what was found of those before. They are judged by how near they are
to the truth over all products that are known, measured or not.
"""

from __future__ import annotations

import hashlib
import json
import math
import shlex
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from roemetry.cli.options import cluster_option, executor_of, next_folder, out_option, place, set_option
from roemetry.cli.progress import progress
from roemetry.errors import ConfigurationError, DataError, InterruptedRunError, OutputError, PluginError
from roemetry.io.files import make_folder, write_whole
from roemetry.io.remote import folder_for
from roemetry.run.executors import Executor
from roemetry.stages.registry import discover
from roemetry_tools.compare import say
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.comparison import Measuring, compare, measure
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.score import QUANTITIES, Figures, Scored, beside_truth
from roemetry_tools.compare.tables import WORDS, csv_of, warning_of
from roemetry_tools.compare.variants import Axis, Space, Variant, recipe_of
from roemetry_tools.compare.write import (
    KEPT,
    ItemsFile,
    StoredLines,
    StoredScores,
    identity_of,
    write_comparison,
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


_BATCH = 8
"""Recipes that are tried at once: they share the steps that are the same, and the start of the workers."""
_FINALISTS = 6
"""Recipes of the front that go on to the held-out part, at most."""


TRIED = ".tried"

TrialFigures = tuple[float, int, float, str]
"""Of a trial: error, %; products missing; time, ms; and its fault."""


@dataclass(frozen=True, eq=False, slots=True)
class Trial:
    """A recipe that was tried; number 0 is the recipe as it is."""

    variant: Variant
    error_pct: float
    """Mean absolute error of all products whose truth is known, %; NaN where nothing was measured."""
    missing: int
    """Products among them that were not measured: each counts as an error of 100 %."""
    time_ms: float
    """Median time of an acquisition, without reading files."""
    fault: str = ""

    @property
    def is_whole(self) -> bool:
        """Whether it has both figures."""
        return math.isfinite(self.error_pct) and math.isfinite(self.time_ms)


class StoredTrials(StoredLines):
    """A line in the search's folder for each recipe that was tried; a stopped search goes on where it was.

    Optuna's own storages keep trials, but not where its sampler's random numbers are. So the search is begun
    again with what is kept here in place of measuring: with the same figures it proposes the same recipes.
    `told` decides the proposals besides the space: seed, quantity. OutputError where the folder holds a
    search that was stopped and is not to be gone on with, or another one.
    """

    def __init__(
        self, folder: Path, space: Space, data: Data, told: Sequence[object], *, resume: bool
    ) -> None:
        make_folder(folder)
        self._folder, self._data, self._resume = folder, data, resume
        if (folder / TRIED).exists() and not resume:
            raise OutputError(
                f"{folder}: there is a search in this folder that was stopped",
                hint="go on with it by --resume, or choose another folder with --out",
            )
        axes = [(axis.key, axis.values) for axis in space.axes]
        decides = f"{identity_of([space.as_it_is], data, Terms())} {axes} {[*told]}"
        other = "search in this folder is of another recipe, space, seed or data"
        super().__init__(folder / TRIED, hashlib.sha256(decides.encode()).hexdigest(), other)
        try:
            self._known = dict(self.read(_read, "search"))
        except OutputError:
            self.__exit__(None, None, None)
            raise

    def figures_of(self, variant: Variant) -> TrialFigures | None:
        """Give what a recipe came to before; None where it was not tried."""
        return self._known.get(str(recipe_of(variant)))

    def scores(self, variants: Sequence[Variant]) -> StoredScores:
        """Give the file that keeps what acquisitions score while these recipes are tried."""
        return StoredScores(self._folder, variants, self._data, Terms(), resume=self._resume)

    def add(self, tried: Sequence[tuple[Variant, TrialFigures]]) -> None:
        """Keep what recipes came to, instead of what acquisitions scored."""
        (self._folder / KEPT).unlink(missing_ok=True)
        self.append("\n".join(json.dumps([str(recipe_of(one)), of]) for one, of in tried))


def _read(line: str) -> tuple[str, TrialFigures]:
    name, (error_pct, missing, time_ms, fault) = json.loads(line)
    return str(name), (float(error_pct), int(missing), float(time_ms), str(fault))


class Search:
    """Tries recipes of a space; the same seed and the same figures give the same proposals.

    Raises
    ------
    ConfigurationError
        A range is wrong.
    PluginError
        Optuna is not installed.
    """

    def __init__(self, space: Space, seed: int) -> None:
        try:
            import optuna
        except ImportError as error:
            raise PluginError(
                "the search needs the module optuna",
                hint="install it with `pip install 'roemetry[optimise]'`",
            ) from error
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._space = space
        self._failed = optuna.trial.TrialState.FAIL
        self._domains = {axis.key: _domain(axis, optuna.distributions) for axis in space.axes}
        # proposals of a batch are kept apart by taking those without a result yet for bad ones
        sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
        self._study = optuna.create_study(directions=["minimize", "minimize"], sampler=sampler)
        self.trials: list[Trial] = []

    def run(
        self,
        count: int,
        data: Data,
        field: str,
        executor: Executor,
        kept: StoredTrials,
        on_progress: Callable[[int, int], None] = lambda done, of: None,
    ) -> Iterator[list[Trial]]:
        """Try `count` recipes and the recipe as it is; give all that was tried after every batch.

        `field` is that of the truth. What was `kept` of a search that was stopped is not measured again.
        `on_progress` is called with (proposals done, of how many).
        """
        known: dict[object, Trial] = {}
        new = [self._space.as_it_is]
        for first in range(0, count, _BATCH):
            asked = [self._study.ask(self._domains) for _ in range(min(_BATCH, count - first))]
            proposed = [
                self._space.variant([_text(one.params[axis.key]) for axis in self._space.axes])
                for one in asked
            ]
            seen = {*known, *map(recipe_of, new)}
            for variant in proposed:
                if recipe_of(variant) not in seen:
                    seen.add(recipe_of(variant))
                    new.append(replace(variant, number=len(known) + len(new)))
            for trial in _tried(new, data, field, executor, kept):
                known[recipe_of(trial.variant)] = trial
                self.trials.append(trial)
            new = []
            for one, variant in zip(asked, proposed, strict=True):
                trial = known[recipe_of(variant)]
                if trial.is_whole:
                    self._study.tell(one, [trial.error_pct, trial.time_ms])
                else:
                    self._study.tell(one, state=self._failed)
            on_progress(first + len(asked), count)
            yield self.trials


def _tried(
    variants: Sequence[Variant], data: Data, field: str, executor: Executor, kept: StoredTrials
) -> Iterator[Trial]:
    """Give what recipes come to on the same acquisitions, from what was kept or measured now."""
    new = [variant for variant in variants if kept.figures_of(variant) is None]
    measured = _measured(new, data, field, executor, kept) if new else {}
    for variant in variants:
        yield Trial(variant, *(kept.figures_of(variant) or measured[variant.number]))


def _measured(
    variants: Sequence[Variant], data: Data, field: str, executor: Executor, kept: StoredTrials
) -> dict[int, TrialFigures]:
    """Measure recipes, by their numbers; one that cannot be made has its reason."""
    trueness = Trueness(field)
    figures: dict[int, Figures] = {}
    if any(variant.recipe is not None for variant in variants):
        with kept.scores(variants) as scores:
            figures, _ = measure(variants, data, executor=executor, kept=scores, on_scored=trueness.add)
    tried: dict[int, TrialFigures] = {}
    for variant in variants:
        found = figures.get(variant.number)
        if found is None:
            tried[variant.number] = math.nan, 0, math.nan, variant.fault
            continue
        fault = f"no acquisition was measured: {found.causes[0].text}" if found.failed else ""
        error_pct, missing = trueness.of(variant.number)
        tried[variant.number] = (
            math.nan if found.failed else error_pct,
            missing,
            1000.0 * found.seconds["frame"].median if "frame" in found.seconds else math.nan,
            fault,
        )
    kept.add([(variant, tried[variant.number]) for variant in variants])
    return tried


def front_of(trials: Sequence[Trial]) -> list[Trial]:
    """Give those that no other one beats in error or time without being worse in the other; nearest first."""
    front: list[Trial] = []
    for one in sorted(filter(lambda one: one.is_whole, trials), key=lambda one: (one.error_pct, one.time_ms)):
        if not front or one.time_ms < front[-1].time_ms:
            front.append(one)
    return front


def finalists(trials: Sequence[Trial]) -> list[Trial]:
    """Give the nearest of the front, the fastest, and some that lie evenly between; nearest first."""
    front = front_of(trials)
    most = min(len(front), _FINALISTS)
    places = [round(k * (len(front) - 1) / (most - 1)) for k in range(most)] if most > 1 else range(most)
    return [front[place] for place in places]


def to_csv(trials: Sequence[Trial], axes: Sequence[Axis]) -> str:
    """Write a line for each recipe that was tried."""
    head = ["trial", "name", *(f"set {axis.key}" for axis in axes)]
    lines: list[list[object]] = [[*head, "error_pct", "missing", "time_ms", "front", "reason"]]
    front = {one.variant.number for one in front_of(trials)}
    for one in trials:
        number, name = one.variant.number, one.variant.name
        settings = [one.variant.settings.get(axis.key, "") for axis in axes]
        figures = (one.error_pct, one.missing, one.time_ms)
        lines.append([number, name, *settings, *figures, str(number in front).lower(), one.fault])
    return csv_of(lines)


def _domain(axis: Axis, distributions: Any) -> Any:
    """Read ``LOW..HIGH``, ``LOW..HIGH:log`` or a choice."""
    if len(axis.values) > 1 or ".." not in axis.values[0]:
        return distributions.CategoricalDistribution(axis.values)
    text, colon, scale = axis.values[0].partition(":")
    low, _, high = text.partition("..")
    for number, made in ((int, distributions.IntDistribution), (float, distributions.FloatDistribution)):
        try:
            ends: tuple[Any, Any] = number(low), number(high)
        except ValueError:
            continue
        if ends[0] < ends[1] and scale in ("", "log") and (not colon or ends[0] > 0):
            return made(*ends, log=bool(colon))
    raise ConfigurationError(
        f"--vary {axis.key}={axis.values[0]}: expected LOW..HIGH, LOW below HIGH, "
        "or LOW..HIGH:log with both above 0",
        hint="whole numbers are tried if both ends are whole, as in 5..60; otherwise write 5.0..60",
    )


def _text(value: object) -> str:
    """Write a proposed value as on the command line; six digits are finer than any option."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


_MISSING_PCT = 100.0
"""Error of a product that was not measured, and of any other at most: else who refuses what is difficult
would be the nearest.
"""


class Trueness:
    """Adds up the absolute errors of a quantity, by the number of the variant."""

    def __init__(self, field: str) -> None:
        self._field = field
        self._errors: defaultdict[int, list[float]] = defaultdict(list)
        self._missing: defaultdict[int, int] = defaultdict(int)

    def add(self, variant: Variant, scored: Scored) -> None:
        """Add what a variant made of an acquisition."""
        for pair in scored.pairs:
            value, true = beside_truth(pair, self._field)
            if not true > 0.0:
                continue
            measured = value is not None and math.isfinite(value)
            self._missing[variant.number] += not measured
            error = 100.0 * abs(value / true - 1.0) if measured and value is not None else _MISSING_PCT
            self._errors[variant.number].append(min(error, _MISSING_PCT))

    def of(self, number: int) -> tuple[float, int]:
        """Give the mean absolute error, %, NaN without any, and how many products were not measured."""
        errors = self._errors[number]
        return math.fsum(errors) / len(errors) if errors else math.nan, self._missing[number]


def field_of(data: Data, wanted: str | None) -> str:
    """Give the quantity to judge by: the one that is wanted, else the first that the data know.

    DataError where they know none, or not that one.
    """
    known = [
        name
        for name in QUANTITIES
        if any(
            getattr(product, name) > 0.0
            for unit in data.units()
            for product in (() if unit.item is None else unit.item.products)
        )
    ]
    if wanted in known:
        return wanted
    if wanted is not None or not known:
        what = "neither volume nor weight" if wanted is None else f"no {WORDS[wanted]}"
        raise DataError(
            f"nothing to search by: {data.without_truth or f'the data set knows {what} of any product'}",
            hint="name a data set with truth by --data, or another quantity by --by",
        )
    return known[0]
