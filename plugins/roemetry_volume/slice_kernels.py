"""The kernels that slices need, imported once: an import inside a function costs anew at each call."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple


class SliceKernels(NamedTuple):
    """Modules of kernels and of the columns' names, and single kernels."""

    columns: Any
    order: Any
    rules: Any
    quadric_end: Any
    flat_end: Any
    edges_missed: Any


@lru_cache(maxsize=1)
def slice_kernels() -> SliceKernels:
    """Import what takes long to import at the first call."""
    from roemetry_kernels.volume import slice_areas, slice_order, slice_rules
    from roemetry_kernels.volume.flat_ends import flat_end
    from roemetry_kernels.volume.quadric_ends import quadric_end
    from roemetry_kernels.volume.slice_edges import edges_missed

    return SliceKernels(slice_areas, slice_order, slice_rules, quadric_end, flat_end, edges_missed)
