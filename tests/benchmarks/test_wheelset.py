"""Numbering by order without calibration: what follows on is numbered, what is open is not."""

from __future__ import annotations

import numpy as np
import pytest

wheelset = pytest.importorskip("benchmarks.wheelset", reason="only in a checkout")


def pieces_of(off_spacings: float, stripes: int = 4, gap: tuple[int, int] = (100, 140)) -> list:
    """Slanting stripes 40 px apart, cut by a gap; below it they go on so many spacings to the side."""
    found = []
    for stripe in range(stripes):
        for rows, shift in ((np.arange(gap[0]), 0.0), (np.arange(gap[1], 240), 40.0 * off_spacings)):
            found.append(wheelset.Piece(rows, 50.0 + 40.0 * stripe + 0.2 * rows + shift))
    return found


@pytest.mark.parametrize("off_spacings", [0.0, 0.15, -0.15])
def test_stripes_that_go_on_after_a_gap_are_numbered(off_spacings: float) -> None:
    assert wheelset.numbered(pieces_of(off_spacings)) == [1, 1, 2, 2, 3, 3, 4, 4]


@pytest.mark.parametrize("off_spacings", [0.5, -0.5, 0.4])
def test_stripes_that_may_be_either_neighbour_are_not_joined(off_spacings: float) -> None:
    """Then one half is numbered and the other is left open: two runs of four, and nothing ties them."""
    number = wheelset.numbered(pieces_of(off_spacings))
    upper, lower = number[::2], number[1::2]
    assert sorted((upper, lower)) == [[0, 0, 0, 0], [1, 2, 3, 4]]
