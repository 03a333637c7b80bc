"""Classes learned from labelled products: a forest of randomised trees, or the distance from good ones.

Model. From hundreds of products of every class, `roemetry fit-classifier` makes a forest of extremely
randomised trees (Geurts, Ernst and Wehenkel 2006) over the shape features. The mean of the leaves' class
shares, s_c, becomes a probability by temperature scaling, p_c ∝ s_c^k, with the k of least log loss on
held-out products (Guo et al. 2017). From fewer, it makes a reference of good ones
(`roemetry_shape.good_reference`). In both cases

    novel                     → unknown   unlike anything learned (`roemetry_shape.novelty`)
    c = good if p_good ≥ good_from, else the likeliest other class; good_from is balanced on held-out products
    p_c ≥ stated_from         → c
    else                      → unknown   no class is likely enough

`stated_from` is the limit at which no more than 2.5 % of held-out products were given a wrong class. Sizes of
the product are not learned (`LEFT_OUT`): how large a population is says nothing of its shape.

Assumed: the samples' rigs, light and population are those of the products; where they are not, novelty must
tell. The model that is shipped was fitted over random rigs, two simulators' shapes, noise and turned
products. It fails, as every classifier, for a defect that no stripe shows.

A model is a JSON file without code: `LearnedModel.load` checks every index before a tree is walked.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Fitted, Grade, Product, Reason, Samples
from roemetry.records.arrays import Floats, Integers
from roemetry.stages import Capabilities, Classifier, StageOptions
from roemetry_kernels.compiling import kernel
from roemetry_shape.features import SMOOTHING_MM, shape_of
from roemetry_shape.good_reference import GoodReference
from roemetry_shape.novelty import Novelty, SeenClasses

UNKNOWN = "unknown"
VERSION = 5
"""Of the file. 4 had features of the rig (rows, stripes); such a model must be fitted again."""

LEFT_OUT = (
    *("length_seen_mm", "length_extrapolated_mm", "width_mm", "thickness_mm", "section_area_max_mm2"),
    *("length_mm", "across_mm", "footprint_mm2", "hump_height_mm", "hump_area_mm2", "humps"),
)
"""Features that are not learned: sizes, which are a population's, and humps, which noise makes."""

_SHARE_MIN = 1e-6
"""Of a class in no leaf: its probability is small, not zero."""

_PARTS = 1000
"""Leaves' shares in a file: a thousandth is what one of 60 trees can tell of a leaf of 16 samples."""


class LearnedOptions(StageOptions):
    """Options of `Learned`."""

    model: Path = Field(description="file of `roemetry fit-classifier`")
    probability_min: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="a class less likely than this is not stated: unknown; the model has its own least, too",
    )


class Learned(Classifier[LearnedOptions]):
    """A class, with a calibrated probability, from what was learned of labelled products.

    ``unknown`` is the answer where the product shows too few sections, where it is unlike anything the model
    was fitted on, and where no class is likely enough.
    """

    Options: ClassVar[type[StageOptions]] = LearnedOptions
    capabilities = Capabilities(fixture="roemetry_shape.example_model:learned_options")

    @cached_property
    def _model(self) -> LearnedModel | GoodReference:
        return load_model(self.options.model)

    def classify(self, product: Product, *, rng: np.random.Generator | None = None) -> Grade:
        """Give the likeliest class with its probability; `rng` is not used: the model itself does not err.

        Raises
        ------
        StageError
            The model's file is none, or damaged.
        """
        shape = shape_of(product, self._model.smoothing_mm)
        return replace(self.judge(shape.features), relief=shape.relief)

    def judge(self, features: Mapping[str, float]) -> Grade:
        """Judge features that were measured already, with the model's `smoothing_mm`."""
        model = self._model
        if not features:
            return Grade(UNKNOWN, reasons=(Reason("too-few-sections", _FEW),))
        if isinstance(model, GoodReference):
            return model.judge(features)
        values = model.values(features)
        novelty = model.novelty(values)
        by_class = dict(zip(model.classes, model.probabilities(values).tolist(), strict=True))
        told = {**features, **{f"probability_{name}": value for name, value in by_class.items()}}
        told["novelty"] = novelty.value
        if novelty.value > 1.0:
            return Grade(UNKNOWN, math.nan, told, (Reason("unlike-anything-learned", _unlike(novelty)),))
        label = _decided(by_class, model)
        least = max(self.options.probability_min, model.stated_from)
        if by_class[label] < least:
            why = f"the likeliest class, {label}, has a probability of {by_class[label]:.2f} only"
            return Grade(UNKNOWN, math.nan, told, (Reason("no-class-likely", why),))
        return Grade(label, by_class[label], told, (Reason("learned-class", _said(by_class)),))

    @classmethod
    def fit(cls, samples: Samples, *, good: str = "", smoothing_mm: float = SMOOTHING_MM) -> Fitted:
        """Learn from labelled products; see `roemetry_shape.learned_fit.fit_classifier`."""
        from roemetry_shape.learned_fit import fit_classifier

        return fit_classifier(samples, good=good, smoothing_mm=smoothing_mm)


_FEW = "fewer than three stripes show a cross-section: there is no shape to judge"


def _unlike(novelty: Novelty) -> str:
    if not novelty.feature:
        return f"{novelty.value:.1f} times as far from all that was learned as is usual"
    return (
        f"{novelty.feature} is {novelty.found:.3g}, and was {novelty.low:.3g} to {novelty.high:.3g} in all "
        f"that was learned; over all features {novelty.value:.1f} times as far outside as is usual"
    )


def _decided(by_class: dict[str, float], model: LearnedModel) -> str:
    """Good from `good_from` on; else the likeliest of the others."""
    if model.good and by_class[model.good] >= model.good_from:
        return model.good
    others = {name: value for name, value in by_class.items() if name != model.good}
    return max(others, key=lambda name: others[name])


def _said(by_class: dict[str, float]) -> str:
    likely = sorted(by_class.items(), key=lambda item: -item[1])[:3]
    return "probabilities: " + ", ".join(f"{name} {value:.2f}" for name, value in likely)


class Forest(NamedTuple):
    """Decision trees, all nodes in one row.

    Attributes
    ----------
    feature
        (node,) feature that a split asks for; −1 for a leaf.
    threshold
        (node,) where ``values[feature] <= threshold`` the way goes left.
    left, right
        (node,) the next node.
    shares
        (node, class) class shares of the leaves.
    roots
        (tree,) first node of each tree.
    """

    feature: Integers
    threshold: Floats
    left: Integers
    right: Integers
    shares: Floats
    roots: Integers


@kernel
def forest_shares(
    values: Floats, feature: Integers, threshold: Floats, left: Integers, right: Integers, shares: Floats,
    roots: Integers,
) -> Floats:  # fmt: skip
    """Average the leaves that one sample, (feature,) without NaN, falls into; see `Forest`."""
    total = np.zeros(shares.shape[1])
    for root in roots:
        node = root
        while feature[node] >= 0:
            node = left[node] if values[feature[node]] <= threshold[node] else right[node]
        for c in range(total.size):
            total[c] += shares[node, c]
    return total / roots.size


@dataclass(frozen=True, eq=False)
class LearnedModel:
    """What `roemetry fit-classifier` found from many products.

    Attributes
    ----------
    features
        Names, in the forest's order.
    fill
        (feature,) median of the samples: stands for a feature that is missing.
    classes
        Names; `good` is one of them, or "".
    good, good_from
        The class of good products, and the least probability of it that is called so.
    stated_from
        Least probability of a class that is stated.
    temperature
        Power that turns the forest's shares into probabilities.
    forest
        The trees.
    seen
        What the samples of each class look like: how far a product is from all of them.
    distance_max
        Largest such distance that is not yet novel.
    excess_max
        The same of how far features lie beyond all that were seen.
    smoothing_mm
        How the features were measured.
    """

    features: tuple[str, ...]
    fill: Floats
    classes: tuple[str, ...]
    good: str
    good_from: float
    stated_from: float
    temperature: float
    forest: Forest
    seen: SeenClasses
    distance_max: float
    excess_max: float
    smoothing_mm: float

    def values(self, features: Mapping[str, float]) -> Floats:
        """Put features in the forest's order; the median of the samples where one is missing."""
        values = np.array([features.get(name, np.nan) for name in self.features])
        return np.where(np.isfinite(values), values, self.fill)

    def probabilities(self, values: Floats) -> Floats:
        """(class,) calibrated probabilities of one sample, without NaN."""
        return temperature_scale(forest_shares(values, *self.forest), self.temperature)

    def novelty(self, values: Floats) -> Novelty:
        """How far a sample, without NaN, is from all that was learned; above 1 it is novel."""
        return self.seen.novelty(values, self.features, self.distance_max, self.excess_max)

    def to_json(self, about: Mapping[str, Any]) -> str:
        """Write the model, with whatever is to be said about it."""
        plain = {name: _plain(value) for name, value in vars(self).items() if name not in ("forest", "seen")}
        content = {
            "roemetry_classifier": VERSION,
            "method": "forest",
            "about": dict(about),
            **plain,
            "seen": {name: _plain(value) for name, value in self.seen.to_json().items()},
            "forest": pack_forest(self.forest),
        }
        return json.dumps(content, allow_nan=False, separators=(",", ":")) + "\n"

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> LearnedModel:
        """Read a file's content; raise KeyError, TypeError or ValueError where it is no model."""
        forest = unpack_forest(data["forest"])
        features = tuple(data["features"])
        if forest.feature.max() >= len(features):
            raise ValueError("a split asks for a feature that is not there")
        numbers = ("good_from", "stated_from", "temperature", "distance_max", "excess_max", "smoothing_mm")
        return cls(
            features=features,
            fill=np.array(data["fill"], np.float64),
            classes=tuple(data["classes"]),
            good=str(data["good"]),
            forest=forest,
            seen=SeenClasses.from_json(data["seen"], len(features)),
            **{name: float(data[name]) for name in numbers},
        )


def load_model(path: Path) -> LearnedModel | GoodReference:
    """Read a file of `roemetry fit-classifier`; raise StageError where it is none, or damaged."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["roemetry_classifier"] != VERSION:
            raise StageError(
                f"{path.name}: format {data['roemetry_classifier']}, expected {VERSION}",
                hint="fit it again with `roemetry fit-classifier`",
            )
        made: type[LearnedModel] | type[GoodReference]
        made = {"forest": LearnedModel, "good-reference": GoodReference}[data["method"]]
        return made.from_json(data)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StageError(
            f"{path.name} is no fitted classifier, or it is damaged: {type(error).__name__}: {error}",
            hint="make it with `roemetry fit-classifier`",
        ) from error


def temperature_scale(shares: Floats, power: float) -> Floats:
    """Raise class shares to a power and make them add up to 1 again, along the last axis."""
    raised = np.maximum(shares, _SHARE_MIN) ** power
    return np.asarray(raised / raised.sum(axis=-1, keepdims=True))


def pack_forest(forest: Forest) -> dict[str, list[Any]]:
    """Write a forest as short lists: a leaf needs no threshold, and a split no shares.

    Returns
    -------
    dict
        ``roots``: first node of each tree; ``feature``: of every node, −1 for a leaf; ``threshold``: of the
        splits, seven digits; ``left``, ``right``: of the splits, as steps from their node; ``shares``: of the
        leaves, in thousandths.
    """
    split = np.flatnonzero(forest.feature >= 0)
    thousandths = np.round(forest.shares[forest.feature < 0] * _PARTS).astype(np.int64)
    return {
        "roots": forest.roots.tolist(),
        "feature": forest.feature.tolist(),
        "threshold": [float(f"{value:.7g}") for value in forest.threshold[split]],
        "left": (forest.left[split] - split).tolist(),
        "right": (forest.right[split] - split).tolist(),
        "shares": thousandths.tolist(),
    }


def unpack_forest(lists: Mapping[str, Any]) -> Forest:
    """Make the forest again; raise KeyError, TypeError or ValueError for lists that are none."""
    feature = np.array(lists["feature"], np.int64)
    split, leaf = np.flatnonzero(feature >= 0), np.flatnonzero(feature < 0)
    leaves: Floats = np.array(lists["shares"], np.float64)
    if leaves.ndim != 2 or len(leaves) != leaf.size:
        raise ValueError(f"{leaf.size} leaves, and shares of shape {leaves.shape}")
    shares = np.zeros((feature.size, leaves.shape[1]))
    shares[leaf] = leaves / np.maximum(leaves.sum(axis=1, keepdims=True), 1e-9)
    threshold = np.zeros(feature.size)
    threshold[split] = np.array(lists["threshold"], np.float64)
    ways = []
    for name in ("left", "right"):
        way = np.full(feature.size, -1, np.int64)
        way[split] = split + np.array(lists[name], np.int64)
        if ((way[split] <= split) | (way[split] >= feature.size)).any():
            raise ValueError(f"{name}: a way leads out of the forest, or back")
        ways.append(way)
    roots = np.array(lists["roots"], np.int64)
    if not ((roots >= 0) & (roots < feature.size)).all():
        raise ValueError("roots: not within the forest")
    return Forest(feature, threshold, ways[0], ways[1], shares, roots)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value
