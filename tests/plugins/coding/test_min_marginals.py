"""The exact costs of a line's labels, against all ways to label it."""

from itertools import pairwise, product

import numpy as np
import pytest

from roemetry_coding.planes.graph import WEIGHTS, Candidates, PairCosts
from roemetry_coding.planes.lines import Entries
from roemetry_coding.planes.solve import _EMPTY, min_marginals

LOOK_BACK = 4


def line(seed: int) -> tuple[Entries, Candidates, np.ndarray, PairCosts]:
    """Draw one line of six entries that no other line says anything of."""
    rng = np.random.default_rng(seed)
    entries = 6
    low, many = rng.integers(0, 4, entries), rng.integers(1, 5, entries)
    offset = np.append(0, np.cumsum(many + 1))
    pair, surface, unseen = [], [], []
    for p in range(entries):
        for q in range(max(0, p - LOOK_BACK), p):
            pair.append((q, p, len(surface)))
            for s in low[p] + np.arange(many[p]):
                for t in low[q] + np.arange(many[q]):
                    surface.append(rng.uniform(0, 1) if t < s else np.inf)
                    unseen.append(rng.uniform(0, 1) if t < s else np.inf)
    costs = PairCosts(
        np.array(pair), np.array([0, len(pair)]), np.float32(surface), np.float32(unseen),
        rng.uniform(0, 3, offset[-1]), rng.uniform(0, 3, offset[-1]),
    )  # fmt: skip
    alone = np.full(entries, -1)
    at = Entries(np.array([0, entries]), np.arange(entries), np.arange(6.0), alone, alone, np.zeros(entries))
    nothing = np.zeros(offset[-1])
    return at, Candidates(low, many, offset, nothing, nothing + 1.0), rng.uniform(-4, 6, offset[-1]), costs


def tried(candidates: Candidates, own: np.ndarray, costs: PairCosts) -> np.ndarray:
    """Give (node,) the least cost over all labellings of the line, less the least of the entry."""
    many, offset = candidates.many, candidates.offset
    first = {(q, p): c for q, p, c in costs.pair.tolist()}
    cost = np.full(own.size, np.inf)
    for labels in product(*[range(count + 1) for count in many]):
        nodes = [offset[i] + k for i, k in enumerate(labels)]
        lit = [i for i, k in enumerate(labels) if k < many[i]]
        total = own[nodes].sum()
        if lit:
            total += WEIGHTS.unseen * (costs.before[nodes[lit[0]]] + costs.after[nodes[lit[-1]]])
        else:
            total += WEIGHTS.unseen * _EMPTY
        for q, p in pairwise(lit):
            if (q, p) not in first:
                total = np.inf
                break
            c = first[q, p] + labels[p] * many[q] + labels[q]
            total += np.float32(WEIGHTS.surface * costs.surface[c] + WEIGHTS.unseen * costs.unseen[c])
        cost[nodes] = np.minimum(cost[nodes], total)
    for begin, end in pairwise(offset):
        cost[begin:end] -= cost[begin:end].min()
    return cost


@pytest.mark.parametrize("seed", range(6))
def test_they_are_those_of_all_labellings(seed) -> None:
    entries, candidates, own, costs = line(seed)
    found = min_marginals(entries, candidates, own, costs, WEIGHTS)
    np.testing.assert_allclose(found, tried(candidates, own, costs), atol=1e-5)
