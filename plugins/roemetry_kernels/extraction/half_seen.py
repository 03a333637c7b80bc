"""Stripes of which white hides the top, and the border or glare a flank: what is known of them; compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry.records.peaks import EDGE, SATURATED
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.extraction.influence import variance_of_middle
from roemetry_kernels.extraction.stripe_footing import Stripes
from roemetry_kernels.extraction.stripe_glare import GLARE

CUT_TWICE = EDGE | SATURATED
_MIRRORED_PX = 0.02
"""Standard uncertainty of a middle by a pixel's like on the other flank, but for noise; found by drawing."""

_OF_GLARE = 0.25
"""Of its width, that a stripe in glare is known to: told by another program's line on a real image."""


@kernel
def what_is_odd(x_px: Floats, flags: NDArray[np.uint8], columns: int) -> tuple[bool, bool]:
    """Say whether a centre lies outside of the image or is none, and whether a stripe may be half seen."""
    inside, highest = 0, np.uint8(0)
    last = columns - 1.0
    for i in range(np.uint64(x_px.shape[0])):
        inside += (x_px[i] >= 0.0) & (x_px[i] <= last)
    for i in range(np.uint64(flags.shape[0])):
        highest = max(highest, flags[i])
    return bool(inside < x_px.shape[0]), bool(highest >= CUT_TWICE)


@float_kernel
def middles_of_half_seen(
    s: Stripes, noise: Floats, contrast2: Floats, x_px: Floats, x_std_px: Floats
) -> None:
    """Take the middle for the centre where a top is cut off at white and a flank is not seen, in place.

    That is where the border cuts it off above half height, and in glare. What a method makes of the pixels
    that are left is up to 0.2 px beside at the border, and states an eighth of it. `GLARE` is taken off the
    flags.

    Parameters
    ----------
    s
        Stripes, as `roemetry_kernels.extraction.stripe_footing.stripes_around` gave them.
    noise, contrast2
        As for `roemetry_kernels.extraction.gaussian_fit.gaussian_centres`.
    x_px, x_std_px
        (peak,) centres and what is stated of them.
    """
    _, los, his, flags, middles, widths, amplitudes, backgrounds, _, _ = s
    each = contrast2.shape[0] > 1
    for i in range(flags.shape[0]):
        half = 0.5 * widths[i]
        glare = flags[i] & GLARE != 0
        whole = (
            flags[i] & CUT_TWICE != CUT_TWICE or los[i] <= middles[i] - half <= middles[i] + half <= his[i]
        )
        if whole and not glare:
            continue
        speckle = contrast2[i if each else 0]
        variance = variance_of_middle(widths[i], amplitudes[i], backgrounds[i], noise, speckle)
        more = _OF_GLARE * widths[i] if glare else _MIRRORED_PX
        x_px[i], x_std_px[i] = middles[i], np.sqrt(variance + more * more)
        flags[i] &= ~GLARE
