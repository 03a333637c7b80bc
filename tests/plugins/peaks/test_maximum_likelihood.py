"""maximum-likelihood: noise that is estimated as it is, centres at the bound, uncertainties that are true."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from roemetry.errors import DataError, StageError
from roemetry.records import EDGE, SATURATED, Frame, Peaks, Sensor
from roemetry_peaks.maximum_likelihood import (
    MaximumLikelihood,
    MaximumLikelihoodOptions,
    estimated_noise,
    starts,
)
from roemetry_peaks.measure_noise import main, measured

GAIN, READ = 0.0255, 1.0
SENSOR = Sensor(GAIN, READ)
SIGMA_PX, AMPLITUDE, LIGHT = 2.0, 150.0, 12.0


def true_x_px(rows: int = 240, stripes: int = 9) -> np.ndarray:
    lean = 0.02 * np.arange(rows)[None, :]
    return 30.0 + 40.0 * np.arange(stripes)[:, None] + 0.37 * np.arange(stripes)[:, None] + lean


def drawn(
    rng: np.random.Generator, contrast: float | np.ndarray, x_px: np.ndarray | None = None, columns: int = 400
) -> np.ndarray:
    """Stripes integrated over pixels, with speckle, shot noise, read noise and rounding."""
    x_px = true_x_px() if x_px is None else x_px
    rows = x_px.shape[1]
    light = np.zeros((rows, columns))
    for line in x_px:
        d = np.arange(columns)[None, :] - line[:, None]
        s = SIGMA_PX * np.sqrt(2.0)
        light += 0.5 * AMPLITUDE * SIGMA_PX * np.sqrt(2 * np.pi) * (erf((d + 0.5) / s) - erf((d - 0.5) / s))
    grains = gaussian_filter(rng.standard_normal((rows, columns)), 0.8)
    grains = grains / grains.std() * contrast
    mean = light * np.exp(grains - np.square(contrast) / 2.0) + LIGHT
    noisy = mean + rng.standard_normal(mean.shape) * np.sqrt(GAIN * mean + READ**2)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def bound_px(contrast: float, correlation_px: float = 0.8) -> float:
    """Cramér-Rao bound of a row's centre with height, width and background unknown."""
    u = np.arange(-18, 19, dtype=float)
    e = np.exp(-0.5 * (u / SIGMA_PX) ** 2)
    m = AMPLITUDE * e
    jacobian = np.column_stack([m * u / SIGMA_PX**2, e, m * u**2 / SIGMA_PX**3, np.ones_like(u)])
    grains = np.exp(-((u[:, None] - u) ** 2) / (4 * correlation_px**2))
    noise = contrast**2 * np.outer(m, m) * grains + np.diag(GAIN * (m + LIGHT) + READ**2 + 1 / 12)
    return float(np.sqrt(np.linalg.inv(jacobian.T @ np.linalg.solve(noise, jacobian))[0, 0]))


def errors_px(peaks: Peaks, x_px: np.ndarray) -> np.ndarray:
    off = peaks.x_px[:, None] - x_px[:, peaks.row].T
    return np.take_along_axis(off, np.abs(off).argmin(1)[:, None], axis=1)[:, 0]


@pytest.mark.parametrize("contrast", [0.0, 0.15, 0.25])
@pytest.mark.parametrize("sensor", [SENSOR, None], ids=["known", "estimated"])
def test_one_mode_is_at_the_bound_and_knows_it(
    contrast: float, sensor: Sensor | None, rng: np.random.Generator
) -> None:
    peaks = MaximumLikelihood().extract(Frame(drawn(rng, contrast), sensor=sensor))
    assert len(peaks) == true_x_px().size
    error = errors_px(peaks, true_x_px())
    assert np.sqrt((error**2).mean()) < 1.06 * bound_px(contrast)
    assert abs(error.mean()) < 0.006 + 3.0 * error.std() / np.sqrt(error.size)
    assert 0.92 < np.sqrt((peaks.x_std_px**2).mean()) / error.std() < 1.08
    assert [reason.code for reason in peaks.reasons] == ([] if sensor else ["noise-estimated"])


def test_the_noise_is_estimated_as_it_was_drawn(rng: np.random.Generator) -> None:
    image, found = starts(Frame(drawn(rng, 0.2)), MaximumLikelihoodOptions())
    noise = estimated_noise(image, 255, found)
    assert np.sqrt(noise.contrast2.mean()) == pytest.approx(0.2, abs=0.02)
    assert noise.correlation == pytest.approx(np.exp(-1 / (4 * 0.8**2)), abs=0.04)
    image, found = starts(Frame(drawn(rng, 0.0)), MaximumLikelihoodOptions())
    noise = estimated_noise(image, 255, found)
    assert noise.gain == pytest.approx(GAIN, rel=0.3)  # one amplitude tells it apart from speckle badly
    assert noise.variance == pytest.approx(READ**2 + 1 / 12, abs=0.15)
    assert np.sqrt(noise.contrast2.max()) < 0.02


def test_two_materials_in_one_image_have_a_contrast_each(rng: np.random.Generator) -> None:
    left = np.arange(400)[None, :] < 205
    frame = Frame(drawn(rng, np.where(left, 0.03, 0.25)), sensor=SENSOR)
    peaks = MaximumLikelihood().extract(frame)
    error = errors_px(peaks, true_x_px())
    for side, contrast in ((peaks.x_px < 195, 0.03), (peaks.x_px > 215, 0.25)):
        assert np.sqrt((error[side] ** 2).mean()) < 1.1 * bound_px(contrast)


def test_errors_along_the_stripe_are_as_correlated_as_said(rng: np.random.Generator) -> None:
    peaks = MaximumLikelihood().extract(Frame(drawn(rng, 0.2), sensor=SENSOR))
    error = errors_px(peaks, true_x_px()).reshape(240, 9)
    error -= error.mean(0)
    seen = [float((error[lag:] * error[: 240 - lag]).mean() / (error**2).mean()) for lag in (1, 2)]
    said = [np.exp(-(lag**2) / (4 * peaks.correlation_rows**2)) for lag in (1, 2)]
    assert sum(said) == pytest.approx(sum(seen), abs=0.1)
    clean = MaximumLikelihood().extract(Frame(drawn(rng, 0.0), sensor=SENSOR))
    assert clean.correlation_rows < 0.4


def test_hot_pixels_are_no_stripes_and_no_harm(rng: np.random.Generator) -> None:
    pixels = drawn(rng, 0.0).astype(np.int64)
    hot = rng.integers(0, pixels.size, 40)
    pixels.flat[hot] += 120
    peaks = MaximumLikelihood().extract(Frame(np.clip(pixels, 0, 255).astype(np.uint8), sensor=SENSOR))
    assert len(peaks) == true_x_px().size
    assert np.abs(errors_px(peaks, true_x_px())).max() < 0.3


@pytest.mark.parametrize("spacing_sigmas", [8, 10])
def test_near_stripes_do_not_disturb_each_other(spacing_sigmas: int, rng: np.random.Generator) -> None:
    x_px = 40.0 + spacing_sigmas * SIGMA_PX * np.arange(12)[:, None] + 0.03 * np.arange(120)[None, :]
    peaks = MaximumLikelihood().extract(Frame(drawn(rng, 0.0, x_px), sensor=SENSOR))
    assert len(peaks) == x_px.size
    assert np.sqrt((errors_px(peaks, x_px) ** 2).mean()) < 1.08 * bound_px(0.0)


def test_saturated_and_cut_off_stripes_are_flagged(rng: np.random.Generator) -> None:
    x_px = np.array([[3.0], [150.0], [250.0]]) + np.zeros((1, 40))
    pixels = drawn(rng, 0.0, x_px, 300).astype(np.float64)
    pixels[:, 200:] = (pixels[:, 200:] - LIGHT) * 4.0
    peaks = MaximumLikelihood().extract(Frame(np.clip(pixels, 0, 255).astype(np.uint8), sensor=SENSOR))
    for line, flag in zip(x_px[:, 0], (EDGE, 0, SATURATED), strict=True):
        near = np.abs(peaks.x_px - line) < 2.0
        assert near.sum() == 40
        assert (peaks.flags[near] == flag).all()
        assert np.abs(peaks.x_px[near] - line).max() < 0.25


def test_a_region_gives_the_same_peaks_as_the_whole(rng: np.random.Generator) -> None:
    frame = Frame(drawn(rng, 0.0), sensor=SENSOR)
    told = {"speckle_contrast": 0.0, "threshold": 20.0}
    whole = MaximumLikelihood(MaximumLikelihoodOptions(**told)).extract(frame)
    part = MaximumLikelihood(MaximumLikelihoodOptions(**told, region=(50, 90, 92, 215))).extract(frame)
    inside = (whole.row >= 58) & (whole.row < 82) & (np.abs(whole.x_px - 150) < 60)
    shown = (part.row >= 58) & (part.row < 82)
    assert inside.sum() == shown.sum() == 24 * 3
    # Peaks that are fitted side by side stop together, a little earlier or later.
    assert np.abs(part.x_px[shown] - whole.x_px[inside]).max() < 1e-3
    with pytest.raises(StageError, match="region"):
        MaximumLikelihood(MaximumLikelihoodOptions(region=(0, 500, 0, 10))).extract(frame)


# The noise as a file


@pytest.fixture
def noise_file(rng: np.random.Generator, tmp_path: Path) -> Path:
    frames = [Frame(drawn(rng, 0.2), sensor=SENSOR) for _ in range(2)]
    path = tmp_path / "noise.json"
    path.write_text(json.dumps(measured(frames, MaximumLikelihoodOptions())), "utf-8")
    return path


def test_noise_from_a_file_does_what_the_images_own_does(noise_file: Path, rng: np.random.Generator) -> None:
    frame = Frame(drawn(rng, 0.2))
    error = errors_px(
        MaximumLikelihood(MaximumLikelihoodOptions(noise=noise_file)).extract(frame), true_x_px()
    )
    assert np.sqrt((error**2).mean()) < 1.06 * bound_px(0.2)


def test_a_noise_file_of_other_images_is_refused(noise_file: Path, rng: np.random.Generator) -> None:
    extractor = MaximumLikelihood(MaximumLikelihoodOptions(noise=noise_file))
    pixels = drawn(rng, 0.0)
    for frame, said in (
        (Frame(pixels[:100]), "image_size"),
        (Frame(pixels, turn_deg=180), "turn_deg"),
        (Frame(pixels.astype(np.uint16), bit_depth=12), "bit_depth"),
    ):
        with pytest.raises(StageError, match=said):
            extractor.extract(frame)
    held = json.loads(noise_file.read_text("utf-8"))
    for broken in ({**held, "speckle_contrast": [[0.1]]}, {**held, "frames": 0}, {}, [1]):
        path = noise_file.with_name(f"broken{len(broken)}{len(str(broken))}.json")
        path.write_text(json.dumps(broken), "utf-8")
        with pytest.raises(StageError, match="broken"):
            MaximumLikelihood(MaximumLikelihoodOptions(noise=path)).extract(Frame(pixels))
    gone = MaximumLikelihood(MaximumLikelihoodOptions(noise=noise_file.with_name("gone.json")))
    with pytest.raises(StageError, match="cannot be read"):
        gone.extract(Frame(pixels))


RECIPE = """\
roemetry: 1
product: plate
source: {use: image-files, path: images/*.png}
stages: {extractor: {use: %s}}
"""


def test_the_command_measures_a_recipes_images(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "images").mkdir()
    cv2.imwrite(str(tmp_path / "images" / "a.png"), drawn(rng, 0.15))
    recipe, out = tmp_path / "recipe.yaml", tmp_path / "noise.json"
    recipe.write_text(RECIPE % "maximum-likelihood", "utf-8")
    assert main([str(recipe), "--out", str(out)]) == 0
    assert "speckle contrast" in capsys.readouterr().out
    assert np.mean(json.loads(out.read_text("utf-8"))["speckle_contrast"]) == pytest.approx(0.15, abs=0.03)
    recipe.write_text(RECIPE % "dominant-peak", "utf-8")
    assert main([str(recipe), "--out", str(out)]) == 2
    assert "maximum-likelihood" in capsys.readouterr().err


def test_there_must_be_stripes_to_measure_noise() -> None:
    for frames in ([], [Frame(np.zeros((50, 60), np.uint8))]):
        with pytest.raises(DataError):
            measured(frames, MaximumLikelihoodOptions())


@pytest.mark.parametrize("threshold", ["auto", 20.0])
def test_overexposed_stripes_of_no_gaussian_shape_are_not_taken_for_noise(
    threshold: float | str, rng: np.random.Generator
) -> None:
    x_px = true_x_px()
    off = np.abs(np.arange(400)[None, None, :] - x_px[:, :, None])
    height = rng.uniform(200.0, 1200.0, x_px.shape)[:, :, None]
    flat = (height * np.clip(4.0 - off, 0.0, 1.0) + 60.0 * np.exp(-off / 3.0)).sum(axis=0)
    _, packed = cv2.imencode(".jpg", np.clip(flat, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 85])
    pixels = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)
    extractor = MaximumLikelihood(MaximumLikelihoodOptions(threshold=threshold))
    image, found = starts(Frame(pixels), extractor.options)
    noise = estimated_noise(image, 255, found)
    assert noise.variance <= 5.2**2  # grey levels²
    assert noise.gain <= 1.0
    peaks = extractor.extract(Frame(pixels))
    off_px = np.abs(peaks.x_px - x_px[:, peaks.row]).min(axis=0)
    assert (off_px < 1.0).sum() >= 0.9 * x_px.size  # px


def test_a_stripe_narrower_than_a_hot_pixel_goes_on(rng: np.random.Generator) -> None:
    pixels = rng.normal(12.0, 1.0, (60, 120))
    x_px = 40.2 + 0.05 * np.arange(60)
    for row, x in enumerate(x_px):
        d = np.arange(120) - x
        pixels[row] += 80.0 * (erf((d + 0.5) / 1.0) - erf((d - 0.5) / 1.0))  # σ 0.7: 1.67 px wide
    pixels[20, 90] = 200.0
    peaks = MaximumLikelihood().extract(Frame(np.rint(pixels).astype(np.uint8)))
    assert (peaks.width_px < MaximumLikelihoodOptions().width_min_px).all()
    assert set(peaks.row) >= set(range(1, 59)), "first and last go on to one side only"
    assert np.abs(peaks.x_px - x_px[peaks.row]).max() < 0.1, "px; the hot pixel is 50 px beside"
