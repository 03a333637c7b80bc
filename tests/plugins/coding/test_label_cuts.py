"""The best set of runs to shift, against all sets; pieces that agree on one stripe, in order."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from roemetry_coding.planes.graph import Candidates
from roemetry_coding.planes.lines import Entries
from roemetry_coding.planes.pieces import ENDS, Pieces
from roemetry_coding.planes.shifts import Runs, best_shift
from roemetry_coding.planes.solve import agreed

STAYS = 1
NONE = np.zeros(0, np.int64)


def runs_of(own: np.ndarray, one: np.ndarray, other: np.ndarray, both: np.ndarray) -> Runs:
    """Give runs of which the cut needs to know no more."""
    order = np.zeros(both.shape, np.int64)
    return Runs(NONE, NONE, own, one, other, both, order, NONE, NONE, NONE, NONE, NONE)


def agree(
    start: np.ndarray, piece: np.ndarray, rest: np.ndarray, stripes: int, cost: np.ndarray
) -> np.ndarray:
    """Let (entry,) pieces agree, of entries that may be the first stripes each; give (entry,) stripes."""
    size, none = piece.size, np.full(piece.size, -1)
    entries = Entries(start, np.arange(size), np.arange(float(size)), none, none, np.zeros(size))
    offset = np.arange(0, (stripes + 1) * size + 1, stripes + 1)
    nodes = Candidates(
        np.zeros(size, np.int64), np.full(size, stripes), offset, np.zeros(cost.size), np.ones(cost.size)
    )
    pieces = Pieces(none, piece, none, rest, rest, np.zeros(rest.size, np.bool_))
    return agreed(entries, nodes, pieces, cost.ravel()) - offset[:-1]


def graph(rng: np.random.Generator, goes: int) -> tuple[np.ndarray, ...]:
    """Give a graph of up to eight runs; pairs would rather go together than one alone."""
    runs = int(rng.integers(2, 9))
    own = rng.uniform(-3.0, 3.0, (runs, 4))
    pairs = np.array([(f, g) for f in range(runs) for g in range(f + 1, runs) if rng.random() < 0.5])
    pairs = pairs.reshape(-1, 2).astype(np.int64)
    both = rng.uniform(0.0, 4.0, (len(pairs), 4, 4))
    both[:, STAYS, goes] += np.where(rng.random(len(pairs)) < 0.3, 40.0, 0.0)  # out of order
    alone = both[:, STAYS, goes] + both[:, goes, STAYS] - both[:, STAYS, STAYS]
    both[:, goes, goes] = np.minimum(both[:, goes, goes], alone)
    return own, np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1]), both


def change_of(
    own: np.ndarray, one: np.ndarray, other: np.ndarray, both: np.ndarray, way: np.ndarray
) -> float:
    runs, pairs = np.arange(own.shape[0]), np.arange(one.size)
    now = own[runs, way].sum() + both[pairs, way[one], way[other]].sum()
    return float(now - own[:, STAYS].sum() - both[:, STAYS, STAYS].sum())


@pytest.mark.parametrize("by", [1, -1])
def test_no_set_of_runs_is_better_to_shift(rng: np.random.Generator, by: int) -> None:
    for _ in range(40):
        own, one, other, both = graph(rng, STAYS + by)
        moved, change = best_shift(runs_of(own, one, other, both), by)
        runs = own.shape[0]
        least = min(
            change_of(own, one, other, both, STAYS + by * np.array(some))
            for some in product((0, 1), repeat=runs)
        )
        assert change == pytest.approx(least, abs=1e-4)
        way = np.where(moved, STAYS + by, STAYS)
        assert change == pytest.approx(change_of(own, one, other, both, way), abs=1e-9)


def test_the_change_is_true_for_pairs_that_would_rather_part(rng: np.random.Generator) -> None:
    own, one, other, both = graph(rng, STAYS + 1)
    both[:] = rng.uniform(0.0, 4.0, both.shape)
    moved, change = best_shift(runs_of(own, one, other, both), 1)
    way = np.where(moved, STAYS + 1, STAYS)
    assert change == pytest.approx(change_of(own, one, other, both, way), abs=1e-9)


def test_a_piece_agrees_on_the_stripe_that_is_cheapest_for_all_of_it() -> None:
    """Three lines, two pieces; on the second line the first piece would rather be stripe 1."""
    cost = np.full((6, 4), 9.0)
    cost[0::2, 0] = cost[1::2, 1] = 0.0
    cost[2, :2] = 2.0, 0.0
    way = agree(np.array([0, 2, 4, 6]), np.array([0, 1] * 3), np.array([-1, -1]), 3, cost)
    np.testing.assert_array_equal(way, [0, 1] * 3)


@pytest.mark.parametrize("small", ["end", "few", "many"])
def test_of_two_out_of_order_the_small_one_gives_way(small: str) -> None:
    """A piece of stripe 1 to the left of one of stripe 0; neither gives way where both are large."""
    lines = 15
    piece = np.array([0, 1] * lines)
    if small == "few":  # the left piece is cut up into many
        piece = np.array([[n + 1, 0] for n in range(lines)]).ravel()
    piece_line = np.full(piece.max() + 1, -1)
    if small == "end":
        piece_line[0] = ENDS
    cost = np.full((piece.size, 3), 9.0)
    cost[0::2, 1] = cost[1::2, 0] = 0.0
    way = agree(np.arange(0, 2 * lines + 1, 2), piece, piece_line, 2, cost)
    np.testing.assert_array_equal(way[0::2], 1 if small == "many" else 2)
    np.testing.assert_array_equal(way[1::2], 0)
