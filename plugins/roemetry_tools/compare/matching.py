"""Which measured product is which true one: by the points of stripes they share."""

from __future__ import annotations

import numpy as np

from roemetry.records import StripeMap, StripeTruth
from roemetry_tools.compare.points import nearest


def by_place(stripes: StripeMap, truth: StripeTruth) -> dict[int, int]:
    """Match products by place.

    Parameters
    ----------
    stripes
        As coded; their labels of stripes do not count, only those of products.
    truth
        Of the same, turned, image.

    Returns
    -------
    dict
        Number of a measured product to the number of the true one on which most of its points lie, each of
        both at most once; more common points come first. Products without common points are missing.
    """
    row, true_row = _rows(stripes.x_px), _rows(truth.x_px)
    mine, theirs = (stripes.product > 0) & stripes.seen, truth.product > 0
    found = nearest(row[mine], stripes.x_px[mine], true_row[theirs], truth.x_px[theirs])
    near = found >= 0
    pairs = np.column_stack([stripes.product[mine][near], truth.product[theirs][found[near]]])
    if not pairs.size:
        return {}
    which, shared = np.unique(pairs, axis=0, return_counts=True)
    matched: dict[int, int] = {}
    for index in np.argsort(-shared, kind="stable"):
        measured, true = (int(number) for number in which[index])
        if measured not in matched and true not in matched.values():
            matched[measured] = true
    return matched


def _rows(x_px: np.ndarray) -> np.ndarray:
    return np.broadcast_to(np.arange(x_px.shape[1], dtype=np.int64), x_px.shape)
