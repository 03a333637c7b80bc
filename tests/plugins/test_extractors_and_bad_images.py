"""Every registered extractor on images no one hopes for: right, or refused with a reason, never a crash."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry.errors import DataError, RoemetryError
from roemetry.records import EDGE, SATURATED, WIDE, Frame, Peaks
from roemetry.stages.registry import discover

REGISTRY = discover()
NAMES = [each.entry.name for each in REGISTRY.of_kind("extractor") if each.missing is None]
TOLD = {"dominant-peak": {"threshold": 30.0, "start": "lowest"}}
"""The paper's stage has a fixed threshold: it takes no noise for a stripe only if told a fitting one."""

WHOLE_PIXEL = {"dominant-peak": "the last pixel of a flat top counts"}

NARROW = {"steger": "a flat top much wider than its filter has no ridge in the middle"}

RNG = partial(np.random.default_rng, 20260711)
ROWS, COLUMNS = 96, 320
REST_PX = np.array([60.0, 130.0, 200.0, 270.0])

every_extractor = pytest.mark.parametrize("name", NAMES)
every_line_extractor = pytest.mark.parametrize(
    "name",
    [
        name
        for name in NAMES
        if REGISTRY.load(REGISTRY.find("extractor", name)).capabilities.pattern == "lines"
    ],
)


def made(name: str):
    cls = REGISTRY.load(REGISTRY.find("extractor", name))
    return cls(cls.Options(**TOLD.get(name, {})))


def centres(tilt: float = 0.05, rows: int = ROWS) -> np.ndarray:
    """(stripe, row) true centres, px."""
    return REST_PX[:, None] + tilt * (np.arange(rows) - rows / 2) + 0.3


def light(x_px: np.ndarray, sigma: float = 1.8, amplitude: float = 160.0) -> np.ndarray:
    """Give the mean grey levels of stripes."""
    off = np.arange(COLUMNS)[None, None, :] - x_px[:, :, None]
    return 14.0 + (amplitude * np.exp(-0.5 * (off / sigma) ** 2)).sum(axis=0)


def camera(level: np.ndarray, rng: np.random.Generator | None = None) -> np.ndarray:
    """Round to 8 bit, with noise of 1.5 grey levels where a generator is given."""
    noisy = level if rng is None else level + rng.normal(0.0, 1.5, level.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def stripes_of(peaks: Peaks) -> np.ndarray:
    """Tell which peaks are given as sound ones: neither too wide nor cut off by the border."""
    return peaks.flags & (WIDE | EDGE) == 0


def sane(peaks: Peaks, frame: Frame) -> None:
    """Hold what must be true of any result."""
    assert peaks.image_size == frame.size
    assert np.isfinite(peaks.x_px).all()
    for values in (peaks.amplitude, peaks.background):
        assert np.isfinite(values).all()
    assert (peaks.amplitude >= 0.0).all()
    below_white = peaks.flags & SATURATED == 0
    assert (peaks.amplitude[below_white] <= 3.0 * frame.white).all()
    assert ((peaks.background >= -0.1 * frame.white) & (peaks.background <= frame.white)).all()
    assert not (peaks.width_px <= 0.0).any()
    assert not (peaks.x_std_px <= 0.0).any()


def extracted(name: str, pixels: np.ndarray, bit_depth: int = 8) -> Peaks | None:
    """Extract; None where the image was refused by a named error."""
    try:
        frame = Frame(pixels, bit_depth=bit_depth)
        peaks = made(name).extract(frame)
    except RoemetryError as refusal:
        assert str(refusal)
        return None
    sane(peaks, frame)
    return peaks


def strays(peaks: Peaks, x_px: np.ndarray, within_px: float) -> float:
    """Give the share of sound peaks that are farther from every true centre of their row."""
    sound = stripes_of(peaks)
    distance = np.abs(x_px[:, peaks.row[sound]] - peaks.x_px[sound]).min(axis=0)
    return float((distance > within_px).mean()) if distance.size else 0.0


def found_share(peaks: Peaks, x_px: np.ndarray, within_px: float) -> float:
    """Give the share of true centres, first and last rows aside, that have a peak near them."""
    hit = 0
    for row in range(2, x_px.shape[1] - 2):
        there = peaks.x_px[peaks.row_start[row] : peaks.row_start[row + 1]]
        if there.size:
            hit += int((np.abs(x_px[:, row, None] - there).min(axis=1) <= within_px).sum())
    return hit / (x_px.shape[0] * (x_px.shape[1] - 4))


@dataclass(frozen=True)
class Scene:
    """An image, its stripes, and what is asked: how near to one sound peaks lie, what share is found."""

    pixels: np.ndarray
    x_px: np.ndarray
    within_px: float = np.inf
    share: float = 0.0
    bits: int = 8
    strays: float = 0.0
    may_be_refused: bool = False


def drawn(x_px: np.ndarray, width: int = 1) -> np.ndarray:
    """Give grey levels of lines so many whole pixels wide."""
    level = np.full((ROWS, COLUMNS), 14.0)
    for line in x_px.astype(int):
        for off in range(-(width // 2), width // 2 + width % 2):
            level[np.arange(ROWS), line + off] = 180.0
    return level


def flat_tops(width: int) -> Scene:
    """No Gaussian at all: found all the same, and near the middle."""
    lines = np.rint(centres())
    level = cv2.GaussianBlur(drawn(lines, width), (7, 1), 0.9)
    return Scene(camera(level, RNG()), lines - 0.5 * (1 - width % 2), share=0.95)


def jpeg(quality: int) -> Scene:
    """The ringing beside a stripe is light in the image: a few of its ripples may pass, no more."""
    _, packed = cv2.imencode(".jpg", camera(light(centres()), RNG()), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return Scene(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), centres(), 1.5, 0.99, strays=0.01)


def seen(x_px: np.ndarray, within_px: float, level: np.ndarray | None = None) -> Scene:
    return Scene(camera(light(x_px) if level is None else level, RNG()), x_px, within_px)


def deep(bits: int, kind: str = "u2", **asked: bool) -> Scene:
    """Twelve bits of light in sixteen, in some order of bytes."""
    level = 16.0 * (light(centres()) + RNG().normal(0.0, 1.5, (ROWS, COLUMNS)))
    return Scene(np.clip(np.rint(level), 0, 4095).astype(kind), centres(), 1.5, 0.99, bits, **asked)


TWO = centres()[[0, 2]]
SCENES = {
    "one pixel wide": seen(np.rint(centres()), 0.6, drawn(np.rint(centres()))),
    "forty pixels wide": seen(TWO, 2.0, light(TWO, sigma=17.0)),
    "touching": seen(np.sort(np.concatenate([centres(), centres() + 9.0]), axis=0), 1.5),
    "blended": seen(centres() + 1.8, 3.0, light(np.concatenate([centres(), centres() + 3.6]))),
    "interlaced": seen(centres() + 6.0 * (np.arange(ROWS) % 2), 1.0),
    "flat tops of 4": flat_tops(4),
    "flat tops of 9": flat_tops(9),
    "jpeg 40": jpeg(40),
    "jpeg 80": jpeg(80),
    "12 of 16 bits": deep(12),
    "12 of 16 bits, not told": deep(16, may_be_refused=True),  # white is far away: all is dim
    "little-endian": deep(12, "<u2", may_be_refused=True),
    "big-endian": deep(12, ">u2", may_be_refused=True),
}


@every_line_extractor
@pytest.mark.parametrize("of", SCENES)
def test_unusual_stripes_are_found_where_they_are_or_refused(name: str, of: str) -> None:
    asked = SCENES[of]
    peaks = extracted(name, asked.pixels, asked.bits)
    if peaks is None:
        assert asked.may_be_refused or not asked.share
        return
    within_px = 8.0 if name in WHOLE_PIXEL and of == "forty pixels wide" else asked.within_px
    assert strays(peaks, asked.x_px, within_px) <= asked.strays
    if not (name in TOLD and of == "12 of 16 bits, not told"):
        near_px = 5.0 if name in TOLD and of.startswith("flat") else 1.5
        assert found_share(peaks, asked.x_px, near_px) >= asked.share


@every_extractor
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_an_image_that_is_white_all_over(name: str, bits: int) -> None:
    pixels = np.full((ROWS, COLUMNS), 2**bits - 1, np.uint8 if bits == 8 else np.uint16)
    peaks = extracted(name, pixels, bits)
    assert peaks is None or not len(peaks)


@every_line_extractor
def test_stripes_cut_off_at_white(name: str, rng: np.random.Generator) -> None:
    x_px = centres()
    peaks = extracted(name, camera(light(x_px, sigma=3.0, amplitude=20_000.0), rng))
    near = np.abs(x_px[:, peaks.row] - peaks.x_px).min(axis=0) < 12.0
    assert (peaks.flags[near] & SATURATED).all(), "a top at white is told"
    if name not in WHOLE_PIXEL:
        assert not strays(peaks, x_px, 3.0 if name in NARROW else 1.0)
        assert name in NARROW or found_share(peaks, x_px, 1.0) >= 0.8


@every_line_extractor
def test_what_a_headroom_tells_of_clipped_light_is_used_and_flagged(
    name: str, rng: np.random.Generator
) -> None:
    """As in contrast images: a threshold keeps its grey levels, whatever is above white."""
    x_px = centres()
    level = light(x_px[:2], amplitude=400.0) + light(x_px[2:3]) + light(x_px[3:], amplitude=60.0) - 28.0
    pixels = np.rint(np.clip(level + rng.normal(0.0, 1.0, level.shape), 0.0, 510.0)).astype(np.uint16)
    cls = REGISTRY.load(REGISTRY.find("extractor", name))
    stage = cls(cls.Options(**TOLD.get(name, {}) | {"threshold": 100.0}))
    peaks = stage.extract(Frame(pixels, bit_depth=8, headroom=255))
    assert found_share(peaks, x_px[:3], 1.0) >= 0.95
    assert not found_share(peaks, x_px[3:], 5.0)
    assert not strays(peaks, x_px, 1.0)
    bright = np.abs(x_px[:2][:, peaks.row] - peaks.x_px).min(axis=0) < 2.0
    assert np.array_equal((peaks.flags & SATURATED) > 0, bright)
    assert 350.0 < np.median(peaks.amplitude[bright]) < 450.0


@every_line_extractor
@pytest.mark.parametrize("lines", [slice(None), slice(0, 1)])
def test_dark_lines_on_bright_ground_are_named_and_no_stripes(name, lines, rng) -> None:
    x_px = centres()[lines]
    peaks = extracted(name, camera(214.0 - light(x_px), rng))
    sound = stripes_of(peaks)
    assert not (np.abs(x_px[:, peaks.row[sound]] - peaks.x_px[sound]).min(axis=0) < 2.0).any()
    assert "upside-down" in {reason.code for reason in peaks.reasons}


@every_extractor
def test_bright_stripes_are_not_named_so(name, rng) -> None:
    for level in (light(centres()), 60.0 + light(centres()), 0.0 * light(centres())):
        peaks = extracted(name, camera(level, rng))
        assert "upside-down" not in {reason.code for reason in peaks.reasons}


@every_line_extractor
@pytest.mark.parametrize(("hot", "share", "within_px"), [("columns", 0.99, 1.5), ("pixels", 0.98, 3.0)])
def test_hot_columns_and_pixels_cost_no_stripe_and_are_none(name, hot, share, within_px, rng) -> None:
    x_px, level = centres(), light(centres())
    if hot == "columns":
        level[:, [20, 95, 165, 235, 300]] += 150.0
    else:
        level[rng.integers(0, ROWS, 60), rng.integers(0, COLUMNS, 60)] += 150.0
    peaks = extracted(name, camera(level, rng))
    assert peaks is not None
    assert found_share(peaks, x_px, min(within_px, 2.0)) >= share
    if "width_min_px" in type(made(name)).Options.model_fields:
        assert not strays(peaks, x_px, within_px)


@every_extractor
def test_pixels_above_the_bit_depth_are_refused(name: str) -> None:
    pixels = np.full((ROWS, COLUMNS), 100, np.uint16)
    pixels[40, 150] = 5000
    with pytest.raises(DataError, match="bit depth"):
        made(name).extract(Frame(pixels, bit_depth=12))


@every_extractor
def test_a_ramp_has_no_stripe(name: str, rng: np.random.Generator) -> None:
    level = np.broadcast_to(np.linspace(5.0, 240.0, COLUMNS), (ROWS, COLUMNS))
    peaks = extracted(name, camera(level, rng))
    assert peaks is None or not stripes_of(peaks).any()


@settings(max_examples=40, deadline=None)
@given(st.data())
@every_extractor
def test_any_shape_and_any_content(name: str, data: st.DataObject) -> None:
    """Whatever is in the image: a sane result or a named refusal, the same twice."""
    rows = data.draw(st.integers(1, 24), "rows")
    columns = data.draw(st.integers(1, 48), "columns")
    bits = data.draw(st.sampled_from([1, 8, 10, 12, 16]), "bits")
    white = 2**bits - 1
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1), "seed"))
    content = data.draw(
        st.sampled_from(["noise", "black and white", "plateaus", "one lit", "bright noise"]), "content"
    )
    if content == "noise":
        level = rng.integers(0, white + 1, (rows, columns))
    elif content == "black and white":
        level = white * rng.integers(0, 2, (rows, columns))
    elif content == "plateaus":
        level = np.repeat(rng.integers(0, white + 1, (rows, columns // 4 + 1)), 4, axis=1)[:, :columns]
    elif content == "one lit":
        level = np.zeros((rows, columns), int)
        level[rng.integers(0, rows), rng.integers(0, columns)] = white
    else:
        level = np.clip(white - rng.integers(0, 3, (rows, columns)), 0, white)
    pixels = level.astype(np.uint8 if bits <= 8 else np.uint16)
    first, second = extracted(name, pixels, bits), extracted(name, pixels, bits)
    assert (first is None) == (second is None)
    if first is not None and second is not None:
        np.testing.assert_array_equal(first.x_px, second.x_px)
