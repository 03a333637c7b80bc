"""How far a product is from all that was learned: by the means and correlations of each class, and by ranges.

Two measures, since each is blind where the other sees. The distance from the nearest class sees a combination
of features that no class has, but drowns one strange feature among fifty. How far single features lie beyond
all that was ever seen finds that one, and can name it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from roemetry.arrays import Floats

_SHRINKAGE = 0.2
_OF_ALL = 50.0
"""The correlation of a class counts against that of all classes as its samples do against this many."""

_PARTS = 1000
_SPREAD_MIN = 1e-3
_RANGE_MIN = 0.1
"""A feature that hardly varied among the samples may vary by a tenth."""


class Seen(NamedTuple):
    """What was seen of each class.

    Attributes
    ----------
    centres
        (class, feature) means of the squeezed features.
    spread
        (feature,) standard deviations within classes.
    precision
        (class, feature, feature) inverse of the correlation within the class.
    low, high
        (feature,) least and largest squeezed values, of all classes.
    """

    centres: Floats
    spread: Floats
    precision: Floats
    low: Floats
    high: Floats

    def distances(self, values: Floats) -> Floats:
        """(sample,) distances from the nearest class, in its standard deviations, of (sample, feature)."""
        off = (squeezed(values)[:, None] - self.centres) / self.spread
        squares = np.einsum("ncf,cfg,ncg->nc", off, self.precision, off)
        return np.asarray(np.sqrt(squares.min(axis=1) / values.shape[1]))

    def excess(self, values: Floats) -> Floats:
        """(sample, feature) how far values lie beyond all that were seen, as shares of the range seen."""
        small = squeezed(values)
        outside = np.maximum(np.maximum(self.low - small, small - self.high), 0.0)
        return np.asarray(outside / np.maximum(self.high - self.low, _RANGE_MIN))


def beyond(excess: Floats) -> Floats:
    """(sample,) root of the summed squares of (sample, feature) excesses."""
    return np.asarray(np.sqrt((excess**2).sum(axis=1)))


def seen_in(values: Floats, labels: np.ndarray) -> Seen:
    """Learn what each class looks like.

    The correlation within a class is mixed with that within all, the less the more samples it has, and drawn
    towards none (linear shrinkage: Ledoit and Wolf 2004; Friedman 1989 for the mixing).

    Parameters
    ----------
    values, labels
        (sample, feature) without NaN, and (sample,) classes.
    """
    classes, which = np.unique(labels, return_inverse=True)
    small = squeezed(values)
    centres = np.stack([small[which == k].mean(axis=0) for k in range(len(classes))])
    off = small - centres[which]
    spread = np.maximum(off.std(axis=0), _SPREAD_MIN)
    off /= spread
    every = off.T @ off / len(off)
    precision = []
    for k in range(len(classes)):
        mine = off[which == k]
        own = len(mine) / (len(mine) + _OF_ALL)
        mixed = own * (mine.T @ mine / len(mine)) + (1.0 - own) * every
        # What never varies in a class may vary a little all the same.
        alone = np.diag(np.maximum(np.diag(mixed), 0.05))
        precision.append(np.linalg.inv((1.0 - _SHRINKAGE) * mixed + _SHRINKAGE * alone))
    low, high = small.min(axis=0), small.max(axis=0)
    return Seen(centres, spread, _rounded(np.stack(precision)), low, high)


def squeezed(values: Floats) -> Floats:
    """Bring features of many sizes to one: nearly linear about 0, logarithmic far out."""
    return np.asarray(np.arcsinh(values))


def halves(precision: Floats) -> list[list[int]]:
    """Write symmetric matrices, one a class: upper halves, in thousandths."""
    upper = np.triu_indices(precision.shape[1])
    return [np.round(one[upper] * _PARTS).astype(np.int64).tolist() for one in precision]


def whole(lists: Any, features: int) -> Floats:
    """Make the matrices again; raise ValueError where the lists are of another size."""
    upper = np.triu_indices(features)
    values = np.array(lists, np.float64) / _PARTS
    if values.ndim != 2 or values.shape[1] != upper[0].size:
        raise ValueError(f"precision: {values.shape}, expected {upper[0].size} values a class")
    made = np.zeros((len(values), features, features))
    made[:, upper[0], upper[1]] = values
    made[:, upper[1], upper[0]] = values
    return made


def _rounded(precision: Floats) -> Floats:
    """Keep what the file keeps, so that what was judged is what will judge."""
    return np.asarray(np.round(precision * _PARTS) / _PARTS)
