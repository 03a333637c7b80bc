"""Doubt about one piece is doubt about what stands against it: small arrays, each rule by itself."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_kernels.coding.label_doubts import aside, broken_off, claimed, interjected, left_over
from roemetry_kernels.coding.label_pieces import ENDS, between_bare, presence_of
from roemetry_kernels.coding.label_strays import eased, strays_of

STRIPES = 9


def of(*runs: tuple[int, int]) -> np.ndarray:
    """Repeat values: (value, times)."""
    return np.concatenate([np.full(times, value, np.int64) for value, times in runs])


def test_a_piece_claims_the_stripe_it_has_elsewhere() -> None:
    piece = of((0, 8), (1, 5))
    stripe = of((3, 5), (-1, 3), (4, 3), (-1, 2))
    found = claimed(piece, piece, np.full(2, -1), stripe, np.ones(13), STRIPES, 4)
    np.testing.assert_array_equal(found, of((3, 8), (4, 3), (-1, 2)))  # three peaks are too few for a claim


def test_an_unsettled_end_is_claimed_for_its_trace() -> None:
    trace, piece = of((0, 10)), of((0, 6), (1, 4))
    stripe = of((3, 6), (4, 4))
    line = np.array([-1, ENDS])
    settled = np.concatenate([np.ones(6), np.zeros(4)])
    np.testing.assert_array_equal(claimed(trace, piece, line, stripe, settled, STRIPES, 4), of((3, 10)))
    np.testing.assert_array_equal(claimed(trace, piece, line, stripe, np.ones(10), STRIPES, 4), stripe)


@pytest.mark.parametrize("kept, doubted", [(4, True), (5, False)])
def test_a_piece_of_which_most_is_refused_is_refused(kept: int, doubted: bool) -> None:
    piece, stripe = of((0, 10), (1, 3)), of((2, 10), (3, 3))
    left = of((2, kept), (-2, 10 - kept), (3, 3))
    found = left_over(piece, stripe, left, 0.5)
    np.testing.assert_array_equal(found, np.concatenate([np.arange(10) < kept, np.zeros(3, bool)]) & doubted)


def test_a_piece_amid_a_trace_of_another_stripe_is_doubted() -> None:
    trace, piece = of((0, 23)), of((0, 6), (1, 2), (2, 7), (3, 2), (4, 6))
    stripe = of((7, 6), (7, 2), (8, 7), (8, 2), (7, 6))
    line = np.array([-1, ENDS, -1, ENDS, -1])
    np.testing.assert_array_equal(interjected(trace, piece, line, stripe), piece == 2)
    belt = np.array([7, ENDS, -1, ENDS, 7])  # between two pieces of belt a body may be another stripe's
    assert not interjected(trace, piece, belt, stripe).any()


@pytest.mark.parametrize("gap, sizes, doubted", [(2, (5, 6), {0, 1}), (2, (5, 20), {0}), (6, (5, 6), set())])
def test_pieces_that_go_on_as_another_stripe_are_doubted(
    gap: int, sizes: tuple[int, int], doubted: set[int]
) -> None:
    """A line each; the second trace begins `gap` lines after the first ends, just where it points."""
    piece = of((0, sizes[0]), (1, sizes[1]))
    stripe = of((3, sizes[0]), (4, sizes[1]))
    count = piece.size
    line = np.arange(count) + np.where(piece == 1, gap - 1, 0)
    start = np.searchsorted(line, np.arange(line[-1] + 2))
    before = np.arange(count) - 1
    tie = np.where(np.arange(count) == sizes[0], 5.5, 300.0)
    found = broken_off(start, np.arange(count), before, tie, piece, stripe, 300.0, 4.5, 4)
    np.testing.assert_array_equal(found, np.isin(piece, list(doubted)))
    same = np.full(count, 3)
    assert not broken_off(start, np.arange(count), before, tie, piece, same, 300.0, 4.5, 4).any()


@pytest.mark.parametrize("rows, there", [((200, 240), False), ((100, 400), True), ((0, 60), True)])
def test_what_lies_on_a_rest_line_amid_the_image_only_is_no_belt(rows: tuple[int, int], there: bool) -> None:
    """40 rows amid the image may be the neighbour's body; long runs and those from the border are belt."""
    line = np.arange(*rows, dtype=np.float64)
    piece = np.zeros(line.size, np.int64)
    found = presence_of(
        line, piece, np.zeros(1, np.int64), np.zeros(1), np.full(1, 479.0), 480, 96, 15, 30, 0.25
    )
    assert (found.max() > 0.0) == there


@pytest.mark.parametrize("beside_px, doubted", [(0.0, False), (10.0, False), (40.0, True)])
def test_a_piece_beside_where_its_stripe_goes_on_is_doubted(beside_px: float, doubted: bool) -> None:
    """A stripe's body in three pieces, the middle one moved aside; with belt around it, it is a body."""
    row = np.arange(60)
    piece, stripe = row // 20, np.full(60, 3)
    x_px = np.where(piece == 1, 200.0 + beside_px, 200.0)
    found = aside(row, x_px, np.full(60, -1), piece, stripe, 40.0)
    np.testing.assert_array_equal(found, (piece == 1) & doubted)
    belt = np.where(piece == 1, -1, 3)
    assert not aside(row, x_px, belt, piece, stripe, 40.0).any()


@pytest.mark.parametrize("bare, marked", [((1, 3), True), ((1,), False), ((3,), False), ((), False)])
def test_a_rest_line_between_bare_ones_may_show_a_body(bare: tuple[int, ...], marked: bool) -> None:
    """Five stripes over 100 rows; some rest lines show nothing in rows 30 to 69."""
    row, line = (a.ravel() for a in np.meshgrid(np.arange(100), np.arange(5), indexing="ij"))
    amid = (row >= 30) & (row < 70)
    line = np.where(amid & np.isin(line, bare), -1, line)
    found = between_bare(row, line, 5, 100, 20)
    np.testing.assert_array_equal(found, amid & (line == 2) & marked)
    assert not between_bare(row, line, 5, 100, 41).any()  # 40 rows are then no bare line


@pytest.mark.parametrize("of_three, stray", [((40, 60), True), ((0, 60), False), ((10, 90), False)])
def test_a_stripe_amid_its_neighbours_only_is_a_stray(of_three: tuple[int, int], stray: bool) -> None:
    """Stripes 2 and 4 are seen on 100 lines, 3 between them on some."""
    seen = [(e, s) for e in range(100) for s in (2, 3, 4) if s != 3 or of_three[0] <= e < of_three[1]]
    start = np.searchsorted([e for e, _ in seen], np.arange(101))
    of = np.array([s - 2 for _, s in seen])
    found = strays_of(start, of, np.array([2, 3, 4]), 6, 15)
    np.testing.assert_array_equal(found, [False, stray, False])


def test_runs_that_hardly_touch_need_not_give_way() -> None:
    both, disorder = np.array([[[100.0, 85.0, 3.0]]]), np.array([[[2, 5, 0]]])
    cost, left = eased(both, disorder, 40.0)
    np.testing.assert_allclose(cost, [[[100.0 - 2 * 32.0, 85.0, 3.0]]])
    np.testing.assert_array_equal(left, [[[0, 5, 0]]])
