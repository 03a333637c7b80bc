"""Labels that are shifted keep their order, their costs are exact, and doubt about one piece spreads."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest

from roemetry_coding.planes.graph import WEIGHTS, Candidates, PairCosts
from roemetry_coding.planes.lines import Entries
from roemetry_coding.planes.pieces import ENDS, Pieces, between_bare, found_share, presence_of, relative_light
from roemetry_coding.planes.shifts import (
    OUT,
    Runs,
    _edges,
    of_entries,
    shift_labels,
    shifts_of,
    single_shifts,
)
from roemetry_coding.planes.solve import _EMPTY, agreed, favour_labels, min_marginals
from roemetry_coding.planes.vetoes import claimed, ends_settled, going_on, left_over, missing_amid

RUNS, LINES = 6, 20
STAYS = 1
DISORDER = 1e5
NONE = np.zeros(0, np.int64)
BESIDE = np.arange(RUNS - 1), np.arange(1, RUNS)
"""Edges of runs side by side."""


def pieces_of(
    piece: np.ndarray, rest: np.ndarray, home: np.ndarray | None = None, line: np.ndarray | None = None
) -> Pieces:
    """Give pieces of one trace."""
    none = np.full(piece.size, -1)
    return Pieces(
        np.zeros(piece.size, np.int64), piece, none if line is None else line, rest,
        rest if home is None else home, np.zeros(rest.size, np.bool_), np.ones(rest.size),
    )  # fmt: skip


def runs_of(
    own: np.ndarray, one: np.ndarray, other: np.ndarray, both: np.ndarray, disorder: np.ndarray | None = None
) -> Runs:
    """Give runs that all lie on all lines; out of order are, if not told, those at the cost of disorder."""
    runs = len(own)
    if disorder is None:
        disorder = np.where(both == DISORDER, LINES, 0)
    first, last = np.zeros(runs, np.int64), np.full(runs, LINES - 1)
    return Runs(NONE, NONE, own, one, other, both, disorder, *_edges(runs, one, other), first, last)


def in_order(own: np.ndarray) -> Runs:
    """Give runs side by side without gaps, of which each pushes the next."""
    both = np.zeros((RUNS - 1, 4, 4))
    for a, b in product(range(3), range(3)):
        both[:, a, b] = DISORDER if a > b else 0.0
    return runs_of(own, *BESIDE, both)


def energy(graph: Runs, way: np.ndarray) -> float:
    pairs = graph.both[np.arange(graph.one.size), way[graph.one], way[graph.other]]
    return float(graph.own[np.arange(way.size), way].sum() + pairs.sum())


@pytest.mark.parametrize("trial", range(10))
def test_what_is_shifted_is_cheaper_and_no_shift_is_cheaper_than_the_cheapest(trial: int) -> None:
    """Against all changes of a small graph: never dearer than before, never below the least of all."""
    rng = np.random.default_rng(trial)
    own = np.hstack([rng.uniform(-3.0, 3.0, (RUNS, 3)), np.full((RUNS, 1), 1e3)])
    both = np.zeros((RUNS - 1, 4, 4))
    both[:, :3, :3] = rng.uniform(0.0, 4.0, (RUNS - 1, 3, 3))
    gaps = rng.integers(0, 2, RUNS - 1)  # stripes left out between neighbours
    for t, a, b in product(range(RUNS - 1), range(3), range(3)):
        if a >= b + 1 + gaps[t]:
            both[t, a, b] = DISORDER
    graph = runs_of(own, *BESIDE, both)
    dearer, by = shifts_of(graph, LINES, 0.5)
    before, after = energy(graph, np.full(RUNS, STAYS)), energy(graph, STAYS + by)
    assert after <= before - 0.5 or not by.any()
    least = min(energy(graph, np.array(way)) for way in product(range(3), repeat=RUNS))
    assert after >= least - 1e-9
    assert (dearer * LINES >= least - before - 1e-9).all()


def test_a_run_without_room_takes_its_neighbours_along() -> None:
    """Six stripes without gaps: shifting one to the right costs what it costs to shift all beyond."""
    dearer, by = shifts_of(in_order(np.tile([2.0, 0.0, 3.0, 100.0], (RUNS, 1))), LINES, 0.5)
    assert not by.any()
    # one to the left takes all before it along, at 2 each; one to the right all behind it, at 3 each
    reached = np.minimum.accumulate(np.array([2.0 * (n + 1) for n in range(RUNS)])[::-1])[::-1]
    behind = np.minimum.accumulate(np.array([3.0 * (RUNS - n) for n in range(RUNS)]))
    np.testing.assert_allclose(dearer * LINES, np.minimum(reached, behind))


def test_a_small_run_in_the_way_is_left_out() -> None:
    """Five runs that are better one stripe on; the last, of two peaks or faint ones, has no room: it goes."""
    own = np.tile([2.0, 0.0, -9.0, 120.0], (RUNS, 1))
    own[-1] = [2.0, 0.0, 50.0, 12.0]
    _, by = shifts_of(in_order(own), LINES, 0.5)
    np.testing.assert_array_equal(by, [1] * (RUNS - 1) + [OUT])


def test_single_shifts_end_where_none_gains(rng: np.random.Generator) -> None:
    for _ in range(20):
        runs = int(rng.integers(2, 9))
        pairs = np.array([(f, g) for f in range(runs) for g in range(f + 1, runs) if rng.random() < 0.5])
        one, other = np.ascontiguousarray(pairs.reshape(-1, 2).T.astype(np.int64))
        own, both = rng.uniform(-3.0, 3.0, (runs, 4)), rng.uniform(0.0, 4.0, (one.size, 4, 4))
        graph = runs_of(own, one, other, both)
        way = STAYS + single_shifts(graph, 0.5)
        least = energy(graph, way)
        assert least <= energy(graph, np.full(runs, STAYS))
        for f, to in product(range(runs), range(3)):
            other_way = way.copy()
            other_way[f] = to
            assert energy(graph, other_way) > least - 0.5 - 1e-9


def test_one_wrong_run_is_put_right_and_the_others_stand() -> None:
    """Five runs in a row; the last has its neighbour's stripe. All others could make way for it."""
    own, both = np.zeros((5, 4)), np.zeros((4, 4, 4))
    for a, b in product(range(3), range(3)):
        both[:3, a, b] = 100.0 * max(a - b, 0)  # out of order
        both[3, a, b] = 100.0 * max(a - b + 1, 0)  # as they are, too
    own[:4, 0] = 5.0  # nothing speaks for the shift of the others
    own[4, 2] = 10.0
    graph = runs_of(own, np.arange(4), np.arange(1, 5), both)
    np.testing.assert_array_equal(single_shifts(graph, 0.5), [0, 0, 0, 0, 1])


@pytest.mark.parametrize("lines, forced", [(4, False), (5, True)])
def test_runs_that_hardly_touch_need_not_give_way(lines: int, forced: bool) -> None:
    """The left run is moved onto the right one's stripe; that one's own shift is dear."""
    own = np.array([[0.0, 0.0, 0.0, 50.0], [100.0, 0.0, 100.0, 500.0]])
    disorder = np.zeros((1, 4, 4), np.int64)
    disorder[0, 2, :2] = lines
    graph = runs_of(own, np.zeros(1, np.int64), np.ones(1, np.int64), 8.0 * disorder, disorder)
    dearer, way = shifts_of(graph, LINES, 0.5)
    assert not way.any()
    assert dearer * LINES == pytest.approx([0.0, 100.0])  # the left one moves to the other side
    own[0, 0] = 1000.0
    dearer, _ = shifts_of(graph, LINES, 0.5)
    assert dearer[0] * LINES == pytest.approx(100.0 if forced else 8.0 * lines)


def test_nodes_are_stepped_and_fall_to_none_beyond_what_is_possible() -> None:
    nodes = Candidates(np.zeros(2, np.int64), np.array([3, 2]), np.array([0, 4, 7]), np.zeros(7), np.ones(7))
    best = np.array([1, 5])
    np.testing.assert_array_equal(shift_labels(nodes, best, np.array([1, 1])), [2, 6])
    np.testing.assert_array_equal(shift_labels(nodes, best, np.array([0, -1])), [1, 4])
    np.testing.assert_array_equal(np.flatnonzero(favour_labels(nodes, best, np.zeros(7), 6.0)), [1, 5])


def agree(start: np.ndarray, piece: np.ndarray, rest: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Let (entry,) pieces agree at (entry, stripe or none) costs; give (entry,) stripes."""
    size, none, stripes = piece.size, np.full(piece.size, -1), cost.shape[1] - 1
    entries = Entries(start, np.arange(size), np.arange(float(size)), none, none, np.zeros(size))
    offset = np.arange(0, (stripes + 1) * size + 1, stripes + 1)
    count = np.full(size, stripes)
    nodes = Candidates(np.zeros(size, np.int64), count, offset, np.zeros(cost.size), np.ones(cost.size))
    pieces = pieces_of(piece, rest)._replace(trace=none)
    return agreed(entries, nodes, pieces, cost.ravel()) - offset[:-1]


def test_a_piece_agrees_on_the_stripe_that_is_cheapest_for_all_of_it() -> None:
    """Three lines, two pieces; on the second line the first piece would rather be stripe 1."""
    cost = np.full((6, 4), 9.0)
    cost[0::2, 0] = cost[1::2, 1] = 0.0
    cost[2, :2] = 2.0, 0.0
    way = agree(np.array([0, 2, 4, 6]), np.array([0, 1] * 3), np.array([-1, -1]), cost)
    np.testing.assert_array_equal(way, [0, 1] * 3)


@pytest.mark.parametrize("small", ["end", "few", "many"])
def test_of_two_out_of_order_the_small_one_gives_way(small: str) -> None:
    """A piece of stripe 1 to the left of one of stripe 0; neither gives way where both are large."""
    lines = 15
    piece = np.array([0, 1] * lines)
    if small == "few":  # the left piece is cut up into many
        piece = np.array([[n + 1, 0] for n in range(lines)]).ravel()
    rest = np.full(piece.max() + 1, -1)
    if small == "end":
        rest[0] = ENDS
    cost = np.full((piece.size, 3), 9.0)
    cost[0::2, 1] = cost[1::2, 0] = 0.0
    way = agree(np.arange(0, 2 * lines + 1, 2), piece, rest, cost)
    np.testing.assert_array_equal(way[0::2], 1 if small == "many" else 2)
    np.testing.assert_array_equal(way[1::2], 0)


@pytest.mark.parametrize(("of", "of_run"), [([-1, -1, -1], []), ([1, -1, 0], [4, 7])])
def test_what_a_run_is_given_holds_for_its_entries(of: list[int], of_run: list[int]) -> None:
    """Where all entries are left out there is no run at all."""
    none = np.zeros((0, 4, 4))
    runs = runs_of(np.zeros((len(of_run), 4)), NONE, NONE, none)._replace(of=np.array(of))
    expected = [of_run[k] if k >= 0 else -9 for k in of]
    np.testing.assert_array_equal(of_entries(runs, np.array(of_run, np.int64), -9), expected)


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


def test_light_is_held_against_the_median_of_two_on_either_side(rng: np.random.Generator) -> None:
    rows = [rng.uniform(1.0, 100.0, count) for count in (0, 1, 2, 3, 9)]
    expected = []
    for row in rows:
        for p, own in enumerate(row):
            beside = np.delete(row, p)[max(0, p - 2) : p + 2]
            expected.append(min(1.0, own / np.median(beside)) if beside.size else 1.0)
    row_start = np.cumsum([0, *(row.size for row in rows)])
    found = relative_light(row_start, np.concatenate(rows))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_what_is_not_known_is_as_bright_as_any() -> None:
    np.testing.assert_array_equal(relative_light(np.array([0, 3]), np.full(3, np.nan)), 1.0)


STRIPES = 9


def of(*runs: tuple[int, int]) -> np.ndarray:
    """Repeat values: (value, times)."""
    return np.concatenate([np.full(times, value, np.int64) for value, times in runs])


def test_doubt_goes_on_along_a_stripe_over_short_gaps() -> None:
    """Two stripes; what is not asked, and what lies beyond a long gap, is left alone."""
    row = np.array([10, 12, 13, 14, 30, 31, 60, 61, 12, 13])
    stripe = np.array([4] * 8 + [5] * 2)
    asked = np.ones(10, np.bool_)
    asked[5] = False
    doubted = np.zeros(10, np.bool_)
    doubted[1] = True
    found = going_on(row, stripe, asked, doubted, 20)
    np.testing.assert_array_equal(np.flatnonzero(found), [0, 1, 2, 3, 4])


def test_a_piece_claims_the_stripe_it_has_elsewhere() -> None:
    piece = of((0, 8), (1, 5))
    stripe = of((3, 5), (-1, 3), (4, 3), (-1, 2))
    found = claimed(pieces_of(piece, np.full(2, -1))._replace(trace=piece), stripe, STRIPES)
    np.testing.assert_array_equal(found, of((3, 8), (4, 3), (-1, 2)))  # three peaks are too few for a claim
    ends = claimed(pieces_of(piece, np.array([ENDS, -1]))._replace(trace=piece), stripe, STRIPES)
    np.testing.assert_array_equal(ends, stripe)


@pytest.mark.parametrize("kept, doubted", [(4, True), (5, False)])
def test_a_piece_of_which_most_is_refused_is_refused(kept: int, doubted: bool) -> None:
    piece, stripe = of((0, 10), (1, 3)), of((2, 10), (3, 3))
    left = of((2, kept), (-2, 10 - kept), (3, 3))
    found = left_over(piece, stripe, left, 0.5)
    np.testing.assert_array_equal(found, np.concatenate([np.arange(10) < kept, np.zeros(3, bool)]) & doubted)


@pytest.mark.parametrize("rows, there", [((200, 240), False), ((100, 400), True), ((0, 60), True)])
def test_what_lies_on_a_rest_line_amid_the_image_only_is_no_belt(rows: tuple[int, int], there: bool) -> None:
    """40 rows amid the image may be the neighbour's body; long runs and those from the border are belt."""
    line = np.arange(*rows, dtype=np.float64)
    piece = np.zeros(line.size, np.int64)
    found = presence_of(
        line, piece, np.zeros(1, np.int64), np.zeros(1), np.full(1, 479.0), 480, 96, 15, 30, 0.25
    )
    assert (found.max() > 0.0) == there


@pytest.mark.parametrize("bare, marked", [((1, 3), True), ((1,), False), ((3,), False), ((), False)])
def test_a_rest_line_between_bare_ones_may_show_a_body(bare: tuple[int, ...], marked: bool) -> None:
    """Five stripes over 100 rows; some rest lines show nothing in rows 30 to 69."""
    row, line = (a.ravel() for a in np.meshgrid(np.arange(100), np.arange(5), indexing="ij"))
    amid = (row >= 30) & (row < 70)
    line = np.where(amid & np.isin(line, bare), -1, line)
    found = between_bare(row, line, 5, 100, 20)
    np.testing.assert_array_equal(found, amid & (line == 2) & marked)
    assert not between_bare(row, line, 5, 100, 41).any()  # 40 rows are then no bare line


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
    pieces = pieces_of(piece, np.array([4, ENDS, -1]), np.array([4, 4, -1]), line)
    found = ends_settled(pieces, stripe)
    assert (found[10:14] == (settled if first == 4 else 1.0)).all()
    assert (found[14:18] == (0.4 if first == 4 else 1.0)).all()


def test_a_stripe_is_found_as_often_as_on_belt_that_nothing_covers() -> None:
    """Stripe 0 is always found, 1 in every other row, 2 nowhere; a body covers all but the lower rows."""
    rows = np.arange(400)
    bare = rows >= 280
    row = np.concatenate([rows[bare], rows[bare & (rows % 2 == 0)]])
    line = np.repeat([0, 1], [120, 60])
    np.testing.assert_allclose(found_share(row, line, 3, 400, 40), [1.0, 20 / 39, 1.0])


@pytest.mark.parametrize(
    ("rows", "light", "bodies", "doubted"),
    [(60, 1.0, 1, True), (59, 1.0, 1, False), (60, 0.0, 1, False), (60, 1.0, 2, False)],
    ids=str,
)
def test_a_stripe_that_is_missing_all_along_a_seam_casts_doubt_on_both_sides(
    rows: int, light: float, bodies: int, doubted: bool
) -> None:
    """Stripes 1, 2 and 4, 5 on two parts of a body, belt beside; one without light is not missing.

    Of two bodies side by side, one may hide a stripe beside the other.
    """
    on_line = np.array([0, 1, 2, 4, 5, 6])
    stripe = np.tile(on_line, rows)
    body = np.tile([0, 1, 1, bodies, bodies, 0], rows)
    none = np.full(stripe.size, -1)
    start = np.arange(rows + 1) * on_line.size
    entries = Entries(start, np.arange(stripe.size), stripe.astype(float), none, none, np.zeros(stripe.size))
    there = np.ones(7)
    there[3] = light
    np.testing.assert_array_equal(missing_amid(entries, stripe, body, there), (body > 0) & doubted)
