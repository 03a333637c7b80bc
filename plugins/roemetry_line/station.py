"""One camera of a line, in a process of its own: take, spool, measure, put into the outbox.

A thread takes frames and spools them; another measures them in order and commits their rows. Between them is
a queue of a few frames: when it is full the taking waits, so that nothing that was spooled is left
unmeasured, and what the camera cannot keep meanwhile shows as a gap in its numbers. A third thread says of a
frame whose time is up that it is late; a fourth looks whether the recipe has changed.
"""

from __future__ import annotations

import math
import queue
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.cli.warm_up import warm_up
from roemetry.config.dataset import Item
from roemetry.config.recipe import Recipe
from roemetry.errors import FAULTS, DataError, OutputError, RoemetryError
from roemetry.io.files import sha256_of
from roemetry.records import Acquisition, AcquisitionReference, Frame, Reason, Role, Trace
from roemetry.records.live import LiveFrame
from roemetry.run.control_chart import calibration_doubts
from roemetry.run.pipeline import Pipeline
from roemetry.run.record import recipe_of
from roemetry.run.rows import failed, measurements_of
from roemetry_line import line_file, runs
from roemetry_line.block_checks import BlockChecks, LaserHealth
from roemetry_line.live_view import LiveView
from roemetry_line.log import log, log_libraries
from roemetry_line.outbox import NewRow, Outbox
from roemetry_line.process import alone, off_main_thread, settle, stop_event
from roemetry_line.rows import Taken, Where, notice_row, product_rows


class Exposures:
    """Puts frames together, from when the camera is opened: its first frame is in the first light.

    A frame that is lost or not whole takes its product with it; those that follow are in their light again.
    """

    def __init__(self, lights: Sequence[Role]) -> None:
        """Make it; `lights` says what lights the scene, in the order in which frames are taken."""
        self._lights = lights
        self._count = 0
        self._product = 0
        self._kept: list[Frame] = []

    def add(self, live: LiveFrame) -> tuple[Frame, ...] | None:
        """Give the frames of a product with its last one; None before that."""
        product, index = divmod(self._count + live.lost_before, len(self._lights))
        self._count += live.lost_before + 1
        if product != self._product:
            self._product, self._kept = product, []
        if live.frame is not None:
            self._kept.append(replace(live.frame, role=self._lights[index]))
        return tuple(self._kept) if len(self._kept) == len(self._lights) else None


LATENCY_MS = (5.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Upper ends of the classes in which times from frame to outbox are counted, ms."""
_REOPEN_S = 1.0
"""How long a camera that is gone is left alone before it is tried again, s."""
_RETRY_S = 0.5
"""How long a disk that refuses is left alone before it is tried again, s."""
_RELOAD_S = 1.0
"""How often the recipe's file is looked at, s."""
_DISK_LOW_GB = 1.0  # free, below which it is said
_OPENING_S = 15.0
"""So long a driver may take to open a camera, s."""
_SILENT_S = 2.0
"""So long a feed may neither give a frame nor say that none has come, s; then its driver hangs."""
_TRIED = "tried.txt"


@dataclass(eq=False)
class Job:
    """A recipe that is ready to measure, and the run that it fills."""

    recipe: Recipe
    pipeline: Pipeline
    doubts: tuple[Reason, ...]
    run: Path
    spool: runs.Spool
    record: runs.RunRecord


@dataclass(frozen=True)
class Task:
    """A frame that waits to be measured."""

    job: Job
    acquisition: Acquisition
    hashes: dict[str, str]
    taken: Taken


@dataclass
class Figures:
    """What is counted; read by other threads as it is."""

    frames: int = 0
    products: int = 0
    lost: int = 0
    incomplete: int = 0
    late: int = 0
    recovered: int = 0
    reloads: int = 0
    reconnects: int = 0
    waited_s: float = 0.0
    """How long the taking of frames has waited for a place in the queue."""
    latency_ms_sum: float = 0.0
    latency_ms_worst: float = 0.0
    latency_counts: list[int] = field(default_factory=lambda: [0] * (len(LATENCY_MS) + 1))
    results: Counter[str] = field(default_factory=Counter)
    """Products by decision, else grade, else status."""

    def add_latency(self, latency_ms: float) -> None:
        """Count one frame."""
        self.latency_ms_sum += latency_ms
        self.latency_ms_worst = max(self.latency_ms_worst, latency_ms)
        self.latency_counts[int(np.searchsorted(LATENCY_MS, latency_ms))] += 1


class StationProcess:
    """Runs one station until it is told to stop."""

    def __init__(self, line: line_file.Line, name: str, outbox: Outbox, stop: threading.Event) -> None:
        self._line, self._station = line, line.station(name)
        self._name = name
        self._outbox, self._stop = outbox, stop
        self._home = line.folder / "runs"
        self._section = self._station.section
        self._kept = runs.KeptImages(self._home, name, self._section.spool_gb)
        self._queue: queue.Queue[Task] = queue.Queue(self._section.queue)
        self._figures = Figures()
        self._next: Recipe | None = None
        self._lock = threading.Lock()
        self._due: dict[tuple[str, str], tuple[float, Taken, Where]] = {}
        self._state = "starting"
        self._last_frame_s = self._last_try_s = time.time()
        self._last_beat_s = 0.0
        self._taking, self._opened = False, False
        self._open = outbox.open_alarms(name)
        self._view = LiveView(line.folder, name)
        self._laser = LaserHealth()
        self._checks = BlockChecks(
            name, self._station.block, line.folder, outbox, self._loaded_now, self._block_checked
        )

    def run(self) -> None:
        """Recover what the last run left, then take and measure until asked to stop; then drain."""
        recipe = self._whole_recipe()
        if recipe is None:
            return
        warm_up(recipe.stages)
        self._beat(now=True)
        for left in runs.runs_of(self._home, self._name):
            if runs.unfinished(left):
                self._recover(left)
        job = self._begin(recipe)
        _load_kernels(recipe)
        settle()
        self._state = "running"
        threads = [
            threading.Thread(target=target, daemon=True)
            for target in (
                lambda: self._take(job),
                self._watch_deadlines,
                self._watch_recipe,
                lambda: self._checks.run(self._stop),
            )
        ]
        for thread in threads:
            thread.start()
        self._measure_all(job)

    # --- taking ---------------------------------------------------------------------------------------------

    def _take(self, job: Job) -> None:
        """Take frames until asked to stop; a camera that is gone is opened again and again."""
        self._taking, self._last_try_s = True, time.time()
        try:
            while not self._stop.is_set():
                try:
                    with self._station.feed.make().open() as frames:
                        exposures = Exposures(self._section.lights)
                        self._opened = True
                        self._last_try_s = time.time()
                        self._ended("camera", "the camera is there again")
                        for live in frames:
                            if self._stop.is_set():
                                break
                            if live is not None:
                                job = self._take_one(job, live, exposures.add(live))
                            self._last_frame_s = self._last_try_s = time.time()
                        else:
                            self._note("feed-ended", "the feed has no more frames")
                            return
                # Whatever a feed raises, the line goes on as soon as there are frames again.
                except FAULTS as error:
                    self._opened = False
                    self._figures.reconnects += 1
                    self._last_try_s = time.time()
                    said = error.message if isinstance(error, RoemetryError) else _fault(error)
                    self._alarm("camera", f"no frames from the camera: {said}")
                    self._stop.wait(_REOPEN_S)
        finally:
            self._taking = False

    def _take_one(self, job: Job, live: LiveFrame, frames: tuple[Frame, ...] | None) -> Job:
        """Count a frame; with the last one of a product, let it be measured."""
        taken = Taken.of(live, time.time())
        self._figures.frames += 1
        where = self._where(job)
        if live.lost_before:
            self._figures.lost += live.lost_before
            said = f"{live.lost_before} frames lost before frame {live.number}"
            self._tell(notice_row(where, "frames-lost", said, taken))
            self._note("frames-lost", said, run=where.run, frame=live.number)
        if live.frame is None:
            self._figures.incomplete += 1
            said = f"frame {live.number} is not whole: {live.fault}"
            self._tell(notice_row(where, "frame-incomplete", said, taken))
            self._note("frame-incomplete", said, run=where.run, frame=live.number)
        if frames is None:
            return job
        laser = next(frame for frame in frames if frame.role == "laser")
        taken = replace(taken, encoder_count=laser.encoder_count)
        if self._checks.takes(laser):
            return job
        if self._next is not None or job.spool.full():
            job = self._switch(job)
        acquisition, hashes = self._until_written(lambda: job.spool.add(frames), "spool")
        if self._section.deadline_ms is not None:
            with self._lock:
                due = taken.time_s + self._section.deadline_ms / 1e3
                self._due[job.run.name, acquisition.id] = due, taken, self._where(job)
        task = Task(job, acquisition, hashes, taken)
        begin = time.perf_counter()
        while True:
            try:
                self._queue.put(task, timeout=0.25)
                break
            except queue.Full:
                self._last_try_s = time.time()
                if not self._stop.is_set():
                    said = "measuring does not keep up: frames wait, and the camera may lose some"
                    self._alarm("queue-full", said, "warning")
        self._figures.waited_s += time.perf_counter() - begin
        return job

    def _switch(self, job: Job) -> Job:
        with self._lock:
            recipe, self._next = self._next, None
        job.spool.close()
        self._laser = LaserHealth()
        if recipe is not None:
            self._figures.reloads += 1
            self._note("recipe-reloaded", f"a new run begins, with the recipe as it is now: {recipe.path}")
        return self._begin(recipe or job.recipe)

    def _whole_recipe(self) -> Recipe | None:
        """Load the recipe; wait while it has faults, as after a restart. None where asked to stop."""
        while not self._stop.is_set():
            try:
                recipe = self._loaded_now()
            except RoemetryError as error:
                self._alarm("recipe", f"nothing is measured, the recipe has faults: {error}")
                self._state = "waits for a recipe without faults"
                self._beat()
                self._stop.wait(_RELOAD_S)
                continue
            self._ended("recipe", "the recipe is whole")
            return recipe
        return None

    def _begin(self, recipe: Recipe) -> Job:
        """Begin a run with a recipe; its source is the run's own spool, so that `roemetry run` finds it."""
        run = runs.new_run(self._home, self._name)
        recipe = line_file.load_recipe(recipe.path, run)
        return Job(
            recipe,
            Pipeline(recipe),
            calibration_doubts(recipe),
            run,
            runs.Spool(run, self._kept),
            runs.RunRecord(run, recipe),
        )

    # --- measuring ------------------------------------------------------------------------------------------

    def _measure_all(self, job: Job) -> None:
        """Measure what is taken, in order, until nothing more can come."""
        while True:
            try:
                task = self._queue.get(timeout=0.25)
            except queue.Empty:
                self._ended("queue-full", "measuring keeps up again")
                self._beat()
                if not self._taking and self._queue.empty():
                    if self._stop.is_set():
                        break
                    self._stop.wait(0.25)
                continue
            if task.job is not job:
                job.record.close()
                runs.finish_beside(job.run)
                job = task.job
            self._measure(task)
            self._beat()
        job.spool.close()
        job.record.close()
        runs.finish(job.run)
        self._state = "stopped"
        self._beat(now=True)

    def _measure(self, task: Task) -> None:
        job = task.job
        trace: Trace | None = None
        try:
            trace = job.pipeline.trace(task.acquisition)
            rows = measurements_of(trace, job.recipe, job.recipe.hashes | task.hashes, job.doubts)
        # The pipeline answers for its stages; what else may break must not stop the line.
        except FAULTS as error:
            why = Reason("unreadable", _fault(error))
            rows = (failed(task.acquisition.id, "source", why, job.recipe.hashes | task.hashes),)
        now = time.time()
        latency_ms = 1e3 * (now - task.taken.time_s)
        with self._lock:
            self._due.pop((job.run.name, task.acquisition.id), None)
        deadline_ms = self._section.deadline_ms
        late = deadline_ms is not None and latency_ms > deadline_ms
        told = product_rows(
            self._where(job), rows, trace, task.taken, self._section.gate, latency_ms=latency_ms, late=late
        )
        self._until_written(lambda: self._outbox.put(told), "outbox")
        self._until_written(lambda: job.record.append([row.record or "" for row in told]), "record")
        self._count(told, latency_ms, late)
        self._look_at_laser(trace)
        for row in told:
            if row.summary["status"] == "failed":
                log("warning", "not-measured", str(row.summary["reason"]), station=self._name, run=row.run,
                    product=row.summary["id"], frame=task.taken.number)  # fmt: skip
        self._view.show(task.acquisition, trace, told)

    def _look_at_laser(self, trace: Trace | None) -> None:
        said = self._laser.look(trace)
        if said:
            self._alarm("laser", said)
        elif said is not None:
            self._ended("laser", "the stripes have their light again")

    def _count(self, told: list[NewRow], latency_ms: float, late: bool) -> None:
        figures = self._figures
        figures.products += len(told)
        figures.add_latency(latency_ms)
        figures.late += late
        for row in told:
            said = row.summary["decision"] or row.summary["grade"] or row.summary["status"]
            figures.results[str(said)] += 1

    def _recover(self, run: Path) -> None:
        """Finish a run whose process died: complete its record, and measure what was taken."""
        done = runs.complete_record(run, self._outbox)
        left = list(runs.not_measured(run, done))
        if left:
            self._note(
                "recovering", f"{run.name}: {len(left)} frames were taken and not measured; now they are"
            )
            for rows in self._measured_again(run, left):
                self._until_written(lambda rows=rows: self._outbox.put(rows), "outbox")
                self._figures.recovered += len(rows)
            runs.complete_record(run, self._outbox)
        runs.finish(run)

    def _measured_again(self, run: Path, left: list[Item]) -> Iterator[list[NewRow]]:
        try:
            recipe, _ = recipe_of(run)
        except RoemetryError as error:
            self._note("not-recovered", f"{run.name}: {len(left)} frames stay unmeasured: {error.message}")
            return
        where = Where(self._line.name, self._name, run.name, recipe.product)
        pipeline, source, doubts = Pipeline(recipe), recipe.source.make(), calibration_doubts(recipe)
        tried = run / _TRIED
        before = set(tried.read_text("utf-8").split()) if tried.exists() else set()
        for item in left:
            files = {role: run / name for role, name in item.files.items()}
            hashes = recipe.hashes | {f"{role}_sha256": sha256_of(path) for role, path in files.items()}
            trace = None
            if item.id in before:
                why = Reason("process-died", "the process died whenever this frame was measured; see its log")
                rows: tuple[Any, ...] = (failed(item.id, "source", why, hashes),)
            else:
                with tried.open("a", encoding="utf-8") as file:
                    file.write(item.id + "\n")
                trace = pipeline.trace(source.read(AcquisitionReference(item.id, files)))
                rows = measurements_of(trace, recipe, hashes, doubts)
            latency_ms = 1e3 * (time.time() - item.time_s)
            taken = Taken(-1, 0, item.time_s, item.encoder_count, float("nan"))
            yield product_rows(
                where, rows, trace, taken, self._section.gate,
                latency_ms=latency_ms, late=self._section.deadline_ms is not None, recovered=True,
            )  # fmt: skip

    # --- beside ---------------------------------------------------------------------------------------------

    def _watch_deadlines(self) -> None:
        """Say of every frame whose time is up and that is still being measured that it is late."""
        if self._section.deadline_ms is None:
            return
        step_s = min(0.01, max(0.001, self._section.deadline_ms / 4e3))
        while not self._stop.wait(step_s):
            now = time.time()
            with self._lock:
                over = [(key, *told) for key, told in self._due.items() if told[0] <= now]
                for key, *_ in over:
                    del self._due[key]
            for (_, acquisition), _, taken, where in over:
                said = f"not measured within {self._section.deadline_ms:g} ms"
                self._tell(notice_row(where, "late", said, taken, acquisition))
                log("warning", "late", said, station=self._name, run=where.run, product=acquisition,
                    frame=taken.number)  # fmt: skip

    def _watch_recipe(self) -> None:
        """Load the recipe again whenever it has changed; one with faults leaves the old one at work."""
        current = self._loaded_now()
        seen = current.path, _states(current)
        while not self._stop.wait(_RELOAD_S):
            now = self._wanted(), _states(current)
            if now == seen:
                continue
            seen = now
            try:
                changed = line_file.load_recipe(now[0], self._home)
                if changed.sha256 == current.sha256:
                    self._ended("recipe", "the recipe is whole again")
                    continue
                warm_up(changed.stages)
                _load_kernels(changed)
            except FAULTS as error:
                self._alarm("recipe", f"the changed recipe is not taken, the old one measures on: {error}")
                continue
            self._ended("recipe", "the changed recipe is whole")
            current, seen = changed, (changed.path, _states(changed))
            with self._lock:
                self._next = changed

    def _loaded_now(self) -> Recipe:
        """Load the recipe that is at work, as it is on disk."""
        return line_file.load_recipe(self._wanted(), self._home)

    def _block_checked(self, verdict: str, said: str) -> None:
        """Tell what a check of the calibration found; the next run's rows then carry it."""
        taken = Taken(-1, 0, time.time(), float("nan"), float("nan"))
        where = Where(self._line.name, self._name, "checks", self._loaded_now().product)
        self._tell(notice_row(where, "calibration-check", said, taken))
        if verdict == "failed":
            self._note("check-failed", said)
            return
        if verdict == "in order":
            self._ended("calibration", said)
            self._note("calibration-check", said)
        else:
            self._alarm("calibration", said, "alarm" if verdict == "out" else "warning")
        with suppress(RoemetryError):  # a recipe that is being edited is taken once it loads
            recipe = self._loaded_now()
            with self._lock:
                self._next = self._next or recipe

    def _wanted(self) -> Path:
        """Give the recipe that was chosen on the page, where it is one of the line's; else the first."""
        try:
            chosen = self._outbox.requested_recipe(self._name)
        except OutputError:
            chosen = None
        recipes = self._station.recipes
        return next((path for path in recipes if str(path) == chosen), recipes[0])

    def _until_written(self, write: Any, what: str) -> Any:
        """Write, again and again where the disk refuses: the queue fills meanwhile, and nothing is lost."""
        while True:
            try:
                done = write()
            except OutputError as error:
                self._alarm(f"{what}-not-written", error.message)
                time.sleep(_RETRY_S)
                self._last_try_s = time.time()
                self._beat()
                continue
            self._ended(f"{what}-not-written", f"the {what} can be written again")
            return done

    def _tell(self, row: NewRow) -> None:
        try:
            self._outbox.put([row])
        except OutputError as error:
            log("error", "notice-not-written", str(error), station=self._name)

    def _where(self, job: Job) -> Where:
        return Where(self._line.name, self._name, job.run.name, job.recipe.product)

    def _alarm(self, code: str, text: str, level: Any = "alarm", **context: Any) -> None:
        if level != "note":
            self._open.add(code)
        try:
            new = self._outbox.raise_alarm(self._name, code, text, level)
        except OutputError:  # the disk is full: the log still says it
            new = True
        if new:
            log("error" if level == "alarm" else "warning", code, text, station=self._name, **context)

    def _ended(self, code: str, text: str) -> None:
        if code not in self._open:
            return
        try:
            self._outbox.end_alarm(self._name, code)
        except OutputError:  # it stays open, and is ended the next time
            return
        self._open.discard(code)
        log("info", code, text, station=self._name)

    def _note(self, code: str, text: str, **context: Any) -> None:
        self._alarm(code, text, "note", **context)

    def _beat(self, *, now: bool = False) -> None:
        """Say once a second that this process works, and what it has counted; and at once what hangs."""
        silent_s = time.time() - self._last_try_s
        if self._taking and silent_s > (_SILENT_S if self._opened else _OPENING_S):
            self._alarm("driver", f"the camera's driver has not answered for {silent_s:.0f} s")
        else:
            self._ended("driver", "the camera's driver answers again")
        if not now and time.time() - self._last_beat_s < 1.0:
            return
        self._last_beat_s = time.time()
        free_gb = runs.disk_free(self._line.folder)
        if free_gb < _DISK_LOW_GB:
            self._alarm("disk-low", f"{free_gb:.2f} GB are free for {self._line.folder}", "warning")
        else:
            self._ended("disk-low", "there is room on the disk again")
        figures = {
            **vars(self._figures),
            "queue": self._queue.qsize(),
            "last_frame_s": self._last_frame_s,
            "last_try_s": self._last_try_s,
            "disk_free_gb": free_gb,
            "laser_percent": None if math.isnan(self._laser.percent) else self._laser.percent,
        }
        try:
            self._outbox.beat(f"station {self._name}", self._state, figures)
        except OutputError as error:
            log("error", "health-not-written", str(error), station=self._name)


def _load_kernels(recipe: Recipe) -> None:
    """Measure one image and throw the result away, so that the first product does not wait for kernels.

    It is the first image of the recipe's own source; where there is none, a dark one.
    """
    try:
        own = Recipe.load(recipe.path)
        first = own.source.make().read(own.references()[0])
    except (RoemetryError, IndexError):
        colours = () if recipe.source_choice.contrast == "none" else (3,)
        first = Acquisition("warm", (Frame(np.zeros((480, 640, *colours), np.uint8)),))
    Pipeline(recipe).trace(first)


def _states(recipe: Recipe) -> list[tuple[int, int] | None]:
    """Give what changes when one of a recipe's files is written."""
    paths = [recipe.path, *([] if recipe.calibration_path is None else [recipe.calibration_path])]
    found: list[tuple[int, int] | None] = []
    for path in paths:
        try:
            state = path.stat()
        except OSError:
            found.append(None)
            continue
        found.append((state.st_mtime_ns, state.st_size))
    return found


def _fault(error: BaseException) -> str:
    return str(error) if isinstance(error, RoemetryError | DataError) else f"{type(error).__name__}: {error}"


def main() -> int:
    """Run the station that the command line names, of a line file."""
    log_libraries()
    stop = stop_event()
    path, name = Path(sys.argv[1]), sys.argv[2]
    line = line_file.Line.load(path, with_recipes=False)
    outbox = Outbox(line.folder)
    with alone(line.folder, f"station-{name}", stop) as mine:
        if mine and not stop.is_set():
            off_main_thread(StationProcess(line, name, outbox, stop).run)
    return 0


if __name__ == "__main__":
    sys.exit(main())
