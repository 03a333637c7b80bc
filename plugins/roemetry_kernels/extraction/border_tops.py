"""Tops cut off at white of which the image's border cuts off a flank as well, compiled."""

from __future__ import annotations

import numpy as np

from roemetry_kernels.compiling import inlined
from roemetry_kernels.extraction.stripe_scan import Pixels


@inlined
def mirrored(levels: Pixels, outer: int, first: int, last: int, base: float, end: int) -> float:
    """Middle of a top cut off at white, from a pixel `outer` on the side that the border cuts off.

    That pixel has its like on the other flank, where that is as bright: on the parabola through logarithms of
    the three pixels that come after the top (`first` … `last`) there. Halfway is the middle.
    """
    way = 1 if end > last else -1
    at = last if way > 0 else first
    most = abs(end - at)
    near = np.log(max(float(levels[at + way * min(1, most)]) - base, 1.0))
    next_ = np.log(max(float(levels[at + way * min(2, most)]) - base, 1.0))
    far = np.log(max(float(levels[at + way * min(3, most)]) - base, 1.0))
    wanted = np.log(max(float(levels[outer]) - base, 1.0))
    # Steps from the first of the three pixels; a parabola's value there, slope and bend.
    bend = min(near - 2.0 * next_ + far, 0.0)
    slope = next_ - near - 0.5 * bend
    step = 0.0
    for _ in range(4):
        step -= (near + slope * step + 0.5 * bend * step * step - wanted) / min(slope + bend * step, -0.05)
        step = min(max(step, -1.0), 3.0)
    return 0.5 * (outer + at + way * (1.0 + step))
