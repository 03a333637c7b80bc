"""Every coder on every case that is known to be hard, and the judge of coders: crossings, damage, counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks import coded
from benchmarks.coded import Sample, cases, score
from roemetry.errors import StageError
from roemetry.records import StripeMap
from roemetry.records.arrays import Integers
from roemetry.stages.registry import discover
from roemetry_simulate.solid import Block, EmptyBelt
from roemetry_tools.compare.stripes import nearest


@pytest.fixture(scope="module")
def rig():
    return coded.easy_rig(5)


@pytest.fixture(scope="module")
def block(rig):
    return coded.crossings_of(rig.camera, rig.laser, Block(60.0, 30.0, 12.0, yaw_deg=7.0))


def test_the_bare_belt_shows_the_rest_lines(rig) -> None:
    found = coded.crossings_of(rig.camera, rig.laser, EmptyBelt())
    rest = rig.calibration().rest_line_px(np.arange(rig.rows, dtype=float))
    off = found.x_px - rest[found.stripe, found.row]
    assert np.abs(off).max() < 1e-3  # px
    assert not found.on_product.any()


def test_points_on_a_block_lie_on_it_in_their_plane_and_in_their_pixel(rig, block) -> None:
    top = block.on_product & (np.abs(block.xyz_mm[:, 2] - 12.0) < 1e-6)
    assert top.sum() > 500
    pixels = rig.camera.project(block.xyz_mm)
    assert np.abs(pixels - np.column_stack([block.x_px, block.row])).max() < 1e-3  # px
    distance = rig.laser.distance_mm(block.xyz_mm)[np.arange(block.row.size), block.stripe]
    assert np.abs(distance).max() < 1e-3  # mm
    lifted = rig.calibration().view.lift(np.column_stack([block.x_px, block.row]), block.stripe)
    assert np.abs(lifted - block.xyz_mm).max() < 1e-3  # mm


@pytest.mark.parametrize(("make", "spacings"), [(coded.easy_rig, 1.3), (coded.dense_rig, 2.5)])
@pytest.mark.parametrize("seed", [None, 1, 2, 3])
def test_rigs_displace_as_far_as_they_say(make, spacings: float, seed) -> None:
    rig = make(seed)
    assert rig.displacement_spacings() == pytest.approx(spacings, abs=0.01)
    assert (np.diff(rig.line_px(0.0), axis=0) > 10.0).all()  # px: rest lines do not cross


def test_the_same_seed_gives_the_same_peaks_and_every_damage_changes_them(rig, block) -> None:
    plain = coded.sample_from(rig, block, seed=1)
    again = coded.sample_from(rig, block, seed=1)
    assert np.array_equal(plain.peaks.x_px, again.peaks.x_px)
    for name, damage in coded.DAMAGES.items():
        if name != "none":
            other = coded.sample_from(rig, block, damage, seed=1)
            assert not np.array_equal(plain.peaks.x_px, other.peaks.x_px), name
    dead = coded.sample_from(rig, block, coded.DAMAGES["dead-stripe"], seed=1)
    assert dead.dead.size == 1


def test_a_right_answer_is_right_and_a_shifted_one_wrong(rig, block) -> None:
    sample = coded.sample_from(rig, block, coded.Damage(missing_share=0.0), seed=2)
    right = _answer(sample, shift=0)
    whole = coded.score(right, sample)
    assert whole.right == whole.visible - whole.unseen > 0
    assert (whole.mistaken, whole.wrong, whole.invented, whole.as_belt, whole.as_product) == (0, 0, 0, 0, 0)
    shifted = coded.score(_answer(sample, shift=1), sample)
    assert shifted.right == 0
    assert shifted.wrong_share == 1.0
    assert shifted.products_wrong == 1
    assert coded.score(None, sample).refused == whole.right
    assert coded.score(replace(right, margin=np.full(right.margin.shape, 0.4)), sample, 0.5).right == 0


def _answer(sample, shift: int) -> StripeMap:
    """Give every peak the stripe of its nearest crossing, moved on by `shift` where there is one."""
    peaks, true = sample.peaks, sample.crossings
    stripes, rows = sample.calibration.stripe_count, peaks.image_size[0]
    near = nearest(peaks.row, peaks.x_px, true.row, true.x_px)
    given = (near >= 0) & (true.stripe[near] + shift < stripes)
    cell = np.where(given, (true.stripe[near] + shift) * rows + peaks.row, -1)
    _, first = np.unique(cell, return_index=True)  # of two peaks of one stripe and row
    first = first[given[first]]
    verdict = np.full(len(peaks), -1, np.int16)
    verdict[first] = true.stripe[near[first]] + shift
    x_px, product = np.full((stripes, rows), np.nan), np.full((stripes, rows), -1, np.int16)
    x_px.flat[cell[first]], product.flat[cell[first]] = peaks.x_px[first], true.on_product[near[first]]
    nothing, ones = np.full(x_px.shape, np.nan), np.ones(x_px.shape)
    return StripeMap(x_px, nothing, product, np.isfinite(x_px), ones, ones < 0.0, nothing, verdict)


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
