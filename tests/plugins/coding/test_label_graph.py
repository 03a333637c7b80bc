"""Runs that are shifted together: costs are exact, order is kept, a dear body stays where it is."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from roemetry_coding.planes.graph import Candidates
from roemetry_coding.planes.pieces import ENDS, Pieces
from roemetry_coding.planes.shifts import OUT, Runs, _edges, shift_labels, shifts_of
from roemetry_coding.planes.solve import favour_labels
from roemetry_coding.planes.vetoes import ends_settled

RUNS, LINES = 6, 20
DISORDER = 1e5
NONE = np.zeros(0, np.int64)


def pieces_of(
    piece: np.ndarray, rest: np.ndarray, home: np.ndarray | None = None, line: np.ndarray | None = None
) -> Pieces:
    """Give pieces of one trace."""
    none = np.full(piece.size, -1)
    return Pieces(
        np.zeros(piece.size, np.int64), piece, none if line is None else line, rest,
        rest if home is None else home, np.zeros(rest.size, np.bool_), np.ones(rest.size),
    )  # fmt: skip


def runs_of(own: np.ndarray, one: np.ndarray, other: np.ndarray, both: np.ndarray) -> Runs:
    """Give runs that all lie on all lines."""
    first, last = np.zeros(RUNS, np.int64), np.full(RUNS, LINES - 1)
    return Runs(NONE, NONE, own, one, other, both, disordered(both), *_edges(RUNS, one, other), first, last)


def disordered(both: np.ndarray) -> np.ndarray:
    """Give (edge, way, way) sight lines that are out of order: all on which the two meet, or none."""
    return np.where(both == DISORDER, LINES, 0)


def chain(rng: np.random.Generator, gaps: list[int]) -> Runs:
    """Give the graph of runs side by side, each with random costs, that must stay in order.

    `gaps` are the stripes left out between neighbours.
    """
    own = np.hstack([rng.uniform(-3.0, 3.0, (RUNS, 3)), np.full((RUNS, 1), 1e3)])
    one, other = np.arange(RUNS - 1), np.arange(1, RUNS)
    both = np.zeros((RUNS - 1, 4, 4))
    both[:, :3, :3] = rng.uniform(0.0, 4.0, (RUNS - 1, 3, 3))
    for t, a, b in product(range(RUNS - 1), range(3), range(3)):
        if a >= b + 1 + gaps[t]:
            both[t, a, b] = DISORDER
    return runs_of(own, one, other, both)


def energy(graph: Runs, by: np.ndarray) -> float:
    own, one, other, both = graph.own, graph.one, graph.other, graph.both
    return float(
        own[np.arange(RUNS), by + 1].sum() + both[np.arange(RUNS - 1), by[one] + 1, by[other] + 1].sum()
    )


@pytest.mark.parametrize("trial", range(20))
def test_what_is_shifted_is_cheaper_and_no_shift_is_cheaper_than_the_cheapest(
    rng: np.random.Generator, trial: int
) -> None:
    """Against all changes of a small graph: never dearer than before, never below the least of all."""
    graph = chain(rng, list(rng.integers(0, 2, RUNS - 1)))
    dearer, by = shifts_of(graph, LINES, 0.5)
    before, after = energy(graph, np.zeros(RUNS, np.int64)), energy(graph, by)
    assert after <= before - 0.5 or not by.any()
    least = min(energy(graph, np.array(way)) for way in product((-1, 0, 1), repeat=RUNS))
    assert after >= least - 1e-9
    assert (dearer * LINES >= least - before - 1e-9).all()


def test_a_run_without_room_takes_its_neighbours_along() -> None:
    """Six stripes without gaps: shifting one to the right costs what it costs to shift all beyond."""
    own = np.tile([2.0, 0.0, 3.0, 100.0], (RUNS, 1))
    one, other = np.arange(RUNS - 1), np.arange(1, RUNS)
    both = np.zeros((RUNS - 1, 4, 4))
    for a, b in product(range(3), range(3)):
        both[:, a, b] = DISORDER if a > b else 0.0
    dearer, by = shifts_of(runs_of(own, one, other, both), LINES, 0.5)
    assert not by.any()
    # one to the left takes all before it along, at 2 each; one to the right all behind it, at 3 each
    reached = np.minimum.accumulate(np.array([2.0 * (n + 1) for n in range(RUNS)])[::-1])[::-1]
    behind = np.minimum.accumulate(np.array([3.0 * (RUNS - n) for n in range(RUNS)]))
    np.testing.assert_allclose(dearer * LINES, np.minimum(reached, behind))


def test_a_small_run_in_the_way_is_left_out() -> None:
    """Five runs that are better one stripe on; the last, of two peaks or faint ones, has no room: it goes."""
    own = np.tile([2.0, 0.0, -9.0, 120.0], (RUNS, 1))
    own[-1] = [2.0, 0.0, 50.0, 12.0]
    one, other = np.arange(RUNS - 1), np.arange(1, RUNS)
    both = np.zeros((RUNS - 1, 4, 4))
    for a, b in product(range(3), range(3)):
        both[:, a, b] = DISORDER if a > b else 0.0
    _, by = shifts_of(runs_of(own, one, other, both), LINES, 0.5)
    np.testing.assert_array_equal(by, [1] * (RUNS - 1) + [OUT])


def test_nodes_are_stepped_and_fall_to_none_beyond_what_is_possible() -> None:
    nodes = Candidates(np.zeros(2, np.int64), np.array([3, 2]), np.array([0, 4, 7]), np.zeros(7), np.ones(7))
    best = np.array([1, 5])
    np.testing.assert_array_equal(shift_labels(nodes, best, np.array([1, 1])), [2, 6])
    np.testing.assert_array_equal(shift_labels(nodes, best, np.array([0, -1])), [1, 4])
    own = np.zeros(7)
    np.testing.assert_array_equal(np.flatnonzero(favour_labels(nodes, best, own, 6.0)), [1, 5])


@pytest.mark.parametrize(
    ("sides", "said", "settled"),
    [
        ((4, 4), 4, 1.0),  # both sides agree
        ((4, 4), 5, 0.0),
        ((4, 5), 5, 0.4),  # belt of 4, then the product's 5: where it changes is not known
        ((4, 5), 4, 0.0),
        ((4, None), 4, 0.4),
        ((4, None), 3, 0.0),
    ],
)
def test_ends_are_believed_as_far_as_their_trace_speaks_for_them(
    sides: tuple[int, int | None], said: int, settled: float
) -> None:
    """A piece of belt on stripe 4's rest line, its end, and what follows."""
    counts = [10, 8, 10 if sides[1] is not None else 0]
    piece = np.repeat(np.arange(3), counts)
    stripe = np.repeat([sides[0], said, -1 if sides[1] is None else sides[1]], counts)
    after = 4 if sides[1] == 4 else -1
    pieces = pieces_of(piece, np.array([4, ENDS, after]), np.array([4, 4, after]))
    found = ends_settled(pieces, stripe)
    assert (found[:10] == 1.0).all()
    assert (found[10:18] == settled).all()


@pytest.mark.parametrize(("first", "settled"), [(4, 0.0), (5, 0.4)])
def test_an_end_that_lies_on_the_belt_still_is_not_yet_the_product(first: int, settled: float) -> None:
    """An end called 5 on stripe 4's rest line, before a body of 5; before it there is belt, or that body."""
    piece = np.repeat(np.arange(3), [10, 8, 10])
    stripe = np.repeat([first, 5, 5], [10, 8, 10])
    line = np.where(np.arange(28) < 14, 4, -1)
    found = ends_settled(pieces_of(piece, np.array([4, ENDS, -1]), np.array([4, 4, -1]), line), stripe)
    assert (found[10:14] == (settled if first == 4 else 1.0)).all()
    assert (found[14:18] == (0.4 if first == 4 else 1.0)).all()
