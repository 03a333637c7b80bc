"""Every coder on every case that is known to be hard: each peak right, or refused; each case is hard."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.coded import Sample, cases, score
from roemetry.errors import StageError
from roemetry.records.arrays import Integers
from roemetry.stages.registry import discover
from roemetry_tools.compare.stripes import nearest

FAILURES = {
    **{
        ("ordered", case): "order in each row alone does not see what is hidden"
        for case in (
            "smooth_tail", "leaving_the_image", "past_the_neighbour", "on_the_neighbour", "crossing_twice",
            "dense_and_displaced", "a_step_of_one_spacing",
        )
    },
    ("window-tracking", "on_the_neighbour"): "it takes a body on the next rest line for that stripe's belt",
    ("window-tracking", "dense_and_displaced"): "order in rows has no height: 2 spacings are too much for it",
    ("window-tracking", "a_step_of_one_spacing"): "where a body lies on the next rest line it cuts too late",
}  # fmt: skip
"""Known: a coder and a case in which it gives a peak to another stripe, with the reason."""
REGISTRY = discover()
OTHERS = ("single", "pieces", "epipolar-dots", "grid-planes")
"""These refuse any calibration of several lines."""
CODERS: dict[str, Any] = {
    stage.entry.name: REGISTRY.load(stage)()
    for stage in REGISTRY.of_kind("coder")
    if stage.entry.name not in OTHERS
}


@cache
def sample_of(case: str) -> Sample:
    return cases.CASES[case]()


@pytest.mark.parametrize("case", cases.CASES)
@pytest.mark.parametrize("coder", CODERS)
def test_right_or_refused(coder: str, case: str) -> None:
    sample = sample_of(case)
    try:
        stripes = CODERS[coder].code(sample.peaks, sample.calibration)
    except StageError as refusal:
        assert str(refusal)
        return
    found = score(stripes, sample)
    wrong = found.wrong - found.shared
    known = FAILURES.get((coder, case))
    if known is None:
        assert wrong == 0
        if found.refused > 0.05 * found.visible:
            assert stripes.reasons, "product points are refused and no reason says so"
    else:
        assert wrong > 0, f"declared to fail ({known}), and does not any more"


@pytest.mark.parametrize("coder", OTHERS)
def test_a_coder_of_another_pattern_refuses_several_lines(coder: str) -> None:
    sample = sample_of("broken_stripes")
    with pytest.raises(StageError):
        REGISTRY.load(REGISTRY.find("coder", coder))().code(sample.peaks, sample.calibration)


def runs(rows: Integers, apart: int = 10) -> int:
    """Count the runs of sorted rows that are parted by more than so many rows."""
    return int(rows.size > 0) + int((np.diff(rows) > apart).sum())


def rows_of(sample: Sample, stripe: int, *, body: bool) -> Integers:
    true = sample.crossings
    return np.unique(true.row[(true.on_product == body) & (true.stripe == stripe)])


def bodies(sample: Sample) -> list[Integers]:
    """Rows on the product, by stripe."""
    return [rows_of(sample, stripe, body=True) for stripe in range(sample.calibration.stripe_count)]


def whole(sample: Sample) -> list[Integers]:
    """Rows on product or belt, by stripe."""
    return [np.union1d(body, rows_of(sample, k, body=False)) for k, body in enumerate(bodies(sample))]


def lost(sample: Sample) -> np.ndarray:
    """(crossing,) True for crossings of which there is no peak."""
    true, peaks = sample.crossings, sample.peaks
    return np.asarray(nearest(true.row, true.x_px, peaks.row, peaks.x_px) < 0)


def false_peaks(sample: Sample) -> int:
    true, peaks = sample.crossings, sample.peaks
    return int((nearest(peaks.row, peaks.x_px, true.row, true.x_px) < 0).sum())


def breaks(sample: Sample) -> int:
    """Count breaks of two rows or more along stripes that are there."""
    gone = lost(sample)
    found = 0
    for stripe in range(sample.calibration.stripe_count):
        mine = gone[sample.crossings.stripe == stripe]
        found += int((mine[1:] & mine[:-1] & ~np.concatenate([[False], mine[:-2]])).sum())
    return found


def bodies_side_by_side(sample: Sample) -> int:
    """Rows on which belt lies between two bodies."""
    true, found = sample.crossings, 0
    for row in np.unique(true.row[true.on_product]):
        on = true.on_product[true.row == row]
        found += int(((np.diff(on.astype(int)) == 1).sum() + on[0]) >= 2)
    return found


SHOWS: dict[str, Callable[[Sample], bool]] = {
    "broken_stripes": lambda s: breaks(s) >= 10,
    "grazed_stripes": lambda s: any(0 < b.size < 0.25 * bodies(s)[6].size for b in bodies(s)),
    "hidden_body": lambda s: bodies(s)[4].size == 0 and runs(rows_of(s, 4, body=False)) == 2,
    "hidden_belt": lambda s: rows_of(s, 4, body=False).size == 0 and bodies(s)[4].size > 40,
    "smooth_tail": lambda s: any(
        runs(w, 1) < 3 and b.size > 40 for w, b in zip(whole(s), bodies(s), strict=True)
    ),
    "leaving_the_image": lambda s: any(w.size < 0.9 * s.peaks.image_size[0] for w in whole(s)),
    "past_the_neighbour": lambda s: s.displaced_spacings > 1.3,
    "on_the_neighbour": lambda s: abs(s.displaced_spacings - 1.0) < 0.1,
    "crossing_twice": lambda s: sum(runs(b) >= 2 for b in bodies(s)) >= 2,
    "specular_blobs": lambda s: false_peaks(s) >= 40 and (lost(s) & s.crossings.on_product).sum() >= 40,
    "second_reflections": lambda s: false_peaks(s) >= 40,
    "two_products": lambda s: bodies_side_by_side(s) >= 40,
    "two_products_on_one_stripe": lambda s: sum(runs(b) == 2 for b in bodies(s)) >= 3,
    "dirt_on_the_belt": lambda s: false_peaks(s) >= 80,
    "cut_by_the_image_edge": lambda s: bool(s.crossings.on_product[s.crossings.row == 0].any()),
    "lost_belt": lambda s: (lost(s) & ~s.crossings.on_product).sum() >= 200,
    "a_dead_stripe": lambda s: whole(s)[5].size == 0,
    "dense_and_displaced": lambda s: s.calibration.stripe_count == 21 and s.displaced_spacings > 2.0,
    "a_step_of_one_spacing": lambda s: abs(s.displaced_spacings - 1.0) < 0.1,
}


@pytest.mark.parametrize("case", cases.CASES)
def test_the_scene_shows_what_it_is_called(case: str) -> None:
    """Else nothing is tested by it."""
    assert SHOWS[case](sample_of(case))


def test_every_declared_failure_is_of_a_coder_and_a_case_that_exist() -> None:
    assert {coder for coder, _ in FAILURES} <= set(CODERS)
    assert {case for _, case in FAILURES} <= set(cases.CASES)
