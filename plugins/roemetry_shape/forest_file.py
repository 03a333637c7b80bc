"""A forest as short lists for a file: a leaf needs no threshold, and a split no shares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from roemetry.arrays import Floats, Integers

_PARTS = 1000


def packed(forest: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Write a forest's arrays (see `roemetry_kernels.shape.forest`) as short lists.

    Returns
    -------
    dict
        ``roots``: first node of each tree; ``feature``: of every node, −1 for a leaf; ``threshold``: of the
        splits, seven digits; ``left``, ``right``: of the splits, as steps from their node; ``shares``: of the
        leaves, in thousandths.
    """
    feature: Integers = forest["feature"]
    split = np.flatnonzero(feature >= 0)
    thousandths = np.round(forest["shares"][feature < 0] * _PARTS).astype(np.int64)
    return {
        "roots": forest["roots"].tolist(),
        "feature": feature.tolist(),
        "threshold": [float(f"{value:.7g}") for value in forest["threshold"][split]],
        "left": (forest["left"][split] - split).tolist(),
        "right": (forest["right"][split] - split).tolist(),
        "shares": thousandths.tolist(),
    }


def unpacked(lists: Mapping[str, Any]) -> dict[str, Any]:
    """Make the arrays again; raise KeyError, TypeError or ValueError for lists that are none."""
    feature = np.array(lists["feature"], np.int64)
    split, leaf = np.flatnonzero(feature >= 0), np.flatnonzero(feature < 0)
    leaves: Floats = np.array(lists["shares"], np.float64)
    if leaves.ndim != 2 or len(leaves) != leaf.size:
        raise ValueError(f"{leaf.size} leaves, and shares of shape {leaves.shape}")
    shares = np.zeros((feature.size, leaves.shape[1]))
    shares[leaf] = leaves / np.maximum(leaves.sum(axis=1, keepdims=True), 1e-9)
    found: dict[str, Any] = {"feature": feature, "shares": shares, "threshold": np.zeros(feature.size)}
    found["threshold"][split] = np.array(lists["threshold"], np.float64)
    for name in ("left", "right"):
        found[name] = np.full(feature.size, -1, np.int64)
        found[name][split] = split + np.array(lists[name], np.int64)
        if ((found[name][split] <= split) | (found[name][split] >= feature.size)).any():
            raise ValueError(f"{name}: a way leads out of the forest, or back")
    found["roots"] = np.array(lists["roots"], np.int64)
    if not ((found["roots"] >= 0) & (found["roots"] < feature.size)).all():
        raise ValueError("roots: not within the forest")
    return found
