"""Where numba keeps a compiled kernel, and the stamp by which it knows that the kernel is out of date.

numba's own locators stamp the one file in which a function stands. A kernel is compiled together with what it
imports from our other files (kernels, constants), so these locators add a hash of all of them. numba finds
them by its setting `NUMBA_CACHE_LOCATOR_CLASSES`, which takes names of classes like those below.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

from roemetry_kernels.source_digest import digest


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
