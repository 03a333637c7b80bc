"""Stripes that the border cuts off, that leave the image, or that glare hides: found, and stated truly."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import EDGE, SATURATED, Frame, Sensor
from roemetry.records.arrays import Floats
from roemetry.stages.registry import discover

SIGMA_PX, GAIN = 2.0, 0.0255
BY_ROW = ("centre-of-gravity", "fir-zero-crossing", "gaussian", "log-parabola")
STATED = (*BY_ROW, "maximum-likelihood")


def extractor(name: str):
    registry = discover()
    return registry.load(next(s for s in registry.of_kind("extractor") if s.entry.name == name))()


def stripe(columns: int, centre_px: Floats, height: float) -> Floats:
    """(row, column) light of a stripe by its centres."""
    return height * np.exp(-0.5 * ((np.arange(columns) - centre_px[:, None]) / SIGMA_PX) ** 2)


def taken(light: Floats, rng: np.random.Generator, ambient: float = 10.0) -> Frame:
    """An image with shot noise and read noise."""
    level = rng.poisson((ambient + light) / GAIN) * GAIN + rng.normal(0.0, 1.0, light.shape)
    pixels = np.clip(np.rint(level), 0, 255).astype(np.uint8)
    return Frame(pixels, sensor=Sensor(gain_grey_per_electron=GAIN, read_noise_grey=1.0))


def mirrored(frame: Frame) -> Frame:
    return Frame(np.ascontiguousarray(frame.pixels[:, ::-1]), sensor=frame.sensor)


ROWS, COLUMNS = 240, 96


def drawn(centre_px: Floats, rng: np.random.Generator, height: float = 150.0) -> Frame:
    """One stripe at the left border, and one amid the image."""
    light = stripe(COLUMNS, centre_px, height) + stripe(COLUMNS, centre_px + 45.0, height)
    return taken(light, rng, 15.0)


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


GLARE = slice(50, 64)


def in_glare(
    rng: np.random.Generator, lean: float, level: float, wide_px: int, left: bool
) -> tuple[Frame, np.ndarray]:
    """Three overexposed stripes, (stripe, row) their centres; beside the middle one some rows have glare."""
    centre_px = np.array([50.0, 130.0, 210.0])[:, None] + lean * (np.arange(120) - 60.0)
    light = sum(stripe(260, one, 600.0) for one in centre_px)
    off = (np.arange(260) - centre_px[1][:, None]) * (-1 if left else 1)
    light[GLARE] = np.maximum(light, np.where((off > 0) & (off < wide_px), level, 0.0))[GLARE]
    return taken(light, rng), centre_px


@pytest.mark.parametrize("left", [False, True], ids=["right", "left"])
@pytest.mark.parametrize(("level", "wide_px"), [(190.0, 25), (400.0, 25), (400.0, 50)])
@pytest.mark.parametrize("name", BY_ROW)
def test_a_stripe_goes_on_through_glare(name, level, wide_px, left, rng) -> None:
    """Glare darker than white, as white as the stripe, and wider than any stripe may be."""
    frame, centre_px = in_glare(rng, 0.7, level, wide_px, left)
    peaks = extractor(name).extract(frame)
    assert (np.bincount(peaks.row, minlength=120) == 3).all()
    off = peaks.x_px - centre_px[np.arange(len(peaks)) % 3, peaks.row]
    middle = np.arange(len(peaks)) % 3 == 1
    inside = middle & (peaks.row >= GLARE.start) & (peaks.row < GLARE.stop)
    assert np.abs(off[inside]).max() < 1.5  # px; half of the run of light is 10 to 26 px beside
    assert np.abs(off[~inside]).max() < 0.15
    assert np.median(peaks.x_std_px[inside]) > 1.0
    assert (peaks.flags < 16).all()


@pytest.mark.parametrize("name", BY_ROW)
def test_what_grows_wide_on_both_sides_is_wide(name, rng) -> None:
    """An overexposed blob: no flank goes on, so nothing says that it is a narrow stripe."""
    frame, _ = in_glare(rng, 0.0, 400.0, 14, False)
    pixels = np.maximum(frame.pixels, in_glare(rng, 0.0, 400.0, 14, True)[0].pixels)
    peaks = extractor(name).extract(Frame(pixels, sensor=frame.sensor))
    inside = (np.abs(peaks.x_px - 130.0) < 20.0) & (peaks.row >= GLARE.start) & (peaks.row < GLARE.stop)
    assert inside.sum() == GLARE.stop - GLARE.start
    assert (peaks.width_px[inside] > 20.0).all()
    assert np.abs(peaks.x_px[inside] - 130.0).max() < 1.0


@pytest.mark.parametrize("name", BY_ROW)
def test_a_stripe_that_is_not_overexposed_is_left_alone(name, rng) -> None:
    """Half as bright, with a shoulder: what the row shows is what is given."""
    frame, _ = in_glare(rng, 0.0, 120.0, 20, False)
    peaks = extractor(name).extract(Frame((frame.pixels // 2).astype(np.uint8)))
    assert peaks.width_px.max() < 8.0


def leaving(rng: np.random.Generator, lean: float, height: float = 600.0) -> tuple[Frame, np.ndarray]:
    """Two stripes of which the left one leaves the image, and (row,) its centres."""
    centre_px = rng.uniform(20.0, 20.5) - lean * np.arange(160)
    return taken(stripe(140, centre_px, height) + stripe(140, centre_px + 70.0, height), rng), centre_px


@pytest.mark.parametrize("turned", [False, True], ids=["left, downwards", "right, upwards"])
@pytest.mark.parametrize("lean", [0.15, 0.4])
@pytest.mark.parametrize("name", BY_ROW)
def test_a_stripe_is_given_until_its_middle_has_left(name, lean, turned, rng) -> None:
    off, stated, given, wanted = [], [], 0, 0
    for _ in range(6):
        frame, centre_px = leaving(rng, lean)
        if turned:
            frame = Frame(np.ascontiguousarray(frame.pixels[::-1, ::-1]), sensor=frame.sensor)
        peaks = extractor(name).extract(frame)
        row = 160 - 1 - peaks.row if turned else peaks.row
        x_px = 140 - 1 - peaks.x_px if turned else peaks.x_px
        left = x_px < 1.0
        assert (np.bincount(row[x_px < 30.0], minlength=160) <= 1).all()
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


@pytest.mark.parametrize("name", BY_ROW)
def test_without_a_sensor_nothing_is_stated(name, rng) -> None:
    frame, _ = leaving(rng, 0.3)
    peaks = extractor(name).extract(Frame(frame.pixels))
    left = peaks.x_px < 1.0
    assert (peaks.flags[left] == EDGE | SATURATED).any()
    assert np.isnan(peaks.x_std_px).all()


@pytest.mark.parametrize("name", BY_ROW)
def test_a_stripe_that_is_not_overexposed_is_not_followed(name, rng) -> None:
    frame, centre_px = leaving(rng, 0.3, height=150.0)
    peaks = extractor(name).extract(frame)
    left = peaks.x_px < 20.0
    assert centre_px[peaks.row[left]].min() > -0.2


@pytest.mark.parametrize("ripple_px", [3, 4, 5])
@pytest.mark.parametrize("name", [name for name in BY_ROW if name != "fir-zero-crossing"])
def test_a_ripple_takes_no_light_from_a_wide_stripe(name, ripple_px) -> None:
    """Black beside a wide top that is highest at one end, and at the other a ripple of nine grey levels."""
    pixels = np.zeros((160, 140), np.uint8)
    pixels[:, 40:49] = [60, 183, 255, 245, 246, 245, 246, 193, 163]
    pixels[:, 47 + ripple_px : 51 + ripple_px] = [4, 9, 9, 4]
    pixels[:, 90:97] = [20, 80, 190, 250, 190, 80, 20]
    peaks = extractor(name).extract(Frame(pixels))
    near = np.abs(peaks.x_px - 44.4) < 0.9
    assert (np.bincount(peaks.row[near], minlength=160) == 1).all()
    assert len(peaks) == 2 * 160
    assert np.abs(peaks.width_px[near] - 8.0).max() < 0.5
