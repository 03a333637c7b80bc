"""Files by URL: of S3, of a web server, of whatever fsspec reads; credentials are the environment's affair.

A `Url` is a path whose bytes come over a network, so what reads paths reads both. Those that are wanted next
can be fetched ahead, while others are worked on.
"""

from __future__ import annotations

import errno
import io
import os
import shutil
import tempfile
import threading
from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Any

from roemetry.errors import ConfigurationError, OutputError, PluginError, RoemetryError

_AHEAD = 16
"""Objects that are fetched ahead: by 30 ms each, the round trip to a bucket, they come at 500 a second."""
_KEPT = 4
"""Objects kept after they were read: hashed and decoded, and the image before the next, from one fetch."""


def path_of(text: str, folder: Path) -> Path:
    """Give the path, relative to a folder, or the URL that a user wrote.

    PluginError where what reads such a URL is not installed, ConfigurationError where nothing reads it.
    """
    scheme, mark, rest = text.partition("://")
    if not mark:
        return folder / text
    if scheme == "file":
        return Path(rest)
    _require_reader(scheme)
    return Url(text)


@cache
def _require_reader(scheme: str) -> None:
    try:
        import fsspec

        fsspec.get_filesystem_class(scheme)
    except ImportError as error:
        raise PluginError(
            f"{scheme}://: {error}",
            hint="pip install 'roemetry[remote]'; for other stores than S3 what it names",
        ) from error
    except ValueError as error:
        raise ConfigurationError(
            f"{scheme}://: {error}", hint="such as s3://, https:// or file://"
        ) from error


class Url(type(Path())):  # type: ignore[misc]  # pathlib's class for this system
    """A path on a network; what it cannot read is an OSError, whatever the store raised."""

    __slots__ = ()

    def __str__(self) -> str:
        return str(super().__str__()).replace(":/", "://", 1)

    def __truediv__(self, name: str | os.PathLike[str]) -> Url:
        """Give what lies in the folder."""
        return Url(super().__truediv__(name))

    def absolute(self) -> Url:
        """Give the URL: there is nothing that it is relative to."""
        return self

    def resolve(self, strict: bool = False) -> Url:
        """Give the URL."""
        return self

    def read_bytes(self) -> bytes:
        """Give the object's bytes, which may have been fetched already."""
        with _said_plainly(self):
            return _fetched(self)

    def read_text(self, encoding: str | None = None, errors: str | None = None) -> str:
        """Give the object's text."""
        return self.read_bytes().decode(encoding or "utf-8", errors or "strict")

    def open(self, mode: str = "r", *_: Any, encoding: str | None = None, **__: Any) -> IO[Any]:
        """Open the object, fetched whole, for reading."""
        whole = io.BytesIO(self.read_bytes())
        return whole if "b" in mode else io.TextIOWrapper(whole, encoding=encoding or "utf-8")

    def put(self, file: Path) -> None:
        """Make the object what a file on this machine is, whole or not at all."""
        with _said_plainly(self):
            system, name = _system(self)
            system.put_file(str(file), name)
        self.forget()

    def unlink(self, missing_ok: bool = False) -> None:
        """Take the object away."""
        with _said_plainly(self):
            system, name = _system(self)
            system.rm_file(name)
        self.forget()

    def forget(self) -> None:
        """Let the object be fetched anew when it is read next."""
        _ahead.begun.pop(self, None)
        _ahead.read.pop(self, None)

    def exists(self, **_: Any) -> bool:
        """Say whether there is an object or a folder."""
        return bool(self._kind())

    def is_file(self, **_: Any) -> bool:
        """Say whether there is an object; an OSError says why that cannot be known, such as no permission."""
        return self._kind() == "file"

    def is_dir(self, **_: Any) -> bool:
        """Say whether there is a folder."""
        return self._kind() == "directory"

    def _kind(self) -> str:
        with _said_plainly(self):
            system, name = _system(self)
            try:
                return str(system.info(name)["type"])
            except FileNotFoundError:
                return ""

    def iterdir(self) -> Iterator[Url]:
        """Give what lies in the folder."""
        with _said_plainly(self):
            system, name = _system(self)
            found = system.ls(name, detail=False, refresh=True)
            yield from (Url(system.unstrip_protocol(one)) for one in found)

    def glob(self, pattern: str, **_: Any) -> Iterator[Url]:
        """Give what a pattern fits in the folder."""
        with _said_plainly(self):
            system, name = _system(self)
            yield from (Url(system.unstrip_protocol(one)) for one in system.glob(f"{name}/{pattern}"))


@contextmanager
def folder_for(place: Path) -> Iterator[Path]:
    """Give the folder itself; for a URL one on this machine that has its objects, and what they become.

    What is new or has changed in it is put there when the block ends, however it ends; what was taken away
    is taken away there, too. OutputError where it cannot be read, or not be put there: then it is kept here.
    """
    if not isinstance(place, Url):
        yield place
        return
    above = Path(tempfile.mkdtemp(prefix="roemetry-"))
    folder = above / place.name
    folder.mkdir()
    try:
        _fetch_folder(place, folder)
    except OSError as error:
        shutil.rmtree(above)
        raise OutputError(f"{place}: cannot be read: {error.strerror or error}") from error
    before = _states(folder)
    try:
        yield folder
    except RoemetryError as error:
        error.message = error.message.replace(str(folder), str(place))
        raise
    finally:
        try:
            after = _states(folder)
            for name, _ in sorted(after.items() - before.items()):
                (place / name).put(folder / name)
            for gone in before.keys() - after.keys():
                (place / gone).unlink()
        except OSError as error:
            raise OutputError(
                f"{place}: cannot be written: {error.strerror or error}",
                hint=f"nothing is lost: copy {folder} there by hand",
            ) from error
        shutil.rmtree(above)


def _fetch_folder(place: Url, folder: Path) -> None:
    with _said_plainly(place):
        system, root = _system(place)
        for found in system.find(root) if system.exists(root) else ():
            file = folder / found[len(root) :].strip("/")
            file.parent.mkdir(parents=True, exist_ok=True)
            system.get_file(found, str(file))


def _states(folder: Path) -> dict[str, tuple[int, int]]:
    """Give what changes when a file below a folder is written."""
    states = ((path, path.stat()) for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): (one.st_mtime_ns, one.st_size) for path, one in states}


def _system(url: Url) -> tuple[Any, str]:
    """Give the file system of a URL, and the URL's name in it."""
    import fsspec

    system, name = fsspec.core.url_to_fs(str(url))
    return system, str(name)


@contextmanager
def _said_plainly(url: Url) -> Iterator[None]:
    """Turn what a store raises into an OSError that says what is wrong."""
    try:
        yield
    except FileNotFoundError as error:
        raise FileNotFoundError(errno.ENOENT, "there is no such object", str(url)) from error
    except PermissionError as error:
        raise PermissionError(errno.EACCES, f"no permission ({error})", str(url)) from error
    except Exception as error:  # each store has errors of its own
        raise OSError(errno.EIO, f"{type(error).__name__}: {error}", str(url)) from error


class _Ahead(threading.local):
    """What a thread has yet to read."""

    def __init__(self) -> None:
        self.coming: deque[Url] = deque()
        self.begun: OrderedDict[Url, Future[bytes]] = OrderedDict()
        """What is on its way, or has come and was not read yet."""
        self.read: OrderedDict[Url, bytes] = OrderedDict()


_ahead = _Ahead()


def read_ahead(paths: Iterable[Path]) -> None:
    """Begin to fetch the URLs among these paths for this thread, in their order, a few at once."""
    _ahead.coming = deque(path for path in paths if isinstance(path, Url))
    _fetch_more()


def _fetch_more() -> None:
    coming, begun = _ahead.coming, _ahead.begun
    while coming and len(begun) < _AHEAD:
        url = coming.popleft()
        if url not in begun and url not in _ahead.read:
            begun[url] = _threads().submit(_fetch, url)


def _fetch(url: Url) -> bytes:
    system, name = _system(url)
    return bytes(system.cat_file(name))


def _fetched(url: Url) -> bytes:
    read, begun = _ahead.read, _ahead.begun
    if url not in read:
        while url in begun and next(iter(begun)) != url:
            begun.popitem(last=False)  # passed over: nobody will ask for it
        future = begun.pop(url, None)
        _fetch_more()
        read[url] = _fetch(url) if future is None else future.result()
        while len(read) > _KEPT:
            read.popitem(last=False)
    return read[url]


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_AHEAD, "roemetry-read-ahead")
