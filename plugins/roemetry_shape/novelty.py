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
both, and the two are added in squares: a product that comes near both limits is like none of the samples.

Assumed: the samples are what is to be expected: rigs, light and populations that differ from them by more
than they differ among each other are novel, and are said to be so. It fails for a product whose every
feature lies within what was seen.

Good or not, from a few good products (`GoodReference`), is the largest deviation from them against what
deviates by nature. Eight good products say where the good ones of this line lie, but not how they scatter: a
standard deviation of eight is itself uncertain by 26 %, and of forty features some will be far too small. So
each feature's variance is that of the samples, drawn towards what good products show over rigs (an inverse-
gamma prior worth `PRIOR_SAMPLES` samples: empirical Bayes, Efron and Morris 1973):

    s_i² = (Σ (x − m_i)² + ν₀·σ_i²) / (n − 1 + ν₀),    ν₀ = PRIOR_SAMPLES, σ_i of `GOOD_SPREAD`
    z_i  = max(x_i − m_i, 0) / (s_i·√(1 + 1/n))         a defect raises these features; none lowers them
    score = max_i z_i / limit                            above 1: not good

Features are those of `GOOD_SPREAD`, each the size of some defect in its unit. A table without any of them
(features of one's own) is judged by all of its features, to either side, with the samples' variance alone;
Student's t for n − 1 degrees takes the place of z.

The limit is `LIMIT`. Named defects, even one of each, do two things: a limit above the least of them moves to
between it and the good ones; and a product that is not good gets the name of the defect whose direction in z
is nearest, if its cosine is at least `COSINE_MIN`; else it is `not-good`.

What n samples can promise is a matter of counting, whatever the method: if all n are kept when judged by the
others, at least 0.05^(1/n) of good products are kept, with 95 % confidence (Clopper and Pearson 1934): 69 %
of 8, 95 % from 59 on. It fails for defects that raise none of the features.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from roemetry.records import Grade, Reason
from roemetry.records.arrays import Floats

SHRINKAGE = 0.2
"""Share of the uncorrelated part. 0.1 to 0.4 change the share of novel products found by less than 1 %; 0
makes forty features of fifty samples singular."""

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
    """How far a sample is from all that was learned."""

    value: float
    """As a share of the limit; above 1 the sample is novel."""
    feature: str = ""
    found: float = math.nan
    low: float = math.nan
    high: float = math.nan
    """feature, found, low, high: the feature that lies farthest beyond what was seen, its value, and what was
    seen; "" and NaN where it is all features together that are farther from every class."""


class SeenClasses(NamedTuple):
    """What was seen of each class."""

    centres: Floats
    """(class, feature) means of the scaled features."""
    spread: Floats
    """(feature,) standard deviations within classes."""
    precision: Floats
    """(class, feature, feature) inverse of the correlation within the class."""
    low: Floats
    high: Floats
    """low, high: (feature,) least and largest scaled values, of all classes."""

    def novelty(
        self, values: Floats, names: Sequence[str], distance_max: float, excess_max: float
    ) -> Novelty:
        """Judge one sample's (feature,) values against the limits of both measures, in quadrature."""
        # both as shares of what held-out samples reached, so that they can be added
        distance = float(self.distances(values[None])[0]) / distance_max
        excess = self.excess(values[None])[0]
        outside = float(excess_norm(excess[None])[0]) / excess_max
        value = math.hypot(distance, outside)
        # no single feature stands out as far as their combination does: none is named
        if outside <= distance:
            return Novelty(value)
        most = int(excess.argmax())
        # back from asinh to the feature's own unit, for people
        ends = np.sinh([self.low[most], self.high[most]])
        return Novelty(value, names[most], float(values[most]), float(ends[0]), float(ends[1]))

    def distances(self, values: Floats) -> Floats:
        """(sample,) distances from the nearest class, in its standard deviations, of (sample, feature)."""
        # (sample, class, feature): from every class, in standard deviations
        off = (arcsinh_scale(values)[:, None] - self.centres) / self.spread
        # offᵀ · precision · off, for each sample and class
        squares = np.einsum("ncf,cnf->nc", off, off.swapaxes(0, 1) @ self.precision)
        # divided by the number of features: an ordinary sample has a distance of about 1, whatever their
        # number
        return np.asarray(np.sqrt(squares.min(axis=1) / values.shape[1]))

    def excess(self, values: Floats) -> Floats:
        """(sample, feature) how far values lie beyond all that were seen, as shares of the range seen."""
        scaled = arcsinh_scale(values)
        # of one end only: below the least or above the largest; 0 within
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
    # each sample from the mean of its own class: what scatters is noise and nature, not the class
    off = scaled - centres[which]
    spread = np.maximum(off.std(axis=0), _SPREAD_MIN)
    off /= spread
    # the correlation of all classes together, for those with too few samples of their own
    every = off.T @ off / len(off)
    precision = []
    for k in range(len(classes)):
        mine = off[which == k]
        own = len(mine) / (len(mine) + POOLED_SAMPLES)
        mixed = own * (mine.T @ mine / len(mine)) + (1.0 - own) * every
        # the diagonal alone is the part without correlation; what never varied gets a least variance, or a
        # tiny deviation would be endlessly far
        alone = np.diag(np.maximum(np.diag(mixed), _VARIANCE_MIN))
        # mixed with it the matrix has no eigenvalue near 0, and its inverse none that is huge
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


GOOD_SPREAD: Mapping[str, float] = {
    "bow_mm": 0.73,
    "bend_mm": 0.42,
    "s_bend_mm": 0.39,
    "kink_deg": 2.9,
    "edge_kink_deg": 2.8,
    "kink_rest_mm": 0.067,
    "twist_deg": 3.7,
    "twist_of_ends_deg": 3.3,
    "twist_of_flanks_deg": 3.3,
    "lean_range_deg": 3.4,
    "lean_uneven_deg": 0.93,
    "stoutness_spread": 0.02,
    "hollow_depth_mm": 0.037,
    "hollow_median_mm": 0.018,
    "hollow_mean_mm": 0.0022,
    "cup_depth_mm": 0.027,
    "saddle_mm": 0.29,
    "saddle_median_mm": 0.16,
    "saddle_least_mm": 0.11,
    "pit_depth_mm": 0.16,
    "off_dome_mm": 0.063,
    "height_dip": 0.0064,
    "ridge_dip": 0.0067,
    "height_tenth_high": 0.06,
    "width_tenth_high": 0.067,
    "width_end_high": 0.13,
    "stripes_missing_by_area": 0.65,
    "stripes_missing_by_width": 0.7,
}
"""Standard deviation over good bodies and rigs within a population, in the feature's unit: root mean square
of those of 640 good skeins of two simulators' families on random rigs."""

PRIOR_SAMPLES = 12.0
"""What the prior counts against the samples: as many as one rig's first day has. 6 to 25 change good kept, of
eight samples, by less than 2 %."""

LIMIT = 5.0
"""Of the largest of 28 z, chosen on bodies of our simulator: 3 keeps 97 % of good ones and catches
97 % of deformed ones that stripes show by a millimetre; 5 keeps all of 400 and catches 96 %."""

COSINE_MIN = 0.9
"""Of the angle between a product's deviations and a defect's: 26 degrees. At 0.7 three in ten names were
wrong, at 0.9 one in seven."""

_SPREAD_SHARE_MIN = 0.02
"""Of a feature without prior: its spread is at least this share of its mean, as its uncertainty is."""

GOOD_MIN = 5
"""With fewer good products nothing is fitted."""


@dataclass(frozen=True, eq=False)
class GoodReference:
    """What `roemetry fit-classifier` found from a few products."""

    features: tuple[str, ...]
    """Names."""
    centre: Floats
    spread: Floats
    """centre, spread: (feature,) mean of the good samples, and the standard deviation a further one is
    expected to have."""
    one_sided: bool
    """Whether only larger values are worse."""
    good: str
    """The class of good products."""
    limit: float
    """Largest deviation that is still good."""
    defects: tuple[str, ...]
    """Names of defects that samples had."""
    directions: Floats
    """(defect, feature) mean deviations of each, of length 1."""
    kept_at_least: float
    """Share of good products kept, by counting, at 95 % confidence."""
    smoothing_mm: float
    """How the features were measured."""

    def deviations(self, values: Floats) -> Floats:
        """(sample, feature) deviations of values, in standard deviations; 0 where a value is missing."""
        # with defects that raise a feature, less of it is better than good
        z = (values - self.centre) / self.spread
        z = np.maximum(z, 0.0) if self.one_sided else np.abs(z)
        return np.where(np.isfinite(z), z, 0.0)

    def judge(self, features: Mapping[str, float]) -> Grade:
        """Judge one product; no probability is stated: so few samples have none to state."""
        values = np.array([features.get(name, np.nan) for name in self.features])
        told = dict(features)
        if not np.isfinite(values).any():
            why = f"it has none of the features that were learned, such as {self.features[0]}"
            return Grade("unknown", features=told, reasons=(Reason("no-such-feature", why),))
        z = self.deviations(values[None])[0]
        told["novelty"] = float(z.max() / self.limit)
        # the largest deviation, not a sum: a single defect among many sound features must not be averaged
        # away
        most = int(z.argmax())
        of_good = f"{self.features[most]} is {values[most]:.3g}, {z[most]:.1f} deviations from good ones"
        said = f"{of_good}; {self.limit:.1f} is the limit, at least {100 * self.kept_at_least:.0f} % are kept"
        if told["novelty"] <= 1.0:
            return Grade(self.good, features=told, reasons=(Reason("like-good-ones", said),))
        label = self._name(z)
        return Grade(label, features=told, reasons=(Reason("unlike-good-ones", said),))

    def _name(self, z: Floats) -> str:
        if len(self.defects):
            # the direction of the deviations, whatever their size: a slight bend and a strong one are both
            # bends
            cosine = self.directions @ z / max(float(np.linalg.norm(z)), 1e-9)
            if cosine.max() >= COSINE_MIN:
                return self.defects[int(cosine.argmax())]
        return f"not-{self.good}"

    def to_json(self, about: Mapping[str, Any], version: int) -> str:
        """Write the model, with whatever is to be said about it."""
        plain = {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }
        content = {"roemetry_classifier": version, "method": "good-reference", "about": dict(about), **plain}
        return json.dumps(content, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> GoodReference:
        """Read a file's content; raise KeyError, TypeError or ValueError where it is no model."""
        features, defects = tuple(data["features"]), tuple(data["defects"])
        centre, spread = (np.array(data[name], np.float64) for name in ("centre", "spread"))
        directions = np.array(data["directions"], np.float64).reshape(len(defects), len(features))
        if centre.shape != (len(features),) or spread.shape != centre.shape or not (spread > 0).all():
            raise ValueError("centre and spread do not fit the features")
        return cls(
            features=features,
            centre=centre,
            spread=spread,
            one_sided=bool(data["one_sided"]),
            good=str(data["good"]),
            limit=float(data["limit"]),
            defects=defects,
            directions=directions,
            kept_at_least=float(data["kept_at_least"]),
            smoothing_mm=float(data["smoothing_mm"]),
        )


def fit_reference(
    names: tuple[str, ...], values: Floats, labels: np.ndarray, good: str, smoothing_mm: float
) -> tuple[GoodReference, dict[str, float]]:
    """Fit on a few samples, at least `GOOD_MIN` of them good; give the model and how it does left-one-out.

    Parameters
    ----------
    names, values, labels
        (feature,), (sample, feature) and (sample,); values may be NaN.
    good
        The class of good products.
    smoothing_mm
        How the features were measured.
    """
    # features of one's own have no prior; they are judged only where none of ours is in the table
    known = [k for k, name in enumerate(names) if name in GOOD_SPREAD]
    one_sided = bool(known)
    taken = known or list(range(len(names)))
    kept_names = tuple(names[k] for k in taken)
    of_good, others = values[labels == good][:, taken], values[labels != good][:, taken]
    prior = np.array([GOOD_SPREAD[name] for name in kept_names]) if known else None
    # Student's t of n − 1 degrees has wider tails than z: the limit that as many exceed.
    limit = LIMIT if known else LIMIT * math.sqrt((len(of_good) + 1.0) / max(len(of_good) - 3.0, 1.0))

    def made(good_values: Floats) -> GoodReference:
        centre, spread = _centre_and_spread(good_values, prior)
        return GoodReference(
            kept_names,
            centre,
            spread,
            one_sided,
            good,
            limit,
            (),
            np.empty((0, len(taken))),
            0.0,
            smoothing_mm,
        )

    # each good sample is judged by a model made without it, as a new product would be
    left_out = np.array(
        [
            made(np.delete(of_good, k, axis=0)).deviations(of_good[k : k + 1]).max()
            for k in range(len(of_good))
        ]
    )
    model = made(of_good)
    defects, directions, least = _directions(model, others, labels[labels != good])
    # A limit above a named defect that all good ones keep clear of is too wide.
    # the good sample that is farthest from the rest
    worst_good = float(np.sort(left_out)[-1])
    if worst_good < least < limit:
        # half way between good and defect on a logarithmic scale; at least one deviation is always allowed
        limit = math.sqrt(max(worst_good, 1.0) * least)
    kept = int((left_out <= limit).sum())
    figures = {
        "good_kept_left_one_out": kept / len(of_good),
        "good_kept_at_least": lower_bound(kept, len(of_good)),
    }
    if len(others):
        # these samples moved the limit and named the directions, so this share is no promise; none is made of
        # it
        caught = model.deviations(others).max(axis=1) > limit
        figures["others_caught_share"] = float(caught.mean())
    fitted = GoodReference(
        kept_names, model.centre, model.spread, one_sided, good, limit, defects, directions,
        figures["good_kept_at_least"], smoothing_mm,
    )  # fmt: skip
    return fitted, figures


def lower_bound(kept: int, count: int, confidence: float = 0.95) -> float:
    """Least share of all products that is kept, if `kept` of `count` were (Clopper and Pearson 1934)."""
    from scipy.special import betaincinv

    # the lower end: the share at which so many kept, or more, would have a chance of 5 %
    return float(betaincinv(kept, count - kept + 1, 1.0 - confidence)) if kept else 0.0


def _centre_and_spread(values: Floats, prior: Floats | None) -> tuple[Floats, Floats]:
    count = len(values)
    with np.errstate(all="ignore"):
        # a feature that no sample has gives NaN, with a warning that nobody needs
        centre = np.nanmean(values, axis=0)
        squares = np.nansum((values - centre) ** 2, axis=0)
    # a feature that no sample has: its centre is never used where `deviations` finds NaN
    centre = np.nan_to_num(centre)
    if prior is None:
        # a feature that never varied is still not known better than to a share of its mean; 1e-18 is for a
        # mean of 0
        variance = squares / max(count - 1, 1) + (_SPREAD_SHARE_MIN * np.abs(centre)) ** 2 + 1e-18
    else:
        variance = (squares + PRIOR_SAMPLES * prior**2) / (count - 1 + PRIOR_SAMPLES)
    # a further product lies off a mean that is itself uncertain by s/√n
    return centre, np.sqrt(variance * (1.0 + 1.0 / count))


def _directions(
    model: GoodReference, others: Floats, labels: np.ndarray
) -> tuple[tuple[str, ...], Floats, float]:
    """Names of defects, their mean directions, and the least of the samples' largest deviations."""
    if not len(others):
        # an infinite least deviation leaves the limit where it is
        return (), np.empty((0, len(model.features))), math.inf
    z = model.deviations(others)
    names = sorted(set(labels.tolist()))
    # directions first, means after: a strong example of a defect counts no more than a slight one
    unit = z / np.maximum(np.linalg.norm(z, axis=1, keepdims=True), 1e-9)
    means = np.stack([unit[labels == name].mean(axis=0) for name in names])
    # the mean of unit vectors is shorter than 1
    means /= np.maximum(np.linalg.norm(means, axis=1, keepdims=True), 1e-9)
    return tuple(names), means, float(z.max(axis=1).min())
