"""Where numba keeps a compiled kernel, and the stamp by which it knows that the kernel is out of date.

numba's own locators stamp the one file in which a function stands. A kernel is compiled together with what it
imports from our other files (kernels, constants), so these locators add a hash of all of them. numba finds
them by its setting `NUMBA_CACHE_LOCATOR_CLASSES`, which takes names of classes like those below.

Where processes need the same kernel at the same time, one compiles it and the others take it from disk: a run
with several jobs starts them all on an empty cache, and each would compile every kernel for itself.
"""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator


class _AllSources:
    """A locator whose stamp holds every file of ours that the kernel's file imports."""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        """Make the locator, or return None where its folder cannot be written."""
        made = super().from_function(py_func, py_file)  # type: ignore[misc]
        if made is not None:
            made.source = Path(py_file)
        return made

    def get_source_stamp(self) -> tuple[Any, str]:
        """Return numba's stamp of the file and the hash of all that it imports."""
        return super().get_source_stamp(), digest(self.source)  # type: ignore[misc, attr-defined]


class InCacheDir(_AllSources, UserProvidedCacheLocator):  # type: ignore[misc]
    """In the folder that `NUMBA_CACHE_DIR` names; none where it is not set."""


class BesideSource(_AllSources, InTreeCacheLocator):  # type: ignore[misc]
    """In `__pycache__` beside the source."""


class InHome(_AllSources, UserWideCacheLocator):  # type: ignore[misc]
    """In the user's cache folder: where the package is installed read-only."""


NAMES = ",".join(f"{__name__}.{cls.__name__}" for cls in (InCacheDir, BesideSource, InHome))


_IMPORT = re.compile(
    r"^[ \t]*(?:from|import)[ \t]+(roemetry_[\w.]*)(?:[ \t]+import[ \t]+(?:([^(\n]+)|\(([^)]*)\)))?",
    re.MULTILINE,
)
"""An import of ours, one to a line. Reading whole files as programs takes longest of all at the start."""


@cache
def digest(file: Path) -> str:
    """Return a hash of a source file and of every file of ours that it imports, directly or not."""
    found: dict[Path, bytes] = {}
    waiting = [file]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found[path] = path.read_bytes()
            waiting.extend(_imported(path))
    summed = hashlib.sha256()
    for path in sorted(found):
        summed.update(path.name.encode() + b"\0" + found[path] + b"\0")
    return summed.hexdigest()


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """Give the files of our modules that a file imports, wherever in it."""
    root = path.parent
    while (root / "__init__.py").exists():
        root = root.parent
    files = []
    for module, one_line, in_brackets in _IMPORT.findall(path.read_text("utf-8")):
        listed = re.sub(r"#.*", "", in_brackets or one_line).split(",")
        for name in (module, *(f"{module}.{words[0]}" for part in listed if (words := part.split()))):
            place = root.joinpath(*name.split("."))
            files += [file for file in (place.with_suffix(".py"), place / "__init__.py") if file.exists()]
    return tuple(files)


_WAIT_S = 120.0
"""Longer than any kernel takes; who has waited so long compiles for itself."""
_LOOK_S = 0.02

_mine: set[Path] = set()
"""Files whose turn this process has; numba's own lock lets one thread at a time look."""


def compiled_in_turns(compiled: Any, source: Path) -> Any:
    """Let one process at a time compile what a source file defines.

    Parameters
    ----------
    compiled
        numba's dispatcher, which keeps on disk what it compiles.
    source
        The file it stands in. Its lock is the turn: no file of its own is left behind, and the system gives
        it back when a process dies.

    Returns
    -------
    object
        The same dispatcher.
    """
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.sigutils import normalize_signature

    compile_now: Callable[[Any], Any] = compiled.compile

    def compile_in_turn(signature: Any) -> Any:
        """Compile for a signature, or take from disk what another process has compiled meanwhile."""
        if tuple(normalize_signature(signature)[0]) in compiled.overloads:
            return compile_now(signature)
        # numba's lock first: threads of this process that waited for each other's files could wait for ever
        with global_compiler_lock, _turn(source):
            return compile_now(signature)

    compiled.compile = compile_in_turn
    return compiled


@contextmanager
def _turn(source: Path) -> Iterator[None]:
    """Hold a file's lock; without one where the system has none, or where it does not come."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    if source in _mine:
        yield
        return
    try:
        file = source.open("rb")
    except OSError:
        yield
        return
    with file:
        end = time.monotonic() + _WAIT_S
        while time.monotonic() < end:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(_LOOK_S)
            except OSError:
                break
        _mine.add(source)
        try:
            yield
        finally:
            _mine.discard(source)
