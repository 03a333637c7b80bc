"""The n-th smallest of some numbers and their median, compiled.

Kernels that call numpy's have all of it compiled into them, each anew, with the texts of its errors: seconds
for what is a loop.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel


@kernel
def nth_smallest(values: NDArray[Any], n: int) -> Any:
    """Give the number that would stand at `n` if the values were sorted (Hoare's selection).

    Parameters
    ----------
    values
        (k,) in any order, none of them NaN; they are left as they are.
    n
        From 0 to k − 1.
    """
    return _with_in_place(values, n)[n]


@kernel
def median_of(values: NDArray[Any]) -> float:
    """Give the median of one value or more, none of them NaN; of an even number the middle two's mean."""
    lower = (values.shape[0] - 1) // 2
    some = _with_in_place(values, lower)
    if values.shape[0] % 2:
        return float(some[lower])
    above = some[lower + 1]
    for k in range(lower + 2, some.shape[0]):
        above = min(above, some[k])
    return 0.5 * (some[lower] + above)


@kernel
def _with_in_place(values: NDArray[Any], n: int) -> NDArray[Any]:
    """Give the values with the n-th smallest at `n`, none before it larger and none behind it smaller."""
    some = values.copy()
    low, high = 0, some.shape[0] - 1
    while low < high:
        middle = some[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while some[i] < middle:
                i += 1
            while middle < some[j]:
                j -= 1
            if i <= j:
                some[i], some[j] = some[j], some[i]
                i += 1
                j -= 1
        if n <= j:
            high = j
        elif n >= i:
            low = i
        else:
            break
    return some
