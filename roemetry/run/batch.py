"""Run a recipe over its source: the record grows line by line, everything else is derived from it.

Traces that sinks look at again are kept on disk, so that no acquisition is traced twice, but not their
images, which the source gives again. What cannot be written or read is traced anew.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import platform
import statistics
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from urllib.parse import quote

from roemetry.config.recipe import Recipe
from roemetry.errors import FAULTS, DataError, RoemetryError
from roemetry.io.files import LineFile, exclusive, make_folder, sha256_of, write_whole
from roemetry.io.remote import Url, read_ahead
from roemetry.records import AcquisitionReference, Reason, Trace
from roemetry.records.arrays import Floats
from roemetry.records.display import thinned
from roemetry.run.executors import Executor, Lost, Processes
from roemetry.run.pipeline import Pipeline, frame_of
from roemetry.run.record import (
    INDEX,
    PROVENANCE,
    RECORD,
    Parts,
    acquisitions_to_keep,
    copied,
    in_bucket,
    read_record,
    rows_of,
    summed_up,
)
from roemetry.run.rows import failed, measurements_of, seen_of
from roemetry.stages import Run


class Measured(NamedTuple):
    """What became of an acquisition."""

    lines: list[str]
    """Its lines of the record."""
    seconds: Mapping[str, float]
    """By stage kind, the time it took, s."""
    pictures: Sequence[Floats | None] = ()
    """For each line, what `thinned` leaves of the points that were seen; empty where none were asked for."""


class Derived(NamedTuple):
    """What sinks made of a record."""

    files: tuple[Path, ...]
    faults: tuple[str, ...]
    """Of sinks that could not write, in words."""
    warnings: tuple[str, ...]
    """What could not be drawn for them, each said once for all products."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run came to."""

    folder: Path
    counts: Mapping[str, int]
    """Rows by status: measured, empty, failed."""
    files: tuple[Path, ...]
    sink_faults: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    """What a report should show and does not, each said once for all products."""
    drift: Reason | None = None
    """What moves in the course of the run; None for nothing."""

    @property
    def record(self) -> Path:
        """The record; in a bucket the index of its parts."""
        return self.folder / (INDEX if isinstance(self.folder, Url) else RECORD)


def run_recipe(
    recipe: Recipe,
    folder: Path,
    *,
    jobs: int = 1,
    executor: Executor | None = None,
    resume: bool = False,
    debug: bool = False,
    on_progress: Callable[[int, int], None] = lambda done, of: None,
) -> Outcome:
    """Measure everything a recipe's source has.

    Parameters
    ----------
    recipe
        What to do.
    folder
        Where to write; created if needed. Or a `roemetry.io.remote.Url`: the record is in parts there.
    jobs
        Worker processes; results are the same, and in the same order, for any number.
    executor
        What does the work instead of `jobs` processes, such as a `roemetry.run.cluster.Cluster`.
    resume
        Go on with a run of the same recipe that was stopped; what is measured stays as it is.
    debug
        Let every exception through.
    on_progress
        Called with (acquisitions done, of how many).

    Raises
    ------
    OutputError
        The folder cannot be written, already holds a run, or another process is writing into it; what was
        written before stays whole.
    DataError
        The source has nothing.
    CalibrationError
        The recipe asks for a check of the calibration that is missing, overdue or failed.
    """
    if recipe.calibration_check is not None:
        from roemetry.run.control_chart import refuse_doubtful

        refuse_doubtful(recipe, _doubts_of(recipe))
    references = recipe.references()
    executor = executor or Processes(jobs)
    if isinstance(folder, Url):
        with in_bucket(folder, RECORD, resume=resume) as (local, parts):
            found = _run(recipe, local, references, executor, resume, debug, on_progress, parts)
        files = tuple(_in(folder, file, local) for file in found.files)
        return replace(found, folder=folder, files=files)
    make_folder(folder)
    with exclusive(folder):
        return _run(recipe, folder, references, executor, resume, debug, on_progress)


def _in(place: Url, file: Path, local: Path) -> Path:
    """Give where a file of a working folder lies in the bucket."""
    return place / file.relative_to(local) if file.is_relative_to(local) else file


def _run(
    recipe: Recipe,
    folder: Path,
    references: Sequence[AcquisitionReference],
    executor: Executor,
    resume: bool,
    debug: bool,
    on_progress: Callable[[int, int], None],
    parts: Parts | None = None,
) -> Outcome:
    done = acquisitions_to_keep(recipe, folder, references, resume=resume)
    provenance = provenance_of(recipe, len(references))
    write_whole(folder / PROVENANCE, json.dumps(provenance, indent=2) + "\n")
    if parts is not None:
        parts.begin(folder / PROVENANCE)
    to_do = [reference for reference in references if reference.id not in done]
    seconds: dict[str, list[float]] = {}
    finished = len(references) - len(to_do)
    on_progress(finished, len(references))
    replayed = max((chosen.make().replays_first for chosen in recipe.sinks), default=0)
    with TemporaryDirectory(prefix=".traces-", dir=folder) as traces:
        kept = KeptTraces(Path(traces), frozenset(reference.id for reference in references[:replayed]))
        try:
            with LineFile(folder / RECORD) as record:
                measured = measure_all(recipe, to_do, executor, debug, kept)
                for reference, found in zip(to_do, measured, strict=True):
                    record.append("\n".join(found.lines))
                    finished += 1
                    if parts is not None:
                        parts.grown(reference.id, len(found.lines))
                    for stage, value in found.seconds.items():
                        seconds.setdefault(stage, []).append(value)
                    on_progress(finished, len(references))
        except BaseException:
            if not (finished or done):  # such as a cluster that is not there: then there is no run
                _take_back(folder, parts)
            raise
        counts, drift = summed_up(folder)
        provenance |= {"finished": _now(), "counts": counts, "seconds_median": _medians(seconds)}
        provenance["drift"] = None if drift is None else drift.text
        write_whole(folder / PROVENANCE, json.dumps(provenance, indent=2) + "\n")
        made = derive(recipe, folder, provenance, debug=debug, kept=kept)
    return Outcome(folder, counts, made.files, made.faults, made.warnings, drift)


def _take_back(folder: Path, parts: Parts | None) -> None:
    for name in (RECORD, PROVENANCE):
        (folder / name).unlink(missing_ok=True)
    if parts is not None:
        parts.take_back(PROVENANCE)


def derive(
    recipe: Recipe,
    folder: Path,
    provenance: Mapping[str, Any],
    *,
    debug: bool = False,
    kept: KeptTraces | None = None,
    product: str | None = None,
) -> Derived:
    """Let each sink derive its files from the record; a sink that fails does not stop the others.

    Those of one `product`, by the id of its row or its acquisition, go to a folder of their own.
    Acquisitions whose traces were not `kept` are traced again where a sink asks for them.
    """
    if isinstance(folder, Url):
        lines = None if product is None else [row.to_json() for row in rows_of(folder, product)]
        with copied(folder, lines, RECORD) as local:
            made = derive(recipe, local, provenance, debug=debug, product=product)
        return made._replace(files=tuple(_in(folder, file, local) for file in made.files))
    # The record has the uncertainties; the replay is for pictures.
    source, pipeline = recipe.source.make(), Pipeline(recipe, draws=0)
    references: dict[str, AcquisitionReference] = {}
    undrawn: dict[str, dict[str, str]] = {}  # by what is not drawn, products with why

    def replay(acquisition_id: str) -> Trace:
        """Give an acquisition's trace with its images, as it was kept or made again."""
        trace = replayed(acquisition_id)
        for found in trace.products:
            for what, why in found.undrawn.items():
                undrawn.setdefault(what, {})[f"{acquisition_id}#{found.product.number}"] = why.text
        return trace

    def replayed(acquisition_id: str) -> Trace:
        """Find the images; a trace that was kept needs no stage, any other is made again."""
        if not references:
            references.update({found.id: found for found in source.references(recipe.source_path)})
        if acquisition_id not in references:
            raise DataError(f"{acquisition_id}: the images are no longer there")
        acquisition = source.read(references[acquisition_id])
        trace = None if kept is None else kept.get(acquisition_id)
        if trace is None:
            return pipeline.trace(acquisition, surfaces=True)
        frame = frame_of(recipe, acquisition) if acquisition.frames else None  # scans have none of their own
        return replace(trace, acquisition=acquisition, frame=frame)

    run = Run(folder, recipe.product, lambda: read_record(folder), replay, provenance)
    if product is not None:
        rows = rows_of(folder, product)
        run = replace(
            run, folder=folder / f"product-{quote(product, safe=' ')}", measurements=lambda: iter(rows)
        )
        make_folder(run.folder)
    files: list[Path] = []
    faults: list[str] = []
    for chosen in recipe.sinks:
        try:
            files += chosen.make().write(run)
        except RoemetryError as error:
            faults.append(f"sink {chosen.registered.entry.name}: {error}")
        # A fault in one sink must not take the others' files away.
        except FAULTS as error:
            if debug:
                raise
            faults.append(
                f"sink {chosen.registered.entry.name}: failed with {type(error).__name__}: {error} "
                "(a plugin's fault; see --debug)"
            )
    return Derived(tuple(files), tuple(faults), tuple(_not_drawn(*found) for found in undrawn.items()))


def _not_drawn(what: str, why: Mapping[str, str]) -> str:
    (first, text), others = next(iter(why.items())), len(why) - 1
    more = f" (and {others} more)" if others else ""
    return f"{first}{more}: the {what} is not drawn: {text}"


def measure_all(
    recipe: Recipe,
    references: Sequence[AcquisitionReference],
    executor: Executor,
    debug: bool,
    kept: KeptTraces | None = None,
    *,
    pictures: bool = False,
) -> Iterator[Measured]:
    """Give each acquisition's lines, in the order of the source, with the seconds its stages took.

    Those of its traces that are to be `kept` are put there; `pictures` come with the lines where asked for.
    """
    for found in executor.in_order(_Worker, (recipe, debug, kept, pictures), references):
        if isinstance(found, Lost):
            why = Reason("process-died", found.why)
            yield Measured([failed(found.task.id, "source", why, recipe.hashes).to_json()], {})
        else:
            yield found


class _Worker:
    """Reads, traces and writes down one acquisition at a time."""

    def __init__(self, recipe: Recipe, debug: bool, kept: KeptTraces | None, pictures: bool = False) -> None:
        self._recipe = recipe
        self._pictures = pictures
        self._source = recipe.source.make()
        self._pipeline = Pipeline(recipe, debug=debug)
        self._debug = debug
        self._kept = kept
        self._hashes = recipe.hashes
        self._doubts = _doubts_of(recipe)

    def ahead(self, references: Sequence[AcquisitionReference]) -> None:
        """Begin to fetch what will be read next."""
        read_ahead(path for reference in references for path in reference.files.values())

    def __call__(self, reference: AcquisitionReference) -> Measured:
        try:
            before = _states_of(reference)
            _refuse_changed(reference)
            acquisition = self._source.read(reference)
            hashes = {
                f"{role}_sha256": reference.sha256.get(role) or sha256_of(path)
                for role, path in reference.files.items()
            }
            if _states_of(reference) != before:  # the hash may not be that of what was decoded
                raise DataError("an image was written to while it was read", hint="run when it is whole")
        # Whatever a source raises, the batch goes on.
        except FAULTS as error:
            if self._debug:
                raise
            ours = isinstance(error, RoemetryError | OSError)
            said = str(error) if ours else f"the source failed with {type(error).__name__}: {error}"
            why = Reason("unreadable", said)
            return Measured([failed(reference.id, "source", why, self._hashes).to_json()], {})
        shown = self._kept is not None and reference.id in self._kept.acquisitions
        trace = self._pipeline.trace(acquisition, surfaces=shown)
        if self._kept is not None:
            self._kept.put(trace)
        rows = measurements_of(trace, self._recipe, self._hashes | hashes, self._doubts)
        return Measured(
            [row.to_json() for row in rows],
            trace.seconds,
            [None if xyz is None else thinned(xyz) for xyz in seen_of(trace, rows)] if self._pictures else (),
        )


def _refuse_changed(reference: AcquisitionReference) -> None:
    """Raise DataError where a file has not the hash that it must have."""
    for role, expected in reference.sha256.items():
        path = reference.files[role]
        try:
            found = sha256_of(path)
        except OSError as error:
            raise DataError(f"{path}: the {role} image cannot be read: {error.strerror or error}") from error
        if found != expected:
            raise DataError(f"{path}: has changed: its bytes have another hash than the manifest says")


def _states_of(reference: AcquisitionReference) -> list[tuple[int, int, int]]:
    """Give what changes when one of the files is written to, or another takes its place."""
    local = (path for path in reference.files.values() if not isinstance(path, Url))  # a URL is read once
    found = [path.stat() for path in local if path.is_file()]
    return [(state.st_ino, state.st_size, state.st_mtime_ns) for state in found]


def _doubts_of(recipe: Recipe) -> tuple[Reason, ...]:
    if recipe.calibration is None or not (recipe.calibration_check or recipe.calibration.poor):
        return ()
    from roemetry.run.control_chart import calibration_doubts

    return calibration_doubts(recipe)


def provenance_of(recipe: Recipe, acquisitions: int) -> dict[str, Any]:
    """Give what a run is made with, as plain values: recipe, calibration, plugins, libraries, machine."""
    from importlib.metadata import version

    stages = {"source": recipe.source, **recipe.stages}
    return {
        "roemetry_version": version("roemetry"),
        "started": _now(),
        "finished": None,
        "command": sys.argv[1:],
        "recipe": str(recipe.path.absolute()),
        "sets": list(recipe.sets),
        "recipe_sha256": recipe.sha256,
        "calibration": None if recipe.calibration_path is None else str(recipe.calibration_path.absolute()),
        "calibration_sha256": None if recipe.calibration is None else recipe.calibration.sha256,
        "plugins": {
            f"{kind} {chosen.registered.entry.name}": str(chosen.registered.provider)
            for kind, chosen in stages.items()
        },
        "libraries": {name: version(name) for name in ("numpy", "numba", "opencv-contrib-python-headless")},
        "python": platform.python_version(),
        # Not platform.platform(): that asks another process for the processor's name.
        "platform": "-".join((platform.system(), platform.release(), platform.machine())),
        "acquisitions": acquisitions,
        "resolved_recipe": recipe.resolved(),
    }


def _medians(seconds: Mapping[str, list[float]]) -> dict[str, float]:
    """Median time of each stage; the first acquisition, in which kernels are loaded, is left out."""
    return {stage: statistics.median(values[1:]) for stage, values in seconds.items() if len(values) > 1}


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True)
class KeptTraces:
    """The traces of some acquisitions, in a folder that any process may write to."""

    folder: Path
    acquisitions: frozenset[str]
    """Ids of those that are to be kept."""

    def put(self, trace: Trace) -> None:
        """Keep a trace, if it is one of those that are to be kept and the disk takes it."""
        if trace.acquisition_id not in self.acquisitions:
            return
        path = self._path(trace.acquisition_id)
        try:
            path.write_bytes(pickle.dumps(replace(trace, acquisition=None, frame=None), protocol=5))
        except OSError:
            with suppress(OSError):
                path.unlink()

    def get(self, acquisition_id: str) -> Trace | None:
        """Give a trace that was kept, without its images; None where it was not."""
        if acquisition_id not in self.acquisitions:
            return None
        try:
            found = pickle.loads(self._path(acquisition_id).read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            return None
        return found if isinstance(found, Trace) else None

    def _path(self, acquisition_id: str) -> Path:
        return self.folder / hashlib.sha256(acquisition_id.encode()).hexdigest()
