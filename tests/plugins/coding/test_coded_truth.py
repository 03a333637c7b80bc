"""The judge itself: crossings lie where geometry says, damage does what it says, scores count right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import coded
from roemetry.records import StripeMap
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
