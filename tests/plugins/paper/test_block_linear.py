"""The block calibration gives back the rig it was drawn with, or says why it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import CalibrationError
from roemetry.records import Block, CalibrationSet, Frame, Observation
from roemetry.testing import LinearRig
from roemetry_paper.block_calibrator import BlockCalibrator, BlockCalibratorOptions
from roemetry_paper.block_linear import BlockLinear
from roemetry_paper.dominant_peak import DominantPeak, DominantPeakOptions

BLOCK = Block("test", length_mm=100.0, width_mm=20.0, height_mm=10.0, tolerance_mm=0.02)
FIRST, LAST = 80, 160  # rows of the block's top: 20 mm at 0.25 mm/px


def block_heights(rig, first: int = FIRST, last: int = LAST) -> np.ndarray:
    heights = np.zeros((rig.stripes, rig.rows))
    heights[:, first:last] = BLOCK.height_mm
    return heights


def observed(rig, rng, *, belt: bool = True, heights: np.ndarray | None = None, **changes) -> CalibrationSet:
    extractor = DominantPeak(DominantPeakOptions(threshold=60, start="lowest"))

    def observation(shows: str, over: np.ndarray) -> Observation:
        frame = Frame(rig.image(rig.x_px(over), rng), name=f"{shows}.png")
        return Observation(shows, frame, extractor.extract(frame))

    seen = [observation("block", block_heights(rig) if heights is None else heights)]
    if belt:
        seen.append(observation("belt", np.zeros((rig.stripes, rig.rows))))
    given = {
        "observations": tuple(seen),
        "stripe_count": rig.stripes,
        "block": BLOCK,
        "working_distance_mm": None,
        "extractor": {"use": "dominant-peak"},
    }
    return CalibrationSet(**(given | changes))


@pytest.mark.parametrize("belt", [True, False], ids=["with belt image", "without"])
@pytest.mark.parametrize("side", [1, -1], ids=["laser one side", "other side"])
def test_the_rig_comes_back(rig, rng, belt: bool, side: int) -> None:
    rig = replace(rig, px_per_mm=side * rig.px_per_mm)
    made = BlockCalibrator().calibrate(observed(rig, rng, belt=belt))
    np.testing.assert_allclose(made.parameters["omega_mm_per_px"], side * 0.5, rtol=0, atol=0.01)
    np.testing.assert_allclose(made.displacement_px_per_mm, side * 2.0, rtol=0, atol=0.05)
    np.testing.assert_allclose(made.rest_px[:, 0], rig.rest_px, rtol=0, atol=0.3)
    np.testing.assert_allclose(made.parameters["mm_per_px"], rig.mm_per_px, rtol=0, atol=0.004)
    assert made.height_range_mm == (0.0, 15.0)


def test_a_displacement_of_more_than_a_spacing_is_told_by_order(rig, rng) -> None:
    rig = replace(rig, px_per_mm=4.6)  # 46 px at a spacing of 40
    x_px = rig.x_px(block_heights(rig))
    assert x_px[-1].max() > rig.columns, "the last stripe leaves the image; so use one less"
    rig = replace(rig, stripes=6)
    made = BlockCalibrator().calibrate(observed(rig, rng))
    np.testing.assert_allclose(made.displacement_px_per_mm, 4.6, rtol=0, atol=0.05)


def test_the_scale_is_taken_down_to_the_belt_by_the_working_distance(rig, rng) -> None:
    options = BlockCalibratorOptions(height_max_factor=2.5)
    near = BlockCalibrator(options).calibrate(observed(rig, rng, working_distance_mm=200.0))
    assert near.height_range_mm == (0.0, 25.0)
    unknown = BlockCalibrator().calibrate(observed(rig, rng))
    ratio = near.parameters["mm_per_px"][0] / unknown.parameters["mm_per_px"][0]
    assert ratio == pytest.approx(200.0 / 190.0, abs=2e-3)
    assert near.residuals["scale_relative_std"] < 0.01
    assert unknown.residuals["scale_relative_std"] > 0.05, "what is not known stands in the budget"
    assert any("working distance is not known" in note for note in unknown.notes)


@pytest.mark.parametrize(
    "belt",
    [pytest.param(True, id="with belt image"), pytest.param(False, id="without", marks=pytest.mark.thorough)],
)
def test_heights_from_the_belt_up_scatter_as_stated(rng, belt: bool) -> None:
    """Exact stripes on levels of 0, 5 and 10 mm, by forty calibrations, against redraws of one of them."""
    rig = LinearRig()
    flat = np.zeros((rig.stripes, rig.rows))
    exact = replace(BLOCK, tolerance_mm=0.0)

    def seen(heights: np.ndarray, shows: str) -> Observation:
        x_px = rig.x_px(heights) + rng.normal(0.0, 0.2, flat.shape)
        frame = Frame(np.zeros((rig.rows, rig.columns), np.uint8), name=shows)
        return Observation(shows, frame, rig.peaks(x_px).peaks)

    def made():
        views = [seen(block_heights(rig), "block")]
        views += [seen(flat, "belt")] if belt else []
        return BlockCalibrator().calibrate(
            CalibrationSet(tuple(views), rig.stripes, exact, 300.0, {"use": "exact"})
        )

    def heights(calibration) -> np.ndarray:
        found = []
        for level in (0.0, 5.0, 10.0):
            rest_px = calibration.rest_line_px(np.arange(rig.rows, dtype=np.float64))
            stripes = replace(rig.stripe_map(flat + level), rest_px=rest_px)
            found.append(BlockLinear().triangulate(stripes, calibration).xyz_mm[:, [20, 100, 180], 2])
        return np.array(found)

    first = made()
    stated = np.std([heights(one) for one, _ in zip(first.redraws(rng), range(200), strict=False)], axis=0)
    scatter = np.std([heights(made()) for _ in range(40)], axis=0, ddof=1)
    ratio = np.sqrt((scatter**2).mean(axis=(1, 2)) / (stated**2).mean(axis=(1, 2)))
    assert (stated[0] > 0.001).all(), "mm: the belt's zero is uncertain"
    if belt:
        assert ratio == pytest.approx(1.0, abs=0.25)
    else:
        assert (ratio < 1.25).all(), "how many rows of belt were used is not known: stated with the fewest"


def test_the_lens_is_taken_out_where_it_bows_the_belts_lines(rng) -> None:
    """A barrel that displaces the image's corners by 2.5 %: heights away from the block's rows come back."""
    rig = LinearRig(rows=480)
    kappa, row = -2e-7, np.arange(rig.rows, dtype=np.float64)
    half = np.array([(rig.columns - 1) / 2.0, (rig.rows - 1) / 2.0])
    flat = np.zeros((rig.stripes, rig.rows))

    def lines(height_mm: float) -> np.ndarray:
        straight = np.linspace(-1.2 * half[1], 1.2 * half[1], 2000)
        found = []
        for x_px in rig.x_px(flat + height_mm)[:, 0] - half[0]:
            shrunk = 1.0 + kappa * (x_px**2 + straight**2)
            found.append(np.interp(row - half[1], straight * shrunk, x_px * shrunk) + half[0])
        return np.array(found)

    def seen(x_px: np.ndarray, shows: str) -> Observation:
        frame = Frame(np.zeros((rig.rows, rig.columns), np.uint8), name=shows)
        return Observation(shows, frame, rig.peaks(x_px + rng.normal(0.0, 0.02, flat.shape)).peaks)

    top = np.where((row >= 200) & (row < 280), lines(BLOCK.height_mm), lines(0.0))
    exact = replace(BLOCK, tolerance_mm=0.0)
    views = (seen(top, "block"), seen(lines(0.0), "belt"))
    made = BlockCalibrator().calibrate(CalibrationSet(views, rig.stripes, exact, None, {"use": "exact"}))
    for level in (0.0, 5.0, 10.0):
        stripes = replace(rig.stripe_map(flat), x_px=lines(level), rest_px=made.rest_line_px(row))
        found = BlockLinear().triangulate(stripes, made).xyz_mm[:, :, 2]
        np.testing.assert_allclose(found, level, rtol=0, atol=0.03)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"block": None}, "its three sides are unknown"),
        ({"stripe_count": 9}, "9 stripes are expected on the empty belt, 7 are seen"),
        ({"working_distance_mm": 12.0}, "working_distance_mm is 12"),
        ({"observations": ()}, "no image of the block"),
        ({"belt": False, "stripe_count": 9}, r"block.png: 9 stripes are expected; 7 begin"),
    ],
)
def test_refusals(rig, rng, change: dict[str, object], says: str) -> None:
    with pytest.raises(CalibrationError, match=says):
        BlockCalibrator().calibrate(observed(rig, rng, **change))


@pytest.mark.parametrize(
    ("stripes", "share", "says"),
    [
        (slice(None), 0.0, "block was not found in block.png"),
        (slice(-2, None), 0.0, "stripe 6, 7 is not seen on the block"),
        (slice(3, 4), 1.2, "stripe 4 does not fit the fan"),
    ],
)
def test_blocks_that_cannot_be_used_are_named(rig, rng, stripes, share, says) -> None:
    heights = block_heights(rig)
    heights[stripes] *= share
    with pytest.raises(CalibrationError, match=says):
        BlockCalibrator().calibrate(observed(rig, rng, heights=heights))


def test_an_outer_stripe_that_misses_the_block_is_taken_from_the_fan(rig, rng) -> None:
    heights = block_heights(rig)
    heights[-1] = 0.0
    exact = replace(BLOCK, tolerance_mm=0.0)
    made = BlockCalibrator().calibrate(observed(rig, rng, heights=heights, block=exact))
    assert any("stripe 7 misses the block" in note for note in made.notes)
    assert made.displacement_px_per_mm[-1] == pytest.approx(2.0, abs=0.05), "px/mm"
    assert made.covariance[6, 6] > 2.0 * made.covariance[3, 3], "and is less certain"
