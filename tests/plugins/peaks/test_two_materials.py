"""A product with strong speckle on a belt with weak speckle: what is stated holds on each of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from roemetry.records import Frame, Sensor
from roemetry.stages.registry import discover

ROWS, COLUMNS, SIGMA_PX, GAIN = 480, 640, 2.0, 0.0255
BELT, PRODUCT = 0.08, 0.25


def drawn(rng: np.random.Generator) -> tuple[Frame, np.ndarray]:
    """An image, and (stripe, row) the centres in it."""
    row = np.arange(ROWS)
    centre_px = 53.0 * (np.arange(11)[:, None] + 1) + rng.uniform(-3.0, 3.0, (11, 1)) + 0.02 * row
    y, x = np.mgrid[:ROWS, :COLUMNS]
    light = sum(np.exp(-0.5 * ((x - c[:, None]) / SIGMA_PX) ** 2) for c in centre_px)
    contrast = np.where(on_product(y, x), PRODUCT, BELT)
    field = gaussian_filter(rng.standard_normal((ROWS, COLUMNS)), 0.8)
    speckle = np.exp(contrast * field / field.std() - 0.5 * contrast**2)
    level = rng.poisson((15.0 + 140.0 * light * speckle) / GAIN) * GAIN + rng.normal(0.0, 1.0, light.shape)
    pixels = np.clip(np.rint(level), 0, 255).astype(np.uint8)
    return Frame(pixels, sensor=Sensor(gain_grey_per_electron=GAIN, read_noise_grey=1.0)), centre_px


def on_product(row: np.ndarray, x_px: np.ndarray) -> np.ndarray:
    return np.hypot((row - ROWS / 2) / (0.35 * ROWS), (x_px - COLUMNS / 2) / (0.4 * COLUMNS)) < 1.0


NAMES = ["centre-of-gravity", "fir-zero-crossing", "gaussian", "log-parabola", "maximum-likelihood"]


@pytest.mark.parametrize("name", NAMES)
def test_each_material_is_stated_as_it_scatters(name, rng) -> None:
    """With one contrast for all of the image 1.5 and 0.45 times what comes out would be stated."""
    registry = discover()
    stage = registry.load(next(s for s in registry.of_kind("extractor") if s.entry.name == name))()
    error, stated, product = [], [], []
    for _ in range(3):
        frame, centre_px = drawn(rng)
        peaks = stage.extract(frame)
        off = peaks.x_px - centre_px[:, peaks.row]
        off = np.take_along_axis(off, np.abs(off).argmin(0)[None], axis=0)[0]
        good = (np.abs(off) < 3.0) & (peaks.flags == 0)
        error.append(off[good])
        stated.append(peaks.x_std_px[good])
        product.append(on_product(peaks.row, peaks.x_px)[good])
    errors, stds, inside = (np.concatenate(values) for values in (error, stated, product))
    assert inside.size > 10_000
    for part in (inside, ~inside):
        ratio = np.sqrt((stds[part] ** 2).mean() / (errors[part] ** 2).mean())
        assert 0.85 < ratio < 1.15
