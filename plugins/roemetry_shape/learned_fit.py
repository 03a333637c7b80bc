"""Fit the learned classifier: from a few good products, a handful of named ones, or hundreds.

With at least `PER_CLASS_MIN` products of each of two classes or more, and `FOREST_MIN` in all, a forest is
fitted (`roemetry_shape.learned`), judged on folds that share no group: its temperature, the least
probability of good, that of a stated class, and the limits of novelty are all chosen on held-out products.
With fewer, a reference of the good ones (`roemetry_shape.good_reference`), judged by leaving each out.

What is promised is counted, not modelled: the lower end of the exact 95 % interval (Clopper and Pearson
1934) of the good ones kept, and of the others caught.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from roemetry.errors import DataError
from roemetry.records import Fitted, Samples
from roemetry.records.arrays import Floats, Integers
from roemetry_shape.good_reference import GOOD_MIN, fit_reference, lower_bound
from roemetry_shape.learned import LEFT_OUT, VERSION, Forest, LearnedModel, temperature_scale
from roemetry_shape.novelty import excess_norm, seen_classes

Folds = Sequence[tuple[Integers, Integers]]

TREES = 60
"""120 change no share of the test by more than a half per cent, and double the file."""

FOLDS = 5
PER_CLASS_MIN = 5
"""Of a class for a forest: one in each fold."""

FOREST_MIN = 60
"""Products for a forest: below, a fold's forest has fewer samples than features, and novelty's limits (a
quantile of 99.5 %) are the largest of a handful."""

NOVEL_DISTANCE = 1.2
"""A product this many times farther from all classes than 99.5 % of the held-out samples is novel."""

NOVEL_EXCESS = 1.35
"""The same for features beyond all that was seen; more, since extremes are a matter of few samples."""

EXCESS_LEAST = 0.1
"""Features may lie by a tenth of their range beyond it, however many samples there were."""

WRONG_MAX = 0.025
"""Share of held-out products given a wrong class: half of what is allowed on other rigs."""

_SEED = 1


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
    classes, counts = np.unique(labels, return_counts=True)
    if not len(classes):
        raise DataError("there are no samples", hint="a classifier needs at least five good products")
    if good and good not in classes:
        raise DataError(
            f"no product is labelled `{good}`", hint=f"--good is one of {', '.join(map(str, classes))}"
        )
    if not (np.nanstd(values, axis=0) > 0).any():
        raise DataError("no feature varies: the samples are all alike", hint="are the features in the table?")
    if len(classes) == 1:
        good = str(classes[0])
    if len(classes) == 1 or (len(labels) < FOREST_MIN and good):
        return _reference(names, values, labels, good, smoothing_mm)
    few = [f"`{name}` ({n})" for name, n in zip(classes, counts, strict=True) if n < PER_CLASS_MIN]
    if few:
        raise DataError(
            f"too few products of {', '.join(few)}; at least {PER_CLASS_MIN} of each class are needed",
            hint="is a label misspelt? otherwise collect more, or leave the class out",
        )
    groups = np.unique(np.array(samples.groups), return_inverse=True)[1]
    return _forest_fit(names, values, labels, groups, good, smoothing_mm)


def _reference(
    names: tuple[str, ...], values: Floats, labels: np.ndarray, good: str, smoothing_mm: float
) -> Fitted:
    count = int((labels == good).sum())
    if count < GOOD_MIN:
        raise DataError(
            f"too few products of `{good}` ({count}); at least {GOOD_MIN} are needed",
            hint="measure more good products; eight make a beginning",
        )
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


def _forest_fit(
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
    held_out = _held_out(values, labels, folds, classes)
    power = _temperature(held_out, labels, classes)
    probabilities = temperature_scale(held_out, power)
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
        temperature=power,
        forest=_nodes(_trees().fit(values, labels)),
        seen=seen_classes(values, labels),
        distance_max=NOVEL_DISTANCE * distance,
        excess_max=max(NOVEL_EXCESS * excess, EXCESS_LEAST),
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
    with np.errstate(all="ignore"):
        fill = np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in values.T])
    return np.where(np.isfinite(values), values, fill), fill


_LEAF_SAMPLES = 2
"""Products in a leaf at least: 16 make the file a quarter as large, and good skeins of rigs never seen are
kept at 85 instead of 92 % (of our own), 14 instead of 61 % (of the rendered set)."""


def _trees() -> Any:
    from sklearn.ensemble import ExtraTreesClassifier

    return ExtraTreesClassifier(
        TREES, min_samples_leaf=_LEAF_SAMPLES, max_features=0.4, class_weight="balanced", random_state=_SEED
    )


def _folds(labels: np.ndarray, groups: Integers) -> Folds:
    """Known and asked samples, fold by fold; a group is never on both sides."""
    from sklearn.model_selection import StratifiedGroupKFold

    folds = StratifiedGroupKFold(min(FOLDS, len(np.unique(groups))), shuffle=True, random_state=_SEED)
    return list(folds.split(np.zeros(len(labels)), labels, groups))


def _farthest(values: Floats, labels: np.ndarray, folds: Folds) -> tuple[float, float]:
    """Distance from the classes, and beyond all values, that the others taught; all but 0.5 % keep it."""
    far, outside = [], []
    for known, asked in folds:
        seen = seen_classes(values[known], labels[known])
        far.append(seen.distances(values[asked]))
        outside.append(excess_norm(seen.excess(values[asked])))
    return float(np.quantile(np.concatenate(far), 0.995)), float(np.quantile(np.concatenate(outside), 0.995))


def _held_out(values: Floats, labels: np.ndarray, folds: Folds, classes: np.ndarray) -> Floats:
    """(sample, class) shares by forests that did not know the sample's group."""
    shares = np.zeros((len(labels), len(classes)))
    for known, asked in folds:
        forest = _trees().fit(values[known], labels[known])
        shares[np.ix_(asked, np.searchsorted(classes, forest.classes_))] = forest.predict_proba(values[asked])
    return shares


def _temperature(shares: Floats, labels: np.ndarray, classes: np.ndarray) -> float:
    """Power with the least log loss on held-out samples: 1 leaves the forest's shares as they are."""
    true = np.searchsorted(classes, labels)
    powers = np.geomspace(0.5, 6.0, 60)
    losses = [-np.log(temperature_scale(shares, p)[np.arange(len(true)), true]).mean() for p in powers]
    return float(powers[int(np.argmin(losses))])


def _good_from(probabilities: Floats, labels: np.ndarray, classes: np.ndarray, good: str) -> float:
    """Least probability that is called good: where as few good ones are lost as bad ones kept.

    The best limit of one sample of products is itself a matter of chance. So it is the middle of those that
    are not told from it: within one standard error (Breiman et al. 1984, section 3.4.3).
    """
    if not good:
        return 0.5
    of_good = probabilities[:, int(np.searchsorted(classes, good))]
    limits = np.linspace(0.02, 0.98, 97)
    kept = np.array([(of_good[labels == good] >= limit).mean() for limit in limits])
    caught = np.array([(of_good[labels != good] < limit).mean() for limit in limits])
    balanced = 0.5 * (kept + caught)
    best = int(balanced.argmax())
    n_good = int((labels == good).sum())
    scatter = kept * (1.0 - kept) / n_good + caught * (1.0 - caught) / (len(labels) - n_good)
    alike = np.flatnonzero(balanced >= balanced[best] - 0.5 * np.sqrt(scatter[best]) - 1e-12)
    return float(limits[alike[len(alike) // 2]])


def _stated_from(
    probabilities: Floats, labels: np.ndarray, classes: np.ndarray, good: str, good_from: float
) -> float:
    """Least probability of a stated class at which at most `WRONG_MAX` of all are given a wrong one."""
    of_others = np.where(classes == good, -1.0, probabilities)
    chosen = of_others.argmax(axis=1)
    if good:
        of_good = int(np.searchsorted(classes, good))
        chosen = np.where(probabilities[:, of_good] >= good_from, of_good, chosen)
    stated = probabilities[np.arange(len(labels)), chosen]
    doubtful = np.sort(stated[classes[chosen] != labels])[::-1]
    allowed = int(WRONG_MAX * len(labels))
    return float(doubtful[allowed] + 1e-6) if len(doubtful) > allowed else 0.0


def _nodes(forest: Any) -> Forest:
    feature, threshold, left, right, shares, roots = [], [], [], [], [], []
    first = 0
    for tree in (estimator.tree_ for estimator in forest.estimators_):
        leaf = tree.children_left < 0
        roots.append(first)
        feature.append(np.where(leaf, -1, tree.feature))
        threshold.append(np.where(leaf, 0.0, tree.threshold))
        left.append(np.where(leaf, -1, tree.children_left + first))
        right.append(np.where(leaf, -1, tree.children_right + first))
        value = tree.value[:, 0, :] / tree.value[:, 0, :].sum(axis=1, keepdims=True)
        shares.append(np.where(leaf[:, None], value, 0.0))
        first += tree.node_count
    return Forest(
        feature=np.concatenate(feature).astype(np.int64),
        threshold=np.concatenate(threshold),
        left=np.concatenate(left).astype(np.int64),
        right=np.concatenate(right).astype(np.int64),
        shares=np.concatenate(shares),
        roots=np.array(roots, np.int64),
    )


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
        kept, caught = of_good[labels == good] >= good_from, of_good[labels != good] < good_from
        figures["good_kept_share"] = float(kept.mean())
        figures["good_kept_at_least"] = lower_bound(int(kept.sum()), len(kept))
        figures["others_caught_share"] = float(caught.mean())
        figures["others_caught_at_least"] = lower_bound(int(caught.sum()), len(caught))
    return figures
