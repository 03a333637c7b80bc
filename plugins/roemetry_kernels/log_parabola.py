"""The parabola through the logarithms of three or five pixels at a stripe's top, compiled."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.grey_logs import FAR_OFF, log_above
from roemetry_kernels.influence import variance_of, variance_of_middle
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
    pull, light, inverse = np.zeros(5), np.zeros(5), np.zeros(5)
    # Least squares on equal steps: c1 = Σ by_1·log, c2 = Σ by_2·log; of five pixels three may count.
    by_1, by_2 = np.zeros(5), np.zeros(5)
    half = points // 2
    for k in range(2 - half, 3 + half):
        u = k - 2.0
        by_1[k] = u / (2.0 if half == 1 else 10.0)
        by_2[k] = (u * u - (2.0 / 3.0 if half == 1 else 2.0)) / (2.0 / 3.0 if half == 1 else 14.0)
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
        usable = (at - 2 >= los[i]) & (at + 2 <= his[i])
        c1 = c2 = 0.0
        place = begins + at - 2 if usable else 0
        for k in range(5 if usable else 0):
            level = int(levels[place + k])
            usable &= (level < white) | (abs(k - 2) > half)
            above = max(level - whole, 1)
            off = (rest + slope * (k - 2)) * logs[1, above]
            if abs(off) > FAR_OFF:
                log = log_above(level, whole, rest + slope * (k - 2), logs)
                inverse[k] = 1.0 / max(above * (1.0 - off), 0.1)
            else:
                log = logs[0, above] - off * (1.0 + off * (0.5 + off * (1.0 / 3.0 + 0.25 * off)))
                inverse[k] = logs[1, above] * (1.0 + off * (1.0 + off))
            c1 += by_1[k] * log
            c2 += by_2[k] * log
        if not (usable and c2 < 0.0 and abs(c1) < -2.0 * c2 * (0.5 + _ASTRAY * half)):
            x_px[i] = middle
            x_std_px[i] = np.sqrt(variance_of_middle(width, amplitudes[i], background, noise))
            continue
        x_px[i] = at - 0.5 * c1 / c2
        # How steep the parabola is comes from the width: as fitted it may be flat by chance, which would give
        # this peak an uncertainty beyond all measure.
        broad = width * width / (FWHM_OF_SIGMA * FWHM_OF_SIGMA)
        shift = 2.0 * (at - x_px[i])
        lean = variance = 0.0
        for k in range(5):
            pull[k] = broad * (by_1[k] - shift * by_2[k]) * inverse[k]
            lean += pull[k] * (at + k - 2 - middle)
            variance += pull[k] * pull[k] * (noise[0] + noise[1] * levels[place + k])
        variance += lean * lean * unsures[i] * (noise[0] + noise[1] * background)
        if noise[2] > 0.0:
            for k in range(5):
                light[k] = 1.0 / inverse[k]
            variance = variance_of(levels, white, place, 5, pull, light, background, lean, unsures[i], noise)
        x_std_px[i] = np.sqrt(variance / (1.0 + variance / (_BELIEVED_PX * _BELIEVED_PX)))
