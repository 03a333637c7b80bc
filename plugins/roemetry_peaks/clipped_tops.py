"""Tops cut off at white that no Gaussian could be fitted to."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from roemetry_peaks.maximum_likelihood import Fitted, Found

_STD_PX = math.sqrt(1.0 / 24.0)  # of the middle of two flanks that lie anywhere within a pixel each


def middles_of_flanks(fit: Fitted, image: Any, white: int, found: Found) -> None:
    """Give tops cut off at white that are no Gaussian the middle between their flanks, where the fit began.

    Two or three lit pixels a flank do not tell height from width, or the light is none that has a Gaussian's
    flanks. Where a flank lies, the pixels tell to one of them.
    """
    from roemetry_peaks.fisher_scoring import CLIPPED, FAILED

    lost = np.flatnonzero(fit.state == FAILED)
    x_px = found.starts.x_px[lost]
    inside = np.clip(np.rint(x_px).astype(np.int64), 0, image.shape[1] - 1)
    top = image[found.starts.row[lost], inside] >= white
    lost = lost[top]
    fit.x_px[lost], fit.amplitude[lost] = x_px[top], found.starts.amplitude[lost]
    fit.sigma_px[lost], fit.x_std_px[lost] = found.beside.sigma_px[lost], _STD_PX
    fit.speckled[lost], fit.state[lost] = 0.0, CLIPPED
