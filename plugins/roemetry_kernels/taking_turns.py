"""Processes that need the same kernel at the same time: one compiles it, the others take it from disk.

A run with several jobs starts them all on an empty cache, and each would compile every kernel for itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

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
