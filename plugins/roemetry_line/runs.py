"""A run of a station on disk: the spooled frames as a data set, and the record beside them.

``runs/STATION/RUN/`` holds ``dataset.yaml``, ``items.jsonl`` and ``images/*.tif``, which `roemetry run`
reads, and ``measurements.jsonl`` with ``provenance.json``, which `roemetry report` reads.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.config.dataset import Dataset, DatasetWriter, Description, Item
from roemetry.config.recipe import Recipe
from roemetry.errors import RoemetryError
from roemetry.io.files import LineFile, make_folder, write_bytes, write_whole
from roemetry.records import Acquisition, Frame, Role
from roemetry.run.batch import provenance_of
from roemetry.run.record import PROVENANCE, RECORD, summed_up
from roemetry_line.outbox import Outbox

FRAMES_MAX = 50_000
"""Frames in a run; then another begins: its folder stays one that can be listed, read and reported."""
_IMAGES = "images"


def new_run(home: Path, station: str) -> Path:
    """Make the folder of a new run; its name begins with the station and has the time."""
    begun = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    for number in range(1, 1000):
        folder = home / station / (f"{station}-{begun}" + (f"-{number}" if number > 1 else ""))
        make_folder(folder.parent)
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise AssertionError("a thousand runs in one second")


def runs_of(home: Path, station: str) -> list[Path]:
    """Give a station's runs, the oldest first."""
    found = [path for path in (home / station).glob(f"{station}-*") if path.is_dir()]
    return sorted(found, key=lambda path: path.name)


def image_of(run: Path, acquisition: str) -> Path:
    """Give where a run's spooled image is."""
    return run / _IMAGES / f"{acquisition}.tif"


class Spool:
    """The frames of a run, as they come from the camera; nothing is spooled where none are kept."""

    def __init__(self, run: Path, kept: KeptImages) -> None:
        self._run, self._kept = run, kept
        self._count = 0
        self._before: NDArray[Any] | None = None
        make_folder(run / _IMAGES)
        description = Description(
            roemetry_dataset=1, name=run.name, licence="LicenseRef-own", notes="spooled"
        )
        self._items = DatasetWriter(run, description)

    def add(self, frames: tuple[Frame, ...]) -> tuple[Acquisition, dict[str, str]]:
        """Write a product's frames; give them as they will be read again, and their hashes for the record."""
        self._count += 1
        name = f"{self._count:06d}"
        acquisition = Acquisition(name, frames, before=self._before)
        taken = acquisition.frame("laser")
        self._before = None if taken is None else taken.pixels
        if self._kept.keep_bytes == 0:
            return acquisition, {}
        files: dict[Role, str] = {}
        hashes: dict[str, str] = {}
        for frame in frames:
            content = tiff_of(frame.pixels)
            hashes[frame.role] = hashlib.sha256(content).hexdigest()
            path = image_of(self._run, name if frame.role == "laser" else f"{name}-{frame.role}")
            files[frame.role] = f"{_IMAGES}/{path.name}"
            write_bytes(path, content)
            self._kept.add(self._run, len(content))
        laser = next(frame for frame in frames if frame.role == "laser")
        self._items.add(
            Item(
                name,
                files,
                hashes,
                time_s=laser.time_s,
                encoder_count=laser.encoder_count,
                bit_depth=laser.bit_depth,
            )
        )
        return acquisition, {f"{role}_sha256": digest for role, digest in hashes.items()}

    def full(self) -> bool:
        """Say whether the run has as many frames as it may have."""
        return self._count >= FRAMES_MAX

    def close(self) -> None:
        """Close the list of frames."""
        self._items.close()


class KeptImages:
    """The images that a station keeps: the oldest go where one comes beyond `keep_gb`. Rows and lists stay.

    They are listed once, and a run's again when its turn has come: to list 20,000 of them takes 2 s, and who
    measures has to wait meanwhile.
    """

    def __init__(self, home: Path, station: str, keep_gb: float) -> None:
        self.keep_bytes = keep_gb * 1e9
        self._bytes = {
            run: sum(one.stat().st_size for one in os.scandir(run / _IMAGES))
            for run in runs_of(home, station)
            if (run / _IMAGES).is_dir()
        }
        self._oldest: list[str] = []

    def add(self, run: Path, size: int) -> None:
        """Count an image of a run, bytes, and take away what is too much."""
        self._bytes[run] = self._bytes.get(run, 0) + size
        while sum(self._bytes.values()) > self.keep_bytes:
            first = next(iter(self._bytes))
            try:
                self._oldest = self._oldest or sorted(
                    (one.name for one in os.scandir(first / _IMAGES)), reverse=True
                )
                path = first / _IMAGES / self._oldest.pop()
                size = path.stat().st_size
                path.unlink()
                self._bytes[first] -= size
            except (OSError, IndexError):  # somebody has taken it away, or them all
                if not self._oldest:
                    del self._bytes[first]


class RunRecord:
    """The record of a run that grows; its provenance says what the run is made with."""

    def __init__(self, run: Path, recipe: Recipe) -> None:
        self.run = run
        self._provenance = provenance_of(recipe, 0)
        write_whole(run / PROVENANCE, json.dumps(self._provenance, indent=2) + "\n")
        self._lines = LineFile(run / RECORD)

    def append(self, lines: list[str]) -> None:
        """Add the lines of one acquisition."""
        self._lines.append("\n".join(lines))

    def close(self) -> None:
        """Close it; `finish` is for whoever has the time."""
        self._lines.__exit__(None, None, None)


def finish(run: Path) -> None:
    """Write down what a run came to."""
    provenance = json.loads((run / PROVENANCE).read_text("utf-8"))
    counts, drift = summed_up(run)
    provenance |= {
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "counts": counts,
        "drift": None if drift is None else drift.text,
        "seconds_median": {},
    }
    write_whole(run / PROVENANCE, json.dumps(provenance, indent=2) + "\n")


def finish_beside(run: Path) -> None:
    """Have a run finished by a process of its own: to read 50,000 rows takes seconds. Nobody waits for it."""
    command = [sys.executable, "-m", "roemetry_line.runs", str(run)]
    threading.Thread(target=lambda: subprocess.run(command, check=False), daemon=True).start()


def unfinished(run: Path) -> bool:
    """Say whether a run was stopped before it was finished."""
    try:
        told = json.loads((run / PROVENANCE).read_text("utf-8"))
    except (OSError, ValueError):
        return False
    return told.get("finished") is None


def complete_record(run: Path, outbox: Outbox) -> set[str]:
    """Complete a run's record from the outbox; give the acquisitions that it then has."""
    with LineFile(run / RECORD):
        pass  # opening takes a half line away
    known = [json.loads(line) for line in (run / RECORD).read_text("utf-8").splitlines()]
    have = {row["id"] for row in known}
    missing = [line for line in outbox.records_after(run.name, None) if json.loads(line)["id"] not in have]
    with LineFile(run / RECORD) as record:
        for line in missing:
            record.append(line)
    return {row["acquisition"] for row in known} | {json.loads(line)["acquisition"] for line in missing}


def not_measured(run: Path, done: set[str]) -> Iterator[Item]:
    """Give the spooled frames of a run that have no row, where their images are still there."""
    with suppress(RoemetryError):
        for item in Dataset(run).items():
            if item.id not in done and all((run / name).is_file() for name in item.files.values()):
                yield item


def tiff_of(pixels: NDArray[Any]) -> bytes:
    """Write an image as an uncompressed baseline TIFF: 12 tags and the pixels, in a third of a millisecond.

    (row, column) or (row, column, blue-green-red), uint8 or uint16; OpenCV reads it back bit by bit.
    """
    colour = pixels.ndim == 3
    data = np.ascontiguousarray(pixels[:, :, ::-1] if colour else pixels)
    rows, columns = data.shape[:2]
    samples, bits = (3 if colour else 1), 8 * data.dtype.itemsize
    content = data.astype(data.dtype.newbyteorder("<"), copy=False).tobytes()
    tags = [
        (256, 4, 1, columns),
        (257, 4, 1, rows),
        (258, 3, samples, bits),
        (259, 3, 1, 1),
        (262, 3, 1, 2 if colour else 1),
        (273, 4, 1, 0),
        (277, 3, 1, samples),
        (278, 4, 1, rows),
        (279, 4, 1, len(content)),
    ]
    after = 8 + 2 + 12 * len(tags) + 4
    beside = struct.pack("<3H", bits, bits, bits) if colour else b""
    begin = after + len(beside)
    directory = struct.pack("<H", len(tags))
    for tag, kind, count, value in tags:
        told = {258: after if colour else bits, 273: begin}.get(tag, value)
        directory += struct.pack("<HHII" if kind == 4 or count > 2 else "<HHIHxx", tag, kind, count, told)
    return b"II*\0" + struct.pack("<I", 8) + directory + b"\0\0\0\0" + beside + content


def disk_free(folder: Path) -> float:
    """Give the free space of a folder's disk, GB; NaN where it is not told."""
    try:
        found = os.statvfs(folder)
    except OSError:
        return math.nan
    return found.f_bavail * found.f_frsize / 1e9


if __name__ == "__main__":
    os.nice(10)
    finish(Path(sys.argv[1]))
