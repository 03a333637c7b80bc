"""Overexposed stripes that leave the image, and ripples beside stripes that take no light away from them."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import EDGE, SATURATED, Frame, Sensor
from roemetry.stages.registry import discover

ROWS, COLUMNS, SIGMA_PX, GAIN = 160, 140, 2.0, 0.0255
NAMES = ("centre-of-gravity", "fir-zero-crossing", "gaussian", "log-parabola")


def extractor(name: str):
    registry = discover()
    return registry.load(next(s for s in registry.of_kind("extractor") if s.entry.name == name))()


def drawn(rng: np.random.Generator, lean: float, height: float = 600.0) -> tuple[Frame, np.ndarray]:
    """Two stripes of which the left one leaves the image, and (row,) its centres."""
    centre_px = rng.uniform(20.0, 20.5) - lean * np.arange(ROWS)
    off = (np.arange(COLUMNS) - centre_px[:, None]) / SIGMA_PX
    light = height * (np.exp(-0.5 * off**2) + np.exp(-0.5 * (off - 50.0 / SIGMA_PX - 10.0) ** 2))
    noisy = rng.poisson((10.0 + light) / GAIN) * GAIN + rng.normal(0.0, 1.0, light.shape)
    pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return Frame(pixels, sensor=Sensor(gain_grey_per_electron=GAIN, read_noise_grey=1.0)), centre_px


@pytest.mark.parametrize("turned", [False, True], ids=["left, downwards", "right, upwards"])
@pytest.mark.parametrize("lean", [0.15, 0.4])
@pytest.mark.parametrize("name", NAMES)
def test_a_stripe_is_given_until_its_middle_has_left(name, lean, turned, rng) -> None:
    off, stated, given, wanted = [], [], 0, 0
    for _ in range(6):
        frame, centre_px = drawn(rng, lean)
        if turned:
            frame = Frame(np.ascontiguousarray(frame.pixels[::-1, ::-1]), sensor=frame.sensor)
        peaks = extractor(name).extract(frame)
        row = ROWS - 1 - peaks.row if turned else peaks.row
        x_px = COLUMNS - 1 - peaks.x_px if turned else peaks.x_px
        left = x_px < 1.0
        assert (np.bincount(row[x_px < 30.0], minlength=ROWS) <= 1).all()
        assert (peaks.flags[left] & EDGE != 0).all()
        off.append((x_px - centre_px[row])[left])
        stated.append(peaks.x_std_px[left])
        inside = (centre_px > -0.3) & (centre_px < 1.0)
        wanted += inside.sum()
        given += np.isin(row[left], np.flatnonzero(inside)).sum()
    away, std = np.concatenate(off), np.concatenate(stated)
    assert given >= 0.9 * wanted
    assert np.abs(away).max() < 0.2  # px: so nothing is given where the middle is outside
    assert 0.8 < np.sqrt((std**2).mean() / (away**2).mean()) < 2.0


@pytest.mark.parametrize("name", NAMES)
def test_without_a_sensor_nothing_is_stated(name, rng) -> None:
    frame, _ = drawn(rng, 0.3)
    peaks = extractor(name).extract(Frame(frame.pixels))
    left = peaks.x_px < 1.0
    assert (peaks.flags[left] == EDGE | SATURATED).any()
    assert np.isnan(peaks.x_std_px).all()


@pytest.mark.parametrize("name", NAMES)
def test_a_stripe_that_is_not_overexposed_is_not_followed(name, rng) -> None:
    frame, centre_px = drawn(rng, 0.3, height=150.0)
    peaks = extractor(name).extract(frame)
    left = peaks.x_px < 20.0
    assert centre_px[peaks.row[left]].min() > -0.2


@pytest.mark.parametrize("ripple_px", [3, 4, 5])
@pytest.mark.parametrize("name", [name for name in NAMES if name != "fir-zero-crossing"])
def test_a_ripple_takes_no_light_from_a_wide_stripe(name, ripple_px) -> None:
    """Black beside a wide top that is highest at one end, and at the other a ripple of nine grey levels."""
    pixels = np.zeros((ROWS, COLUMNS), np.uint8)
    pixels[:, 40:49] = [60, 183, 255, 245, 246, 245, 246, 193, 163]
    pixels[:, 47 + ripple_px : 51 + ripple_px] = [4, 9, 9, 4]
    pixels[:, 90:97] = [20, 80, 190, 250, 190, 80, 20]
    peaks = extractor(name).extract(Frame(pixels))
    near = np.abs(peaks.x_px - 44.4) < 0.9
    assert (np.bincount(peaks.row[near], minlength=ROWS) == 1).all()
    assert len(peaks) == 2 * ROWS
    assert np.abs(peaks.width_px[near] - 8.0).max() < 0.5
