"""Sensor, speckle and profiles that contradict what is told: noticed, and the uncertainty made true."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import Frame, Sensor
from roemetry.stages.registry import discover
from roemetry_peaks.gaussian import Gaussian
from roemetry_peaks.maximum_likelihood import MaximumLikelihood
from tests.plugins.peaks.drawing import GAIN, READ, SENSOR, errors_px, exposed, rms, speckled

SIGMA_PX = 1.8


def gaussian(u):
    return np.exp(-0.5 * u**2)


def flat(u):
    return np.exp(-0.5 * (np.abs(u) / 1.4) ** 6)


def skewed(u):
    """A Gaussian with an exponential tail; u = 0 is its centroid."""
    fine = np.arange(-8.0, 12.0, 0.01)
    profile = np.convolve(gaussian(fine / 0.8), np.exp(-fine[fine >= 0.0] / 0.9))
    at = fine[0] + 0.01 * np.arange(profile.size)
    return np.interp(u, at - profile @ at / profile.sum(), profile / profile.max(), 0.0, 0.0)


def errors(extractor, rng, profile=gaussian, contrast=0.12, length=0.8, sensor=SENSOR):
    """Errors and stated uncertainties of the centres of eight bent stripes, px, and the codes of reasons."""
    y, x, stripes = np.arange(400.0)[:, None], np.arange(384), np.arange(8)
    centre = 24.0 + 48.0 * stripes + rng.uniform(-1, 1, 8) + 3.0 * np.sin(y / 60 + stripes) + 0.008 * y
    light = sum((60 + 20 * k) * profile((x - centre[:, k : k + 1]) / SIGMA_PX) for k in stripes)
    pixels = exposed(12.0 + speckled(light, np.sqrt(np.log1p(contrast**2)), rng, length), rng)
    peaks = extractor(extractor.Options()).extract(Frame(pixels, sensor=sensor))
    assert peaks.row.size > 0.98 * centre.size
    return errors_px(peaks, centre.T), peaks.x_std_px, {reason.code for reason in peaks.reasons}


both = pytest.mark.parametrize("extractor", [Gaussian, MaximumLikelihood])
speckle = pytest.mark.parametrize("contrast", [0.0, 0.12])


@both
@speckle
def test_what_is_told_rightly_is_left_alone(extractor, contrast, rng):
    off, std, reasons = errors(extractor, rng, contrast=contrast)
    assert not reasons
    assert 0.85 < rms(std) / rms(off) < 1.2


@both
@pytest.mark.parametrize("sensor", [Sensor(3 * GAIN, READ), Sensor(GAIN, 4 * READ)], ids=["gain", "read"])
def test_a_sensor_that_is_told_wrongly_is_noticed(extractor, sensor, rng):
    off, std, reasons = errors(extractor, rng, contrast=0.0, sensor=sensor)
    assert reasons == {"noise-contradicted"}  # unscaled, it states 1.4 and 2.6 times the error
    assert 0.85 < rms(std) / rms(off) < 1.2


@both
def test_speckle_of_another_length_is_noticed(extractor, rng):
    off, std, reasons = errors(extractor, rng, length=2.5)
    assert reasons == {"noise-contradicted"}  # unscaled, intervals of 95 % hold 52 to 56 %
    assert np.mean(np.abs(off) < 1.96 * std) > 0.88


@both
@speckle
def test_flat_tops_are_noticed(extractor, contrast, rng):
    off, std, reasons = errors(extractor, rng, flat, contrast=contrast)
    assert reasons == {"noise-contradicted"}  # else stated/observed is 0.4 or 7 to 19
    assert 0.8 < rms(std) / rms(off) < 1.3


@both
@speckle
def test_lopsided_profiles_are_noticed(extractor, contrast, rng):
    off, std, reasons = errors(extractor, rng, skewed, contrast=contrast)
    assert "profile-lopsided" in reasons  # else intervals hold 0 to 65 %
    assert np.mean(np.abs(off) < 1.96 * std) > 0.85


ROWS, COLUMNS = 480, 640


def on_product(row: np.ndarray, x_px: np.ndarray) -> np.ndarray:
    return np.hypot((row - ROWS / 2) / (0.35 * ROWS), (x_px - COLUMNS / 2) / (0.4 * COLUMNS)) < 1.0


@pytest.mark.parametrize(
    "name", ["centre-of-gravity", "fir-zero-crossing", "gaussian", "log-parabola", "maximum-likelihood"]
)
def test_each_of_two_materials_is_stated_as_it_scatters(name, rng) -> None:
    """Product and belt; with one contrast for all of it 1.5 and 0.45 times the error would be stated."""
    registry = discover()
    stage = registry.load(registry.find("extractor", name))()
    y, x = np.mgrid[:ROWS, :COLUMNS]
    error, stated, product = [], [], []
    for _ in range(2):
        centre_px = (
            53.0 * np.arange(1, 12)[:, None] + rng.uniform(-3.0, 3.0, (11, 1)) + 0.02 * np.arange(ROWS)
        )
        light = sum(140.0 * gaussian((x - c[:, None]) / 2.0) for c in centre_px)
        pixels = exposed(15.0 + speckled(light, np.where(on_product(y, x), 0.25, 0.08), rng), rng)
        peaks = stage.extract(Frame(pixels, sensor=SENSOR))
        off = errors_px(peaks, centre_px)
        good = (np.abs(off) < 3.0) & (peaks.flags == 0)
        error.append(off[good])
        stated.append(peaks.x_std_px[good])
        product.append(on_product(peaks.row, peaks.x_px)[good])
    errors, stds, inside = (np.concatenate(values) for values in (error, stated, product))
    assert inside.size > 10_000
    for part in (inside, ~inside):
        assert 0.85 < rms(stds[part]) / rms(errors[part]) < 1.15
