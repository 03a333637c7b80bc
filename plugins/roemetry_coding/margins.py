"""From a difference of costs to a margin that predicts error."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats

_WRONG_AT_ZERO = 0.35
_COST_OF_E = 1.0


def margin_of(dearer: Floats) -> Floats:
    """Give (peak,) margins, 0 to 1, from how much dearer the second-best verdict is.

    A margin m says that the label is wrong with a probability of about (1 − m)/2: 0 is a coin's toss.
    """
    return np.asarray(1.0 - 2.0 * _WRONG_AT_ZERO * np.exp(-np.maximum(dearer, 0.0) / _COST_OF_E))
