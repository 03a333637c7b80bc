"""The centres of drawn stripes: scatter against the bound and against what is stated, bias, hard cases."""

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.special import erf

from roemetry.errors import StageError
from roemetry.records import EDGE, SATURATED, Frame, Sensor
from roemetry_peaks.centre_of_gravity import CentreOfGravity, CentreOfGravityOptions
from roemetry_peaks.gaussian import Gaussian, GaussianOptions
from roemetry_peaks.log_parabola import LogParabola, LogParabolaOptions
from roemetry_peaks.zero_crossing import ZeroCrossing, ZeroCrossingOptions

GAIN, READ = 0.0255, 1.0
COLUMNS, MIDDLE = 64, 31.5

MADE = {
    "three": lambda **more: LogParabola(LogParabolaOptions(points="three", **more)),
    "five": lambda **more: LogParabola(LogParabolaOptions(**more)),
    "gravity": lambda **more: CentreOfGravity(CentreOfGravityOptions(**more)),
    "gaussian": lambda **more: Gaussian(GaussianOptions(**more)),
    "crossing": lambda **more: ZeroCrossing(ZeroCrossingOptions(**more)),
}
BIAS_PX = {"three": 0.003, "five": 0.003, "gravity": 0.003, "gaussian": 0.003, "crossing": 0.009}
"""The zero crossing is put on a straight line between two pixels; the derivative is not quite one."""

every = pytest.mark.parametrize("name", MADE)


def profile(centre, sigma, amplitude, columns=COLUMNS):
    """(row, column) light of one stripe a row, summed over each pixel, grey levels."""
    off = np.arange(columns) - np.asarray(centre)[:, None]
    s = np.broadcast_to(sigma, np.shape(centre))[:, None] * math.sqrt(2.0)
    steps = 0.5 * (erf((off + 0.5) / s) - erf((off - 0.5) / s))
    return np.broadcast_to(amplitude, np.shape(centre))[:, None] * s * math.sqrt(math.pi) * steps


def taken(level, rng=None, kind=np.uint8, white=255):
    """Add the sensor's noise, where a generator is given, round, cut off at white."""
    if rng is not None:
        level = level + rng.standard_normal(level.shape) * np.sqrt(GAIN * level + READ**2)
    return np.clip(np.rint(level), 0, white).astype(kind)


def drawn(rng, rows, sigma=(1.5, 3.0), amplitude=(60.0, 220.0)):
    """Draw rows of one stripe each with noise; centres, widths, heights, background beside it."""
    centre = MIDDLE + rng.uniform(-2.0, 2.0, rows)
    sigma, amplitude = rng.uniform(*sigma, rows), rng.uniform(*amplitude, rows)
    background = 10.0 + 0.1 * np.arange(COLUMNS)
    return centre, sigma, amplitude, taken(profile(centre, sigma, amplitude) + background, rng)


def bound_px(sigma, amplitude):
    """Cramér-Rao bound of centres: centre, height, width, background and its slope unknown."""
    off = np.arange(-24, 25)
    parts = []
    for s, a in zip(sigma, amplitude, strict=True):
        g = np.exp(-0.5 * (off / s) ** 2)
        level = a * g + 13.0
        jacobian = np.stack(
            [a * g * off / s**2, g, a * g * off**2 / s**3, np.ones_like(g), off.astype(float)], axis=1
        )
        weight = 1.0 / (GAIN * level + READ**2 + 1.0 / 12.0)
        parts.append(np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian))[0, 0])
    return np.sqrt(parts)


def frame(pixels, *, known=True, bit_depth=8):
    return Frame(pixels, sensor=Sensor(GAIN, READ) if known else None, bit_depth=bit_depth)


@pytest.mark.parametrize(
    ("name", "most"),
    [("gaussian", 1.06), ("gravity", 1.35), ("crossing", 1.2), ("five", 2.0), ("three", 5.0)],
)
def test_scatter_is_near_the_bound_and_as_stated(name, most, rng):
    centre, sigma, amplitude, pixels = drawn(rng, 20_000)
    # These rows are drawn apart: what one says of the next is nothing to tell speckle from.
    peaks = MADE[name](speckle_contrast=0.0).extract(frame(pixels))
    assert peaks.row.tolist() == list(range(20_000)), "one peak in each row"
    error, stated = peaks.x_px - centre, peaks.x_std_px
    every_tenth = slice(None, None, 10)
    bound = np.sqrt(np.mean(bound_px(sigma[every_tenth], amplitude[every_tenth]) ** 2))
    assert np.sqrt(np.mean(error**2)) <= most * bound
    for by in (amplitude, sigma):
        for fifth in np.array_split(np.argsort(by), 5):
            ratio = np.sqrt(np.mean(stated[fifth] ** 2) / np.mean(error[fifth] ** 2))
            assert 0.9 <= ratio <= 1.1


@every
def test_there_is_no_bias_at_any_phase_height_or_width(name, rng):
    extractor, rows = MADE[name](), 4_000
    for sigma in (1.5, 2.2, 3.0):
        for amplitude in (60.0, 200.0):
            centre = MIDDLE + np.tile(np.arange(10) / 10.0, rows // 10)
            level = profile(centre, sigma, amplitude) + 15.0
            error = extractor.extract(frame(taken(level, rng))).x_px - centre
            by_phase = error.reshape(-1, 10)
            unsure = by_phase.std(axis=0).max() / math.sqrt(rows / 10)
            assert np.abs(by_phase.mean(axis=0)).max() <= BIAS_PX[name] + 3.5 * unsure


@pytest.mark.parametrize("name", ["gaussian", "gravity", "crossing"])
def test_speckle_is_in_what_is_stated(name, rng):
    from scipy.ndimage import gaussian_filter

    centre = np.full(12_000, MIDDLE) + rng.uniform(-2.0, 2.0, 12_000)
    grain = gaussian_filter(rng.standard_normal((12_000, COLUMNS)), 0.8)
    grain *= 0.15 / grain.std()
    level = profile(centre, 2.2, 150.0) * np.exp(grain - 0.15**2 / 2) + 15.0
    peaks = MADE[name](speckle_contrast=0.15).extract(frame(taken(level, rng)))
    error = peaks.x_px - centre[peaks.row]
    assert peaks.row.size == 12_000
    assert 0.9 <= np.sqrt(np.mean(peaks.x_std_px**2) / np.mean(error**2)) <= 1.1


def speckled(contrast, rng, *, rows=960, stripes=6):
    """Draw bent stripes with breaks, and their centres by (stripe, row)."""
    from scipy.ndimage import gaussian_filter

    row = np.arange(rows)
    phase = rng.uniform(0.0, 6.0, (stripes, 1))
    centre = 40.3 + 60.0 * np.arange(stripes)[:, None] + 8.0 * np.sin(row / 40.0 + phase)
    light = np.zeros((rows, 60 * stripes + 20))
    for k in range(stripes):
        light += profile(centre[k], rng.uniform(1.6, 2.8), rng.uniform(70.0, 170.0), light.shape[1])
    light[::97] = 0.0
    if contrast:
        grain = gaussian_filter(rng.standard_normal(light.shape), 0.8)
        light = light * np.exp(contrast * grain / grain.std() - 0.5 * contrast**2)
    return centre, taken(light + 15.0, rng)


@every
@pytest.mark.parametrize("contrast", [0.0, 0.1, 0.25])
def test_the_contrast_is_found_and_stated(name, contrast, rng):
    centre, pixels = speckled(contrast, rng)
    peaks = MADE[name]().extract(frame(pixels))
    error = peaks.x_px - centre[np.abs(peaks.x_px - centre[:, peaks.row]).argmin(axis=0), peaks.row]
    assert 0.9 <= np.sqrt(np.mean(peaks.x_std_px**2) / np.mean(error**2)) <= 1.1
    assert (peaks.correlation_rows > 0.0) == (contrast > 0.0)


def test_finding_the_contrast_makes_the_gaussian_better(rng):
    centre, pixels = speckled(0.15, rng)

    def rms(**told):
        peaks = MADE["gaussian"](**told).extract(frame(pixels))
        return np.sqrt(np.mean(np.abs(peaks.x_px - centre[:, peaks.row]).min(axis=0) ** 2))

    assert rms() < 0.8 * rms(speckle_contrast=0.0)
    assert rms() < 1.02 * rms(speckle_contrast=0.15)


def test_stating_the_contrast_makes_the_gaussian_better(rng):
    centre = np.full(4_000, MIDDLE) + rng.uniform(-2.0, 2.0, 4_000)
    level = profile(centre, 2.2, 150.0) * np.exp(rng.normal(0.0, 0.15, (4_000, COLUMNS))) + 15.0
    pixels = taken(level, rng)

    def rms(contrast):
        peaks = MADE["gaussian"](speckle_contrast=contrast).extract(frame(pixels))
        return np.sqrt(np.mean((peaks.x_px - centre[peaks.row]) ** 2))

    assert rms(0.15) < 0.8 * rms(0.0)


@every
def test_a_clipped_stripe_is_where_its_flanks_say(name, rng):
    centre = MIDDLE + rng.uniform(-1.0, 1.0, 1_000)
    pixels = taken(profile(centre, 2.5, 900.0) + 12.0, rng)
    peaks = MADE[name]().extract(frame(pixels))
    assert (peaks.flags & SATURATED).all()
    assert np.abs(peaks.x_px - centre).max() < 0.2  # px
    assert np.sqrt(np.mean((peaks.x_px - centre) ** 2)) < 0.05  # px


@every
def test_a_sloping_background_does_not_pull(name):
    centre = MIDDLE + np.arange(20) / 20.0
    level = profile(centre, 2.2, 120.0) + 40.0 + 0.8 * (np.arange(COLUMNS) - MIDDLE)
    error = MADE[name]().extract(frame(taken(level))).x_px - centre
    assert abs(error.mean()) < 0.01  # px


@every
def test_spikes_and_glare_are_left_out(name, rng):
    level = np.full((40, 320), 20.0)
    level[::2, 50] = 200.0  # one pixel
    level += 150.0 * np.exp(-0.5 * ((np.arange(320) - 200) / 25.0) ** 2)  # 59 px wide
    assert len(MADE[name]().extract(frame(taken(level, rng)))) == 0
    wide = MADE[name](width_max_px=80.0, threshold=60.0).extract(frame(taken(level)))
    assert len(wide) == 40
    assert wide.width_px == pytest.approx(np.full(40, 58.9), abs=3.0)  # px


@every
def test_a_rough_stripe_is_one_and_two_stripes_are_two(name):
    rough = np.array([[20] * 20 + [30, 80, 180, 140, 190, 90, 30] + [20] * 20] * 5, np.uint8)
    assert len(MADE[name]().extract(frame(rough))) == 5
    centre = np.full(30, 30.3)
    two = profile(centre, 1.6, 150.0) + profile(centre + 9.0, 1.6, 90.0) + 20.0
    peaks = MADE[name]().extract(frame(taken(two)))
    assert len(peaks) == 60
    assert np.abs(peaks.x_px[::2] - 30.3).max() < 0.06  # px
    assert np.abs(peaks.x_px[1::2] - 39.3).max() < 0.06  # px


@every
def test_a_stripe_near_the_border_is_flagged(name):
    level = profile(np.full(4, 3.0), 1.6, 150.0) + profile(np.full(4, 40.0), 1.6, 150.0) + 20.0
    peaks = MADE[name]().extract(frame(taken(level)))
    near = peaks.x_px < 20.0
    assert ((peaks.flags & EDGE) > 0)[near].all()
    assert not ((peaks.flags & EDGE) > 0)[~near].any()
    assert (~near).sum() == 4


@every
def test_what_is_found_in_a_region_is_what_is_found_in_all(name, rng):
    _, _, _, pixels = drawn(rng, 60)
    pixels = np.hstack([pixels, pixels])
    told = {"threshold": 25.0, "speckle_contrast": 0.0}
    whole = MADE[name](**told).extract(frame(pixels))
    part = MADE[name](**told, region=(10, 50, 64, 128)).extract(frame(pixels))
    mine = (whole.row >= 10) & (whole.row < 50) & (whole.x_px > 64)
    np.testing.assert_array_equal(part.row, whole.row[mine])
    np.testing.assert_allclose(part.x_px, whole.x_px[mine], atol=0.02)  # px: the background ends elsewhere


@every
def test_twelve_bits_in_sixteen_say_the_same_more_finely(name):
    centre = MIDDLE + np.arange(10) / 10.0
    level = profile(centre, 2.0, 150.0) + 15.0
    fine = taken(level * 4095 / 255, kind=np.uint16, white=4095)
    peaks = MADE[name]().extract(frame(fine, known=False, bit_depth=12))
    assert np.abs(peaks.x_px - centre).max() < BIAS_PX[name] + 0.002
    assert peaks.amplitude == pytest.approx(np.full(10, 150.0 * 16.06), rel=0.06)
    assert np.isnan(peaks.x_std_px).all(), "without a sensor no uncertainty is stated"


def test_rows_err_independently():
    peaks = MADE["gaussian"]().extract(frame(taken(profile(np.full(9, MIDDLE), 2.0, 150.0) + 15.0)))
    assert peaks.correlation_rows == 0.0


def test_speckle_of_neighbouring_rows_is_alike():
    pixels = taken(profile(np.full(9, MIDDLE), 2.0, 150.0) + 15.0)
    options = {"speckle_contrast": 0.2, "speckle_length_px": 1.1}
    assert MADE["gaussian"](**options).extract(frame(pixels)).correlation_rows == pytest.approx(1.1)


@every
def test_options_are_bounded(name):
    for wrong in (
        {"threshold": 0.0},
        {"threshold": "low"},
        {"width_min_px": -1.0},
        {"speckle_contrast": 2.0},
    ):
        with pytest.raises(ValidationError):
            MADE[name](**wrong)
    with pytest.raises(StageError, match="does not lie within the image"):
        MADE[name](region=(0, 10, 0, 900)).extract(frame(np.zeros((20, 30), np.uint8)))
