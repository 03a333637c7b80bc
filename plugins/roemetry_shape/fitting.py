"""Fit the learned classifier: folds by product, calibrated probabilities, and a sense for what is strange."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry.errors import DataError
from roemetry.records import Fitted, Samples
from roemetry_shape.learned_model import LearnedModel, sharpened
from roemetry_shape.strangeness import beyond, seen_in

Folds = Sequence[tuple[Integers, Integers]]

TREES = 60
FOLDS = 5
_PER_CLASS_MIN = 5
_STRANGE = 1.2
"""A product this many times farther from all classes than 99.5 % of the held-out samples is strange."""
_BEYOND = 1.35
"""The same for features beyond all that was seen; more, since extremes are a matter of few samples."""
_BEYOND_LEAST = 0.1
"""Features may lie by a tenth of their range beyond it, however many samples there were."""
_SEED = 1


def fit_forest(samples: Samples, *, good: str, smoothing_rows: int) -> Fitted:
    """Fit on all samples; judge on folds.

    Parameters
    ----------
    samples
        With labels.
    good
        The class of good products; "" where there is none.
    smoothing_rows
        How the features were measured; stored with the model.

    Raises
    ------
    DataError
        One class only, a class with fewer than five products, a good class that nobody has, or no feature
        that varies.
    """
    labels = np.array(samples.labels)
    classes, counts = np.unique(labels, return_counts=True)
    _check(classes, counts, good)
    values, fill = _filled(samples.values)
    groups = np.unique(np.array(samples.groups), return_inverse=True)[1]
    folds = _folds(labels, groups)
    held_out = _held_out(values, labels, folds, classes)
    power = _sharpness(held_out, labels, classes)
    probabilities = sharpened(held_out, power)
    good_from = _good_from(probabilities, labels, classes, good)
    distance, outside = _farthest(values, labels, folds)
    forest = _forest().fit(values, labels)
    arrays = _nodes(forest)
    model = LearnedModel(
        features=samples.features,
        fill=fill,
        classes=tuple(str(name) for name in classes),
        good=good,
        good_from=good_from,
        sharpness=power,
        **arrays,
        seen=seen_in(values, labels),
        distance_max=_STRANGE * distance,
        beyond_max=max(_BEYOND * outside, _BEYOND_LEAST),
        smoothing_rows=smoothing_rows,
    )
    figures = _figures(probabilities, labels, classes, good, good_from)
    about = {"samples": dict(zip(classes.tolist(), counts.tolist(), strict=True)), **figures}
    words = (
        f"{len(labels)} products in {len(np.unique(groups))} groups, {len(classes)} classes; "
        f"judged on {FOLDS} folds that share no group",
    )
    return Fitted(model.to_json(about), figures, words)


def _check(classes: np.ndarray, counts: Integers, good: str) -> None:
    if len(classes) < 2:
        raise DataError(
            f"there is one class only (`{classes[0]}`)" if len(classes) else "there are no samples",
            hint="a classifier needs products of at least two classes",
        )
    few = [f"`{name}` ({n})" for name, n in zip(classes, counts, strict=True) if n < _PER_CLASS_MIN]
    if few:
        raise DataError(
            f"too few products of {', '.join(few)}; at least {_PER_CLASS_MIN} of each class are needed",
            hint="is a label misspelt? otherwise collect more, or leave the class out",
        )
    if good and good not in classes:
        raise DataError(
            f"no product is labelled `{good}`", hint=f"--good is one of {', '.join(map(str, classes))}"
        )


def _filled(values: Floats) -> tuple[Floats, Floats]:
    with np.errstate(all="ignore"):
        fill = np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in values.T])
    if not (np.nanstd(values, axis=0) > 0).any():
        raise DataError("no feature varies: the samples are all alike", hint="are the features in the table?")
    return np.where(np.isfinite(values), values, fill), fill


def _forest() -> Any:
    from sklearn.ensemble import ExtraTreesClassifier

    return ExtraTreesClassifier(
        TREES, min_samples_leaf=2, max_features=0.4, class_weight="balanced", random_state=_SEED
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
        seen = seen_in(values[known], labels[known])
        far.append(seen.distances(values[asked]))
        outside.append(beyond(seen.excess(values[asked])))
    return float(np.quantile(np.concatenate(far), 0.995)), float(np.quantile(np.concatenate(outside), 0.995))


def _held_out(values: Floats, labels: np.ndarray, folds: Folds, classes: np.ndarray) -> Floats:
    """(sample, class) shares by forests that did not know the sample's group."""
    shares = np.zeros((len(labels), len(classes)))
    for known, asked in folds:
        forest = _forest().fit(values[known], labels[known])
        shares[np.ix_(asked, np.searchsorted(classes, forest.classes_))] = forest.predict_proba(values[asked])
    return shares


def _sharpness(shares: Floats, labels: np.ndarray, classes: np.ndarray) -> float:
    """Power with the least log loss on held-out samples: 1 leaves the forest's shares as they are."""
    true = np.searchsorted(classes, labels)
    powers = np.geomspace(0.5, 6.0, 60)
    losses = [-np.log(sharpened(shares, p)[np.arange(len(true)), true]).mean() for p in powers]
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


def _nodes(forest: Any) -> dict[str, Any]:
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
    return {
        "feature": np.concatenate(feature).astype(np.int64),
        "threshold": np.concatenate(threshold),
        "left": np.concatenate(left).astype(np.int64),
        "right": np.concatenate(right).astype(np.int64),
        "shares": np.concatenate(shares),
        "roots": np.array(roots, np.int64),
    }


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
        figures["good_kept_share"] = float((of_good[labels == good] >= good_from).mean())
        figures["others_caught_share"] = float((of_good[labels != good] < good_from).mean())
    return figures
