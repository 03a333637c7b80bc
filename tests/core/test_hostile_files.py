"""Files that nobody means well with: whatever stands in them, only our own error comes out, and soon."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from roemetry.config.recipe import Recipe
from roemetry.errors import DataError, RoemetryError
from roemetry.io.yaml_source import parse, read_numbers
from roemetry.records import Acquisition, Frame
from roemetry.run.preprocess import prepare
from roemetry.run.transport_faults import check_joins, check_repeats

HOME = Path(__file__).parents[2] / "recipes"
TEXTS = [path.read_bytes() for path in sorted(HOME.glob("*/*.yaml")) if path.stat().st_size < 4000]


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [*a]",
        "a: &a [x, x]\n" + "".join(f"b{i}: &b{i} [{', '.join(['*a'] * 9)}]\n" for i in range(9)),
        "[" * 3000 + "]" * 3000,
        "".join(" " * depth + "a:\n" for depth in range(2000)),
        "a: \0",
        "a: \ud800",
        "a: " + "9" * 10_000,
    ],
    ids=[
        "recursive",
        "a billion laughs",
        "3000 lists",
        "2000 maps",
        "NUL",
        "half a surrogate",
        "10,000 digits",
    ],
)
def test_a_text_that_would_never_end_is_refused_at_once(text: str) -> None:
    begun = time.perf_counter()
    with pytest.raises(RoemetryError, match="f:"):
        parse(text, "f")
    assert time.perf_counter() - begun < 2.0


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("a:\n  - {seed: 29, !!python/object:os.system: {kinds: {bent: 1}}}", "f:2:"),
        ("a: 1\n? ? ? b: c", "f:2:"),
        ("{[1, 2]: 3}", "f:1:2"),
        ("{{a: 1}: 3}", "f:1:2"),
    ],
)
def test_a_map_or_a_list_as_a_key_is_refused_with_its_place(text: str, place: str) -> None:
    with pytest.raises(RoemetryError, match="a map or a list is no key") as refused:
        parse(text, "f")
    assert str(refused.value).startswith(place)


@given(data=st.data())
@settings(max_examples=300)
def test_a_recipe_with_any_bytes_changed_is_read_or_refused(data: st.DataObject, tmp_path_factory) -> None:
    raw = bytearray(data.draw(st.sampled_from(TEXTS)))
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(raw) - 1))
        new = data.draw(
            st.binary(max_size=4) | st.sampled_from([b"*", b"&a ", b"[", b"{", b": ", b"\n", b"true"])
        )
        raw[at : at + data.draw(st.integers(0, 4))] = new
    path = tmp_path_factory.getbasetemp() / "mutated.yaml"
    path.write_bytes(bytes(raw))
    try:
        Recipe.load(path)
    except RoemetryError as error:
        assert error.message.strip()


def test_a_byte_that_is_not_utf_8_has_a_place(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_bytes("roemetry: 1\r\nproduct: rö".encode() + b"\xe4e\n")
    with pytest.raises(RoemetryError, match=r"recipe\.yaml:2:12: byte 0xe4 is not UTF-8"):
        Recipe.load(path)


def test_yes_is_no_number(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    extractor = "{use: gaussian, options: {threshold: true}}"
    path.write_text(f"roemetry: 1\nproduct: roe\nstages:\n  extractor: {extractor}\nsource: {{path: .}}\n")
    with pytest.raises(RoemetryError, match=r"recipe\.yaml:4:\d+: .*threshold"):
        Recipe.load(path)


@pytest.mark.parametrize("line", ["row", "column"])
@pytest.mark.parametrize("fault", ["sent twice", "filled with black", "filled with the last ones"])
def test_lines_that_no_sensor_gives_refuse_the_image(fault: str, line: str, rng: np.random.Generator) -> None:
    pixels = np.clip(rng.normal(12.0, 1.0, (200, 320)), 0, 255).astype(np.uint8)
    pixels[:, 40::60] = 200
    frame = Frame(pixels, role="laser", name="frame", bit_depth=8)
    prepare(Acquisition("a", (frame,)), turn_deg=0, subtract="none")
    bad = {
        "sent twice": np.concatenate([pixels[:100], pixels[80:180]]),
        "filled with black": np.concatenate([pixels[:180], np.zeros_like(pixels[:20])]),
        "filled with the last ones": np.concatenate([pixels[:80], pixels[100:], pixels[-20:]]),
    }[fault]
    bad = bad if line == "row" else np.ascontiguousarray(bad.T)
    with pytest.raises(DataError, match=f"the {line} .* noise makes impossible"):
        prepare(Acquisition("a", (replace(frame, pixels=bad),)), turn_deg=0, subtract="none")


def lines(
    rng: np.random.Generator,
    shift_px: float | NDArray[np.float64] = 0.0,
    slant: float = 0.3,
    pitch_px: float = 40.0,
    sigma_px: float = 1.4,
    peak: float = 150.0,
) -> NDArray[np.float64]:
    """Bright slanted lines with noise, in 240 × 240 pixels."""
    column, row = np.meshgrid(np.arange(240.0), np.arange(240.0))
    across = (column + slant * row + shift_px) % pitch_px - 0.5 * pitch_px
    return 8.0 + peak * np.exp(-0.5 * (across / sigma_px) ** 2) + rng.normal(0.0, 2.0, row.shape)


def frame_of(light: NDArray[np.float64]) -> Frame:
    return Frame(np.clip(light, 0, 255).astype(np.uint8), role="laser", name="a", bit_depth=8)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("specks", [0.0, 0.03])
def test_an_image_joined_of_two_is_refused_where_it_is_joined(
    axis: int, specks: float, rng: np.random.Generator
) -> None:
    one, other = lines(rng), lines(rng, 19.0)
    for light in (one, other):
        light[rng.random(light.shape) < specks] = 255.0
    check_joins(frame_of(one))
    joined = np.concatenate([np.split(one, [130], axis)[0], np.split(other, [130], axis)[1]], axis)
    with pytest.raises(DataError, match=f"the {('rows', 'columns')[axis]} 129 and 130"):
        check_joins(frame_of(joined))
    row = np.arange(240.0)[:, None]
    with pytest.raises(DataError, match="between the rows"):  # of two frames that take turns
        check_joins(frame_of(lines(rng, 15.0 * (row % 2) * (row > 100))))


@pytest.mark.parametrize("slant", [0.0, 0.004, 0.3])
@pytest.mark.parametrize("sigma_px", [0.3, 0.6, 1.5])
def test_lines_as_thin_as_a_pixel_are_no_joins(
    slant: float, sigma_px: float, rng: np.random.Generator
) -> None:
    light, other = (lines(rng, shift_px, slant, 30.0, sigma_px, 200.0) for shift_px in (0.2, 15.2))
    for pixels in (light, light.T):
        check_joins(frame_of(pixels))
    with pytest.raises(DataError, match="the rows 129 and 130"):  # as thin as they are, joins are seen
        check_joins(frame_of(np.concatenate([light[:130], other[130:]])))


def test_dark_rows_of_a_sensor_that_clips_are_no_fault(rng: np.random.Generator) -> None:
    pixels = np.clip(rng.normal(-3.0, 2.0, (200, 320)), 0, 255).astype(np.uint8)
    pixels[20:150, 40::60] = rng.integers(100, 200, (130, 5))
    pixels[150:] = 0
    frame = Frame(pixels, role="laser", name="frame", bit_depth=8)
    seen = prepare(Acquisition("a", (frame,)), turn_deg=0, subtract="none")
    np.testing.assert_array_equal(seen.pixels, pixels)


@pytest.mark.parametrize("lines", [1, 3])
def test_black_lines_that_fill_up_a_frame_refuse_it(lines: int, rng: np.random.Generator) -> None:
    light = 12.0 + 180.0 * (np.arange(320) % 16 < 3)
    pixels = np.clip(rng.normal(light, 2.0, (200, 320)), 0, 255).astype(np.uint8)
    pixels[200 - lines :] = 0
    frame = Frame(pixels, role="laser", name="frame", bit_depth=8)
    with pytest.raises(DataError, match=f"row {200 - lines} .* were lost"):
        prepare(Acquisition("a", (frame,)), turn_deg=0, subtract="none")


def test_a_row_of_numbers_amid_a_longer_value_is_read_as_yaml_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "numbers.yaml"
    path.write_text("a: [1.0,\nb: [2.0, 3.0]\n  4.0]\nc: [5.0]\n", "utf-8")
    with pytest.raises(RoemetryError):
        read_numbers(path)
    path.write_text("a: x\n  - [2.0, 3.0]\n  y\n", "utf-8")
    assert read_numbers(path) == {"a": "x - [2.0, 3.0] y"}


def test_a_block_of_the_frame_before_under_thin_stripes_of_one_colour_refuses_the_image(
    rng: np.random.Generator,
) -> None:
    """Black but for one channel: of eight bytes two or three hold light, and repeat by accident."""
    light = np.zeros((240, 320, 3))
    place = np.arange(320)
    for channel, first in ((1, 0.0), (2, 16.0)):
        light[..., channel] = 150.0 * np.exp(-0.5 * (((place - first + 16.0) % 32.0 - 16.0) / 1.3) ** 2)
    new, before = (
        np.clip(rng.normal(light, 0.25 * np.sqrt(light)), 0, 255).round().astype(np.uint8) for _ in range(2)
    )
    check_repeats(Frame(new, name="frame"), before)
    torn = new.copy()
    torn[80:130, 100:170] = before[80:130, 100:170]
    with pytest.raises(DataError, match="identical to the image before"):
        check_repeats(Frame(torn, name="frame"), before)


@pytest.mark.parametrize("noise_grey", [2.0, 0.0], ids=["noise", "no noise"])
@pytest.mark.parametrize("part", [np.s_[:, 200:], np.s_[60:140, 64:256], np.s_[::2]])
def test_a_part_of_the_frame_before_refuses_the_image(
    part: tuple[slice, ...], noise_grey: float, rng: np.random.Generator
) -> None:
    light = 12.0 + 180.0 * (np.arange(320) % 16 < 3)
    new, before = (
        np.clip(rng.normal(light, noise_grey, (200, 320)), 0, 255).astype(np.uint8) for _ in range(2)
    )
    frame = Frame(new, name="frame")
    check_repeats(frame, before)
    check_repeats(frame, new)  # the very same file, copied
    torn = new.copy()
    torn[part] = before[part]
    if noise_grey:
        with pytest.raises(DataError, match="identical to the image before"):
            check_repeats(replace(frame, pixels=torn), before)
    else:
        check_repeats(replace(frame, pixels=torn), before)
