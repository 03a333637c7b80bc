"""Each scene that is known to be hard shows what its name says: else nothing is tested by it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

cases = pytest.importorskip("benchmarks.coded.cases", reason="only in a checkout")
from benchmarks.coded import Sample  # noqa: E402
from roemetry_tools.compare.stripes import nearest  # noqa: E402


@cache
def sample_of(case: str) -> Sample:
    return cases.CASES[case]()


def runs(rows: np.ndarray, apart: int = 10) -> int:
    """Count the runs of sorted rows that are parted by more than so many rows."""
    return int(rows.size > 0) + int((np.diff(rows) > apart).sum())


def body_rows(sample: Sample, stripe: int) -> np.ndarray:
    true = sample.crossings
    return np.unique(true.row[true.on_product & (true.stripe == stripe)])


def belt_rows(sample: Sample, stripe: int) -> np.ndarray:
    true = sample.crossings
    return np.unique(true.row[~true.on_product & (true.stripe == stripe)])


def stripes_of(sample: Sample) -> range:
    return range(sample.calibration.stripe_count)


def lost(sample: Sample) -> np.ndarray:
    """(crossing,) True for crossings of which there is no peak."""
    true, peaks = sample.crossings, sample.peaks
    return nearest(true.row, true.x_px, peaks.row, peaks.x_px) < 0


def false_peaks(sample: Sample) -> int:
    true, peaks = sample.crossings, sample.peaks
    return int((nearest(peaks.row, peaks.x_px, true.row, true.x_px) < 0).sum())


def breaks(sample: Sample) -> int:
    """Count breaks of two rows or more along stripes that are there."""
    gone, true = lost(sample), sample.crossings
    found = 0
    for stripe in stripes_of(sample):
        mine = gone[true.stripe == stripe]
        found += int((mine[1:] & mine[:-1] & ~np.concatenate([[False], mine[:-2]])).sum())
    return found


def largest_step_mm(sample: Sample) -> float:
    """Largest change of height from row to row along a stripe, from belt to body and back too."""
    true, largest = sample.crossings, 0.0
    for stripe in stripes_of(sample):
        mine = true.stripe == stripe
        step = np.abs(np.diff(true.xyz_mm[mine, 2]))[np.diff(true.row[mine]) == 1]
        largest = max(largest, float(step.max(initial=0.0)))
    return largest


def bodies_side_by_side(sample: Sample) -> int:
    """Rows on which belt lies between two bodies."""
    true, found = sample.crossings, 0
    for row in np.unique(true.row[true.on_product]):
        on = true.on_product[true.row == row]
        found += int(((np.diff(on.astype(int)) == 1).sum() + on[0]) >= 2)
    return found


SHOWS: dict[str, Callable[[Sample], bool]] = {
    "broken_stripes": lambda s: breaks(s) >= 10,
    "grazed_stripes": lambda s: any(
        0 < body_rows(s, k).size < 0.25 * body_rows(s, 6).size for k in stripes_of(s)
    ),
    "hidden_body": lambda s: body_rows(s, 4).size == 0 and runs(belt_rows(s, 4)) == 2,
    "hidden_belt": lambda s: belt_rows(s, 4).size == 0 and body_rows(s, 4).size > 40,
    "smooth_tail": lambda s: any(
        runs(np.union1d(body_rows(s, k), belt_rows(s, k)), 1) < 3 and body_rows(s, k).size > 40
        for k in stripes_of(s)
    ),
    "leaving_the_image": lambda s: any(
        np.union1d(body_rows(s, k), belt_rows(s, k)).size < 0.9 * s.peaks.image_size[0] for k in stripes_of(s)
    ),
    "past_the_neighbour": lambda s: s.displaced_spacings > 1.3,
    "on_the_neighbour": lambda s: abs(s.displaced_spacings - 1.0) < 0.1,
    "crossing_twice": lambda s: sum(runs(body_rows(s, k)) >= 2 for k in stripes_of(s)) >= 2,
    "specular_blobs": lambda s: false_peaks(s) >= 40 and (lost(s) & s.crossings.on_product).sum() >= 40,
    "second_reflections": lambda s: false_peaks(s) >= 40,
    "two_products": lambda s: bodies_side_by_side(s) >= 40,
    "two_products_on_one_stripe": lambda s: sum(runs(body_rows(s, k)) == 2 for k in stripes_of(s)) >= 3,
    "dirt_on_the_belt": lambda s: false_peaks(s) >= 80,
    "cut_by_the_image_edge": lambda s: bool(s.crossings.on_product[s.crossings.row == 0].any()),
    "lost_belt": lambda s: (lost(s) & ~s.crossings.on_product).sum() >= 200,
    "a_dead_stripe": lambda s: belt_rows(s, 5).size == body_rows(s, 5).size == 0,
    "dense_and_displaced": lambda s: len(stripes_of(s)) == 21 and s.displaced_spacings > 2.0,
    "a_step_of_one_spacing": lambda s: abs(s.displaced_spacings - 1.0) < 0.1,
}


def test_every_case_is_looked_at() -> None:
    assert set(SHOWS) == set(cases.CASES)


@pytest.mark.parametrize("case", cases.CASES)
def test_the_scene_shows_what_it_is_called(case: str) -> None:
    assert SHOWS[case](sample_of(case))
