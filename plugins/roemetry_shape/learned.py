"""Classes learned from labelled products: a regression over shape features, or the distance from good ones.

Model. From hundreds of products of every class, `roemetry fit-classifier` fits a multinomial logistic
regression (Hastie, Tibshirani and Friedman 2009, section 4.4) over the features:

    p_c ∝ exp(w_c · x + b_c),    x_i = asinh(feature i), held within what was seen of it
    least   −Σ log p(label) + ½ λ Σ w²       w in units of the features' standard deviations

The weights and intercepts are then multiplied by the k of least log loss on held-out products (temperature
scaling, Guo et al. 2017). From fewer products, it makes a reference of good ones (`roemetry_shape.novelty`).
In both cases

    novel                     → unknown   unlike anything learned (`roemetry_shape.novelty`)
    c = good if p_good ≥ good_from, else the likeliest other class; good_from is balanced on held-out products
    p_c ≥ stated_from         → c
    1 − p_good ≥ stated_from  → not-good  it has a defect, but which one is in doubt
    else                      → unknown   no class is likely enough

`stated_from` is the limit at which no more than `WRONG_MAX` of held-out products were given a wrong class.
Sizes of the product are not learned (`LEFT_OUT`): how large a population is says nothing of its shape.

Assumed: the features of a class lie to one side of a plane, as they do where a defect raises some of them.
The samples' rigs, light and population are those of the products; where they are not, novelty must tell. It
fails, as every classifier, for a defect that no stripe shows, and for a population whose good ones vary as
another's defects do.

A model is a JSON file without code. What is promised is counted, not modelled: the lower end of the exact
95 % interval (Clopper and Pearson 1934) of the good ones kept, and of the others caught, of held-out products
that share no group with those that taught.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from roemetry.errors import DataError, StageError
from roemetry.records import Fitted, Grade, Product, Reason, Relief, Samples
from roemetry.records.arrays import Floats, Integers
from roemetry.stages import Capabilities, Classifier, StageOptions
from roemetry_shape.features import SMOOTHING_MM, shape_features, shape_of
from roemetry_shape.novelty import (
    GOOD_MIN,
    GoodReference,
    Novelty,
    SeenClasses,
    arcsinh_scale,
    excess_norm,
    fit_reference,
    lower_bound,
    seen_classes,
)

UNKNOWN = "unknown"
VERSION = 6
"""Of the file. 5 held a forest of trees over other features; such a model must be fitted again."""

LEFT_OUT = (
    *("length_seen_mm", "length_extrapolated_mm", "width_mm", "thickness_mm", "section_area_max_mm2"),
    *("length_mm", "across_mm", "footprint_mm2", "hump_height_mm", "hump_area_mm2", "humps"),
)
"""Features that are not learned: sizes, which are a population's, and humps, which noise makes."""


class LearnedOptions(StageOptions):
    """Options of `Learned`."""

    model: Path = Field(description="file of `roemetry fit-classifier`")
    probability_min: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="nothing less likely than this is stated; the model has its own least, too",
    )


class Learned(Classifier[LearnedOptions]):
    """A class, with a calibrated probability, from what was learned of labelled products.

    ``unknown`` is the answer where the product shows too few sections, where it is unlike anything the model
    was fitted on, and where it may as well be good as not. ``not-good`` (after the name of the good class) is
    the answer where it is surely not good, but no defect is likely enough to be named.
    """

    capabilities = Capabilities(fixture="roemetry_shape.learned:learned_options")

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
        del rng
        return self.judge(shape_features(product, self._model.smoothing_mm))

    def relief(self, product: Product) -> Relief | None:
        """Give the surface that the features were read off."""
        return shape_of(product, self._model.smoothing_mm).relief

    def judge(self, features: Mapping[str, float]) -> Grade:
        """Judge features that were measured already, with the model's `smoothing_mm`."""
        model = self._model
        if not features:
            return Grade(UNKNOWN, reasons=(Reason("too-few-sections", _FEW),))
        if isinstance(model, GoodReference):
            return model.judge(features)
        values = model.values(features)
        # novelty is asked before the class: a regression is as sure of what it has never seen
        novelty = model.novelty(values)
        by_class = dict(zip(model.classes, model.probabilities(values).tolist(), strict=True))
        told = {**features, **{f"probability_{name}": value for name, value in by_class.items()}}
        if model.good:
            told[f"probability_not-{model.good}"] = 1.0 - by_class[model.good]
        told["novelty"] = novelty.value
        if novelty.value > 1.0:
            # no probability: those of the classes say nothing of a product that is of none
            return Grade(UNKNOWN, math.nan, told, (Reason("unlike-anything-learned", _unlike(novelty)),))
        label = _decided(by_class, model)
        # the recipe may be stricter than the model, never laxer
        least = max(self.options.probability_min, model.stated_from)
        if by_class[label] >= least:
            return Grade(label, by_class[label], told, (Reason("learned-class", _said(by_class)),))
        if label != model.good and told.get(f"probability_not-{model.good}", 0.0) >= least:
            return Grade(
                f"not-{model.good}",
                told[f"probability_not-{model.good}"],
                told,
                (Reason("defect-not-named", f"no defect is likely enough to be named; {_said(by_class)}"),),
            )
        why = f"the likeliest class, {label}, has a probability of {by_class[label]:.2f} only"
        return Grade(UNKNOWN, math.nan, told, (Reason("no-class-likely", why),))

    @classmethod
    def fit(
        cls,
        samples: Samples,
        *,
        good: str = "",
        smoothing_mm: float = SMOOTHING_MM,
        begin: Path | None = None,
    ) -> Fitted:
        """Learn from labelled products; see `roemetry_shape.learned.fit_classifier` and `adapted`."""
        if begin is not None:
            return adapted(load_model(begin), samples)
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
    # good by its own limit, at which what is kept and what is caught were balanced, not by being likeliest
    if model.good and by_class[model.good] >= model.good_from:
        return model.good
    others = {name: value for name, value in by_class.items() if name != model.good}
    # how likely it is that it is none of them was decided above; here only which
    return max(others, key=lambda name: others[name])


def _said(by_class: dict[str, float]) -> str:
    likely = sorted(by_class.items(), key=lambda item: -item[1])[:3]
    return "probabilities: " + ", ".join(f"{name} {value:.2f}" for name, value in likely)


@dataclass(frozen=True, eq=False)
class LearnedModel:
    """What `roemetry fit-classifier` found from many products."""

    features: tuple[str, ...]
    """Names, in the order of the weights."""
    fill: Floats
    """(feature,) median of the samples: stands for a feature that is missing."""
    classes: tuple[str, ...]
    """Names; `good` is one of them, or ""."""
    good: str
    good_from: float
    """good, good_from: the class of good products, and the least probability of it that is called so."""
    stated_from: float
    """Least probability of a class that is stated."""
    weights: Floats
    intercepts: Floats
    """weights, intercepts: (class, feature) and (class,), of the features' inverse hyperbolic sines."""
    seen: SeenClasses
    """What the samples of each class look like: how far a product is from all of them."""
    distance_max: float
    """Largest such distance that is not yet novel."""
    excess_max: float
    """The same of how far features lie beyond all that were seen."""
    smoothing_mm: float
    """How the features were measured."""

    def values(self, features: Mapping[str, float]) -> Floats:
        """Put features in the model's order; the median of the samples where one is missing."""
        values = np.array([features.get(name, np.nan) for name in self.features])
        # a missing feature counts as an ordinary one
        return np.where(np.isfinite(values), values, self.fill)

    def probabilities(self, values: Floats) -> Floats:
        """(class,) calibrated probabilities of one sample, without NaN."""
        # Beyond what was seen a straight line promises what nobody has looked at.
        within = np.clip(arcsinh_scale(values), self.seen.low, self.seen.high)
        return _softmax(self.weights @ within + self.intercepts)

    def novelty(self, values: Floats) -> Novelty:
        """How far a sample, without NaN, is from all that was learned; above 1 it is novel."""
        return self.seen.novelty(values, self.features, self.distance_max, self.excess_max)

    def to_json(self, about: Mapping[str, Any]) -> str:
        """Write the model, with whatever is to be said about it."""
        plain = {name: _plain(value) for name, value in vars(self).items() if name != "seen"}
        seen = {name: _plain(value) for name, value in self.seen.to_json().items()}
        content = {"roemetry_classifier": VERSION, "method": "regression", "about": dict(about)}
        return json.dumps(content | plain | {"seen": seen}, allow_nan=False, separators=(",", ":")) + "\n"

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> LearnedModel:
        """Read a file's content; raise KeyError, TypeError or ValueError where it is no model."""
        features, classes = tuple(data["features"]), tuple(data["classes"])
        fill, weights, intercepts = (
            np.array(data[name], np.float64) for name in ("fill", "weights", "intercepts")
        )
        shapes = (fill.shape, weights.shape, intercepts.shape)
        expected = ((len(features),), (len(classes), len(features)), (len(classes),))
        if shapes != expected:
            raise ValueError(f"fill, weights and intercepts are {shapes}, expected {expected}")
        if not (np.isfinite(weights).all() and np.isfinite(intercepts).all()):
            raise ValueError("a weight is no number")
        return cls(
            features=features,
            fill=fill,
            classes=classes,
            good=str(data["good"]),
            good_from=float(data["good_from"]),
            stated_from=float(data["stated_from"]),
            weights=weights,
            intercepts=intercepts,
            seen=SeenClasses.from_json(data["seen"], len(features)),
            distance_max=float(data["distance_max"]),
            excess_max=float(data["excess_max"]),
            smoothing_mm=float(data["smoothing_mm"]),
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
        made = {"regression": LearnedModel, "good-reference": GoodReference}[data["method"]]
        return made.from_json(data)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StageError(
            f"{path.name} is no fitted classifier, or it is damaged: {type(error).__name__}: {error}",
            hint="make it with `roemetry fit-classifier`",
        ) from error


def _softmax(logits: Floats) -> Floats:
    """Probabilities of logits, along the last axis."""
    # the largest is taken off first: exp of a large logit overflows
    raised = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=-1, keepdims=True))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


Folds = Sequence[tuple[Integers, Integers]]

FOLDS = 5  # of cross-validation: each holds a fifth of the groups back
PER_CLASS_MIN = 5
"""Of a class for a regression: one in each fold."""

REGRESSION_MIN = 60
"""Products for a regression: below, a fold has fewer samples than features, and novelty's limits (a quantile
of 99.5 %) are the largest of a handful."""

PENALTY = 10.0
"""λ: weights are expected to be about 0.3 for each standard deviation of a feature."""

EXCESS_LEAST = 0.1
"""Features may lie by a tenth of their range beyond it, however many samples there were."""

WRONG_MAX = 0.03
"""Share of held-out products given a wrong class: of the 5 % that may be wrong on other rigs, two fifths are
left for what other rigs add."""

_SEED = 1  # of the folds: the same samples give the same model


def fit_classifier(samples: Samples, *, good: str, smoothing_mm: float) -> Fitted:
    """Fit on all samples; judge on those held out.

    Parameters
    ----------
    samples
        With labels.
    good
        The class of good products; "" where there is none, or where all samples are of one class.
    smoothing_mm
        How the features were measured; stored with the model.

    Raises
    ------
    DataError
        Too few samples; a good class that nobody has; no feature that varies.
    """
    taken = [k for k, name in enumerate(samples.features) if name not in LEFT_OUT]
    if not taken:
        raise DataError("there are only sizes in the table", hint="features of shape are needed")
    names = tuple(samples.features[k] for k in taken)
    values, labels = samples.values[:, taken], np.array(samples.labels)
    # sorted, so that classes have the same order in every run
    classes, counts = np.unique(labels, return_counts=True)
    if not len(classes):
        raise DataError("there are no samples", hint="a classifier needs at least five good products")
    if good and good not in classes:
        raise DataError(
            f"no product is labelled `{good}`", hint=f"--good is one of {', '.join(map(str, classes))}"
        )
    # with nothing that varies, a regression is its intercept
    if not (np.nanstd(values, axis=0) > 0).any():
        raise DataError("no feature varies: the samples are all alike", hint="are the features in the table?")
    if len(classes) == 1:
        good = str(classes[0])
    if len(classes) > 2 and f"not-{good}" in classes:
        raise DataError(
            f"`not-{good}` is a class beside others, but it is the word for all that is not {good}",
            hint="call it by another name, or all defects so",
        )
    # too few for probabilities; with a good class they are still enough to know what is good
    if len(classes) == 1 or (len(labels) < REGRESSION_MIN and good):
        return _reference(names, values, labels, good, smoothing_mm)
    few = [f"`{name}` ({n})" for name, n in zip(classes, counts, strict=True) if n < PER_CLASS_MIN]
    if few:
        raise DataError(
            f"too few products of {', '.join(few)}; at least {PER_CLASS_MIN} of each class are needed",
            hint="is a label misspelt? otherwise collect more, or leave the class out",
        )
    # as numbers from 0: `_folds` counts with them
    groups = np.unique(np.array(samples.groups), return_inverse=True)[1]
    return _regression_fit(names, values, labels, groups, good, smoothing_mm)


def adapted(model: LearnedModel | GoodReference, samples: Samples) -> Fitted:
    """Adapt a model that was learned elsewhere to a few products, and judge it by them.

    They taught it nothing, so all of them judge it. Of one's own line one knows more than a model of all
    lines: its good ones are not novel, and a class is always named. The least probability of good falls to
    what one's own good ones have; the promise counts them at the limit that the model came with.

    Raises
    ------
    DataError
        The model has no class of good ones; fewer than `GOOD_MIN` good products; a feature is missing.
    """
    if not isinstance(model, LearnedModel) or not model.good:
        raise DataError("the model to begin with has no class of good ones", hint="begin with a regression")
    missing = sorted(set(model.features) - set(samples.features))
    if missing:
        raise DataError(f"there is no column {missing[0]}, which the model to begin with asks for")
    labels = np.array(samples.labels)
    good = labels == model.good
    _enough_good(int(good.sum()), model.good)
    values = samples.values[:, [samples.features.index(name) for name in model.features]]
    # the model's own fill, as where it judges
    values = np.where(np.isfinite(values), values, model.fill)
    of_good = np.array([model.probabilities(row)[model.classes.index(model.good)] for row in values])
    own = values[good]
    # how far the good ones of this line lie beyond what the model has seen
    outside = float(excess_norm(model.seen.excess(own)).max())
    fitted = replace(
        model,
        # limits only ever give way: what this line makes well is good here
        good_from=min(model.good_from, float(of_good[good].min())),
        stated_from=0.0,
        distance_max=max(model.distance_max, float(model.seen.distances(own).max())),
        excess_max=max(model.excess_max, outside),
    )
    # kept is counted at the limit the model came with: at the new one all good ones are kept by construction
    kept, caught = of_good[good] >= model.good_from, of_good[~good] < fitted.good_from
    figures = _kept_and_caught(kept, caught)
    counts = {str(name): int((labels == name).sum()) for name in np.unique(labels)}
    promise = 100.0 * figures["good_kept_at_least"]
    words = (
        f"{good.sum()} {model.good} and {(~good).sum()} others, which taught nothing, judged the model",
        f"promised by counting, with 95 % confidence: at least {promise:.0f} % of good products are kept",
    )
    about = {"samples": counts, **figures}
    return Fitted(fitted.to_json(about), figures, words)


def _kept_and_caught(kept: np.ndarray, caught: np.ndarray) -> dict[str, float]:
    """Shares of good ones kept and of others caught, and what they promise by counting."""
    told = {}
    for name, of in (("good_kept", kept), ("others_caught", caught)):
        if len(of):
            told[f"{name}_share"] = float(of.mean())
            told[f"{name}_at_least"] = lower_bound(int(of.sum()), len(of))
    return told


def _enough_good(count: int, good: str) -> None:
    if count < GOOD_MIN:
        raise DataError(
            f"too few products of `{good}` ({count}); at least {GOOD_MIN} are needed",
            hint="measure more good products; eight make a beginning",
        )


def _reference(
    names: tuple[str, ...], values: Floats, labels: np.ndarray, good: str, smoothing_mm: float
) -> Fitted:
    count = int((labels == good).sum())
    _enough_good(count, good)
    model, figures = fit_reference(names, values, labels, good, smoothing_mm)
    kinds = ", ".join(f"{(labels == name).sum()} {name}" for name in model.defects)
    words = (
        f"{count} {good}" + (f" and {kinds}" if kinds else "") + ": too few for probabilities; "
        "products are compared with the good ones, and what deviates is not good",
        f"promised by counting, with 95 % confidence: at least {100 * model.kept_at_least:.0f} % of good "
        "products are kept" + ("" if count >= 59 else "; 95 % can be promised from 59 good ones on"),
    )
    about = {"samples": {str(name): int((labels == name).sum()) for name in np.unique(labels)}, **figures}
    return Fitted(model.to_json(about, VERSION), figures, words)


def _regression_fit(
    names: tuple[str, ...],
    values: Floats,
    labels: np.ndarray,
    groups: Integers,
    good: str,
    smoothing_mm: float,
) -> Fitted:
    classes, counts = np.unique(labels, return_counts=True)
    values, fill = _filled(values)
    folds = _folds(labels, groups)
    which = np.searchsorted(classes, labels)
    logits = np.zeros((len(labels), len(classes)))
    for known, asked in folds:
        weights, intercepts = _regression(values[known], which[known], len(classes))
        # out of sample: each product is judged by weights that it did not teach
        logits[asked] = arcsinh_scale(values[asked]) @ weights.T + intercepts
    # the folds' logits are too sure or too timid by a common factor, which scales all weights
    power = _temperature(logits, which)
    probabilities = _softmax(power * logits)
    # the shipped weights are of all samples; limits and figures are those of the folds
    weights, intercepts = _regression(values, which, len(classes))
    good_from = _good_from(probabilities, labels, classes, good)
    stated_from = _stated_from(probabilities, labels, classes, good, good_from)
    distance, excess = _farthest(values, labels, folds)
    model = LearnedModel(
        features=names,
        fill=fill,
        classes=tuple(str(name) for name in classes),
        good=good,
        good_from=good_from,
        stated_from=stated_from,
        weights=power * weights,
        intercepts=power * intercepts,
        seen=seen_classes(values, labels),
        distance_max=distance,
        excess_max=max(excess, EXCESS_LEAST),
        smoothing_mm=smoothing_mm,
    )
    figures = _figures(probabilities, labels, classes, good, good_from)
    about = {"samples": dict(zip(classes.tolist(), counts.tolist(), strict=True)), **figures}
    words = [
        f"{len(labels)} products in {len(np.unique(groups))} groups, {len(classes)} classes; "
        f"judged on {FOLDS} folds that share no group"
    ]
    if good:
        kept, caught = (100 * figures[f"{name}_at_least"] for name in ("good_kept", "others_caught"))
        words.append(
            f"promised by counting, with 95 % confidence: at least {kept:.0f} % of good products are kept, "
            f"{caught:.0f} % of the others caught"
        )
    return Fitted(model.to_json(about), figures, tuple(words))


def _filled(values: Floats) -> tuple[Floats, Floats]:
    # a feature that no sample has is 0 for all, and so tells nothing
    with np.errstate(all="ignore"):
        fill = np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in values.T])
    return np.where(np.isfinite(values), values, fill), fill


def _regression(values: Floats, which: Integers, classes: int) -> tuple[Floats, Floats]:
    """(class, feature) weights and (class,) intercepts of the least penalised loss."""
    from scipy.optimize import minimize

    scaled = arcsinh_scale(values)
    # in standard deviations, so that the penalty weighs all features alike
    mean, std = scaled.mean(axis=0), np.maximum(scaled.std(axis=0), _STD_MIN)
    # the column of ones is the intercept
    x = np.column_stack([(scaled - mean) / std, np.ones(len(scaled))])
    true = np.eye(classes)[which]
    # the intercept is not drawn towards 0: it says how frequent a class is
    penalty = PENALTY * np.concatenate([np.ones(x.shape[1] - 1), [0.0]])

    def loss(flat: Floats) -> tuple[float, Floats]:
        """Give the penalised cross-entropy of weights and intercepts, and its gradient."""
        w = flat.reshape(classes, -1)
        p = _softmax(x @ w.T)
        # a probability that underflows has a loss of 690, not infinity
        value = -np.log(np.maximum((p * true).sum(axis=1), 1e-300)).sum() + 0.5 * (penalty * w**2).sum()
        return float(value), ((p - true).T @ x + penalty * w).ravel()

    w = minimize(loss, np.zeros(classes * x.shape[1]), jac=True, method="L-BFGS-B").x.reshape(classes, -1)
    # back from standard deviations to the features themselves
    weights = w[:, :-1] / std
    return weights, w[:, -1] - weights @ mean


_STD_MIN = 1e-6
"""Of a feature that never varied: nothing divides by less."""


def _folds(labels: np.ndarray, groups: Integers) -> Folds:
    """Known and asked samples, fold by fold; a group is never on both sides, classes are spread evenly."""
    count = int(groups.max()) + 1
    # classes of groups, by their first sample
    first = np.array([int(np.argmax(groups == k)) for k in range(count)])
    # sorted by class, at random within it; dealt out in turn, every fold gets its share of each class
    order = np.lexsort([np.random.default_rng(_SEED).random(count), labels[first]])
    # fewer groups than folds: each group is held out by itself
    fold = np.empty(count, np.int64)
    fold[order] = np.arange(count) % min(FOLDS, count)
    of_sample = fold[groups]
    return [(np.flatnonzero(of_sample != k), np.flatnonzero(of_sample == k)) for k in np.unique(of_sample)]


def _farthest(values: Floats, labels: np.ndarray, folds: Folds) -> tuple[float, float]:
    """Distance from the classes, and beyond all values, that the others taught; all but 0.5 % keep it."""
    far, outside = [], []
    for known, asked in folds:
        # what is seen must not hold those who are asked, or nothing would be novel
        seen = seen_classes(values[known], labels[known])
        far.append(seen.distances(values[asked]))
        outside.append(excess_norm(seen.excess(values[asked])))
    return float(np.quantile(np.concatenate(far), 0.995)), float(np.quantile(np.concatenate(outside), 0.995))


def _temperature(logits: Floats, which: Integers) -> float:
    """Factor with the least log loss on held-out samples: 1 leaves the logits as they are."""
    # from a fifth to six, 6 % apart: the least of a flat curve, which needs no finer step
    powers = np.geomspace(0.2, 6.0, 60)
    at = np.arange(len(which)), which
    losses = [-np.log(np.maximum(_softmax(power * logits)[at], 1e-300)).mean() for power in powers]
    return float(powers[int(np.argmin(losses))])


def _good_from(probabilities: Floats, labels: np.ndarray, classes: np.ndarray, good: str) -> float:
    """Least probability that is called good: where as few good ones are lost as bad ones kept.

    The best limit of one sample of products is itself a matter of chance. So it is the middle of those that
    are not told from it: within one standard error (Breiman et al. 1984, section 3.4.3).
    """
    if not good:
        # without a good class nothing is called good; the value is not used
        return 0.5
    of_good = probabilities[:, int(np.searchsorted(classes, good))]
    limits = np.linspace(0.02, 0.98, 97)
    # shares at each limit: of good ones kept, of the others caught
    kept = np.array([(of_good[labels == good] >= limit).mean() for limit in limits])
    caught = np.array([(of_good[labels != good] < limit).mean() for limit in limits])
    balanced = 0.5 * (kept + caught)
    best = int(balanced.argmax())
    n_good = int((labels == good).sum())
    # variance of the two shares; the mean of the two has half of their combined standard deviation
    scatter = kept * (1.0 - kept) / n_good + caught * (1.0 - caught) / (len(labels) - n_good)
    # the small number keeps the best itself in, whatever the rounding
    alike = np.flatnonzero(balanced >= balanced[best] - 0.5 * np.sqrt(scatter[best]) - 1e-12)
    return float(limits[alike[len(alike) // 2]])


def _stated_from(
    probabilities: Floats, labels: np.ndarray, classes: np.ndarray, good: str, good_from: float
) -> float:
    """Least probability of a stated class at which at most `WRONG_MAX` of all are given a wrong one."""
    # good is chosen by its own limit only, so it is left out of the likeliest
    of_others = np.where(classes == good, -1.0, probabilities)
    chosen = of_others.argmax(axis=1)
    if good:
        of_good = int(np.searchsorted(classes, good))
        chosen = np.where(probabilities[:, of_good] >= good_from, of_good, chosen)
    stated = probabilities[np.arange(len(labels)), chosen]
    # wrong answers, the surest first: those behind the allowed ones must fall below the limit
    doubtful = np.sort(stated[classes[chosen] != labels])[::-1]
    allowed = int(WRONG_MAX * len(labels))
    # just above the surest that is not allowed
    return float(doubtful[allowed] + 1e-6) if len(doubtful) > allowed else 0.0


def _figures(
    probabilities: Floats, labels: np.ndarray, classes: np.ndarray, good: str, good_from: float
) -> dict[str, float]:
    likeliest = classes[probabilities.argmax(axis=1)]
    right = likeliest == labels
    top = probabilities.max(axis=1)
    figures = {
        "right_share": float(right.mean()),
        "balanced_accuracy": float(np.mean([right[labels == name].mean() for name in classes])),
        "stated_probability_mean": float(top.mean()),
    }
    if good:
        of_good = probabilities[:, int(np.searchsorted(classes, good))]
        figures |= _kept_and_caught(of_good[labels == good] >= good_from, of_good[labels != good] < good_from)
    return figures


def learned_options() -> LearnedOptions:
    """Write a model that calls a product dented if a section is hollow by a millimetre; give its options."""
    model = LearnedModel(
        features=("hollow_depth_mm",),
        fill=np.zeros(1),
        classes=("dented", "good"),
        good="good",
        good_from=0.5,
        stated_from=0.0,
        weights=np.array([[4.0], [0.0]]),
        intercepts=np.array([-4.0 * np.arcsinh(1.0), 0.0]),
        seen=SeenClasses(np.zeros((2, 1)), np.ones(1), np.ones((2, 1, 1)), np.zeros(1), np.full(1, 6.0)),
        distance_max=20.0,
        excess_max=1.0,
        smoothing_mm=3.0,
    )
    path = Path(tempfile.mkdtemp()) / "one_decision.json"
    path.write_text(model.to_json({"samples": {}}), encoding="utf-8")
    return LearnedOptions(model=path)
