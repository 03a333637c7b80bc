"""One line: followed through reflections and gaps, on a belt or without; of two as good, refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, BELT, Peaks
from roemetry.records.arrays import Floats
from roemetry.records.calibration import ON_BOARD
from roemetry.testing import LinearRig
from roemetry_coding.single import Single, SingleOptions, brightest_path

RIG = LinearRig(stripes=1, first_px=120.0)


def peaks_of(*lines: tuple[Floats, float]) -> Peaks:
    """Peaks of lines, each by its (row,) x, NaN where it is not seen, and its amplitude."""
    found = sorted(
        (row, x, amplitude)
        for x_px, amplitude in lines
        for row, x in enumerate(x_px.tolist())
        if np.isfinite(x)
    )
    row, x_px, amplitude = (np.array(values) for values in zip(*found, strict=True))
    same, none = np.ones(row.size), np.zeros(row.size, np.uint8)
    size = (RIG.rows, RIG.columns)
    return Peaks(size, row, x_px, 0.1 * same, amplitude, 10.0 * same, 4.0 * same, none)


def bump() -> Floats:
    """(row,) of a line over a body of 20 px displacement, upright at its ends."""
    x_px = np.full(RIG.rows, 120.0)
    x_px[60:140] += 20.0 + 3.0 * np.sin(np.linspace(0.0, np.pi, 80))
    return x_px


def test_the_line_is_followed_through_reflections_and_gaps(rng: np.random.Generator) -> None:
    line = bump()
    line[90:94] = np.nan
    stray = np.where(rng.random(RIG.rows) < 0.3, rng.uniform(0.0, RIG.columns - 1.0, RIG.rows), np.nan)
    peaks = peaks_of((line, 100.0), (stray, 60.0))
    found = Single().code(peaks, RIG.calibration())
    on_line = np.isclose(peaks.x_px, line[peaks.row])
    assert not (found.peak_stripe[~on_line] == 0).any(), "no reflection is given the stripe"
    assert (found.peak_stripe[on_line] == 0).mean() > 0.98
    assert (found.product[0, 62:88] == 1).all()
    assert (found.product[0, 5:55] == BELT).all()


def test_without_a_belt_all_is_one_product_but_for_brighter_glare() -> None:
    glare = np.full(RIG.rows, np.nan)
    glare[100:103] = 250.0
    peaks = peaks_of((bump(), 100.0), (glare, 200.0))
    for calibration in (None, replace(RIG.calibration(), reference=ON_BOARD)):
        found = Single().code(peaks, calibration)
        assert (found.peak_stripe[peaks.x_px == 250.0] != 0).all()
        assert (found.product[found.seen] == 1).all()
        assert np.isnan(found.rest_px).all()


def test_of_two_lines_as_bright_and_as_smooth_both_are_refused() -> None:
    other = bump() + 40.0
    found = Single(SingleOptions(margin_min=0.1)).code(peaks_of((bump(), 80.0), (other, 80.0)), None)
    assert (found.peak_stripe == 0).mean() < 0.02
    assert (found.peak_stripe == AMBIGUOUS).any()


def test_the_path_is_the_cheapest_of_all() -> None:
    x_px, amplitude = np.array([10.0, 30.0, 10.5, 31.0, 11.0]), np.array([5.0, 5.0, 4.0, 5.0, 5.0])
    path, dearer = brightest_path(np.array([0, 2, 4, 5]), x_px, amplitude)
    assert path.tolist() == [1, 0, 1, 0, 1]
    # 0.2 for the fainter peak and two steps of 0.5; through the other one a step of 1 and a jump of 1.5
    assert dearer[2] == pytest.approx(2.5 - 1.2, abs=1e-12)
    assert dearer[4] == pytest.approx(0.8 + 1.5, abs=1e-12), "there is no other peak in its row"


def test_several_stripes_and_too_few_rows_are_refused() -> None:
    with pytest.raises(StageError, match="7 stripes"):
        Single().code(peaks_of((bump(), 100.0)), LinearRig().calibration())
    few = np.full(RIG.rows, np.nan)
    few[:6] = 50.0
    with pytest.raises(StageError, match="10 are the least"):
        Single().code(peaks_of((few, 100.0)), None)


@pytest.mark.parametrize("frames", [1, 75, 1000])
def test_a_line_is_whole_however_many_dark_rows_are_left_out(frames: int) -> None:
    """58 of each frame's 216 rows show the line: costs of all others add up, and are rounded."""
    row = np.arange(216 * frames)
    shown = (row % 216 >= 70) & (row % 216 < 128)
    row_start = np.concatenate([[0], np.cumsum(shown)])
    at = row[shown]
    x_px = 100.0 + 30.0 * np.sin((at % 216 - 70) / 58.0 * np.pi)
    path, _ = brightest_path(row_start, x_px, 80.0 + 20.0 * np.sin(0.37 * at))
    assert path.all()
