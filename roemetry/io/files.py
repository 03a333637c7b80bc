"""Files that survive: whole ones or the old ones, whole lines or none; JSON's values; what is shipped."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import platform
import tempfile
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from pydantic import ValidationError

from roemetry.errors import ConfigurationError, OutputError
from roemetry.io.remote import Url


def sha256_of(path: Path) -> str:
    """Hash of a file's bytes, as hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_whole(path: Path, text: str) -> None:
    """Write a text as `write_bytes` does, in UTF-8."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file so that a reader sees the old one or the whole new one, never a part.

    Where that fails, OutputError says why, and an old file of this name is left as it was.
    """
    with whole_file(path) as file:
        file.write(content)


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """Give a file to write piece by piece that takes its place, as by `write_bytes`, when the block ends."""
    temporary: Path | None = None
    try:
        if isinstance(path, Url):
            with tempfile.NamedTemporaryFile() as buffer:
                yield buffer
                buffer.flush()
                path.put(Path(buffer.name))
            return
        descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        temporary = Path(name)
        with os.fdopen(descriptor, "wb") as file:
            yield file
        temporary.chmod(0o644)
        temporary.replace(path)
        temporary = None
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def make_folder(path: Path) -> None:
    """Make a folder and its parents; raise OutputError where that cannot be done."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_write(path, error) from error
    if not os.access(path, os.W_OK):
        raise OutputError(f"{path}: the folder cannot be written", hint="choose another with --out")


def printable(name: str) -> str:
    """Give a file's name as text that can be shown: other bytes and control characters as escapes."""
    text = os.fsencode(name).decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


@contextlib.contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Keep a folder to this process while the block runs; OutputError says who has it already.

    The system takes the lock from a process that died, so there is none to be taken away by hand.
    """
    import fcntl

    path = folder / ".lock"
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.pread(descriptor, 200, 0).decode() or "another process"
            os.close(descriptor)
            raise OutputError(
                f"{folder}: {owner} is writing into this folder",
                hint="wait until it is done, or choose another folder with --out",
            ) from error
        # Its last owner may have taken the file away between our opening and our locking it.
        if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
            break
        os.close(descriptor)
    try:
        since = datetime.now(UTC).isoformat(timespec="seconds")
        os.write(descriptor, f"process {os.getpid()} on {platform.node()}, since {since},".encode())
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)


class LineFile:
    """A file that grows line by line; each line is on its way to the disk, whole, before `append` returns.

    Opening repairs a file whose last line was cut off: the half line is removed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            self._size = self._whole_lines()
            os.ftruncate(self._descriptor, self._size)
        except OSError as error:
            raise _cannot_write(path, error) from error

    def append(self, line: str) -> None:
        """Add one line; on failure, or where the file is gone, OutputError is raised."""
        data = line.encode("utf-8", "backslashreplace") + b"\n"  # in JSON an escape means the same character
        try:
            written = os.write(self._descriptor, data)
            if written < len(data):
                written += os.write(self._descriptor, data[written:])
            if written < len(data):
                raise OSError("the line was written only in part")
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._size)
            raise _cannot_write(self._path, error) from error
        self._size += len(data)
        if os.fstat(self._descriptor).st_nlink == 0:  # the system would go on writing, to nowhere
            raise OutputError(
                f"{self._path}: was deleted while it was written to: what was measured is lost",
                hint="run again",
            )

    def __enter__(self) -> LineFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._descriptor)

    def _whole_lines(self) -> int:
        """Give the length of the file up to and including its last line feed."""
        end = os.fstat(self._descriptor).st_size
        block = 65536
        while end > 0:
            start = max(0, end - block)
            found = os.pread(self._descriptor, end - start, start).rfind(b"\n")
            if found >= 0:
                return start + found + 1
            end = start
        return 0


def _cannot_write(path: Path, error: OSError) -> OutputError:
    if isinstance(error, FileExistsError | NotADirectoryError):
        return OutputError(
            f"{path}: cannot be written: a file stands where a folder is needed",
            hint="choose another with --out",
        )
    why = error.strerror or str(error)
    if isinstance(path, Url):
        return OutputError(
            f"{path}: cannot be written: {why}", hint="is there such a bucket, and may it be written to?"
        )
    return OutputError(
        f"{path}: cannot be written: {why}",
        hint="free some space or choose another folder with --out; what was written before is whole, "
        "and `--resume` goes on from there",
    )


def is_file(path: Path) -> bool:
    """Say whether there is a file; False also for a name that no file system takes: too long, a NUL in it."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def json_values(value: Any) -> Any:
    """Make a value, and all it holds, fit for JSON: NaN and infinity become None, numpy's Python's."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: json_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def shipped(*parts: str) -> Path:
    """Give the path of a shipped file or folder, as ``"recipes", "herring_roe"``, from the project's top.

    It lies inside the installed package or beside it in a checkout; ConfigurationError where it does not.
    """
    package = Path(__file__).parents[1]
    for home in (package, package.parent):
        path = home.joinpath(*parts)
        if path.exists():
            return path
    raise ConfigurationError(
        f"{'/'.join(parts)} does not lie where roemetry is installed ({package})",
        hint="install roemetry again",
    )


def first_fault(error: Exception) -> str:
    """Say in one line what is wrong with a line of a file that pydantic, or Python, refused."""
    if isinstance(error, ValidationError):
        told = error.errors()[0]
        return f"{'.'.join(map(str, told['loc']))}: {told['msg']}"
    return f"{type(error).__name__}: {error}"
