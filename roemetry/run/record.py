"""The record of a run: ``measurements.jsonl``, a line a product; and what the run was made with.

A run whose folder is in a bucket has its record in parts, with an index of them. An object is written whole
and never appended to, and a bucket has no lock. So the run works in a folder of its own on this machine;
whenever so many rows were measured, they are put into the bucket as a part, and then the index that names it.
What the index names counts: a run that is killed, or whose machine is gone, loses the rows since its last
part, which `--resume` measures again from anywhere. A run that ends in any other way loses none. What sinks
derive follows at the end.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from roemetry.config.recipe import Recipe
from roemetry.errors import DataError, OutputError
from roemetry.io.files import LineFile, first_fault, sha256_of, whole_file, write_bytes, write_whole
from roemetry.io.remote import Url
from roemetry.records import AcquisitionReference, Measurement, Reason
from roemetry.records.arrays import Floats

INDEX = "index.json"
_ROWS = 5000
"""Rows of a part: some 12 MB, which a bucket takes in a second, and a minute's work of a few cores."""


@dataclass(frozen=True, slots=True)
class Part:
    """Some rows of a record, in a file of JSON lines; all of an acquisition are in one part."""

    file: Annotated[str, Field(pattern=r"^parts/[0-9]+\.jsonl$")]
    """Relative to the run's folder."""
    rows: int
    sha256: str
    lowest: str
    highest: str
    """lowest, highest: of the acquisitions' ids, in the order of their characters."""


@dataclass(frozen=True, slots=True)
class _Index:
    roemetry_index: Literal[1]
    parts: tuple[Part, ...]


@cache
def _reader() -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(_Index)


def parts_of(folder: Path) -> tuple[Part, ...]:
    """Read the index of a record; FileNotFoundError where there is none, DataError for a wrong one."""
    path = folder / INDEX
    try:
        found: _Index = _reader().validate_python(json.loads(path.read_bytes()))
    except ValueError as error:
        raise DataError(f"{path}: damaged ({first_fault(error)})", hint="name the folder of a run") from error
    return found.parts


def bytes_of(folder: Path, part: Part) -> bytes:
    """Read a part's lines; DataError where they are not those that the index says."""
    path = folder / part.file
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != part.sha256:
        raise DataError(
            f"{path}: damaged: its bytes have another hash than {INDEX} says",
            hint="`roemetry run` into a fresh folder measures again",
        )
    return data


class Parts:
    """Puts a record that grows on this machine into a bucket, part by part."""

    def __init__(self, place: Url, record: Path, parts: tuple[Part, ...]) -> None:
        self._place, self._record, self._parts = place, record, list(parts)
        self._end = record.stat().st_size if parts else 0
        self._rows, self._names = 0, set[str]()
        self._told = b""
        """The index as this run wrote it."""

    def begin(self, provenance: Path) -> None:
        """Put there what a run is made with: a bucket that takes nothing is known before the first image."""
        write_bytes(self._place / provenance.name, provenance.read_bytes())
        self._write_index()

    def take_back(self, provenance: str) -> None:
        """Take away what `begin` put there; as far as the bucket lets us, for an error is on its way."""
        with suppress(OSError, OutputError):
            self._refuse_another_run()
            for name in (provenance, INDEX):
                (self._place / name).unlink()

    def grown(self, acquisition: str, rows: int) -> None:
        """Count an acquisition's rows, which stand in the record now; OutputError: a part is not taken."""
        self._rows += rows
        self._names.add(acquisition)
        if self._rows >= _ROWS:
            self.close()

    def close(self) -> None:
        """Put the rows since the last part there."""
        if not self._rows:
            return
        with self._record.open("rb") as file:
            file.seek(self._end)
            data = file.read()
        self._refuse_another_run()
        name = f"parts/{len(self._parts) + 1:06d}.jsonl"
        write_bytes(self._place / name, data)
        sha256 = hashlib.sha256(data).hexdigest()
        self._parts.append(Part(name, self._rows, sha256, min(self._names), max(self._names)))
        self._write_index()
        self._end += len(data)
        self._rows, self._names = 0, set()

    def _write_index(self) -> None:
        index = _Index(1, tuple(self._parts))
        self._told = (json.dumps(asdict(index), indent=1) + "\n").encode()
        write_bytes(self._place / INDEX, self._told)

    def _refuse_another_run(self) -> None:
        path = self._place / INDEX
        path.forget()
        try:
            same = path.read_bytes() == self._told
        except OSError as error:
            raise OutputError(f"{path}: cannot be read: {error.strerror or error}") from error
        if not same:
            raise OutputError(
                f"{self._place}: another run is writing into this folder",
                hint="wait until it is done, or choose another folder with --out",
            )


@contextmanager
def in_bucket(place: Url, record: str, *, resume: bool) -> Iterator[tuple[Path, Parts]]:
    """Give a folder to run in, and what puts its `record` into the bucket; the rest follows at the end.

    OutputError where the bucket cannot be read or written, or has a run that is not to be gone on with.
    """
    with _working_folder(place) as folder:
        try:
            (place / INDEX).forget()
            parts = parts_of(place)
        except FileNotFoundError:
            parts = ()
        except OSError as error:
            raise OutputError(f"{place}: cannot be read: {error.strerror or error}") from error
        if parts and not resume:
            raise OutputError(
                f"{place}: there is a run in this folder already",
                hint="go on with it by --resume, or choose another folder with --out",
            )
        if parts:
            fetch(place, parts, folder / record)
        made = Parts(place, folder / record, parts)
        try:
            yield folder, made
        finally:
            made.close()
        _put_files(folder, place, without=record)


@contextmanager
def copied(place: Url, lines: Iterable[str] | None, record: str) -> Iterator[Path]:
    """Give a folder with a `record` of these lines, or of all, and put what is made in it into the bucket."""
    with _working_folder(place) as folder:
        if lines is None:
            fetch(place, parts_of(place), folder / record)
        else:
            write_whole(folder / record, "".join(f"{line}\n" for line in lines))
        yield folder
        _put_files(folder, place, without=record)


@contextmanager
def _working_folder(place: Url) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="roemetry-") as name:
        folder = Path(name) / place.name  # which data sets know the run by
        folder.mkdir()
        yield folder


def fetch(place: Path, parts: Iterable[Part], record: Path) -> None:
    """Write a record of parts as one file."""
    try:
        with record.open("wb") as file:
            for part in parts:
                file.write(bytes_of(place, part))
    except OSError as error:
        raise OutputError(f"{place}: cannot be read: {error.strerror or error}") from error


def _put_files(folder: Path, place: Url, *, without: str) -> None:
    """Put what lies in a folder into the bucket, but for one file and hidden ones."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if path.is_file() and str(name) != without and not any(part.startswith(".") for part in name.parts):
            write_bytes(place / name, path.read_bytes())


RECORD = "measurements.jsonl"
PROVENANCE = "provenance.json"


def read_record(folder: Path) -> Iterator[Measurement]:
    """Give the measurements of a run, one at a time; DataError where one stands twice."""
    seen: set[int] = set()  # of a long run the hashes of the ids take less memory than the ids
    for place, line in _lines_of(folder):
        try:
            row = Measurement.from_json(line)
        except DataError as error:
            if not line.endswith("\n"):
                raise DataError(
                    f"{place}: the last line is cut off: the run was stopped in it",
                    hint="`roemetry run` with --resume takes it away and goes on",
                ) from error
            raise DataError(f"{place}: {error.message}", hint=error.hint) from error
        mark = hash(row.id)
        if mark in seen and (first := _place_of(folder, row.id)) != place:
            raise DataError(
                f"{place}: {row.id} stands in line {first.rpartition(':')[2]} already"
                if first.rpartition(":")[0] == place.rpartition(":")[0]
                else f"{place}: {row.id} stands in {first} already",
                hint="it was put together by hand, or by two runs; run again with another --out",
            )
        seen.add(mark)
        yield row


def _lines_of(folder: Path) -> Iterator[tuple[str, str]]:
    """Give the lines of a record, in one file or in parts, and where each stands."""
    path = folder / RECORD
    try:
        if not isinstance(folder, Url) and path.exists():
            with path.open(encoding="utf-8") as file:
                for number, line in enumerate(file, start=1):
                    yield f"{path}:{number}", line
            return
        for part in _parts_of(folder):
            path = folder / part.file
            for number, raw in enumerate(bytes_of(folder, part).splitlines(keepends=True), start=1):
                yield f"{path}:{number}", raw.decode()
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: damaged: byte {error.start} of a block is not UTF-8") from error
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror or error}") from error


def _parts_of(folder: Path) -> tuple[Part, ...]:
    """Read the index of a record in parts; OutputError where there is no record in the folder at all."""
    try:
        return parts_of(folder)
    except OSError as error:
        raise OutputError(f"{folder / RECORD}: cannot be read: {error.strerror or error}") from error


def _place_of(folder: Path, name: str) -> str:
    """Give where the first row of a name stands."""
    return next(place for place, line in _lines_of(folder) if Measurement.from_json(line).id == name)


def rows_of(folder: Path, name: str) -> list[Measurement]:
    """Give the rows of an acquisition, or of the one that a product's id names; OutputError for none."""
    path, acquisition = folder / RECORD, name.rpartition("#")[0] or name
    marks = [f'"acquisition": {json.dumps(one, ensure_ascii=False)},'.encode() for one in (name, acquisition)]
    found: list[Measurement] = []
    try:
        for lines in _stretches(folder, (name, acquisition)):
            for line in lines:
                if marks[0] in line or marks[1] in line:
                    found.append(Measurement.from_json(line.decode()))
                elif found:
                    break
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not found:
        raise OutputError(f"{path}: there is no product `{name}`", hint="an id is that of a row or an image")
    return found


def _stretches(folder: Path, acquisitions: Sequence[str]) -> Iterator[Iterable[bytes]]:
    """Give the lines of a record: of its file, or of each part that may hold one of these acquisitions."""
    path = folder / RECORD
    if not isinstance(folder, Url) and path.exists():
        with path.open("rb") as file:
            yield file
        return
    for part in _parts_of(folder):
        if any(part.lowest <= name <= part.highest for name in acquisitions):
            yield bytes_of(folder, part).splitlines(keepends=True)


def acquisitions_to_keep(
    recipe: Recipe, folder: Path, references: Sequence[AcquisitionReference], *, resume: bool
) -> set[str]:
    """Give the ids of the acquisitions whose rows are all there, and take the others' rows away.

    OutputError where there is a run that may not be gone on with: `resume` is not wanted, or the run is
    another recipe's.
    """
    path = folder / RECORD
    in_parts = not path.exists() and (folder / INDEX).exists()  # copied from a bucket by hand
    if not in_parts and (not path.exists() or path.stat().st_size == 0):
        return set()
    if not resume:
        raise OutputError(
            f"{folder}: there is a run in this folder already",
            hint="go on with it by --resume, or choose another folder with --out",
        )
    if in_parts:
        fetch(folder, _parts_of(folder), path)
    with LineFile(path):
        pass  # opening it takes a half line away
    by_id = {reference.id: reference for reference in references}
    missing: dict[str, int] = {}
    for row in read_record(folder):
        if row.provenance.get("recipe_sha256") != recipe.sha256:
            raise OutputError(
                f"{folder}: the run in this folder was made with another recipe, calibration or plugin",
                hint="choose another folder with --out",
            )
        _check_images(row, by_id.get(row.acquisition))
        missing[row.acquisition] = missing.get(row.acquisition, row.products) - 1
    whole = {name for name, rows in missing.items() if rows == 0}
    if len(whole) < len(missing):
        with whole_file(path) as file:
            file.writelines(
                row.to_json().encode() + b"\n" for row in read_record(folder) if row.acquisition in whole
            )
    return whole


def _check_images(row: Measurement, reference: AcquisitionReference | None) -> None:
    """Refuse to go on with rows of other images than those that are there now."""
    for role, path in ({} if reference is None else reference.files).items():
        measured = row.provenance.get(f"{role}_sha256")
        if measured is None:
            continue
        now = reference.sha256.get(role) if reference else None
        if now is None:  # of what lies on a network only a manifest says the hash without fetching it again
            now = measured if isinstance(path, Url) or not path.is_file() else sha256_of(path)
        if now != measured:
            raise OutputError(
                f"{path}: another image than the one that was measured as {row.acquisition}",
                hint="choose another folder with --out",
            )


def summed_up(folder: Path) -> tuple[dict[str, int], Reason | None]:
    """Count the rows by status, and say what moves in the course of the run; None for nothing."""
    counts, trend = {"measured": 0, "empty": 0, "failed": 0}, MotionTrend()
    for row in read_record(folder):
        counts[row.status] += 1
        if row.coding is not None:
            trend.add(row.acquisition, row.coding.motion_px)
    return counts, trend.reason


def recipe_of(folder: Path, *, sets: Sequence[str] = ()) -> tuple[Recipe, dict[str, Any]]:
    """Load the recipe of a run again, and the run's provenance.

    `sets` are further changes of what decides no number (its sinks). OutputError where the folder holds no
    run, or what decides its numbers has changed since.
    """
    path = folder / PROVENANCE
    try:
        provenance = json.loads(path.read_text(encoding="utf-8"))
        recipe_path, made_with = provenance["recipe"], provenance["sets"]
        recipe_sha256 = provenance["recipe_sha256"]
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be read: {error.strerror or error}", hint="name the folder of a run"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: damaged ({error})", hint="name the folder of a run") from error
    recipe = Recipe.load(recipe_path, sets=[*made_with, *sets])
    if recipe.sha256 != recipe_sha256:
        raise OutputError(
            f"{folder}: the recipe, calibration or a plugin has changed since the run",
            hint="the pictures would show something else than was measured; run again",
        )
    return recipe, provenance


_FIRST = 8
"""Images that give centre and scatter: the scatter is then known to 25 %."""
_SLACK, _LIMIT = 1.0, 8.0
"""Standard deviations that are not summed up, and of the sum from which something moves. The mean of the
first eight is off by a third of one: half of one, which is usual, would hardly cover it."""
_SCATTER_MIN_PX = 0.02
"""Less scatter than this says more of rounding than of the rig."""
_TOLD_FROM_PX = 0.1
"""Less motion is corrected without a trace in any number: it needs no one's attention."""
_MOVING_RANGE_TO_STD = 1.128  # mean range of two normal values over their standard deviation (Shewhart's d₂)
_WORDS = ("shifts along x", "turns", "grows or shrinks", "tilts about its x axis")


class MotionTrend:
    """Takes the images of a run one after another, and says since which of them camera, laser or belt move.

    A cumulative-sum chart of the belt's motion. The first images give centre and scatter of each part of the
    motion. From then on what lies beyond the centre by more than a standard deviation is summed up, on either
    side, and the sum begins anew where it falls below nothing (Page, Biometrika 41, 1954). Beyond eight
    standard deviations something moves: by chance less than once in a million images. The motion began where
    the sum last began; a chart of single values would not say where.
    """

    def __init__(self) -> None:
        self._first: list[Floats] = []
        self._centre_px: Floats = np.zeros(4)
        self._std_px: Floats = np.ones(4)
        self._sum: Floats = np.zeros((2, 4))
        self._since = [["", ""] for _ in _WORDS]
        self._sums_px: Floats = np.zeros((2, 4))
        self._count: Floats = np.zeros((2, 4))
        self._last = ""

    def add(self, acquisition: str, motion_px: tuple[float, ...]) -> None:
        """Take what one image's motion does at its edge, px; of an image's rows the first."""
        if acquisition == self._last or len(motion_px) != len(_WORDS):
            return
        self._last = acquisition
        motion = np.array(motion_px)
        if len(self._first) < _FIRST:
            self._first.append(motion)
            first = np.array(self._first)
            self._centre_px = first.mean(axis=0)
            if len(first) > 1:
                scatter = np.abs(np.diff(first, axis=0)).mean(axis=0) / _MOVING_RANGE_TO_STD
                self._std_px = np.maximum(scatter, _SCATTER_MIN_PX)
            return
        off = (motion - self._centre_px) / self._std_px
        for side, sign in enumerate((1.0, -1.0)):
            self._sum[side] = np.maximum(self._sum[side] + sign * off - _SLACK, 0.0)
            begins = self._sum[side] == 0.0
            self._sums_px[side] = np.where(begins, 0.0, self._sums_px[side] + motion - self._centre_px)
            self._count[side] = np.where(begins, 0.0, self._count[side] + 1.0)
            for part in np.flatnonzero(self._count[side] == 1.0):
                self._since[part][side] = acquisition

    @property
    def reason(self) -> Reason | None:
        """What moves, by how much, and since when; None where nothing does."""
        mean_px = self._sums_px / np.maximum(self._count, 1.0)
        told = (self._sum > _LIMIT) & (np.abs(mean_px) >= _TOLD_FROM_PX)
        if not told.any():
            return None
        side, part = np.unravel_index(int(np.argmax(np.where(told, np.abs(mean_px), 0.0))), told.shape)
        return Reason(
            "drifting",
            f"from {self._since[int(part)][int(side)]} on the image {_WORDS[int(part)]}: at its edge by "
            f"{mean_px[side, part]:+.2f} px on average against the run's first {_FIRST} images; each image "
            "was corrected or refused; look for what is loose, and calibrate again",
        )
