"""Doubt about one piece is doubt about what stands against it: small arrays, each rule by itself."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_coding.planes.pieces import ENDS, Pieces, between_bare, found_share, presence_of
from roemetry_coding.planes.vetoes import claimed, ends_settled, going_on, left_over

STRIPES = 9


def of(*runs: tuple[int, int]) -> np.ndarray:
    """Repeat values: (value, times)."""
    return np.concatenate([np.full(times, value, np.int64) for value, times in runs])


def pieces_of(
    trace: np.ndarray, piece: np.ndarray, rest: np.ndarray,
    home: np.ndarray | None = None, line: np.ndarray | None = None,
) -> Pieces:  # fmt: skip
    return Pieces(
        trace, piece, np.full(piece.size, -1) if line is None else line, rest,
        rest if home is None else home, np.zeros(rest.size, np.bool_), np.ones(rest.size),
    )  # fmt: skip


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
    found = claimed(pieces_of(piece, piece, np.full(2, -1)), stripe, STRIPES)
    np.testing.assert_array_equal(found, of((3, 8), (4, 3), (-1, 2)))  # three peaks are too few for a claim
    ends = claimed(pieces_of(piece, piece, np.array([ENDS, -1])), stripe, STRIPES)
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
    pieces = pieces_of(
        np.zeros(piece.size, np.int64), piece, np.array([4, ENDS, after]), np.array([4, 4, after])
    )
    found = ends_settled(pieces, stripe)
    assert (found[:10] == 1.0).all()
    assert (found[10:18] == settled).all()


@pytest.mark.parametrize(("first", "settled"), [(4, 0.0), (5, 0.4)])
def test_an_end_that_lies_on_the_belt_still_is_not_yet_the_product(first: int, settled: float) -> None:
    """An end called 5 on stripe 4's rest line, before a body of 5; before it there is belt, or that body."""
    piece = np.repeat(np.arange(3), [10, 8, 10])
    stripe = np.repeat([first, 5, 5], [10, 8, 10])
    line = np.where(np.arange(28) < 14, 4, -1)
    pieces = pieces_of(np.zeros(28, np.int64), piece, np.array([4, ENDS, -1]), np.array([4, 4, -1]), line)
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
