"""One line in a V groove, with reflections beside it: where the line is.

The line was marked by hand: six points, straight between them; the bottom of the groove has no light of its
own. Speckle moves the middle of a single row's light by 0.4 to 0.7 px, so known is a parabola through those
middles along each straight part, looked at over the image eight times as large. It is turned by 90°, so that
the line crosses the rows.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats

LINE = ((2.0, 390.0), (518.0, 385.0), (735.0, 585.0)), ((818.0, 583.0), (1042.0, 389.0), (1278.0, 400.0))
"""(x, y) of the line's corners in the image as it is, px: left flank, right flank."""
_AROUND_PX, _CORNER_PX = 14, 6  # of the marks: where light is the line's; where two parts meet
_ABOVE = 15.0  # grey levels above the column's median, that are light


def line_of(image: NDArray[Any]) -> Floats:
    """Give the line's y for each column, NaN where it has no light of its own."""
    light = image.max(axis=2).astype(np.float64)
    light = np.clip(light - np.median(light, axis=0) - _ABOVE, 0.0, None)
    line = np.full(light.shape[1], np.nan)
    for part in LINE:
        for (begin, y_begin), (end, y_end) in itertools.pairwise(part):
            columns = np.arange(int(begin), int(end) + 1)
            marked = np.rint(np.interp(columns, (begin, end), (y_begin, y_end))).astype(np.int64)
            rows = marked + np.arange(-_AROUND_PX, _AROUND_PX + 1)[:, None]
            here = light[rows, columns]
            middle = (here * rows).sum(axis=0) / np.maximum(here.sum(axis=0), 1.0)
            kept = (here.sum(axis=0) > 0) & (columns > begin + _CORNER_PX) & (columns < end - _CORNER_PX)
            for _ in range(5):
                path = np.polyval(np.polyfit(columns[kept], middle[kept], 2), columns)
                off = np.abs(middle - path)
                kept &= off <= 3.0 * 1.4826 * float(np.median(off[kept]))
            line[columns] = path
    return line
