"""Runs that are shifted one by one or with others; pieces that agree on one stripe, in order."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_coding.planes.graph import Candidates
from roemetry_coding.planes.lines import Entries
from roemetry_coding.planes.pieces import ENDS, Pieces
from roemetry_coding.planes.shifts import Runs, shifts_of, single_shifts
from roemetry_coding.planes.solve import agreed

STAYS = 1
NONE = np.zeros(0, np.int64)


def runs_of(
    own: np.ndarray, one: np.ndarray, other: np.ndarray, both: np.ndarray, disorder: np.ndarray | None = None
) -> Runs:
    """Give runs on ten lines."""
    runs = own.shape[0]
    edges = [np.flatnonzero((one == f) | (other == f)) for f in range(runs)]
    start = np.concatenate([[0], np.cumsum([len(edge) for edge in edges])]).astype(np.int64)
    order = np.zeros(both.shape, np.int64) if disorder is None else disorder
    first, last = np.zeros(runs, np.int64), np.full(runs, 9)
    edge = np.concatenate(edges).astype(np.int64)
    return Runs(NONE, NONE, own, one, other, both, order, start, edge, first, last)


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
    pieces = Pieces(none, piece, none, rest, rest, np.zeros(rest.size, np.bool_), np.ones(rest.size))
    return agreed(entries, nodes, pieces, cost.ravel()) - offset[:-1]


def graph(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Give a graph of up to eight runs."""
    runs = int(rng.integers(2, 9))
    pairs = np.array([(f, g) for f in range(runs) for g in range(f + 1, runs) if rng.random() < 0.5])
    one, other = np.ascontiguousarray(pairs.reshape(-1, 2).T.astype(np.int64))
    return rng.uniform(-3.0, 3.0, (runs, 4)), one, other, rng.uniform(0.0, 4.0, (one.size, 4, 4))


def energy(own: np.ndarray, one: np.ndarray, other: np.ndarray, both: np.ndarray, way: np.ndarray) -> float:
    pairs = np.arange(one.size)
    return float(own[np.arange(way.size), way].sum() + both[pairs, way[one], way[other]].sum())


def test_single_shifts_end_where_none_gains(rng: np.random.Generator) -> None:
    for _ in range(40):
        given = graph(rng)
        way = STAYS + single_shifts(runs_of(*given), 0.5)
        least = energy(*given, way)
        assert least <= energy(*given, np.full(way.size, STAYS))
        for f in range(way.size):
            for to in range(3):
                other_way = way.copy()
                other_way[f] = to
                assert energy(*given, other_way) > least - 0.5 - 1e-9


def test_one_wrong_run_is_put_right_and_the_others_stand() -> None:
    """Five runs in a row; the last has its neighbour's stripe. All others could make way for it."""
    one, other = np.arange(4), np.arange(1, 5)
    own, both = np.zeros((5, 4)), np.zeros((4, 4, 4))
    for a in range(3):
        for b in range(3):
            both[:3, a, b] = 100.0 * max(a - b, 0)  # out of order
            both[3, a, b] = 100.0 * max(a - b + 1, 0)  # as they are, too
    own[:4, 0] = 5.0  # nothing speaks for the shift of the others
    own[4, 2] = 10.0
    np.testing.assert_array_equal(single_shifts(runs_of(own, one, other, both), 0.5), [0, 0, 0, 0, 1])


@pytest.mark.parametrize("lines, forced", [(4, False), (5, True)])
def test_runs_that_hardly_touch_need_not_give_way(lines: int, forced: bool) -> None:
    """The left run is moved onto the right one's stripe; that one's own shift is dear."""
    own = np.array([[0.0, 0.0, 0.0, 50.0], [100.0, 0.0, 100.0, 500.0]])
    disorder = np.zeros((1, 4, 4), np.int64)
    disorder[0, 2, :2] = lines
    both = 8.0 * disorder
    one, other = np.zeros(1, np.int64), np.ones(1, np.int64)
    dearer, way = shifts_of(runs_of(own, one, other, both, disorder), 10, 0.5)
    assert not way.any()
    assert dearer[0] == pytest.approx(0.0)  # moved to the other side
    assert dearer[1] == pytest.approx(10.0)
    own[0, 0] = 1000.0
    dearer, _ = shifts_of(runs_of(own, one, other, both, disorder), 10, 0.5)
    assert dearer[0] == pytest.approx((100.0 if forced else 8.0 * lines) / 10.0)


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
