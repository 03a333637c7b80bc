"""Where numba keeps a compiled kernel, and the stamp by which it knows that the kernel is out of date.

numba's own locators stamp the one file in which a function stands. A kernel is compiled together with what it
imports from our other files (kernels, constants), so these locators add a hash of all of them. numba finds
them by its setting `NUMBA_CACHE_LOCATOR_CLASSES`, which takes names of classes like those below.

Machine code runs on the processor and by the version of numba that it was made with. Both are part of the
files' names: what another machine or an installed wheel brought along is used where it fits, and else stands
aside. Nothing in a stamp depends on the folder, so compiled kernels can be installed with the sources.

Where processes need the same kernel at the same time, one compiles it and the others take it from disk: a run
with several jobs starts them all on an empty cache, and each would compile every kernel for itself.

numba tells functions of one name apart by a number that each process counts from 1, and the linker of a
process that reads two of one name and number from disk takes one for both: a sort then runs as an argsort
(numba's issue 10486). So each process counts from a place of its own.

What is damaged on disk is compiled anew, and where nothing can be written kernels are compiled in each
process; either is said once (`KernelCacheWarning`).
"""

from __future__ import annotations

import gc
import hashlib
import itertools
import os
import platform
import re
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.bytecode import FunctionIdentity
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

from roemetry.run.time_limit import not_counted


def _count_apart() -> None:
    """Let numba number this process's functions as no other process does."""
    FunctionIdentity._unique_ids = itertools.count(int.from_bytes(os.urandom(7), "little"))


_count_apart()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_count_apart)


class KernelCacheWarning(UserWarning):
    """Compiled kernels could not be kept on disk, or what was kept is damaged: it only takes longer."""


def say(message: str) -> None:
    """Warn once: not again in this process, nor in those that it starts."""
    told = "ROEMETRY_KERNEL_CACHE_TOLD"
    if told not in os.environ:
        os.environ[told] = "1"
        warnings.warn(message, KernelCacheWarning, stacklevel=2)


@cache
def machine() -> str:
    """Name the processor and the numba that machine code is made for, in eight digits."""
    import numba
    from llvmlite import binding

    target: tuple[Any, ...] = (numba.config.CPU_NAME, numba.config.CPU_FEATURES)
    if None in target:
        target = (*target, binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten())
    text = repr((numba.__version__, sys.platform, platform.machine(), *target))
    return hashlib.sha256(text.encode()).hexdigest()[:8]


class _AllSources:
    """A locator whose stamp holds every file of ours that the kernel's file imports."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        self.source = Path(py_file)
        super().__init__(py_func, py_file)  # type: ignore[call-arg]

    def ensure_cache_path(self) -> None:
        """Raise OSError where the folder cannot be written; asked once a folder, not once a kernel."""
        _check_writable(Path(self.get_cache_path()))  # type: ignore[attr-defined]

    def get_source_stamp(self) -> str:
        """Return the hash of the file and of all that it imports, wherever it lies."""
        return digest(self.source)

    def get_disambiguator(self) -> str:
        """Return what tells files of the same function apart: its line, and the machine."""
        return f"{super().get_disambiguator()}-{machine()}"  # type: ignore[misc]


@cache
def _check_writable(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        raise PermissionError(folder)


class InCacheDir(_AllSources, UserProvidedCacheLocator):  # type: ignore[misc]
    """In the folder that `NUMBA_CACHE_DIR` names; none where it is not set.

    Installations of the same sources share it: their folders are told apart by what stands in the files.
    """

    def get_cache_path(self) -> str:
        """Return the folder of a source file's kernels."""
        from numba import config

        return str(Path(config.CACHE_DIR, self.source.parent.name, digest(self.source)[:12]))


class BesideSource(_AllSources, InTreeCacheLocator):  # type: ignore[misc]
    """In `__pycache__` beside the source."""


class InHome(_AllSources, UserWideCacheLocator):  # type: ignore[misc]
    """In the user's cache folder, where the package is installed read-only."""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        """Make the locator; kernels that were installed with the sources are brought along."""
        made = super().from_function(py_func, py_file)
        if made is not None:
            _bring(Path(py_file).parent / "__pycache__", Path(made.get_cache_path()))
        return made


@cache
def _bring(source: Path, target: Path) -> None:
    """Copy the compiled kernels of this machine that are missing in a folder or older there."""
    for path in source.glob(f"*-{machine()}.*.nb[ic]"):
        mine = target / path.name
        with suppress(OSError):
            if not mine.exists() or mine.stat().st_mtime < path.stat().st_mtime:
                shutil.copyfile(path, mine)


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
_LOOK_S = 0.02  # between two tries for a lock that another process holds

_mine: set[Path] = set()
"""Files whose turn this process has; numba's own lock lets one thread at a time look."""


def compiled_in_turns(compiled: Any, source: Path) -> Any:
    """Let one process at a time compile what a source file defines, and do without a cache that fails.

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
        The same dispatcher; its `is_on_disk()` says whether this machine's code of it lies there.
    """
    from numba import types
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.errors import NumbaError
    from numba.core.sigutils import normalize_signature

    compile_now: Callable[[Any], Any] = compiled.compile

    def kept() -> list[Path]:
        """Give the files of the function on disk."""
        name = f"{source.stem}.{compiled.py_func.__qualname__}".replace("<", "").replace(">", "")
        line = compiled.py_func.__code__.co_firstlineno
        return list(Path(compiled.stats.cache_path).glob(f"{name}-{line}-{machine()}.*"))

    def compile_in_turn(signature: Any) -> Any:
        """Compile for a signature, or take from disk what another process has compiled meanwhile."""
        # numba would compile a kernel anew for each number that a caller writes out
        given = tuple(map(types.unliteral, normalize_signature(signature)[0]))
        if given in compiled.overloads:
            return compile_now(given)
        signature = given
        turn = nullcontext() if _is_kept(compiled, signature) else _turn(source)
        # A stage's time limit is for what it does, not for compiling nor for waiting for others that compile,
        # and LLVM's callbacks would swallow it. numba's lock comes before the turn: threads of this process
        # that waited for each other's files could wait for ever.
        with not_counted(), global_compiler_lock, turn, _without_collector():
            try:
                return compile_now(signature)
            except NumbaError:
                raise  # the kernel's own fault
            except Exception as error:
                if given in compiled.overloads:
                    say(
                        f"a compiled kernel could not be written to {compiled.stats.cache_path} ({error}) "
                        "and is compiled again next time. Free the disk, or set NUMBA_CACHE_DIR"
                    )
                    return compiled.overloads[given].entry_point
                damaged = kept()
                if not damaged:
                    raise
                say(f"{damaged[0].with_suffix('')} is damaged ({type(error).__name__}): it is recompiled")
                for path in damaged:
                    path.unlink(missing_ok=True)
                return compile_now(signature)

    compiled.compile = compile_in_turn
    compiled.is_on_disk = lambda: any(path.suffix == ".nbi" for path in kept())
    return compiled


def _is_kept(compiled: Any, signature: Any) -> bool:
    """Say whether a signature's code lies on disk: it is read at once, whoever compiles beside it."""
    try:
        cache = compiled._cache
        return cache._index_key(signature, compiled.targetctx.codegen()) in cache._cache_file._load_index()
    except Exception:  # of a damaged file, or another numba: the turn is waited for
        return False


@contextmanager
def _without_collector() -> Iterator[None]:
    """Keep Python's garbage collector away: it looks at all that a compiler holds and finds nothing."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


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
