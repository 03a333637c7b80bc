"""What every source, sink, simulator, planner, feed and outlet keeps."""

from __future__ import annotations

import contextlib
import math
import pickle
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.errors import DataError, OutputError, RoemetryError
from roemetry.records import AcquisitionReference, Measurement
from roemetry.records.live import LineRow, LiveFrame
from roemetry.stages import Feed, Outlet, Planner, Simulator, Sink, Source
from roemetry.testing.cases import content_of, readable_path
from roemetry.testing.runs import failed, measured, run_of
from roemetry.testing.verdict import difference, refused, require


def check_acquisitions_are_found_and_read(source: Source[Any]) -> None:
    """Two acquisitions are listed in order with different ids, and each can be read by its id."""
    with tempfile.TemporaryDirectory() as folder:
        references = source.references(readable_path(source, Path(folder)))
        require(len(references) == 2, f"{len(references)} acquisitions are listed, 2 are there")
        ids = [reference.id for reference in references]
        require(len(set(ids)) == 2, f"both have the id `{ids[0]}`")
        for reference in references:
            acquisition = source.read(reference)
            require(acquisition.id == reference.id, f"`{reference.id}` is read as `{acquisition.id}`")
            _, of_lines = content_of(acquisition)
            found = acquisition.frames or of_lines or acquisition.profiles is not None
            require(found, f"`{reference.id}` has no frame, no line and no slices")


def check_reading_order_does_not_matter(source: Source[Any]) -> None:
    """Acquisitions can be read in any order, as worker processes do, and their references pickled."""
    with tempfile.TemporaryDirectory() as folder:
        references = source.references(readable_path(source, Path(folder)))
        first, second = (content_of(source.read(reference)) for reference in references)
        pickled = [pickle.loads(pickle.dumps(reference)) for reference in references[::-1]]
        again = [content_of(source.read(reference)) for reference in pickled]
        found = difference([second, first], again)
    require(found is None, f"read in another order, {found}")


def check_a_missing_path_is_named(source: Source[Any]) -> None:
    """A path that does not exist raises a `DataError` that names it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "nowhere"
        with refused("a path that is not there", DataError) as caught:
            source.references(path)
    require("nowhere" in str(caught[0]), f"the error does not name the path: {caught[0]}")


def check_an_unreadable_file_is_named(source: Source[Any]) -> None:
    """A file that is missing, empty or damaged raises a `DataError` that names it."""
    for content in (None, b"", b"not what it should be\n" * 9):
        with tempfile.TemporaryDirectory() as folder:
            references = source.references(readable_path(source, Path(folder)))
            broken = _broken(references[0], Path(folder), content)
            what = "a missing file" if content is None else f"a file of {len(content)} damaged bytes"
            with refused(what, DataError) as caught:
                source.read(broken)
        name = next(iter(broken.files.values())).name
        require(name in str(caught[0]), f"the error does not name {name}: {caught[0]}")


def _broken(reference: AcquisitionReference, folder: Path, content: bytes | None) -> AcquisitionReference:
    """Give the reference with its first file missing (None) or holding something else."""
    role, whole = next(iter(reference.files.items()))
    path = folder / f"broken{whole.suffix}"
    if content is not None:
        path.write_bytes(content)
    return replace(reference, files={**reference.files, role: path})


def check_it_writes_what_it_says(sink: Sink[Any]) -> None:
    """The files it names exist after writing and are not empty."""
    with tempfile.TemporaryDirectory() as folder:
        paths = _written(sink, Path(folder) / "run", measured(), failed())
        require(paths, "it names no file")
        for path in paths:
            require(path.is_file(), f"{path.name} is named and not there")
            require(path.stat().st_size > 0, f"{path.name} is empty")


def check_it_writes_only_inside_its_folder(sink: Sink[Any]) -> None:
    """It writes inside the run's folder and nowhere else, and names all files it leaves there."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        named = {path.resolve() for path in _written(sink, folder / "run", measured(), failed())}
        found = {path.resolve() for path in folder.rglob("*") if path.is_file()}
        inside = (folder / "run").resolve()
        outside = [path.name for path in found | named if not path.is_relative_to(inside)]
        require(not outside, f"written outside the folder: {', '.join(outside)}")
        unnamed = sorted(path.name for path in found - named)
        require(not unnamed, f"written and not named: {', '.join(unnamed)}")


def check_an_id_does_not_lead_outside(sink: Sink[Any]) -> None:
    """An acquisition's id with ``../`` in it does not lead outside the folder; it is written or refused."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with contextlib.suppress(RoemetryError):
            _written(sink, folder / "deep" / "run", measured("../../away"))
        inside = (folder / "deep" / "run").resolve()
        found = [path for path in folder.rglob("*") if path.is_file()]
        outside = [path.name for path in found if not path.resolve().is_relative_to(inside)]
        require(not outside, f"written outside the folder: {', '.join(outside)}")


def check_an_empty_run_works(sink: Sink[Any]) -> None:
    """A run without any measurement is written without an exception."""
    with tempfile.TemporaryDirectory() as folder:
        _written(sink, Path(folder) / "run")


def check_failed_rows_and_lost_images_work(sink: Sink[Any]) -> None:
    """Failed rows, and acquisitions whose image is missing, do not stop it."""
    with tempfile.TemporaryDirectory() as folder:
        _written(sink, Path(folder) / "run", failed("p1"), failed("p2"))


def check_it_can_write_again(sink: Sink[Any]) -> None:
    """Writing a second time into the same folder replaces its files."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        first = {path: path.read_bytes() for path in _written(sink, run, measured())}
        second = {path: path.read_bytes() for path in _written(sink, run, measured())}
    require(first == second, "the second time it writes something else")


def check_a_folder_that_cannot_be_is_refused(sink: Sink[Any]) -> None:
    """A folder that cannot be created raises a `RoemetryError`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        path.write_text("in the way", encoding="utf-8")
        with refused("a folder below a file"):
            sink.write(run_of(path / "run", (measured(),)))


def _written(sink: Sink[Any], folder: Path, *rows: Measurement) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    return list(sink.write(run_of(folder, rows)))


def check_numbers_and_seeds_make_others(simulator: Simulator[Any]) -> None:
    """Another number, or another seed, gives another image."""
    one, number, seed = (simulator.simulate(*which) for which in ((0, 1), (1, 1), (0, 2)))
    require(difference(one.frames, number.frames) is not None, "numbers 0 and 1 are the same image")
    require(difference(one.frames, seed.frames) is not None, "seeds 1 and 2 make the same image")


def check_truth_fits_the_image(simulator: Simulator[Any]) -> None:
    """True stripe centres have a row for each row of the laser frame and lie within it."""
    made = simulator.simulate(0, 1)
    frame = next((frame for frame in made.frames if frame.role == "laser"), None)
    require(frame is not None, "there is no laser frame")
    if frame is None or made.truth.stripes is None:
        return
    x_px = made.truth.stripes.x_px
    require(x_px.shape[1] == frame.size[0], f"truth of {x_px.shape[1]} rows for {frame.size[0]} rows")
    known = x_px[np.isfinite(x_px)]
    require(bool(((known >= -0.5) & (known <= frame.size[1] - 0.5)).all()), "true centres lie outside")


def check_every_figure_has_unit_and_basis(planner: Planner[Any]) -> None:
    """Every figure, table, map and curve states its unit, and its formula or source."""
    plan = planner.plan(simulate=False)
    require(bool(plan.figures), "the plan has no figures")
    columns = [column for table in plan.tables for column in table.columns]
    columns += [line for curves in plan.curves for line in (curves.over, *curves.lines)]
    with_unit = [(figure.name, figure.unit) for figure in plan.figures]
    with_unit += [(one.name, one.unit) for one in plan.maps]
    with_unit += [(column.name, column.unit) for column in columns]
    for name, unit in with_unit:
        require(bool(unit), f"`{name}` has no unit")
    told = [(figure.name, figure.basis) for figure in plan.figures]
    told += [(one.name, one.basis) for one in plan.maps]
    told += [(table.name, table.basis) for table in plan.tables]
    told += [(curves.name, curves.basis) for curves in plan.curves]
    for name, basis in told:
        require(bool(basis), f"`{name}` does not say where it comes from")


def check_what_is_missing_has_a_reason(planner: Planner[Any]) -> None:
    """A plan with a figure that is not known (NaN) has reasons in words."""
    plan = planner.plan(simulate=False)
    missing = [one.name for one in plan.figures if math.isnan(one.value)]
    require(not missing or bool(plan.reasons), f"{', '.join(missing)}: no reason is given")


_WAIT_S = 10.0  # longer than any feed takes for its first frames


def check_frames_come_in_order(feed: Feed[Any]) -> None:
    """Two complete frames arrive within ten seconds, with rising numbers and the host's time."""
    first, second = _taken(feed, 2)
    require(second.number > first.number, f"frame {second.number} comes after frame {first.number}")
    for live in (first, second):
        require(live.frame is not None, f"frame {live.number} is not whole: {live.fault}")
        known = live.frame is not None and not math.isnan(live.frame.time_s)
        require(known, f"frame {live.number} has no time")


def check_it_can_be_opened_again(feed: Feed[Any]) -> None:
    """A closed feed gives frames again when it is opened again."""
    _taken(feed, 1)
    _taken(feed, 1)


def _taken(feed: Feed[Any], many: int) -> list[LiveFrame]:
    found: list[LiveFrame] = []
    until_s = time.monotonic() + _WAIT_S
    with feed.open() as frames:
        for live in frames:
            found += [] if live is None else [live]
            if len(found) == many or time.monotonic() > until_s:
                break
    require(len(found) == many, f"{len(found)} frames came within {_WAIT_S:g} s, expected {many}")
    return found


def check_a_receiver_that_is_not_there_is_refused(outlet: Outlet[Any]) -> None:
    """If nothing listens at the fixture's address, delivery raises an `OutputError` with the address."""
    row = LineRow(1, "line/run/000001#1", "product", {"id": "000001#1", "status": "measured"}, "{}")
    with refused("a receiver that is not there", OutputError) as caught, outlet.open() as deliver:
        deliver([row])
    told = str(caught[0])
    require(any(mark in told for mark in ":/@"), f"the error names no address: {told}")
