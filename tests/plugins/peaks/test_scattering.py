"""Light from inside a product beside the stripe, and the same grey levels in 8 and 16 bit."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import Frame
from roemetry_peaks.centre_of_gravity import CentreOfGravity
from roemetry_peaks.gaussian import Gaussian
from roemetry_peaks.log_parabola import LogParabola
from roemetry_peaks.maximum_likelihood import MaximumLikelihood
from roemetry_peaks.steger import Steger
from roemetry_peaks.zero_crossing import ZeroCrossing
from tests.plugins.peaks.drawing import SENSOR, exposed, speckled


def stripe(rng: np.random.Generator, left: float, right: float, rows: int = 500) -> tuple[np.ndarray, ...]:
    """Profiles with a Gaussian peak, σ 1.8 px, on exponential skirts of these shares of its height."""
    centre = 60.0 + rng.uniform(-0.5, 0.5, (rows, 1))
    u = np.arange(120) - centre
    # The skirt's height drifts along the stripe, as tissue does.
    drift = 1.0 + 0.3 * np.sin(np.arange(rows)[:, None] / 40.0)
    skirt = np.where(u < 0, left, right) * drift * np.exp(-np.hypot(u, 2.0) / 3.5)
    return 12.0 + 180.0 * (np.exp(-0.5 * (u / 1.8) ** 2) + skirt), centre[:, 0]


@pytest.mark.parametrize("contrast", [0.12, 0.25])
def test_skirts_of_tissue_neither_pull_the_centre_nor_hide_in_what_is_stated(contrast, rng):
    mean, centre = stripe(rng, 0.2, 0.2)
    frame = Frame(exposed(speckled(mean - 12.0, contrast, rng) + 12.0, rng), sensor=SENSOR)
    peaks = MaximumLikelihood().extract(frame)
    error = peaks.x_px - centre[peaks.row]
    assert peaks.row.size > 490
    assert abs(np.median(error)) < 0.12  # px
    assert np.sqrt(np.mean(error**2)) < 0.9 * contrast + 0.1  # px
    assert np.mean(np.abs(error) < 1.96 * peaks.x_std_px) > 0.85


@pytest.mark.parametrize(
    "extractor", [LogParabola, CentreOfGravity, Gaussian, ZeroCrossing, MaximumLikelihood, Steger]
)
def test_8_and_16_bits_of_the_same_grey_levels_give_the_same_peaks(extractor, rng):
    mean, _ = stripe(rng, 0.1, 0.2, rows=200)
    image = exposed(speckled(mean - 12.0, 0.15, rng) + 12.0, rng)
    narrow, wide = (
        extractor(extractor.Options()).extract(Frame(pixels, sensor=SENSOR))
        for pixels in (image, image.astype(np.uint16))
    )
    for name in ("row", "x_px", "x_std_px", "amplitude", "background", "width_px", "flags"):
        np.testing.assert_array_equal(getattr(narrow, name), getattr(wide, name), err_msg=name)


@pytest.mark.parametrize("top", [150.0, 500.0], ids=["whole", "cut off at white"])
def test_a_core_in_a_wide_halo_is_the_stripe(top, rng):
    """A halo half as high, brighter on one side: half height lies in it, ten pixels beside the core."""
    centre = 100.0 + 6.0 * np.sin(np.arange(200) / 40.0)[:, None]
    u = np.arange(220) - centre
    halo = 0.5 * min(top, 240.0) * np.exp(-np.abs(u) / np.where(u > 0.0, 24.0, 8.0))
    light = 10.0 + halo + (top - halo.max()) * np.exp(-0.5 * (u / 2.0) ** 2)
    image = np.clip(np.rint(light + rng.normal(0.0, 1.0, u.shape)), 0, 255).astype(np.uint8)
    found = MaximumLikelihood().extract(Frame(image, "laser"))
    at = np.flatnonzero(np.abs(found.x_px - centre[found.row, 0]) < 3.0)
    assert np.unique(found.row[at]).size >= 0.98 * 200
    off = found.x_px[at] - centre[found.row[at], 0]
    assert np.sqrt(np.mean(off**2)) < 0.5
    assert (np.abs(off) < 1.96 * found.x_std_px[at]).mean() > 0.9


def test_a_narrow_core_on_a_plateau_brighter_than_half_of_it_is_the_stripe(rng):
    """An overexposed line on a rough wall: level light beside the core, wider to the right."""
    centre = 60.0 + 0.03 * np.arange(300)[:, None]
    u = np.arange(130) - centre
    beside = 85.0 * np.exp(-0.5 * (u / np.where(u > 0.0, 7.0, 3.5)) ** 4)
    light = 75.0 + beside + 160.0 * np.exp(-0.5 * (u / 1.5) ** 4)
    image = np.clip(np.rint(light + rng.normal(0.0, 4.0, u.shape)), 0, 255).astype(np.uint8)
    found = MaximumLikelihood().extract(Frame(image, "laser"))
    off = found.x_px - centre[found.row, 0]
    near = np.abs(off) < 3.0
    assert np.unique(found.row[near]).size >= 0.98 * 300
    assert np.std(off[near]) < 0.12
    assert np.abs(np.mean(off[near])) < 0.35
    assert (np.abs(off[near]) < 1.96 * found.x_std_px[near]).mean() > 0.9


@pytest.mark.parametrize("extractor", [MaximumLikelihood, Gaussian, Steger])
def test_marks_that_throw_light_back_do_not_set_the_level(extractor, rng):
    y, x = np.mgrid[:300, :400]
    centres = 40.0 + 55.0 * np.arange(7)[:, None] + 0.02 * np.arange(300)
    light = 6.0 + sum(19.0 * np.exp(-0.5 * ((x - one[:, None]) / 2.0) ** 2) for one in centres)
    for row in range(20, 300, 50):
        light[(x - 67 - row // 50 * 55) ** 2 + (y - row) ** 2 < 80] = 255.0
    image = np.clip(np.rint(light + rng.normal(0.0, 1.0, light.shape)), 0, 255).astype(np.uint8)
    found = extractor().extract(Frame(image, "laser"))
    off = np.abs(found.x_px[:, None] - centres[:, found.row].T)
    seen = np.zeros((300, 7), np.bool_)
    seen[found.row[off.min(axis=1) < 1.5], off.argmin(axis=1)[off.min(axis=1) < 1.5]] = True
    assert seen.mean() > 0.93
