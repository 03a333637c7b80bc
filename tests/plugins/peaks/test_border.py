"""Stripes that the image's border cuts off: found where their top is inside, and stated as they scatter."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import EDGE, SATURATED, Frame, Sensor
from roemetry.records.arrays import Floats
from roemetry.stages.registry import discover

ROWS, COLUMNS, SIGMA_PX, GAIN = 240, 96, 2.0, 0.0255
STATED = ("centre-of-gravity", "fir-zero-crossing", "gaussian", "log-parabola", "maximum-likelihood")


def extractor(name: str):
    registry = discover()
    return registry.load(next(s for s in registry.of_kind("extractor") if s.entry.name == name))()


def drawn(centre_px: Floats, rng: np.random.Generator, height: float = 150.0) -> Frame:
    """One stripe at the left border, and one amid the image, with shot noise and read noise."""
    x = np.arange(COLUMNS)
    light = sum(np.exp(-0.5 * ((x - c[:, None]) / SIGMA_PX) ** 2) for c in (centre_px, centre_px + 45.0))
    level = rng.poisson((15.0 + height * light) / GAIN) * GAIN + rng.normal(0.0, 1.0, light.shape)
    pixels = np.clip(np.rint(level), 0, 255).astype(np.uint8)
    return Frame(pixels, sensor=Sensor(gain_grey_per_electron=GAIN, read_noise_grey=1.0))


def mirrored(frame: Frame) -> Frame:
    return Frame(np.ascontiguousarray(frame.pixels[:, ::-1]), sensor=frame.sensor)


def at_border(name: str, right: bool, rng: np.random.Generator, frames: int = 12):
    """Distances from the border, σ, of all rows; of those found, with errors, what is stated, flags; amid.

    The last is stated over observed of the stripe amid the image.
    """
    stage = extractor(name)
    rows, found, amid = [], [], []
    for _ in range(frames):
        centre_px = rng.uniform(0.0, 8.0) + rng.uniform(-0.008, 0.008) * np.arange(ROWS)
        frame = drawn(centre_px, rng)
        peaks = stage.extract(mirrored(frame) if right else frame)
        x_px = COLUMNS - 1 - peaks.x_px if right else peaks.x_px
        off = x_px - centre_px[peaks.row]
        near = np.abs(off) < 3.0
        rows.append(centre_px / SIGMA_PX)
        flagged = peaks.flags[near] & EDGE
        found.append(
            np.column_stack(
                [centre_px[peaks.row[near]] / SIGMA_PX, off[near], peaks.x_std_px[near], flagged != 0]
            )
        )
        inner = np.abs(off - 45.0) < 3.0
        amid.append(np.column_stack([off[inner] - 45.0, peaks.x_std_px[inner]]))
    observed, stated = (np.concatenate(amid) ** 2).mean(axis=0)
    return np.concatenate(rows), np.concatenate(found), np.sqrt(stated / observed)


@pytest.mark.parametrize("right", [False, True], ids=["left", "right"])
@pytest.mark.parametrize("name", STATED)
def test_what_is_stated_at_the_border_is_what_comes_out(name: str, right: bool, rng) -> None:
    """From one standard deviation of the stripe inside on, within a tenth of what it is amid the image."""
    at, found, amid = at_border(name, right, rng)
    for low, high in ((1.0, 1.5), (1.5, 2.0), (2.0, 3.0)):
        here = found[(found[:, 0] >= low) & (found[:, 0] < high)]
        assert here.shape[0] >= 0.95 * ((at >= low) & (at < high)).sum(), (low, high)
        rms = float(np.sqrt((here[:, 1] ** 2).mean()))
        assert rms < 0.04, (low, high)  # px
        assert 0.87 < float(np.sqrt((here[:, 2] ** 2).mean())) / rms / amid < 1.1, (low, high)
        assert abs(here[:, 1].mean()) < 0.012, (low, high)  # px
    assert found[found[:, 0] < 1.5, 3].all()


@pytest.mark.parametrize("name", STATED)
def test_both_borders_are_alike(name: str, rng) -> None:
    """A mirrored image gives the mirrored peaks, but for the choice among equal pixels."""
    stage = extractor(name)
    centre_px = np.linspace(-1.0, 6.0, ROWS)
    frame = drawn(centre_px, rng)
    one, other = stage.extract(frame), stage.extract(mirrored(frame))
    assert abs(len(one) - len(other)) <= 0.02 * ROWS
    x_px = COLUMNS - 1 - other.x_px
    same = [
        np.abs(x_px[other.row == row] - x).min(initial=9.0) for row, x in zip(one.row, one.x_px, strict=True)
    ]
    assert np.quantile(same, 0.95) < 0.01  # px


@pytest.mark.parametrize("name", STATED)
def test_a_top_outside_the_image_is_not_given(name: str, rng) -> None:
    peaks = extractor(name).extract(drawn(np.full(ROWS, -1.5), rng))
    assert (peaks.x_px > 20.0).all()
    assert ((peaks.x_px >= 0.0) & (peaks.x_px <= COLUMNS - 1.0)).all()


@pytest.mark.parametrize("name", STATED)
def test_a_saturated_stripe_at_the_border(name: str, rng) -> None:
    """Cut off at white and by the border: a tenth of a pixel, wherever its plateau lies inside."""
    centre_px = np.linspace(3.2, 7.0, ROWS)
    peaks = extractor(name).extract(drawn(centre_px, rng, height=600.0))
    off = peaks.x_px - centre_px[peaks.row]
    near = np.abs(off) < 3.0
    assert near.sum() >= 0.95 * ROWS
    assert np.sqrt((off[near] ** 2).mean()) < 0.1


@pytest.mark.parametrize("right", [False, True], ids=["left", "right"])
@pytest.mark.parametrize("name", STATED)
def test_what_is_stated_of_a_stripe_that_white_and_border_cut_off(name: str, right: bool, rng) -> None:
    """Within a factor of two; as for a stripe that is seen whole, an eighth of it might be stated."""
    stage = extractor(name)
    for height in (300.0, 500.0):
        found = []
        for _ in range(6):
            centre_px = rng.uniform(2.0, 4.0) + rng.uniform(-0.002, 0.002) * np.arange(ROWS)
            frame = drawn(centre_px, rng, height)
            peaks = stage.extract(mirrored(frame) if right else frame)
            off = (COLUMNS - 1 - peaks.x_px if right else peaks.x_px) - centre_px[peaks.row]
            cut = (np.abs(off) < 3.0) & (peaks.flags & EDGE != 0) & (peaks.flags & SATURATED != 0)
            found.append(np.column_stack([off[cut], peaks.x_std_px[cut]]))
        error, stated = np.sqrt((np.concatenate(found) ** 2).mean(axis=0))
        assert error < 0.05, height  # px
        assert 0.5 < stated / error < 2.2, height
