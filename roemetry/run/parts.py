"""A run whose folder is in a bucket: its record in parts, with an index of them.

An object is written whole and never appended to, and a bucket has no lock. So the run works in a folder of
its own on this machine; whenever so many rows were measured, they are put into the bucket as a part, and then
the index that names it. What the index names counts: a run that is killed, or whose machine is gone, loses
the rows since its last part, which `--resume` measures again from anywhere. A run that ends in any other way
loses none. What sinks derive follows at the end.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from roemetry.errors import DataError, OutputError
from roemetry.io.files import first_fault, write_bytes, write_whole
from roemetry.io.remote import Url

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
