"""maximum-likelihood: noise that is estimated as it is, centres at the bound, uncertainties that are true."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.special import erf

from roemetry.errors import DataError, StageError
from roemetry.records import Frame, Sensor
from roemetry_peaks.maximum_likelihood import (
    MaximumLikelihood,
    MaximumLikelihoodOptions,
    estimated_noise,
    starts,
)
from roemetry_peaks.measure_noise import main, measured
from tests.plugins.peaks.drawing import GAIN, READ, SENSOR, errors_px, exposed, integrated, rms, speckled

SIGMA_PX, AMPLITUDE, LIGHT = 2.0, 150.0, 12.0
ROWS, STRIPES = 240, 9
X_PX = 30.0 + 40.37 * np.arange(STRIPES)[:, None] + 0.02 * np.arange(ROWS)


def drawn(rng: np.random.Generator, contrast: float | np.ndarray, x_px: np.ndarray = X_PX) -> np.ndarray:
    """Stripes integrated over pixels, with speckle, shot noise, read noise and rounding."""
    light = sum(integrated(line, SIGMA_PX, AMPLITUDE, 400) for line in x_px)
    return exposed(speckled(light, contrast, rng) + LIGHT, rng)


def made(**told: object) -> MaximumLikelihood:
    return MaximumLikelihood(MaximumLikelihoodOptions(**told))


def bound_px(contrast: float, correlation_px: float = 0.8) -> float:
    """Cramér-Rao bound of a row's centre with height, width and background unknown."""
    u = np.arange(-18, 19, dtype=float)
    e = np.exp(-0.5 * (u / SIGMA_PX) ** 2)
    m = AMPLITUDE * e
    jacobian = np.column_stack([m * u / SIGMA_PX**2, e, m * u**2 / SIGMA_PX**3, np.ones_like(u)])
    grains = np.exp(-((u[:, None] - u) ** 2) / (4 * correlation_px**2))
    noise = contrast**2 * np.outer(m, m) * grains + np.diag(GAIN * (m + LIGHT) + READ**2 + 1 / 12)
    return float(np.sqrt(np.linalg.inv(jacobian.T @ np.linalg.solve(noise, jacobian))[0, 0]))


@pytest.mark.parametrize("contrast", [0.0, 0.15, 0.25])
@pytest.mark.parametrize("sensor", [SENSOR, None], ids=["known", "estimated"])
def test_one_mode_is_at_the_bound_and_knows_it(
    contrast: float, sensor: Sensor | None, rng: np.random.Generator
) -> None:
    peaks = made().extract(Frame(drawn(rng, contrast), sensor=sensor))
    assert len(peaks) == X_PX.size
    error = errors_px(peaks, X_PX)
    assert rms(error) < 1.06 * bound_px(contrast)
    assert abs(error.mean()) < 0.006 + 3.0 * error.std() / np.sqrt(error.size)
    assert 0.92 < rms(peaks.x_std_px) / error.std() < 1.08
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
    peaks = made().extract(Frame(drawn(rng, np.where(left, 0.03, 0.25)), sensor=SENSOR))
    error = errors_px(peaks, X_PX)
    for side, contrast in ((peaks.x_px < 195, 0.03), (peaks.x_px > 215, 0.25)):
        assert rms(error[side]) < 1.1 * bound_px(contrast)


def test_errors_along_the_stripe_are_as_correlated_as_said(rng: np.random.Generator) -> None:
    peaks = made().extract(Frame(drawn(rng, 0.2), sensor=SENSOR))
    error = errors_px(peaks, X_PX).reshape(ROWS, STRIPES)
    error -= error.mean(0)
    seen = [float((error[lag:] * error[: ROWS - lag]).mean() / (error**2).mean()) for lag in (1, 2)]
    said = [np.exp(-(lag**2) / (4 * peaks.correlation_rows**2)) for lag in (1, 2)]
    assert sum(said) == pytest.approx(sum(seen), abs=0.1)
    assert made().extract(Frame(drawn(rng, 0.0), sensor=SENSOR)).correlation_rows < 0.4


@pytest.mark.parametrize("spacing_sigmas", [8, 10])
def test_near_stripes_do_not_disturb_each_other(spacing_sigmas: int, rng: np.random.Generator) -> None:
    x_px = 40.0 + spacing_sigmas * SIGMA_PX * np.arange(12)[:, None] + 0.03 * np.arange(120)[None, :]
    peaks = made().extract(Frame(drawn(rng, 0.0, x_px), sensor=SENSOR))
    assert len(peaks) == x_px.size
    assert rms(errors_px(peaks, x_px)) < 1.08 * bound_px(0.0)


def test_a_region_gives_the_same_peaks_as_the_whole(rng: np.random.Generator) -> None:
    frame = Frame(drawn(rng, 0.0), sensor=SENSOR)
    told = {"speckle_contrast": 0.0, "threshold": 20.0}
    whole, part = made(**told).extract(frame), made(**told, region=(50, 90, 92, 215)).extract(frame)
    inside = (whole.row >= 58) & (whole.row < 82) & (np.abs(whole.x_px - 150) < 60)
    shown = (part.row >= 58) & (part.row < 82)
    assert inside.sum() == shown.sum() == 24 * 3
    # Peaks that are fitted side by side stop together, a little earlier or later.
    assert np.abs(part.x_px[shown] - whole.x_px[inside]).max() < 1e-3
    with pytest.raises(StageError, match="region"):
        made(region=(0, 500, 0, 10)).extract(frame)


def test_noise_from_a_file_does_what_the_images_own_does_and_of_other_images_is_refused(
    rng: np.random.Generator, tmp_path: Path
) -> None:
    noise_file, pixels = tmp_path / "noise.json", drawn(rng, 0.2)
    frames = [Frame(drawn(rng, 0.2), sensor=SENSOR) for _ in range(2)]
    held = measured(frames, MaximumLikelihoodOptions())
    noise_file.write_text(json.dumps(held), "utf-8")
    extractor = made(noise=noise_file)
    assert rms(errors_px(extractor.extract(Frame(pixels)), X_PX)) < 1.06 * bound_px(0.2)
    for frame, said in (
        (Frame(pixels[:100]), "image_size"),
        (Frame(pixels, turn_deg=180), "turn_deg"),
        (Frame(pixels.astype(np.uint16), bit_depth=12), "bit_depth"),
    ):
        with pytest.raises(StageError, match=said):
            extractor.extract(frame)
    broken = tmp_path / "broken.json"
    for content in ({**held, "speckle_contrast": [[0.1]]}, {**held, "frames": 0}, {}, [1]):
        broken.write_text(json.dumps(content), "utf-8")
        with pytest.raises(StageError, match="broken"):
            made(noise=broken).extract(Frame(pixels))
    with pytest.raises(StageError, match="cannot be read"):
        made(noise=tmp_path / "gone.json").extract(Frame(pixels))
    for nothing in ([], [Frame(np.zeros((50, 60), np.uint8))]):
        with pytest.raises(DataError):
            measured(nothing, MaximumLikelihoodOptions())


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


@pytest.mark.parametrize("threshold", ["auto", 20.0])
def test_overexposed_stripes_of_no_gaussian_shape_are_not_taken_for_noise(
    threshold: float | str, rng: np.random.Generator
) -> None:
    off = np.abs(np.arange(400)[None, None, :] - X_PX[:, :, None])
    height = rng.uniform(200.0, 1200.0, X_PX.shape)[:, :, None]
    flat = (height * np.clip(4.0 - off, 0.0, 1.0) + 60.0 * np.exp(-off / 3.0)).sum(axis=0)
    _, packed = cv2.imencode(".jpg", np.clip(flat, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 85])
    pixels = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)
    extractor = made(threshold=threshold)
    image, found = starts(Frame(pixels), extractor.options)
    noise = estimated_noise(image, 255, found)
    assert noise.variance <= 5.2**2  # grey levels²
    assert noise.gain <= 1.0
    off_px = np.abs(errors_px(extractor.extract(Frame(pixels)), X_PX))
    assert (off_px < 1.0).sum() >= 0.9 * X_PX.size  # px


def test_a_stripe_narrower_than_a_hot_pixel_goes_on(rng: np.random.Generator) -> None:
    pixels = rng.normal(12.0, 1.0, (60, 120))
    x_px = 40.2 + 0.05 * np.arange(60)
    d = np.arange(120) - x_px[:, None]
    pixels += 80.0 * (erf((d + 0.5) / 1.0) - erf((d - 0.5) / 1.0))  # σ 0.7: 1.67 px wide
    pixels[20, 90] = 200.0
    peaks = made().extract(Frame(np.rint(pixels).astype(np.uint8)))
    assert (peaks.width_px < MaximumLikelihoodOptions().width_min_px).all()
    assert set(peaks.row) >= set(range(1, 59)), "first and last go on to one side only"
    assert np.abs(peaks.x_px - x_px[peaks.row]).max() < 0.1, "px; the hot pixel is 50 px beside"
