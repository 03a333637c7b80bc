"""The decorator of every kernel: compiled once, kept on disk, compiled anew when any source of it changes.

numba keeps what it compiled beside the source and looks at that one file. What a kernel takes from other
files (kernels that are compiled into it, constants) may have changed since, unnoticed. So the stamp of what
is kept also holds a hash of every file of ours that its file imports, at any depth (`kernel_cache`).

With ``NUMBA_DISABLE_JIT=1`` every kernel is the plain Python function: a reference that needs no compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

_LEAN: dict[str, Any] = {"nogil": True, "no_cfunc_wrapper": True}
"""No kernel is handed to C as a function: the wrapper for that takes a twentieth of the compile time."""
_FLOATS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"reassoc", "contract", "nsz", "arcp"}}


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function on its first call; it runs without the interpreter's lock.

    Parameters
    ----------
    function : callable
        Of numbers, arrays and plain tuples, as numba takes them.
    options
        What else numba is told: ``@kernel(error_model="numpy")``.

    Returns
    -------
    callable
        The same function, compiled; what was compiled before is taken from disk as long as no source of it
        has changed.

    Raises
    ------
    TypeError
        It calls a kernel that it has from a function around it: the mark of what is kept on disk would then
        be another one in each process.
    """
    if function is None:
        return partial(kernel, **options)
    if any(hasattr(cell.cell_contents, "py_func") for cell in function.__closure__ or ()):
        raise TypeError(
            f"{function.__qualname__} has a compiled function from the function around it: it would never be "
            "found again on disk; call it by a name of the module"
        )
    from numba import config, njit

    if config.DISABLE_JIT:  # numba then gives the function itself: every kernel runs as plain Python
        return njit(**options)(function)
    if not hasattr(config, "CACHE_LOCATOR_CLASSES"):
        # this numba cannot be told which files to look at: compile every time, never run what is outdated
        return njit(**_LEAN, **options)(function)
    from roemetry_kernels.kernel_cache import NAMES, compiled_in_turns, say

    # numba asks for locators while it decorates
    before = config.CACHE_LOCATOR_CLASSES
    config.CACHE_LOCATOR_CLASSES = NAMES
    try:
        compiled: Any = njit(cache=True, **_LEAN, **options)(function)
    except RuntimeError as error:  # of numba: there is no folder that it may write to
        say(
            f"compiled kernels are not kept, and each start compiles them again: {error}. Set NUMBA_CACHE_DIR"
        )
        return njit(**_LEAN, **options)(function)
    finally:
        config.CACHE_LOCATOR_CLASSES = before  # functions of others keep the locators they had
    return compiled_in_turns(compiled, Path(function.__code__.co_filename))


def float_kernel(function: Callable[..., Any]) -> Any:
    """Compile as `kernel`, for sums and ratios of floats in a tight loop.

    A division by zero gives infinity or NaN, not an error, and terms may be added in another order: either
    keeps numba from using vectors. What comes out of a kernel stays the same from call to call.
    """
    return kernel(function, **_FLOATS)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function into each kernel that calls it, as if its text stood there.

    A call of its own would cost more than most such functions do: every array is handed over in seven pieces.
    """
    from numba import njit

    return njit(forceinline=True, no_cpython_wrapper=True, **_LEAN, **_FLOATS)(function)
