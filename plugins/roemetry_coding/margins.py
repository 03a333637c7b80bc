"""From a difference of costs to a margin that predicts error."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats

_WRONG_AT_ZERO = 0.3
_DEARER_BY_E = 1.1
_SHIFTED_AT_ZERO = 0.5
_EVIDENCE_BY_E = 0.65
_WRONG_AT_LEAST = 1e-4
"""How often labels were wrong, on simulated skeins: up to half where two cost the same, e times less often
for every 1.1 that the second best is dearer and every 0.65 of evidence, and never less often than the last:
assumptions fail, too."""


def margin_of(dearer: Floats, evidence: Floats) -> Floats:
    """Give (peak,) margins, 0 to 1.

    Parameters
    ----------
    dearer
        (peak,) by how much the second-best verdict is dearer.
    evidence
        (peak,) what the cheapest shift of the whole run, and others with it, costs a sight line.

    Returns
    -------
    numpy.ndarray
        A margin m says that the label is wrong with a probability of about (1 − m)/2.
    """
    alone = _WRONG_AT_ZERO * np.exp(-np.maximum(dearer, 0.0) / _DEARER_BY_E)
    shifted = _SHIFTED_AT_ZERO * np.exp(-np.maximum(evidence, 0.0) / _EVIDENCE_BY_E)
    wrong = np.maximum(alone, shifted)
    return np.asarray(1.0 - 2.0 * np.maximum(wrong, _WRONG_AT_LEAST))
