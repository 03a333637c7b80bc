"""The memory that one frame's arrays give back, kept for those of the next."""

from __future__ import annotations

import ctypes
from functools import cache

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
_LARGEST_ON_HEAP = 32 << 20
"""Bytes: glibc takes no more. A frame of 12 megapixels fits."""
_KEPT = 256 << 20
"""Bytes that stay with the process between frames."""


@cache
def keep_freed_memory() -> None:
    """Let glibc keep freed memory; other C libraries do as they always do.

    It gives a large array's memory back to the system at once, and takes it anew for the next one: of the
    careful recipe's time on a frame a tenth went into pages that the system cleared.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _LARGEST_ON_HEAP)
    mallopt(_TRIM_THRESHOLD, _KEPT)
