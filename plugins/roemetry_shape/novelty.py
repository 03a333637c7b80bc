"""Novelty: how far a product is from all that a classifier has learned.

Model. Features are brought to one scale by asinh (nearly linear about 0, logarithmic far out). Two measures,
since each is blind where the other sees:

    distance   d² = min over classes c of (x − m_c)ᵀ S_c⁻¹ (x − m_c) / features
               the Mahalanobis distance from the nearest class: a combination of features that no class has
    excess     e² = Σ (how far feature i lies beyond all that was ever seen, in ranges seen)²
               one strange feature among fifty, which the distance drowns, and its name

S_c is the correlation within the class, mixed with that of all classes as its samples count against
`POOLED_SAMPLES` (regularised discriminant analysis, Friedman 1989), and drawn towards none by `SHRINKAGE`
(Ledoit and Wolf 2004). Each measure is divided by what held-out samples reach at most, so 1 is the limit for
both.

Assumed: the samples are what is to be expected: rigs, light and populations that differ from them by more
than they differ among each other are novel, and are said to be so. It fails for a stranger whose every
feature lies within what was seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from roemetry.records.arrays import Floats

SHRINKAGE = 0.2
"""Share of the uncorrelated part. 0.1 to 0.4 change the share of strangers found by less than 1 %; 0 makes
forty features of fifty samples singular."""

POOLED_SAMPLES = 50.0
"""A class of this many samples has half of its own correlation, half of all classes'."""

_DECIMALS = 1000
"""Of the precision matrices in a file: a thousandth is below the change that one sample more makes."""

_SPREAD_MIN = 1e-3
"""asinh units: of a feature that never varies within a class (a dent's depth of good products)."""

_RANGE_MIN = 0.1
"""asinh units: a feature that hardly varied among the samples may vary by a tenth."""

_VARIANCE_MIN = 0.05
"""Of a feature within a class, against its variance within all: what never varied may vary a little."""


class Novelty(NamedTuple):
    """How far a sample is from all that was learned.

    Attributes
    ----------
    value
        As a share of the limit; above 1 the sample is novel.
    feature, found, low, high
        The feature that lies farthest beyond what was seen, its value, and what was seen; "" and NaN where it
        is all features together that are farther from every class.
    """

    value: float
    feature: str = ""
    found: float = math.nan
    low: float = math.nan
    high: float = math.nan


class SeenClasses(NamedTuple):
    """What was seen of each class.

    Attributes
    ----------
    centres
        (class, feature) means of the scaled features.
    spread
        (feature,) standard deviations within classes.
    precision
        (class, feature, feature) inverse of the correlation within the class.
    low, high
        (feature,) least and largest scaled values, of all classes.
    """

    centres: Floats
    spread: Floats
    precision: Floats
    low: Floats
    high: Floats

    def novelty(
        self, values: Floats, names: Sequence[str], distance_max: float, excess_max: float
    ) -> Novelty:
        """Judge one sample's (feature,) values against the limits of both measures."""
        distance = float(self.distances(values[None])[0]) / distance_max
        excess = self.excess(values[None])[0]
        outside = float(excess_norm(excess[None])[0]) / excess_max
        if outside <= distance:
            return Novelty(distance)
        most = int(excess.argmax())
        ends = np.sinh([self.low[most], self.high[most]])
        return Novelty(outside, names[most], float(values[most]), float(ends[0]), float(ends[1]))

    def distances(self, values: Floats) -> Floats:
        """(sample,) distances from the nearest class, in its standard deviations, of (sample, feature)."""
        off = (arcsinh_scale(values)[:, None] - self.centres) / self.spread
        squares = np.einsum("ncf,cfg,ncg->nc", off, self.precision, off)
        return np.asarray(np.sqrt(squares.min(axis=1) / values.shape[1]))

    def excess(self, values: Floats) -> Floats:
        """(sample, feature) how far values lie beyond all that were seen, as shares of the range seen."""
        scaled = arcsinh_scale(values)
        outside = np.maximum(np.maximum(self.low - scaled, scaled - self.high), 0.0)
        return np.asarray(outside / np.maximum(self.high - self.low, _RANGE_MIN))

    def to_json(self) -> dict[str, Any]:
        """Give lists for a file."""
        plain = {name: getattr(self, name).tolist() for name in ("centres", "spread", "low", "high")}
        return {**plain, "precision": pack_symmetric(self.precision)}

    @classmethod
    def from_json(cls, data: Any, features: int) -> SeenClasses:
        """Read lists of a file; raise KeyError, TypeError or ValueError for lists that are none."""
        plain = {name: np.array(data[name], np.float64) for name in ("centres", "spread", "low", "high")}
        return cls(**plain, precision=unpack_symmetric(data["precision"], features))


def seen_classes(values: Floats, labels: np.ndarray) -> SeenClasses:
    """Learn what each class looks like.

    Parameters
    ----------
    values, labels
        (sample, feature) without NaN, and (sample,) classes.
    """
    classes, which = np.unique(labels, return_inverse=True)
    scaled = arcsinh_scale(values)
    centres = np.stack([scaled[which == k].mean(axis=0) for k in range(len(classes))])
    off = scaled - centres[which]
    spread = np.maximum(off.std(axis=0), _SPREAD_MIN)
    off /= spread
    every = off.T @ off / len(off)
    precision = []
    for k in range(len(classes)):
        mine = off[which == k]
        own = len(mine) / (len(mine) + POOLED_SAMPLES)
        mixed = own * (mine.T @ mine / len(mine)) + (1.0 - own) * every
        alone = np.diag(np.maximum(np.diag(mixed), _VARIANCE_MIN))
        precision.append(np.linalg.inv((1.0 - SHRINKAGE) * mixed + SHRINKAGE * alone))
    # Rounded as in the file, so that what was judged is what will judge.
    rounded = np.round(np.stack(precision) * _DECIMALS) / _DECIMALS
    return SeenClasses(centres, spread, rounded, scaled.min(axis=0), scaled.max(axis=0))


def excess_norm(excess: Floats) -> Floats:
    """(sample,) root of the summed squares of (sample, feature) excesses."""
    return np.asarray(np.sqrt((excess**2).sum(axis=1)))


def arcsinh_scale(values: Floats) -> Floats:
    """Bring features of many sizes to one scale: nearly linear about 0, logarithmic far out."""
    return np.asarray(np.arcsinh(values))


def pack_symmetric(matrices: Floats) -> list[list[int]]:
    """Write symmetric matrices, one a class: upper halves, in thousandths."""
    upper = np.triu_indices(matrices.shape[1])
    return [np.round(one[upper] * _DECIMALS).astype(np.int64).tolist() for one in matrices]


def unpack_symmetric(lists: Any, features: int) -> Floats:
    """Make the matrices again; raise ValueError where the lists are of another size."""
    upper = np.triu_indices(features)
    values = np.array(lists, np.float64) / _DECIMALS
    if values.ndim != 2 or values.shape[1] != upper[0].size:
        raise ValueError(f"precision: {values.shape}, expected {upper[0].size} values a class")
    made = np.zeros((len(values), features, features))
    made[:, upper[0], upper[1]] = values
    made[:, upper[1], upper[0]] = values
    return made
