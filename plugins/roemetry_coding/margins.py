"""From a difference of costs to a margin that predicts error."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats

_WRONG_AT_ZERO = 0.3
_DEARER_BY_E = 1.1
_WRONG_AT_LEAST = 1e-4
"""How often labels were wrong, on simulated skeins: nearly by half where two cost the same, e times less
often for every 1.1 that the second best is dearer, and never less often than this: assumptions fail, too."""


def margin_of(dearer: Floats) -> Floats:
    """Give (peak,) margins, 0 to 1, from how much dearer the second-best verdict is.

    A margin m says that the label is wrong with a probability of about (1 − m)/2.
    """
    wrong = _WRONG_AT_ZERO * np.exp(-np.maximum(dearer, 0.0) / _DEARER_BY_E)
    return np.asarray(1.0 - 2.0 * np.maximum(wrong, _WRONG_AT_LEAST))
