"""The source `belt-scan`: lines of belt scans with their encoder counts, one part of a belt at a time.

A scan is a folder of frames, an image of frames stacked one below the other, or a video. Counts stand in a
CSV file beside it (in a folder: `counts.csv`; else the scan's name with the suffix `.csv`) or in the names of
a folder's frames. The columns are `encoder_count`, and where known `frame_number`; of a folder also `file`,
without which lines are the frames in the order of their names.

A long belt is cut into parts that overlap by the longest product: a product belongs to the part in which it
begins. So memory is bounded by the part, parts may be measured by several processes, and each can be read
again by itself.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
from array import array
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from roemetry.errors import DataError
from roemetry.io.files import is_file
from roemetry.io.tiff import as_stored
from roemetry.records import Acquisition, AcquisitionReference, Frame, ScanLines
from roemetry.stages import Capabilities, Source, StageOptions

_IMAGES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg")
_VIDEOS = (".avi", ".mp4", ".mkv", ".mov")
_COUNT, _NUMBER, _FILE = "encoder_count", "frame_number", "file"
_COUNT_IN_NAME = r"c(-?\d+)"
"""Of a frame in a folder without counts.csv, which can say the same of files with any other names."""
_M_ARENA_MAX = -8
"""Of glibc's `mallopt`: how many heaps there are at most."""
_DECODERS, _AHEAD = 2, 4
"""Threads that decode a folder's frames, and how many frames they are ahead: with two, decoding keeps up with
measuring where there are two cores."""
_LOOK_BACK = 2
"""Lines before a part's own: enough to see that a product has begun before."""


class BeltScanOptions(StageOptions):
    """Options of `BeltScan`."""

    part_lines: int = Field(default=2000, ge=10, description="lines in which the products of a part begin")
    longest_product_lines: int = Field(
        default=1000, ge=3, description="lines of the longest product: parts overlap by so many"
    )


@dataclass(frozen=True, slots=True)
class ScanReference(AcquisitionReference):
    """A part of a scan."""

    scan: Path
    begin: int
    end: int
    own: tuple[int, int]
    """begin, end: its lines within the scan, the last one not included; own: as in `ScanLines`."""


class BeltScan(Source[BeltScanOptions]):
    """Reads scans of a moving belt."""

    capabilities = Capabilities(fixture="roemetry_scan.conformance:two_scans")
    gives = "lines"

    def references(self, path: Path) -> Sequence[AcquisitionReference]:
        """List the parts of every scan that a path or pattern names; DataError where there is none."""
        for opened in (_table, _tall, _video):
            opened.cache_clear()  # files may have changed
        found: list[AcquisitionReference] = []
        for scan in _scans(path):
            lines = len(_table(scan).count)
            step = self.options.part_lines
            # the last part also takes a remainder that is no longer than the longest product
            parts = max(1, math.ceil((lines - self.options.longest_product_lines) / step))
            for part in range(parts):
                first = part * step
                last = lines if part == parts - 1 else first + step
                begin = max(0, first - _LOOK_BACK)
                # on behind its own lines, until the longest product that begins in them has ended
                end = min(lines, last + self.options.longest_product_lines)
                name = scan.stem if parts == 1 else f"{scan.stem}_part{part + 1:03d}"
                files = {"laser": scan} if scan.is_file() else {}
                found.append(
                    ScanReference(name, files, scan, begin, end, (first - begin, last - begin))  # type: ignore[arg-type]
                )
        return found

    def read(self, reference: AcquisitionReference) -> Acquisition:
        """Give the lines of a part; frames are read when they are asked for, a file of all is opened now."""
        if not isinstance(reference, ScanReference):
            raise DataError(f"{reference.id}: no part of a scan")
        scan = reference.files.get("laser", reference.scan)
        if not scan.is_dir():
            # opened now, so that a missing or damaged file is said of before measuring begins
            (_video if scan.suffix.lower() in _VIDEOS else _tall)(scan)
        table = _table(scan)
        begin, end = reference.begin, reference.end
        lines = ScanLines(
            _Reader(scan, table, begin, end), table.count[begin:end], table.number[begin:end],
            reference.own, begin,
        )  # fmt: skip
        return Acquisition(reference.id, (), lines=lines)


@dataclass(frozen=True, eq=False)
class _Table:
    """What is known of a scan's lines."""

    count: Any
    number: Any
    files: tuple[str, ...]
    """Of a folder: its frames' names."""


class _Reader:
    """Reads a line's frame; what was opened for one is kept for the next.

    While a frame of a folder is measured, the next ones are decoded: that takes longer for a PNG, and OpenCV
    lets other threads run meanwhile.
    """

    def __init__(self, scan: Path, table: _Table, begin: int, end: int) -> None:
        # the process is kept, too: see `_image`
        self.scan, self.table, self.begin, self.end = scan, table, begin, end
        self._next, self._ahead, self._process = begin, dict[int, Future[Any]](), os.getpid()

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave out what is being decoded."""
        return _Reader, (self.scan, self.table, self.begin, self.end)

    def _image(self, at: int) -> Any:
        in_turn, self._next = at == self._next, at + 1
        if self._process != os.getpid():  # a forked process has no threads that would end what was begun
            self._process = os.getpid()
            self._ahead.clear()
        # what lies behind, or too far ahead, is given up
        for one in [one for one in self._ahead if not at <= one <= at + _AHEAD]:
            del self._ahead[one]
        # ahead only while lines are asked for one after another
        for one in range(at, min(at + 1 + _AHEAD, self.end) if in_turn else at):
            if one not in self._ahead:
                self._ahead[one] = _decoders().submit(_decoded, self.scan / self.table.files[one])
        begun = self._ahead.pop(at, None)
        return _decoded(self.scan / self.table.files[at]) if begun is None else begun.result()

    def __call__(self, line: int) -> Frame:
        at = self.begin + line
        if self.table.files:
            return _frame(self._image(at), self.table.files[at])
        if self.scan.suffix.lower() in _VIDEOS:
            return _frame(_video(self.scan)(at), f"{self.scan.name}, frame {at}")
        whole = _tall(self.scan)
        # the table says how many frames the image holds
        rows = whole.shape[0] // len(self.table.count)
        if rows * len(self.table.count) != whole.shape[0]:
            raise DataError(
                f"{self.scan}: {whole.shape[0]} rows are no whole number of frames for the "
                f"{len(self.table.count)} lines of {self.scan.with_suffix('.csv').name}"
            )
        return _frame(whole[at * rows : (at + 1) * rows], f"{self.scan.name}, frame {at}")


def _frame(pixels: Any, name: str) -> Frame:
    return Frame(pixels, name=name, bit_depth=8 * pixels.dtype.itemsize)


def _decoded(path: Path) -> Any:
    import cv2

    try:
        data = np.frombuffer(as_stored(path.read_bytes()), np.uint8)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    # an image that is cut off must not count as one that is dark below
    # OpenCV decodes a PNG as far as it goes, and fills up with black
    cut = path.suffix.lower() == ".png" and data[-8:-4].tobytes() != b"IEND"
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size and not cut else None
    if image is None:
        raise DataError(f"{path}: not an image, cut off, or damaged")
    return image


@lru_cache(maxsize=1)
def _decoders() -> ThreadPoolExecutor:
    _share_heap()
    return ThreadPoolExecutor(_DECODERS)


def _share_heap() -> None:
    """Let decoding threads take memory from the program's heap; where it cannot be told to, nothing changes.

    glibc gives each thread a heap of its own, which keeps what it once held: 16 MB in a run of 3,053 frames
    of half a megabyte. It cannot be told for single threads: from the first scan of files on, all threads
    that the process starts share one heap, those of a program that uses roemetry as a library as well. They
    then wait for each other where they take or free memory at once; results do not change.
    """
    import ctypes

    with suppress(AttributeError, OSError, TypeError):  # another C library, or none that is found by itself
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_decoders.cache_clear)


@lru_cache(maxsize=1)
def _tall(path: Path) -> Any:
    return _decoded(path)


@lru_cache(maxsize=1)
def _video(path: Path) -> Callable[[int], Any]:
    import cv2

    film = cv2.VideoCapture(str(path))
    if not film.isOpened():
        raise DataError(f"{path}: not a video that can be read")
    state = {"next": 0}

    def frame(at: int) -> Any:
        """Give a frame by its number; the next in turn is had without a seek."""
        # seeking in a video is slow, and not exact with every codec
        if state["next"] != at:
            film.set(cv2.CAP_PROP_POS_FRAMES, at)
        good, image = film.read()
        state["next"] = at + 1
        if not good:
            raise DataError(f"{path}: frame {at} cannot be read: the video ends, or is damaged")
        return image

    return frame


def _scans(path: Path) -> list[Path]:
    """Give every scan that a path or pattern names, in order."""
    # a folder of scans; a folder of frames is one itself
    if path.is_dir() and any(_is_scan(one) for one in path.iterdir() if one.is_dir()):
        found = [one for one in sorted(path.iterdir()) if _is_scan(one)]
    elif path.exists():
        found = [path] if _is_scan(path) else []
    else:
        whole = path.absolute()
        try:
            found = sorted(Path(whole.anchor).glob(str(whole.relative_to(whole.anchor))))
        except ValueError:
            found = []
        found = [one for one in found if _is_scan(one)]
    if path.is_dir() and not found:  # tall images or videos in one folder
        found = [one for one in sorted(path.iterdir()) if one.is_file() and _is_scan(one)]
    if not found:
        raise DataError(
            f"{path}: there is no scan",
            hint="a folder of frames, or an image of stacked frames or a video with a CSV file of the same "
            "name beside it",
        )
    return found


def _is_scan(path: Path) -> bool:
    if path.is_dir():
        return bool(_frames_in(path))
    suffix = path.suffix.lower()
    return suffix in (*_IMAGES, *_VIDEOS) and is_file(path.with_suffix(".csv"))


def _frames_in(folder: Path) -> list[Path]:
    images = [one for one in folder.iterdir() if one.suffix.lower() in _IMAGES]
    if any(is_file(one.with_suffix(".csv")) for one in images):
        return []  # these are scans themselves
    # by numbers within names: frame 10 comes after frame 9
    return sorted(
        images, key=lambda one: [int(k) if k.isdigit() else k for k in re.split(r"(\d+)", one.name)]
    )


@lru_cache(maxsize=1)
def _table(scan: Path) -> _Table:
    """Read counts and numbers of a scan's lines; DataError with the file's line where that fails."""
    folder = scan.is_dir()
    path = scan / "counts.csv" if folder else scan.with_suffix(".csv")
    if folder and not is_file(path):
        return _by_names(scan)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    reader = csv.reader(io.StringIO(text))
    names = next(reader, [])
    if _COUNT not in names:
        raise DataError(
            f"{path}: no column `{_COUNT}`; it has {', '.join(names) or 'none'}",
            hint="lines are placed by encoder counts; a header line names the columns",
        )
    counts, numbers, named = array("d"), array("d"), []
    for row in reader:
        if not row:
            continue
        line = dict(zip(names, row, strict=False))
        counts.append(_number(path, reader.line_num, line, _COUNT))
        numbers.append(_number(path, reader.line_num, line, _NUMBER))
        named.append(line.get(_FILE) or "")
    count, number = np.array(counts), np.array(numbers)
    # without numbers, the order of lines
    number = np.where(np.isfinite(number), number, np.arange(len(named))).astype(np.int64)
    files: tuple[str, ...] = ()
    if folder:
        # file names only where every line has one
        files = tuple(named) if all(named) else tuple(one.name for one in _frames_in(scan))
        if len(files) != len(named):
            raise DataError(f"{path}: {len(named)} lines for {len(files)} frames in the folder")
        told = set(files)
        # a frame without a line would be left out silently
        without = [one.name for one in _frames_in(scan) if one.name not in told]
        if without:
            raise DataError(
                f"{path}: {len(without)} frames of the folder have no line in it, {without[0]} first",
                hint="write their counts, an empty cell where none is known, or move them to another folder",
            )
    if not named:
        raise DataError(f"{path}: there is no line in it")
    return _Table(count, number, files)


def _by_names(scan: Path) -> _Table:
    """Take counts from the names of frames; NaN where a name has none."""
    files = tuple(_frames_in(scan))
    found = [re.search(_COUNT_IN_NAME, one.stem) for one in files]
    count = np.array([math.nan if one is None else float(one[1]) for one in found])
    return _Table(count, np.arange(len(files)), tuple(one.name for one in files))


def _number(path: Path, line: int, row: dict[str, str], column: str) -> float:
    text = row.get(column, "")
    if not text.strip():
        return math.nan
    try:
        return float(text)
    except ValueError:
        raise DataError(f"{path}, line {line}: {column} is {text!r}, expected a number") from None
