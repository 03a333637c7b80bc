"""How many stripes are enough: the error of the sum of slices against their number."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_PHASES = 512
_EXACT = 200_001

THICK_END, TAPER, BLUNTNESS, RIM = 0.13, 0.40, 2.6, 0.33


def slice_error_pct(area: Callable[[Floats], Floats], stripes: float) -> float:
    """Return the error of spacing × sum of slice areas, RMS over where the body lies under the stripes.

    The body's length is `stripes` spacings and its place is even over one spacing; the slices are exact, so
    this is the error of sampling alone. An ellipsoid's areas are a parabola along it, and its error has the
    closed form 1 / (√5 N²) for a whole N, which
    is the worst case: both ends err alike. Bodies with blunter ends do worse: their areas rise steeper there.

    Parameters
    ----------
    area : callable
        Area of the section at t, −1…1 along the body and 0 beyond, in any unit.
    stripes : float
        N, spacings over the length; need not be whole.

    Returns
    -------
    float
        Per cent of the volume.
    """
    t = -1.0 + 2.0 * (np.arange(_EXACT) + 0.5) / _EXACT
    exact = 2.0 * float(area(t).mean())
    phase = (np.arange(_PHASES) + 0.5) / _PHASES
    at = -1.0 + 2.0 * (np.arange(int(np.ceil(stripes)))[:, None] + phase) / stripes
    relative = area(at).sum(axis=0) * 2.0 / stripes / exact - 1.0
    return 100.0 * float(np.sqrt(np.mean(relative**2)))


def ellipsoid(t: Floats) -> Floats:
    """Return the section area of an ellipsoid (or half of one), 1 in the middle."""
    area: Floats = np.maximum(1.0 - t**2, 0.0)
    return area


def skein(t: Floats) -> Floats:
    """Return the section area of the simulator's skein with middling parameters, straight and whole.

    An elliptic dome on a rim, a thick end, blunt ends: see `roemetry_simulate.skein`.
    """
    grown = 1.0 + THICK_END * t
    end = np.maximum(1.0 - np.abs(t) ** BLUNTNESS, 0.0)
    dome = 0.5 * np.pi * (1.0 - RIM) * grown**2 * (1.0 - TAPER * t**2) * end
    rim = 2.0 * RIM * (1.0 - 0.3 * t**2) * grown * np.sqrt(end)
    area: Floats = dome + rim
    return area
