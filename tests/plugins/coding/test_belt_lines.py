"""A camera that has moved a little is corrected; its uncertainty is what it says; more is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import roemetry
from roemetry.errors import StageError
from roemetry.records.calibration import Alignment
from roemetry.testing.scenes import LinearRig, moved_rig
from roemetry_coding.alignment import _at_the_edge
from roemetry_coding.belt_lines import BeltLines
from roemetry_coding.tears import tear_of

HOME = Path(__file__).parents[3] / "recipes" / "herring_roe"
NOTHING = np.zeros((4, 4))


def seen_by(rig: LinearRig, motion: tuple[float, ...], rng: np.random.Generator, noise_px: float = 0.2):
    """Peaks of a dome whose camera has moved by `motion` since the rig was calibrated."""
    moved = moved_rig(rig.calibration(), Alignment(np.array(motion), NOTHING))
    rest = moved.rest_line_px(np.arange(rig.rows, dtype=np.float64))
    x_px = rest + rig.px_per_mm * rig.dome() + rng.normal(0.0, noise_px, rest.shape)
    return rig.peaks(x_px).peaks


def test_what_is_found_is_as_sure_as_it_is_stated(rng: np.random.Generator) -> None:
    rig, motion = LinearRig(), (0.4, 0.004, -0.003, 0.0)
    found = [BeltLines().align(seen_by(rig, motion, rng), rig.calibration(), moved_rig) for _ in range(60)]
    off = np.array([(one.motion - motion)[:2] for one in found])
    stated = np.sqrt(np.mean([np.diag(one.covariance)[:2] for one in found], axis=0))
    ratio = np.sqrt((off**2).mean(axis=0)) / stated
    assert (ratio > 0.3).all() and (ratio < 1.5).all(), ratio  # two ways of clustering are added


def test_of_an_unknown_motion_no_size_is_stated() -> None:
    unknown = np.full(4, np.nan)
    largest, *_ = _at_the_edge(unknown, NOTHING, np.ones((3, 4)), np.ones(4), 1e-3)
    assert np.isnan(largest), largest


def test_a_plane_that_moved_alone_is_named(rng: np.random.Generator) -> None:
    rig = LinearRig()
    x_px = rig.rest_px() + rng.normal(0.0, 0.1, (rig.stripes, rig.rows))
    x_px[4] += 0.9
    found = BeltLines().align(rig.peaks(x_px).peaks, rig.calibration(), moved_rig)
    said = [reason.text for reason in found.reasons if reason.code == "stripe-moved"]
    assert len(said) == 1 and "5 (+0." in said[0]
    np.testing.assert_allclose(found.planes_px, np.where(np.arange(rig.stripes) == 4, 0.9, 0.0), atol=0.1)
    assert found.moved and 0.09 <= found.planes_std_px < 0.2


@pytest.mark.parametrize("moved_px", [0.45, 0.55, 0.65, 0.9])
def test_a_plane_that_moved_alone_is_no_lost_column(moved_px: float, rng: np.random.Generator) -> None:
    rig = LinearRig()
    for plane in range(rig.stripes):
        x_px = rig.rest_px() + rng.normal(0.0, 0.1, (rig.stripes, rig.rows))
        x_px[plane] += moved_px
        found = BeltLines().align(rig.peaks(x_px).peaks, rig.calibration(), moved_rig)
        assert "stripe-moved" in [reason.code for reason in found.reasons]


@pytest.mark.parametrize("columns", [1, 2, -1])
def test_lines_that_lie_aside_from_some_place_on_are_lost_columns(
    columns: int, rng: np.random.Generator
) -> None:
    """Taken for planes that had moved, one lost column gave a skein half of its volume."""
    rig = LinearRig()
    for first in range(2, rig.stripes - 1):
        x_px = rig.rest_px() + rng.normal(0.0, 0.1, (rig.stripes, rig.rows))
        x_px[first:] -= columns
        with pytest.raises(StageError, match="columns of the image were lost|have moved"):
            BeltLines().align(rig.peaks(x_px).peaks, rig.calibration(), moved_rig)


@pytest.mark.parametrize("stages", ["with_outline.yaml", "by_words.yaml"])
def test_a_plane_that_moved_alone_is_corrected_and_its_covariance_grows(stages: str) -> None:
    recipe = roemetry.Recipe.load(HOME / stages)
    made, triangulator = recipe.calibration, recipe.stages["triangulator"].make()
    planes_px = np.zeros(len(made.rest_px))
    planes_px[4] = 0.6
    moved = triangulator.moved(made, Alignment(np.zeros(4), NOTHING, planes_px=planes_px, planes_std_px=0.1))
    rows = np.arange(made.image_size[0], dtype=np.float64)
    off = moved.rest_line_px(rows) - made.rest_line_px(rows)
    np.testing.assert_allclose(off[4], 0.6, atol=0.02)
    np.testing.assert_allclose(np.delete(off, 4, axis=0), 0.0, atol=0.005)
    more = np.diag(moved.covariance) - np.diag(made.covariance)
    assert more.max() > 0.0 and more.min() >= 0.0 and np.count_nonzero(more) <= 3


def test_a_plane_that_moved_far_and_another_rig_refuse_the_frame(rng: np.random.Generator) -> None:
    rig = LinearRig()
    x_px = rig.rest_px() + rng.normal(0.0, 0.1, (rig.stripes, rig.rows))
    x_px[4] -= 2.2
    with pytest.raises(StageError, match=r"moved against the others on the belt: 5 \(-2\.[12]"):
        BeltLines().align(rig.peaks(x_px).peaks, rig.calibration(), moved_rig)
    other = LinearRig(first_px=52.0, fan=0.06)
    with pytest.raises(StageError, match="calibrat"):
        BeltLines().align(other.peaks(other.rest_px()).peaks, rig.calibration(), moved_rig)


def test_a_skeins_volume_stays_when_the_camera_turns_or_zooms_a_little() -> None:
    recipe = roemetry.Recipe.load(HOME / "with_outline.yaml", sets=["uncertainty=none"])
    still = _volume(recipe, 0.0, 1.0)
    assert [reason.code for reason in still.reasons if reason.code == "moved"] == []
    for turn_deg, scale, said in (
        (0.4, 1.0, "turned by 0.4"),
        (0.0, 0.995, "shrunk by 0.5"),
        (0.15, 1.001, "turned by 0.15"),
    ):
        moved = _volume(recipe, turn_deg, scale)
        texts = [reason.text for reason in moved.reasons if reason.code == "moved"]
        assert len(texts) == 1 and said in texts[0]
        assert abs(moved.volume.visible_mm3.value / still.volume.visible_mm3.value - 1.0) < 0.004
    for turn_deg, scale, said in ((1.0, 1.0, "turned by 1.0"), (0.0, 0.985, "shrunk by 1.5")):
        row = _volume(recipe, turn_deg, scale)
        assert row.status == "failed" and row.volume is None
        assert any(said in reason.text for reason in row.reasons)


def _volume(recipe: roemetry.Recipe, turn_deg: float, scale: float):
    """Measure the first skein, its images turned clockwise about their middle and scaled."""
    images = []
    for folder in ("images", "images_plain"):
        image = cv2.imread(str(next(iter(sorted((HOME / folder).glob("*01*.png"))))), cv2.IMREAD_UNCHANGED)
        rows, columns = image.shape[:2]
        turn = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), -turn_deg, scale)
        how = {"flags": cv2.INTER_LANCZOS4, "borderMode": cv2.BORDER_REFLECT}
        images.append(cv2.warpAffine(image, turn, (columns, rows), **how))
    return recipe.measure(images[0], plain=images[1], name="skein")[0]


@pytest.mark.parametrize("lost_rows", [4, 20])
def test_a_frame_that_lost_rows_is_refused_and_says_where(lost_rows: int, rng: np.random.Generator) -> None:
    rig = LinearRig()
    x_px = rig.x_px(rig.dome(16.0)) + rng.normal(0.0, 0.05, (rig.stripes, rig.rows))
    torn = np.concatenate([x_px[:, :70], x_px[:, 70 + lost_rows :], x_px[:, -lost_rows:]], axis=1)
    BeltLines().align(rig.peaks(x_px).peaks, rig.calibration(), moved_rig)
    with pytest.raises(StageError, match="between the rows 69 and 70"):
        BeltLines().align(rig.peaks(torn).peaks, rig.calibration(), moved_rig)


def test_a_frame_that_begins_anew_on_the_belt_is_refused(rng: np.random.Generator) -> None:
    rig = LinearRig()
    rest = rig.rest_px() + 0.01 * np.arange(rig.rows)
    x_px = rest + rng.normal(0.0, 0.05, rest.shape)
    torn = np.concatenate([x_px[:, :150], x_px[:, : rig.rows - 150]], axis=1)
    lines, start = np.ascontiguousarray(rest.T), rig.peaks(torn).peaks
    whole = rig.peaks(x_px).peaks
    assert tear_of(whole.row_start, whole.x_px, whole.amplitude, lines, 12.0) is None
    found = tear_of(start.row_start, start.x_px, start.amplitude, lines, 12.0)
    assert found is not None and found.row == 149 and abs(found.jump_px - 1.5) < 0.1


@pytest.mark.parametrize(("lost_rows", "turned"), [(12, 0.0), (12, 0.0015), (0, 0.0), (0, 0.0015)])
def test_lines_that_lean_show_rows_that_were_lost_on_a_level_product(
    lost_rows: int, turned: float, rng: np.random.Generator
) -> None:
    rig = LinearRig(rows=480)
    row = np.arange(rig.rows)
    lines = np.ascontiguousarray((rig.rest_px() + 0.0125 * row).T)
    taken = row + np.where(row < 200, 0, lost_rows)
    x_px = rig.rest_px() + 0.0125 * taken + turned * row + rng.normal(0.0, 0.1, (rig.stripes, rig.rows))
    peaks = rig.peaks(x_px).peaks
    found = tear_of(peaks.row_start, peaks.x_px, peaks.amplitude, lines, 12.0)
    if not lost_rows:
        assert found is None
    else:
        assert found is not None and found.of_belt
        assert abs(found.row - 199) < 16 and abs(found.jump_px - 0.15) < 0.05


def test_few_stripes_beside_a_product_shift_by_chance_farther_than_many(rng: np.random.Generator) -> None:
    """Speckle displaces three stripes together by more than it does fifteen."""
    rig = LinearRig(rows=480, stripes=15)
    lines = np.ascontiguousarray(rig.rest_px().T)
    for _ in range(20):
        grain = gaussian_filter1d(rng.normal(0.0, 1.0, (rig.stripes, rig.rows)), 3.0, axis=1)
        x_px = rig.rest_px() + 0.12 * grain / grain.std()
        x_px[3:, 180:300] = np.nan
        peaks = rig.peaks(x_px).peaks
        assert tear_of(peaks.row_start, peaks.x_px, peaks.amplitude, lines, 12.0) is None


@pytest.mark.parametrize(("lost_rows", "torn"), [(5, True), (5, False), (0, False)])
def test_a_small_shift_is_a_tear_where_the_grain_breaks_off_too(
    lost_rows: int, torn: bool, rng: np.random.Generator
) -> None:
    """Five lost rows, or a belt that lies aside by as much below with a grain that goes on."""
    rig = LinearRig(rows=480)
    row = np.arange(rig.rows)
    lines = np.ascontiguousarray((rig.rest_px() + 0.0125 * row).T)
    grain = gaussian_filter1d(rng.normal(0.0, 1.0, (2, rig.stripes, rig.rows + lost_rows)), 0.9, axis=2)
    taken = row + np.where(row < 200, 0, lost_rows)
    moved, brighter = grain[:, :, taken if torn else row] / grain.std()
    x_px = rig.rest_px() + 0.0125 * taken + 0.05 * moved
    found = rig.peaks(x_px)
    bright = 160.0 * np.exp(0.05 * brighter)[found.stripe, found.peaks.row]
    tear = tear_of(found.peaks.row_start, found.peaks.x_px, bright, lines, 12.0)
    assert (tear is not None) == torn
    if tear is not None:
        assert (tear.row, tear.of_belt) == (199, True) and tear.jump_px < 0.08


def test_a_step_that_stripes_cross_one_after_another_and_whole_pixels_are_no_tear(
    rng: np.random.Generator,
) -> None:
    rig = LinearRig()
    height = rig.dome(4.0)
    for stripe in range(1, rig.stripes - 1):
        height[stripe, 70 + stripe : 130] += 5.0
    step_px = rig.x_px(height) + rng.normal(0.0, 0.05, height.shape)
    for x_px in (step_px, np.rint(rig.x_px(rig.dome(3.0)))):
        found = BeltLines().align(rig.peaks(x_px).peaks, rig.calibration(), moved_rig)
        assert "belt-not-seen" not in [reason.code for reason in found.reasons]
