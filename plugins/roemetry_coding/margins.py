"""From a difference of costs to a margin that predicts error."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats

_SHIFTED = (
    (0.3, 0.5), (0.6, 0.1), (0.8, 0.03), (1.0, 6e-3), (1.5, 3e-3), (2.0, 1e-3), (3.0, 2e-4), (8.0, 5e-5),
)  # fmt: skip
"""Evidence, and how often a label with it was wrong: the more, the less often."""
_ALONE = ((0.0, 0.03), (2.0, 0.02), (3.0, 8e-3), (4.0, 5e-3), (6.0, 5e-4), (10.0, 1e-4))
"""By how much the second best is dearer, and how often a label was wrong whose evidence was large.

Both were counted on simulated skeins, the first on plain shapes, too, on rigs of 11 and of 21 stripes, whole
and damaged, and made monotone and smooth by hand; never less often than the last: assumptions fail, too."""


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
        A margin m says that the label is wrong with a probability of about (1 − m)/2; 0, that it is wrong as
        often as not, or more often.
    """
    wrong = np.maximum(_counted(dearer, _ALONE), _counted(evidence, _SHIFTED))
    return np.asarray(1.0 - 2.0 * wrong)


def _counted(value: Floats, points: tuple[tuple[float, float], ...]) -> Floats:
    """Interpolate the logarithm of a share between points."""
    at, share = np.array(points).T
    return np.asarray(np.exp(np.interp(value, at, np.log(share))))
