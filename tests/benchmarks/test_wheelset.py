"""The wheelset image's count: the coder's numbers against those by hand, whatever both begin with."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import wheelset
from roemetry.records import Peaks
from roemetry_coding.pieces import Pieces


def slanting(off_spacings: float = 0.0) -> Peaks:
    """Give five stripes 40 px apart; all but the outer ones are cut, and go on a little to the side."""
    row, x_px = [], []
    for stripe in range(5):
        rows = np.arange(240)
        if 0 < stripe < 4:
            rows = np.r_[0:100, 140:240]
        row.append(rows)
        x_px.append(
            50.0 + 40.0 * stripe + 0.2 * rows + 40.0 * off_spacings * (rows >= 140) * (len(rows) < 240)
        )
    row, x_px = np.concatenate(row), np.concatenate(x_px)
    order = np.lexsort((x_px, row))
    flat = np.full(row.size, 5.0)
    return Peaks((240, 300), row[order], x_px[order], flat, flat, flat, flat, np.zeros(row.size, np.uint8))


@pytest.mark.parametrize("first", [1, 4])
def test_numbers_are_counted_against_those_by_hand(monkeypatch, first: int) -> None:
    """By hand the same stripes are counted from another number on, and one piece is not numbered."""
    starts = {
        0: ((50, 0),),
        1: ((90, 0),),
        2: ((130, 0), (158, 140)),
        3: ((170, 0), (198, 140)),
        4: ((210, 0),),
    }
    monkeypatch.setattr(wheelset, "BY_HAND", {first + n: at for n, at in starts.items()})
    peaks = slanting()
    verdict = wheelset.judged(peaks, Pieces().code(peaks, None))
    assert len(verdict.pieces) == 8
    assert (verdict.by_hand == 0).sum() == 1
    known = verdict.by_hand > 0
    np.testing.assert_array_equal(verdict.given[known], verdict.by_hand[known])
    assert verdict.given[~known] == first + 1


def test_what_is_open_has_no_number() -> None:
    peaks = slanting(off_spacings=0.5)
    verdict = wheelset.judged(peaks, Pieces().code(peaks, None))
    assert (verdict.given == 0).sum() >= 3
