"""Natural logarithms and reciprocals of many numbers at a time, compiled into vector instructions."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import inlined

_FRACTION_BITS = 52  # of a float64, below those of its exponent
_FRACTION = (1 << _FRACTION_BITS) - 1
_BIAS = 1023
_ONE = _BIAS << _FRACTION_BITS
_LN_2 = 0.6931471805599453
_SQRT_2 = 1.4142135623730951


@inlined
def logarithms(v: Floats, begin: int, inverse: int, count: int) -> None:
    """Take logarithms in place, to 1e-10, and put the reciprocals elsewhere in the same piece of memory.

    A number is taken apart into m·2ⁿ, 0.7 < m < 1.42, of which ln m is twice the series of artanh s with
    s = (m − 1) / (m + 1).

    Parameters
    ----------
    v
        Holds positive numbers from `begin` on; changed.
    begin, inverse
        Where the numbers begin, and where their reciprocals are to begin.
    count
        How many there are.
    """
    bits = v.view(np.int64)
    for k in range(count):
        bits[inverse + k] = (bits[begin + k] & _FRACTION) | _ONE
    for k in range(count):
        exponent = (bits[begin + k] >> _FRACTION_BITS) - _BIAS
        x, m = v[begin + k], v[inverse + k]
        large = m > _SQRT_2
        m = 0.5 * m if large else m
        power = float(exponent + 1) if large else float(exponent)
        # one division for both
        under = 1.0 / (x * (m + 1.0))
        s = (m - 1.0) * x * under
        z = s * s
        series = 1.0 + z * (1 / 3 + z * (1 / 5 + z * (1 / 7 + z * (1 / 9 + z / 11))))
        v[begin + k] = power * _LN_2 + 2.0 * s * series
        v[inverse + k] = (m + 1.0) * under
