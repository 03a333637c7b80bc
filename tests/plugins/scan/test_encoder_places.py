"""Counts of a scan's lines: overflows, lost, repeated and reversed lines, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.errors import StageError
from roemetry_scan.encoder_places import encoder_places

STEP = 25


def lines(many: int = 40) -> tuple[np.ndarray, np.ndarray]:
    return STEP * np.arange(many, dtype=float), np.arange(many)


def codes(count: np.ndarray, number: np.ndarray) -> set[str]:
    return {reason.code for reason in encoder_places(count, number).reasons}


def test_sound_counts_are_kept_as_they_are() -> None:
    count, number = lines()
    found = encoder_places(count, number)
    assert np.array_equal(found.way, count)
    assert np.array_equal(found.place, number)
    assert found.used.all()
    assert not found.reasons


@given(st.sampled_from((16, 32)), st.integers(0, 60), st.booleans())
def test_a_counter_that_overflows_gives_the_same_way(bits: int, at: int, down: bool) -> None:
    count, number = lines(64)
    start = 2.0**bits - STEP * at
    wrapped = (start + (-count if down else count)) % 2.0**bits
    found = encoder_places(wrapped, number)
    assert np.array_equal(found.way, count)


@given(st.integers(2, 30), st.integers(1, 8))
def test_lost_lines_leave_gaps_of_their_size(at: int, many: int) -> None:
    count, number = lines()
    kept = np.delete(np.arange(40), slice(at, at + many))
    found = encoder_places(count[kept], number[kept])
    assert found.lost == many
    assert np.array_equal(found.place, kept - kept[0])
    assert codes(count[kept], number[kept]) == {"lines-lost"}


@given(st.integers(5, 30), st.integers(1, 4))
def test_a_belt_that_turns_back_shows_nothing_twice(at: int, back: int) -> None:
    count, _ = lines()
    index = np.concatenate(
        [np.arange(at + 1), np.arange(at - 1, at - back - 1, -1), np.arange(at - back, 40)]
    )
    found = encoder_places(count[index], np.arange(index.size))
    assert np.array_equal(np.sort(count[index][found.used]), count)
    assert found.reversed + found.repeated == index.size - 40
    assert "belt-reversed" in codes(count[index], np.arange(index.size))


def test_a_belt_that_stands_repeats_a_line() -> None:
    index = np.concatenate([np.arange(10), np.full(5, 9), np.arange(10, 40)])
    found = encoder_places(STEP * index.astype(float), np.arange(index.size))
    assert found.repeated == 5
    assert found.used.sum() == 40


def test_frame_numbers_that_contradict_counts_are_told() -> None:
    count, number = lines()
    assert "counts-disagree" in codes(count, number + 5 * (number > 20))


def test_frame_numbers_of_16_bits_that_leave_out_0_lose_nothing() -> None:
    count, number = lines()
    sixteen = (65530 + number - 1) % 65535 + 1
    assert not codes(count, sixteen)


def test_lines_without_a_count_are_left_out() -> None:
    count, number = lines()
    count[7] = np.nan
    found = encoder_places(count, number)
    assert not found.used[7]
    assert {"count-missing", "lines-lost"} == codes(count, number)


@pytest.mark.parametrize(
    ("count", "why"),
    [
        (np.full(20, np.nan), "placed by counts"),
        (np.full(20, 7.0), "stands still"),
        (np.array([0.0, 25.0]), "the scan has 2 lines"),
        (np.tile([0.0, 1.0], 10), "stands still|to and fro"),
    ],
)
def test_counts_that_place_nothing_are_refused(count: np.ndarray, why: str) -> None:
    with pytest.raises(StageError, match=why):
        encoder_places(count, np.arange(count.size))
