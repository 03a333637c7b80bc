"""Sensor, speckle and profiles that contradict what is told: noticed, and the uncertainty made true."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from roemetry.records import Frame, Sensor
from roemetry_peaks.gaussian import Gaussian
from roemetry_peaks.maximum_likelihood import MaximumLikelihood

GAIN, READ, SIGMA = 0.0255, 1.0, 1.8  # grey levels per electron, grey levels, px
RIGHT = Sensor(GAIN, READ)


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


def errors(extractor, rng, profile=gaussian, contrast=0.12, length=0.8, sensor=RIGHT):
    """Errors and stated uncertainties of the centres of eight bent stripes, px, and the codes of reasons."""
    y, x, stripes = np.arange(400.0)[:, None], np.arange(384), np.arange(8)
    centre = 24.0 + 48.0 * stripes + rng.uniform(-1, 1, 8) + 3.0 * np.sin(y / 60 + stripes) + 0.008 * y
    light = sum((60 + 20 * k) * profile((x - centre[:, k : k + 1]) / SIGMA) for k in stripes)
    grain = gaussian_filter(rng.standard_normal(light.shape), length)
    spread = np.log1p(contrast**2)
    light = 12.0 + light * np.exp(np.sqrt(spread) * grain / grain.std() - spread / 2)
    noisy = light + rng.standard_normal(light.shape) * np.sqrt(GAIN * light + READ**2)
    frame = Frame(pixels=np.clip(np.rint(noisy), 0, 255).astype(np.uint8), sensor=sensor)
    peaks = extractor(extractor.Options()).extract(frame)
    off = peaks.x_px[:, None] - centre[peaks.row]
    off = np.take_along_axis(off, np.abs(off).argmin(1)[:, None], 1)[:, 0]
    assert peaks.row.size > 0.98 * centre.size
    return off, peaks.x_std_px, {reason.code for reason in peaks.reasons}


EXTRACTORS = pytest.mark.parametrize("extractor", [Gaussian, MaximumLikelihood])


@EXTRACTORS
@pytest.mark.parametrize("contrast", [0.0, 0.12])
def test_what_is_told_rightly_is_left_alone(extractor, contrast, rng):
    off, std, reasons = errors(extractor, rng, contrast=contrast)
    assert not reasons
    assert 0.85 < np.sqrt(np.mean(std**2) / np.mean(off**2)) < 1.2


@EXTRACTORS
@pytest.mark.parametrize("sensor", [Sensor(3 * GAIN, READ), Sensor(GAIN, 4 * READ)], ids=["gain", "read"])
def test_a_sensor_that_is_told_wrongly_is_noticed(extractor, sensor, rng):
    off, std, reasons = errors(extractor, rng, contrast=0.0, sensor=sensor)
    assert reasons == {"noise-contradicted"}  # unscaled, it states 1.4 and 2.6 times the error
    assert 0.85 < np.sqrt(np.mean(std**2) / np.mean(off**2)) < 1.2


@EXTRACTORS
def test_speckle_of_another_length_is_noticed(extractor, rng):
    off, std, reasons = errors(extractor, rng, length=2.5)
    assert reasons == {"noise-contradicted"}  # unscaled, intervals of 95 % hold 52 to 56 %
    assert np.mean(np.abs(off) < 1.96 * std) > 0.88


@EXTRACTORS
@pytest.mark.parametrize("contrast", [0.0, 0.12])
def test_flat_tops_are_noticed(extractor, contrast, rng):
    off, std, reasons = errors(extractor, rng, flat, contrast=contrast)
    assert reasons == {"noise-contradicted"}  # else stated/observed is 0.4 or 7 to 19
    assert 0.8 < np.sqrt(np.mean(std**2) / np.mean(off**2)) < 1.3


@EXTRACTORS
@pytest.mark.parametrize("contrast", [0.0, 0.12])
def test_lopsided_profiles_are_noticed(extractor, contrast, rng):
    off, std, reasons = errors(extractor, rng, skewed, contrast=contrast)
    assert "profile-lopsided" in reasons  # else intervals hold 0 to 65 %
    assert np.mean(np.abs(off) < 1.96 * std) > 0.85
