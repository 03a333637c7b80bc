"""Image files as they are put into a folder: another program, a camera's own FTP, takes the pictures."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import Field

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.records.live import LiveFrame
from roemetry.stages import Capabilities, Feed, StageOptions
from roemetry_line.feeds.image import decoded

_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm", ".ppm")
_TICK_S = 0.5  # after which the feed says that no file has come


class FolderWatchOptions(StageOptions):
    """Which folder, and what becomes of its files."""

    path: str = Field(default="incoming", min_length=1, description="folder that images are put into")
    poll_ms: float = Field(default=20.0, ge=1, le=10_000, description="how often the folder is looked at, ms")
    settle_ms: float = Field(
        default=50.0,
        ge=0,
        le=60_000,
        description="a file that has not grown for so long is whole, ms; 0 where files are renamed into "
        "the folder",
    )
    existing: bool = Field(
        default=False, description="whether files that are there at the start are taken as well"
    )


class FolderWatch(Feed[FolderWatchOptions]):
    """Takes the image files of a folder in the order of their times, then names; it leaves them there.

    A file counts as whole once it has not grown for `settle_ms`. Which files were taken is kept in memory:
    after a restart those that are there already are left alone, unless `existing` says otherwise.
    """

    capabilities = Capabilities(fixture="roemetry_line.conformance:folder_watch")

    @contextmanager
    def open(self) -> Iterator[Iterator[LiveFrame | None]]:
        """Watch the folder; DataError where there is none."""
        folder = Path(self.options.path)
        taken = set[str]() if self.options.existing else {path.name for path in _images(folder)}
        yield self._frames(folder, taken)

    def _frames(self, folder: Path, taken: set[str]) -> Iterator[LiveFrame | None]:
        number = 0
        waiting: dict[str, tuple[int, float]] = {}
        last_tick = time.monotonic()
        while True:
            for path in self._whole(folder, taken, waiting):
                taken.add(path.name)
                number += 1
                last_tick = time.monotonic()
                yield _frame_of(path, number)
            if time.monotonic() - last_tick >= _TICK_S:
                last_tick = time.monotonic()
                yield None
            time.sleep(self.options.poll_ms / 1e3)

    def _whole(self, folder: Path, taken: set[str], waiting: dict[str, tuple[int, float]]) -> list[Path]:
        """Give the new files that have stopped growing, the oldest first."""
        now, found = time.monotonic(), list[tuple[int, str, Path]]()
        for path in _images(folder):
            if path.name in taken:
                continue
            try:
                state = path.stat()
            except FileNotFoundError:
                continue
            size, since = waiting.get(path.name, (-1, now))
            if size != state.st_size:
                since = now
            waiting[path.name] = (state.st_size, since)
            if now - since >= self.options.settle_ms / 1e3:
                found.append((state.st_mtime_ns, path.name, path))
        for _, name, _ in found:
            waiting.pop(name, None)
        return [path for _, _, path in sorted(found)]


def _images(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.name[0] != "."]
    except OSError as error:
        raise DataError(
            f"{folder}: cannot be looked into: {error.strerror or error}",
            hint="feed.options.path is the folder that images are put into",
        ) from error


def _frame_of(path: Path, number: int) -> LiveFrame:
    try:
        pixels = decoded(path)
        frame = Frame(pixels, name=path.name, bit_depth=8 * pixels.dtype.itemsize, time_s=time.time())
    except DataError as error:
        return LiveFrame(None, number, fault=error.message)
    return LiveFrame(frame, number)
