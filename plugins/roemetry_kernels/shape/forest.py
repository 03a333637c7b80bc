"""Class shares of a forest of decision trees."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel


@kernel
def forest_shares(
    values: Floats, feature: Integers, threshold: Floats, left: Integers, right: Integers, shares: Floats,
    roots: Integers,
) -> Floats:  # fmt: skip
    """Average the leaves that one sample falls into.

    Parameters
    ----------
    values
        (feature,) of one sample, without NaN.
    feature, threshold, left, right
        (node,) of all trees in one row: where ``values[feature] <= threshold`` the way goes left; a leaf has
        the feature −1.
    shares
        (node, class) class shares of the leaves.
    roots
        (tree,) first node of each tree.
    """
    total = np.zeros(shares.shape[1])
    for root in roots:
        node = root
        while feature[node] >= 0:
            node = left[node] if values[feature[node]] <= threshold[node] else right[node]
        for c in range(total.size):
            total[c] += shares[node, c]
    return total / roots.size
