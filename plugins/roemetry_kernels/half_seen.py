"""Stripes of which white cuts off the top and the image's border a flank: what is known of them; compiled."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry.records.peaks import EDGE, SATURATED
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.influence import variance_of_middle
from roemetry_kernels.stripe_footing import Stripes

CUT_TWICE = EDGE | SATURATED
_MIRRORED_PX = 0.02
"""Standard uncertainty of a middle by a pixel's like on the other flank, but for noise; found by drawing."""


@float_kernel
def middles_at_border(s: Stripes, noise: Floats, contrast2: Floats, x_px: Floats, x_std_px: Floats) -> None:
    """Take the middle for the centre where a top is cut off at white and a flank above half height, in place.

    What a method makes of the pixels that are left is up to 0.2 px beside, and states a quarter of it.

    Parameters
    ----------
    s
        Stripes, as `roemetry_kernels.stripe_footing.stripes_around` gave them.
    noise, contrast2
        As for `roemetry_kernels.gaussian_fit.gaussian_centres`.
    x_px, x_std_px
        (peak,) centres and what is stated of them.
    """
    _, los, his, flags, middles, widths, amplitudes, backgrounds, _, _ = s
    each = contrast2.shape[0] > 1
    for i in range(flags.shape[0]):
        half = 0.5 * widths[i]
        if flags[i] & CUT_TWICE != CUT_TWICE or los[i] <= middles[i] - half <= middles[i] + half <= his[i]:
            continue
        variance = variance_of_middle(
            widths[i], amplitudes[i], backgrounds[i], noise, contrast2[i if each else 0]
        )
        x_px[i], x_std_px[i] = middles[i], np.sqrt(variance + _MIRRORED_PX * _MIRRORED_PX)
