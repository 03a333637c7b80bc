"""Stripes at the border, in glare and in tissue that scatters light: found where they are, or flagged."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from roemetry.records import EDGE, SATURATED, Frame, Sensor
from roemetry.records.arrays import Floats
from roemetry.stages.registry import discover
from roemetry_peaks.centre_of_gravity import CentreOfGravity
from roemetry_peaks.gaussian import Gaussian
from roemetry_peaks.log_parabola import LogParabola
from roemetry_peaks.maximum_likelihood import MaximumLikelihood
from roemetry_peaks.steger import Steger
from roemetry_peaks.zero_crossing import ZeroCrossing
from tests.plugins.peaks.drawing import SENSOR, exposed, speckled

SIGMA_PX, GAIN = 2.0, 0.0255
ROWS, COLUMNS = 240, 96
BY_ROW = ("centre-of-gravity", "fir-zero-crossing", "gaussian", "log-parabola")
by_row = pytest.mark.parametrize("name", BY_ROW)
stated = pytest.mark.parametrize("name", (*BY_ROW, "maximum-likelihood"))


@cache
def extractor(name: str):
    registry = discover()
    return registry.load(registry.find("extractor", name))()


def stripe(columns: int, centre_px: Floats, height: float) -> Floats:
    """(row, column) light of a stripe by its centres."""
    return height * np.exp(-0.5 * ((np.arange(columns) - centre_px[:, None]) / SIGMA_PX) ** 2)


def taken(light: Floats, rng: np.random.Generator, ambient: float = 10.0) -> Frame:
    """An image with shot noise and read noise."""
    level = rng.poisson((ambient + light) / GAIN) * GAIN + rng.normal(0.0, 1.0, light.shape)
    pixels = np.clip(np.rint(level), 0, 255).astype(np.uint8)
    return Frame(pixels, sensor=Sensor(gain_grey_per_electron=GAIN, read_noise_grey=1.0))


def drawn(centre_px: Floats, rng: np.random.Generator, height: float = 150.0) -> Frame:
    """One stripe at the left border, and one amid the image."""
    light = stripe(COLUMNS, centre_px, height) + stripe(COLUMNS, centre_px + 45.0, height)
    return taken(light, rng, 15.0)


def found_in(name: str, frame: Frame, centre_px: Floats, *, right: bool):
    """(peak, 5) centre, error, what is stated, whether flagged as cut off and as saturated, at one border.

    The image may be mirrored before, and what is found after.
    """
    pixels = frame.pixels[:, ::-1] if right else frame.pixels
    peaks = extractor(name).extract(Frame(np.ascontiguousarray(pixels), sensor=frame.sensor))
    x_px = frame.pixels.shape[1] - 1 - peaks.x_px if right else peaks.x_px
    at = centre_px[peaks.row]
    flags = [peaks.flags & EDGE != 0, peaks.flags & SATURATED != 0]
    return np.column_stack([at, x_px - at, peaks.x_std_px, *flags])


@stated
def test_what_is_stated_at_either_border_is_what_comes_out(name: str, rng) -> None:
    """From one standard deviation of the stripe inside on, within a tenth of what it is amid the image."""
    rows, peaks = [], []
    for frame in range(16):  # each goes through all distances, down or up the rows
        way = np.linspace(rng.uniform(0.0, 2.0), rng.uniform(6.0, 8.0), ROWS)
        centre_px = way if frame % 4 < 2 else way[::-1]
        seen = found_in(name, drawn(centre_px, rng), centre_px, right=frame % 2 == 1)
        peaks.append(np.column_stack([seen, np.full(len(seen), frame % 2)]))
        rows.append(np.column_stack([centre_px / SIGMA_PX, np.full(ROWS, frame % 2)]))
    at, every = np.concatenate(rows), np.concatenate(peaks)
    inner = every[np.abs(every[:, 1] - 45.0) < 3.0]
    amid = np.sqrt((inner[:, 2] ** 2).mean() / ((inner[:, 1] - 45.0) ** 2).mean())
    found = every[np.abs(every[:, 1]) < 3.0]
    place = found[:, 0] / SIGMA_PX
    for low, high in ((1.0, 1.5), (1.5, 2.0), (2.0, 3.0)):
        here = found[(place >= low) & (place < high)]
        there = at[(at[:, 0] >= low) & (at[:, 0] < high)]
        for side in (0, 1):  # a bias at one border may be the opposite at the other
            mine = here[here[:, 5] == side]
            assert len(mine) >= 0.95 * (there[:, 1] == side).sum(), (low, high, side)
            assert abs(mine[:, 1].mean()) < 0.012, (low, high, side)  # px
        rms = float(np.sqrt((here[:, 1] ** 2).mean()))
        assert rms < 0.04, (low, high)  # px
        assert 0.87 < float(np.sqrt((here[:, 2] ** 2).mean())) / rms / amid < 1.1, (low, high)
    assert found[place < 1.5, 3].all()
    assert not inner[:, 3].any()


@stated
def test_a_top_outside_the_image_is_not_given(name: str, rng) -> None:
    peaks = extractor(name).extract(drawn(np.full(ROWS, -1.5), rng))
    assert ((peaks.x_px > 20.0) & (peaks.x_px <= COLUMNS - 1.0)).all()


@stated
def test_a_stripe_that_white_and_either_border_cut_off(name: str, rng) -> None:
    """Stated within a factor of two; as for a stripe seen whole, an eighth of it might be stated.

    A tenth of a pixel, wherever its plateau lies inside.
    """
    for height in (300.0, 500.0):
        found = []
        for frame in range(8):
            centre_px = rng.uniform(2.0, 4.0) + rng.uniform(-0.002, 0.002) * np.arange(ROWS)
            seen = found_in(name, drawn(centre_px, rng, height), centre_px, right=frame % 2 == 1)
            found.append(seen[(np.abs(seen[:, 1]) < 3.0) & seen[:, 3:].all(axis=1)])
        error, std = np.sqrt((np.concatenate(found)[:, 1:3] ** 2).mean(axis=0))
        assert error < 0.05, height  # px
        assert 0.5 < std / error < 2.2, height
    centre_px = np.linspace(3.2, 7.0, ROWS)
    off = found_in(name, drawn(centre_px, rng, 600.0), centre_px, right=False)[:, 1]
    near = np.abs(off) < 3.0
    assert near.sum() >= 0.95 * ROWS
    assert np.sqrt((off[near] ** 2).mean()) < 0.1


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


@pytest.mark.parametrize(
    ("level", "wide_px", "left"),
    [(190.0, 25, False), (400.0, 25, True), (400.0, 50, False), (400.0, 50, True)],
)
@by_row
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


@by_row
def test_what_grows_wide_on_both_sides_is_wide(name, rng) -> None:
    """An overexposed blob: no flank goes on, so nothing says that it is a narrow stripe."""
    frame, _ = in_glare(rng, 0.0, 400.0, 14, False)
    pixels = np.maximum(frame.pixels, in_glare(rng, 0.0, 400.0, 14, True)[0].pixels)
    peaks = extractor(name).extract(Frame(pixels, sensor=frame.sensor))
    inside = (np.abs(peaks.x_px - 130.0) < 20.0) & (peaks.row >= GLARE.start) & (peaks.row < GLARE.stop)
    assert inside.sum() == GLARE.stop - GLARE.start
    assert (peaks.width_px[inside] > 20.0).all()
    assert np.abs(peaks.x_px[inside] - 130.0).max() < 1.0


def leaving(rng: np.random.Generator, lean: float, height: float = 600.0) -> tuple[Frame, np.ndarray]:
    """Two stripes of which the left one leaves the image, and (row,) its centres."""
    centre_px = rng.uniform(20.0, 20.5) - lean * np.arange(160)
    return taken(stripe(140, centre_px, height) + stripe(140, centre_px + 70.0, height), rng), centre_px


@pytest.mark.parametrize("lean", [0.15, 0.4])
@by_row
def test_a_stripe_is_given_until_its_middle_has_left(name, lean, rng) -> None:
    """To the left downwards, and to the right upwards by turns."""
    off, std, given, wanted = [], [], 0, 0
    for turned in (False, True) * 4:
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
        std.append(peaks.x_std_px[left])
        inside = (centre_px > -0.3) & (centre_px < 1.0)
        wanted += inside.sum()
        given += np.isin(row[left], np.flatnonzero(inside)).sum()
    away, said = np.concatenate(off), np.concatenate(std)
    assert given >= 0.9 * wanted
    assert np.abs(away).max() < 0.2  # px: so nothing is given where the middle is outside
    assert 0.8 < np.sqrt((said**2).mean() / (away**2).mean()) < 2.0


@by_row
def test_a_stripe_that_is_not_overexposed_is_left_alone(name, rng) -> None:
    """With a shoulder, what the row shows is what is given; beyond the border nothing is followed."""
    frame, _ = in_glare(rng, 0.0, 120.0, 20, False)
    assert extractor(name).extract(Frame((frame.pixels // 2).astype(np.uint8))).width_px.max() < 8.0
    frame, centre_px = leaving(rng, 0.3, height=150.0)
    peaks = extractor(name).extract(frame)
    assert centre_px[peaks.row[peaks.x_px < 20.0]].min() > -0.2


@by_row
def test_without_a_sensor_nothing_is_stated(name, rng) -> None:
    peaks = extractor(name).extract(Frame(leaving(rng, 0.3)[0].pixels))
    assert (peaks.flags[peaks.x_px < 1.0] == EDGE | SATURATED).any()
    assert np.isnan(peaks.x_std_px).all()


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


def skirted(rng: np.random.Generator, left: float, right: float, rows: int = 500) -> tuple[np.ndarray, ...]:
    """Profiles with a Gaussian peak, σ 1.8 px, on exponential skirts of these shares of its height."""
    centre = 60.0 + rng.uniform(-0.5, 0.5, (rows, 1))
    u = np.arange(120) - centre
    # The skirt's height drifts along the stripe, as tissue does.
    drift = 1.0 + 0.3 * np.sin(np.arange(rows)[:, None] / 40.0)
    skirt = np.where(u < 0, left, right) * drift * np.exp(-np.hypot(u, 2.0) / 3.5)
    return 12.0 + 180.0 * (np.exp(-0.5 * (u / 1.8) ** 2) + skirt), centre[:, 0]


@pytest.mark.parametrize("contrast", [0.12, 0.25])
def test_skirts_of_tissue_neither_pull_the_centre_nor_hide_in_what_is_stated(contrast, rng):
    mean, centre = skirted(rng, 0.2, 0.2)
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
    mean, _ = skirted(rng, 0.1, 0.2, rows=200)
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
