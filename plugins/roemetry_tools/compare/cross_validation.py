"""Choosing among variants: what the choice is worth on products that took no part in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from roemetry_tools.compare.agreement import Beside, Terms
from roemetry_tools.compare.grading import Graded


@dataclass(frozen=True, slots=True)
class Choice:
    """The best variant by one figure.

    Attributes
    ----------
    figure
        ``visible_mm3``, ``true_mm3``, ``mass_g``: least mean absolute error, %; ``label``: greatest balanced
        accuracy.
    best
        Number of the variant that is best on all products.
    seen
        Its figure on all products: flattered, since it was chosen on them.
    held_out
        The figure of the choice where each fold's variant was chosen on the other folds.
    chosen
        By fold, the number of the variant.
    n
        Products that all variants measured, and so took part.
    """

    figure: str
    best: int
    seen: float
    held_out: float
    chosen: tuple[int, ...]
    n: int


def choose_by_error(figure: str, values: Mapping[int, Mapping[str, Beside]], terms: Terms) -> Choice | None:
    """Choose by the least mean absolute error, on the products that every variant measured.

    Parameters
    ----------
    figure
        Its name.
    values
        By variant and product.
    terms
        Number of folds, and seed.

    Returns
    -------
    Choice or None
        None with fewer than two variants, or fewer products than two a fold.
    """
    if len(values) < 2:
        return None
    first = next(iter(values.values()))
    names = [n for n, one in first.items() if one.true > 0 and all(n in other for other in values.values())]
    fold = _folds([first[name].specimen for name in names], terms)
    if fold is None:
        return None
    errors = np.array(
        [[100.0 * abs(of[n].estimate / of[n].true - 1.0) for n in names] for of in values.values()]
    )
    numbers = list(values)
    chosen, held_out = [], np.empty(len(names))
    for k in range(terms.folds):
        winner = int(errors[:, fold != k].mean(axis=1).argmin())
        chosen.append(numbers[winner])
        held_out[fold == k] = errors[winner, fold == k]
    best = int(errors.mean(axis=1).argmin())
    return Choice(
        figure, numbers[best], float(errors[best].mean()), float(held_out.mean()), tuple(chosen), len(names)
    )


def choose_by_class(graded: Mapping[int, Sequence[Graded]], terms: Terms) -> Choice | None:
    """Choose by the greatest balanced accuracy; None as in `choose_by_error`, or with one class."""
    if len(graded) < 2:
        return None
    tables = {number: {one.product: one for one in of} for number, of in graded.items()}
    first = next(iter(tables.values()))
    names = [name for name in first if all(name in table for table in tables.values())]
    classes = np.array([first[name].true for name in names])
    fold = _folds([first[name].specimen for name in names], terms)
    if fold is None or len(np.unique(classes)) < 2:
        return None
    right = np.array([[table[name].right for name in names] for table in tables.values()])
    numbers = list(tables)
    chosen, held_out = [], np.empty(len(names), np.bool_)
    for k in range(terms.folds):
        other = fold != k
        winner = int(np.argmax([_balanced(row[other], classes[other]) for row in right]))
        chosen.append(numbers[winner])
        held_out[fold == k] = right[winner, fold == k]
    every = [_balanced(row, classes) for row in right]
    best = int(np.argmax(every))
    return Choice(
        "label", numbers[best], every[best], _balanced(held_out, classes), tuple(chosen), len(names)
    )


def _folds(specimens: Sequence[str], terms: Terms) -> np.ndarray | None:
    """(product,) fold, the same for all that is measured of one specimen; None with fewer than two a fold."""
    names, of = np.unique(np.array(specimens, dtype=str), return_inverse=True)
    if len(names) < 2 * terms.folds:
        return None
    order = np.random.default_rng([terms.seed, len(names)]).permutation(len(names))
    fold = np.empty(len(names), np.int64)
    fold[order] = np.arange(len(names)) % terms.folds
    return np.asarray(fold[of])


def _balanced(right: np.ndarray, classes: np.ndarray) -> float:
    shares = [right[classes == name].mean() for name in np.unique(classes)]
    return float(np.mean(shares)) if shares else math.nan
