"""Doubt about one piece is doubt about what stands against it: small arrays, each rule by itself."""

from __future__ import annotations

import numpy as np

from roemetry_coding.planes.pieces import ENDS, Pieces
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
