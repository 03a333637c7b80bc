"""Lines of two colours: peaks of each from its channel, labels where one colour leaves doubt, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry import Recipe
from roemetry.config.rig import Rig
from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Acquisition, Frame
from roemetry.run.preprocess import prepare
from roemetry.testing import LinearRig
from roemetry.testing.scenes import frame_of
from roemetry_coding.two_families import TwoFamilies
from roemetry_peaks.two_channels import TwoChannels

COLOURS = Path("recipes/potato_two_colours")
RIG = LinearRig(stripes=14, spacing_px=18.0)


def _colours(height_mm: float, leak: float = 0.0) -> Frame:
    """Give a frame whose odd lines are in the second channel, on a dome."""
    x_px = RIG.x_px(RIG.dome(height_mm))
    odd = (np.arange(RIG.stripes) % 2 == 1)[:, None]
    one, other = (RIG.light(np.where(odd == which, x_px, np.nan)) - RIG.background for which in (False, True))
    first, second = one + leak * other + RIG.background, other + leak * one + RIG.background
    return replace(frame_of(first), second=frame_of(second).pixels)


def test_each_peak_is_of_the_channel_it_was_found_in_and_what_a_filter_passes_is_none() -> None:
    clean, leaking = (TwoChannels().extract(_colours(4.0, leak)) for leak in (0.0, 0.08))
    assert clean.family is not None
    assert leaking.family is not None
    for peaks in (clean, leaking):
        true = RIG.x_px(RIG.dome(4.0))[:, peaks.row]
        stripe = np.abs(true - peaks.x_px).argmin(axis=0)
        assert (stripe % 2 == peaks.family).all()
        assert len(peaks) == RIG.stripes * RIG.rows


def test_lines_of_two_colours_are_told_apart_where_those_of_one_are_not() -> None:
    # 12 mm move a line by 24 px: past its neighbour at 18 px, not past that of its colour at 36 px
    calibration = RIG.calibration()
    peaks = TwoChannels().extract(_colours(12.0))
    true = np.abs(RIG.x_px(RIG.dome(12.0))[:, peaks.row] - peaks.x_px).argmin(axis=0)
    coded = TwoFamilies().code(peaks, calibration)
    wrong = (coded.peak_stripe >= 0) & (coded.peak_stripe != true)
    assert not wrong.any()
    assert (coded.peak_stripe == true).mean() > 0.98


def test_a_run_that_lies_off_the_other_colour_is_refused() -> None:
    peaks = TwoChannels().extract(_colours(0.0))
    # in rows 60 to 100 the fifth line stands where its own colour's neighbour belongs, as a wrong label would
    own = RIG.x_px(RIG.dome(0.0))
    moved = (np.abs(own[4, peaks.row] - peaks.x_px) < 1.0) & (peaks.row >= 60) & (peaks.row < 100)
    x_px = np.where(moved, peaks.x_px + 24.0, peaks.x_px)
    order = np.lexsort((x_px, peaks.row))
    shuffled = peaks.some(order, x_px=x_px[order])
    coded = TwoFamilies().code(shuffled, RIG.calibration())
    assert not (coded.peak_stripe[moved[order]] == 4).any()


def test_two_colours_are_for_lines_and_for_colour_images() -> None:
    assert Scene.load(COLOURS / "simulated.yaml").simulator.options.laser.colours == 2
    with pytest.raises(ConfigurationError, match="two colours are for lines"):
        Rig.load(COLOURS / "rig.yaml", sets=["pattern={kind: circles, lines_x: 9, colours: 2}"])
    with pytest.raises(ConfigurationError, match="contrast is for light of one colour"):
        Recipe.load(COLOURS, sets=["source.contrast=red"])
    with pytest.raises(ConfigurationError, match="channel must be another colour, not grey"):
        Rig.load(COLOURS / "rig.yaml", sets=["channel=grey"])
    grey = Acquisition("a", (Frame(np.zeros((20, 30), np.uint8)),))
    with pytest.raises(DataError, match="has no colours, of which `second_channel` is one"):
        prepare(grey, channel="red", second_channel="green", turn_deg=0, subtract="none")


def test_a_body_that_both_colours_take_for_a_line_off_is_doubted_by_all_lines_together() -> None:
    peaks = TwoChannels().extract(_colours(4.0))
    x_px = RIG.x_px(RIG.dome(4.0))[:, peaks.row]
    true = np.abs(x_px - peaks.x_px).argmin(axis=0)
    on_body = RIG.dome(4.0)[true, peaks.row] > 1.0
    wrong = np.where(on_body & (true < RIG.stripes - 2), true + 2, true)
    doubted = TwoFamilies()._doubted(peaks, wrong, RIG.calibration())
    assert doubted[wrong != true].all()
    assert not TwoFamilies()._doubted(peaks, true, RIG.calibration()).any()
