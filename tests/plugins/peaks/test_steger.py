"""steger: stripes of any lean, to a hundredth of a pixel, up to where they end."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import Frame, Peaks
from roemetry_peaks.steger import Steger, StegerOptions

ROWS, COLUMNS, SIGMA_PX = 160, 240, 1.8
AWAY = 8  # rows and columns at the border that are not asked


def leaning(slope: float, rng: np.random.Generator, noise: float = 1.2) -> tuple[np.ndarray, np.ndarray]:
    """An image of parallel stripes 40 px apart (across them), and (stripe, row) their centres."""
    across = np.hypot(1.0, slope)
    step = 40.0 * across
    first = -np.ceil(slope * ROWS / step) * step + 17.3
    start = np.arange(first, COLUMNS + step, step)
    x_px = start[:, None] + slope * np.arange(ROWS)[None, :]
    y, x = np.mgrid[:ROWS, :COLUMNS]
    off = (x[None] - start[:, None, None] - slope * y[None]) / across
    light = 12.0 + 150.0 * np.exp(-0.5 * (off / SIGMA_PX) ** 2).sum(0)
    return np.clip(np.rint(light + rng.normal(0.0, noise, light.shape)), 0, 255).astype(np.uint8), x_px


def inside(peaks: Peaks) -> np.ndarray:
    return (np.abs(peaks.row - (ROWS - 1) / 2) < ROWS / 2 - AWAY) & (
        np.abs(peaks.x_px - (COLUMNS - 1) / 2) < COLUMNS / 2 - AWAY
    )


def test_a_stripe_of_beads_has_no_gaps() -> None:
    """As long as the blocks of a JPEG, and darker in between by four fifths."""
    y, x = np.mgrid[:ROWS, :120]
    light = 20.0 + 140.0 * (1.0 - 0.65 * np.cos(np.pi * y / 4.0)) * np.exp(-0.5 * ((x - 60.3) / 1.2) ** 2)
    peaks = Steger().extract(Frame(np.clip(np.rint(light), 0, 255).astype(np.uint8)))
    assert np.unique(peaks.row).size == ROWS
    assert np.abs(peaks.x_px - 60.3).max() < 0.1


@pytest.mark.parametrize("slope", [0.0, -0.5, 1.0, -2.5, 6.0])
def test_leaning_stripes_are_where_they_are(slope: float, rng: np.random.Generator) -> None:
    pixels, x_px = leaning(slope, rng)
    peaks = Steger().extract(Frame(pixels))
    here = inside(peaks)
    off = peaks.x_px[:, None] - x_px[:, peaks.row].T
    error = np.take_along_axis(off, np.abs(off).argmin(1)[:, None], axis=1)[here, 0] / np.hypot(1.0, slope)
    rows = np.arange(AWAY, ROWS - AWAY)
    asked = int((np.abs(x_px[:, rows] - (COLUMNS - 1) / 2) < COLUMNS / 2 - AWAY).sum())
    assert abs(here.sum() - asked) <= 0.01 * asked + 2
    assert np.sqrt((error**2).mean()) < 0.015
    assert abs(error.mean()) < 0.003
    assert np.median(peaks.width_px[here]) == pytest.approx(2.355 * SIGMA_PX * np.hypot(1.0, slope), rel=0.05)
    assert np.median(peaks.amplitude[here]) == pytest.approx(150.0, rel=0.05)


def test_a_region_and_a_threshold_do_as_told(rng: np.random.Generator) -> None:
    pixels, _ = leaning(0.5, rng)
    whole = Steger().extract(Frame(pixels))
    part = Steger(StegerOptions(region=(40, 120, 50, 200))).extract(Frame(pixels))
    shown = (part.row >= 55) & (part.row < 105) & (np.abs(part.x_px - 125) < 55)
    same = (whole.row >= 55) & (whole.row < 105) & (np.abs(whole.x_px - 125) < 55)
    assert np.abs(part.x_px[shown] - whole.x_px[same]).max() < 1e-6
    assert len(Steger(StegerOptions(threshold=200.0)).extract(Frame(pixels))) == 0


@pytest.mark.parametrize("lean", [-0.6, 0.15, 0.9])
def test_ridges_go_on_to_the_first_and_the_last_row(lean: float, rng: np.random.Generator) -> None:
    """Stripes that lean and bow, 1 px over 9 rows, at both ends: every row of theirs has its peak."""
    row = np.arange(ROWS)
    from_end = np.minimum(row, ROWS - 1 - row)
    x_px = np.array([80.0, 160.0])[:, None] + lean * (row - ROWS / 2) + from_end**2 / 81.0 * (from_end < 9)
    x_px += (from_end >= 9) * 1.0
    light = sum(np.exp(-0.5 * ((np.arange(COLUMNS) - c[:, None]) / SIGMA_PX) ** 2) for c in x_px)
    level = 12.0 + 150.0 * light + rng.normal(0.0, 1.2, light.shape)
    peaks = Steger().extract(Frame(np.clip(np.rint(level), 0, 255).astype(np.uint8)))
    for ends in (row[:4], row[-4:]):
        for y in ends:
            there = [x for x in x_px[:, y] if AWAY < x < COLUMNS - AWAY]
            found = peaks.x_px[(peaks.row == y) & (peaks.x_px > AWAY) & (peaks.x_px < COLUMNS - AWAY)]
            assert found.size == len(there)
            assert np.abs(found - there).max(initial=0.0) < 0.25


def test_a_speck_beyond_a_stripes_end_is_no_more_of_it(rng: np.random.Generator) -> None:
    pixels, x_px = leaning(0.5, rng)
    pixels[:4] = 12
    pixels[2, np.rint(x_px[3, 2]).astype(int)] = 200
    peaks = Steger().extract(Frame(pixels))
    assert (peaks.row >= 3).all()
