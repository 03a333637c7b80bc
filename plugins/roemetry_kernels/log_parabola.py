"""The parabola through the logarithms of three or five pixels at a stripe's top, compiled."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.grey_logs import log_above
from roemetry_kernels.influence import bell, variance_of, variance_of_middle
from roemetry_kernels.stripe_footing import FWHM_OF_SIGMA, Stripes
from roemetry_kernels.stripe_scan import Pixels

_ASTRAY = 0.5  # of the pixels' reach, and 0.5 px more: a top farther from the middle pixel is noise
_BELIEVED_PX = 1.0  # what a top may be off at most by chance: it is one of few pixels


@float_kernel
def log_parabola_centres(
    levels: Pixels,
    columns: int,
    s: Stripes,
    white: int,
    noise: Floats,
    x_px: Floats,
    x_std_px: Floats,
    logs: Floats,
    points: int,
) -> None:
    """Take the top of the least-squares parabola through the logarithms of `points` pixels (3 or 5).

    They lie around the pixel nearest to the middle of the half-height crossings; of 3, around the highest
    of that one and its two neighbours. Where one of them is saturated or too near to a neighbouring stripe,
    and where the parabola has no top near by, that middle is the centre. The other parameters
    are those of `roemetry_kernels.gaussian_fit.gaussian_centres`.
    """
    pull, light, log = np.empty(5), np.empty(5), np.empty(5)
    half = points // 2
    # Least squares on equal steps: c1 = Σ u·log / sum_squares, c2 = Σ (u² − mean_square)·log / spread.
    sum_squares = 2.0 if half == 1 else 10.0
    mean_square = sum_squares / points
    spread = 2.0 / 3.0 if half == 1 else 14.0
    row, los, his, _, middles, widths, amplitudes, backgrounds, slopes, unsures = s
    for i in range(row.shape[0]):
        begins = row[i] * columns
        middle, background, slope, width = middles[i], backgrounds[i], slopes[i], widths[i]
        at = int(np.floor(middle + 0.5))
        if half == 1 and los[i] < at < his[i]:
            before, here, after = levels[begins + at - 1], levels[begins + at], levels[begins + at + 1]
            if max(before, after) > here:
                at += 1 if after > before else -1
        whole = int(np.rint(background))
        rest = background + slope * (at - middle) - whole
        usable = at - half >= los[i] and at + half <= his[i]
        c1 = c2 = 0.0
        for k in range(points if usable else 0):
            u = k - half
            usable = usable and levels[begins + at + u] < white
            log[k] = log_above(levels[begins + at + u], whole, rest + slope * u, logs)
            c1 += u * log[k]
            c2 += (u * u - mean_square) * log[k]
        c1, c2 = c1 / sum_squares, c2 / spread
        if not (usable and c2 < 0.0 and abs(c1) < -2.0 * c2 * (0.5 + _ASTRAY * half)):
            x_px[i] = middle
            x_std_px[i] = np.sqrt(variance_of_middle(width, amplitudes[i], background, noise))
            continue
        x_px[i] = at - 0.5 * c1 / c2
        # How steep the parabola is comes from the width: as fitted it may be flat by chance, which would give
        # this peak an uncertainty beyond all measure.
        narrow = 0.5 * FWHM_OF_SIGMA * FWHM_OF_SIGMA / (width * width)
        by_c1, by_c2 = 0.5 / narrow, (at - x_px[i]) / narrow
        lean = 0.0
        for k in range(points):
            u = k - half
            light[k] = amplitudes[i] * bell(narrow * (at + u - x_px[i]) ** 2)
            pull[k] = (by_c1 * u / sum_squares - by_c2 * (u * u - mean_square) / spread) / light[k]
            lean += pull[k] * (at + u - middle)
        first = at - half
        variance = variance_of(
            levels, white, begins + first, points, pull, light, background, lean, unsures[i], noise
        )
        x_std_px[i] = np.sqrt(variance / (1.0 + variance / (_BELIEVED_PX * _BELIEVED_PX)))
