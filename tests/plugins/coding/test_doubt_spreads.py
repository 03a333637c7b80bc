"""Doubt about one piece is doubt about what stands against it: small arrays, each rule by itself."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_coding.planes.pieces import ENDS, Pieces, between_bare, presence_of
from roemetry_coding.planes.vetoes import claimed, going_on

STRIPES = 9


def of(*runs: tuple[int, int]) -> np.ndarray:
    """Repeat values: (value, times)."""
    return np.concatenate([np.full(times, value, np.int64) for value, times in runs])


def pieces_of(trace: np.ndarray, piece: np.ndarray, rest: np.ndarray) -> Pieces:
    return Pieces(
        trace, piece, np.full(piece.size, -1), rest, rest, np.zeros(rest.size, np.bool_), np.ones(rest.size)
    )


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
