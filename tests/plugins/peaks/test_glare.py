"""Overexposed stripes in glare: a row shows one run of light, the rows above and below tell the stripe."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import Frame, Sensor
from roemetry.stages.registry import discover

ROWS, COLUMNS, SIGMA_PX, GAIN = 120, 260, 2.0, 0.0255
GLARE = slice(50, 64)
NAMES = ("centre-of-gravity", "fir-zero-crossing", "gaussian", "log-parabola")


def extractor(name: str):
    registry = discover()
    return registry.load(next(s for s in registry.of_kind("extractor") if s.entry.name == name))()


def drawn(
    rng: np.random.Generator, lean: float, level: float, wide_px: int, left: bool
) -> tuple[Frame, np.ndarray]:
    """Three overexposed stripes, (stripe, row) their centres; beside the middle one some rows have glare."""
    row = np.arange(ROWS)
    centre_px = np.array([50.0, 130.0, 210.0])[:, None] + lean * (row - ROWS / 2)
    x = np.arange(COLUMNS)
    light = sum(600.0 * np.exp(-0.5 * ((x - c[:, None]) / SIGMA_PX) ** 2) for c in centre_px)
    off = (x - centre_px[1][:, None]) * (-1 if left else 1)
    light[GLARE] = np.maximum(light, np.where((off > 0) & (off < wide_px), level, 0.0))[GLARE]
    noisy = rng.poisson((10.0 + light) / GAIN) * GAIN + rng.normal(0.0, 1.0, light.shape)
    pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return Frame(pixels, sensor=Sensor(gain_grey_per_electron=GAIN, read_noise_grey=1.0)), centre_px


@pytest.mark.parametrize("left", [False, True], ids=["right", "left"])
@pytest.mark.parametrize(("level", "wide_px"), [(190.0, 25), (400.0, 25), (400.0, 50)])
@pytest.mark.parametrize("name", NAMES)
def test_a_stripe_goes_on_through_glare(name, level, wide_px, left, rng) -> None:
    """Glare darker than white, as white as the stripe, and wider than any stripe may be."""
    frame, centre_px = drawn(rng, 0.7, level, wide_px, left)
    peaks = extractor(name).extract(frame)
    assert (np.bincount(peaks.row, minlength=ROWS) == 3).all()
    off = peaks.x_px - centre_px[np.arange(len(peaks)) % 3, peaks.row]
    middle = np.arange(len(peaks)) % 3 == 1
    inside = middle & (peaks.row >= GLARE.start) & (peaks.row < GLARE.stop)
    assert np.abs(off[inside]).max() < 1.5  # px; half of the run of light is 10 to 26 px beside
    assert np.abs(off[~inside]).max() < 0.15
    assert np.median(peaks.x_std_px[inside]) > 1.0
    assert (peaks.flags < 16).all()


@pytest.mark.parametrize("name", NAMES)
def test_what_grows_wide_on_both_sides_is_wide(name, rng) -> None:
    """An overexposed blob: no flank goes on, so nothing says that it is a narrow stripe."""
    frame, _ = drawn(rng, 0.0, 400.0, 14, False)
    pixels = np.maximum(frame.pixels, drawn(rng, 0.0, 400.0, 14, True)[0].pixels)
    peaks = extractor(name).extract(Frame(pixels, sensor=frame.sensor))
    inside = (np.abs(peaks.x_px - 130.0) < 20.0) & (peaks.row >= GLARE.start) & (peaks.row < GLARE.stop)
    assert inside.sum() == GLARE.stop - GLARE.start
    assert (peaks.width_px[inside] > 20.0).all()
    assert np.abs(peaks.x_px[inside] - 130.0).max() < 1.0


@pytest.mark.parametrize("name", NAMES)
def test_a_stripe_that_is_not_overexposed_is_left_alone(name, rng) -> None:
    """Half as bright, with a shoulder: what the row shows is what is given."""
    frame, _ = drawn(rng, 0.0, 120.0, 20, False)
    peaks = extractor(name).extract(Frame((frame.pixels // 2).astype(np.uint8)))
    assert peaks.width_px.max() < 8.0
