"""Tall frames, of which some rows tell between which columns to look at all of them."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.run.transport_faults import check_joins, check_lines

ROWS, COLUMNS = 1280, 400


def line_at(x_px: float, rng: np.random.Generator) -> np.ndarray:
    """Give a frame with one upright line on ground with noise."""
    columns = np.arange(COLUMNS)
    light = 11.0 + 180.0 * np.exp(-0.5 * ((columns - x_px) / 1.8) ** 2)
    return np.clip(np.rint(light + rng.normal(0.0, 1.2, (ROWS, COLUMNS))), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("x_px", [150.0, 199.5, 200.25])
def test_a_whole_frame_with_a_line_is_no_join(x_px: float, rng: np.random.Generator) -> None:
    frame = line_at(x_px, rng)
    check_joins(Frame(frame))
    frame[500:, 200:] = line_at(x_px, rng)[500:, 200:]
    check_joins(Frame(frame))  # the same line goes on: nothing breaks off


def test_noise_in_a_dark_frame_is_no_join(rng: np.random.Generator) -> None:
    """Noise as large as a step has to be; black clips half of it."""
    for _ in range(20):
        light = 4.0 + 95.0 * np.exp(-0.5 * ((np.arange(200) - 99.3) / 1.6) ** 2)
        grey = np.clip(np.rint(light + rng.normal(0.0, 7.0, (200, 200))), 0, 255).astype(np.uint8)
        check_joins(Frame(grey))
    grey[:, 99:] = np.roll(grey, 40, axis=1)[:, 99:]
    with pytest.raises(DataError, match="between the columns|between the rows"):
        check_joins(Frame(grey))


@pytest.mark.parametrize("share", [0.06, 0.2, 1.0])
@pytest.mark.parametrize("together", [True, False])
def test_columns_that_are_joined_in_some_rows_are_found(
    share: float, together: bool, rng: np.random.Generator
) -> None:
    """A part of another frame, in rows one after the other or here and there, begins in its line."""
    frame, other = line_at(100.0, rng), line_at(200.0, rng)
    many = round(share * ROWS)
    rows = np.arange(many) if together else rng.choice(ROWS, many, replace=False)
    frame[rows, 200:] = other[rows, 200:]
    with pytest.raises(DataError, match="between the columns 199 and 200|between the rows"):
        check_joins(Frame(frame))


@pytest.mark.parametrize("rows", [slice(1, None, 2), slice(0, None, 2), slice(1, None, 4), slice(3, None, 4)])
@pytest.mark.parametrize("height", [600, ROWS])
def test_columns_that_are_joined_in_every_so_many_rows_are_found(
    rows: slice, height: int, rng: np.random.Generator
) -> None:
    """One field of an interlaced frame is another frame's."""
    frame, other = line_at(100.0, rng)[:height], line_at(200.0, rng)[:height]
    frame[rows, 200:] = other[rows, 200:]
    with pytest.raises(DataError, match="between the columns 199 and 200"):
        check_joins(Frame(frame))


def test_a_speck_in_the_dark_beside_one_line_is_no_end_of_filled_columns(rng: np.random.Generator) -> None:
    """Little read noise leaves all columns but those of the line at one level."""
    columns = np.arange(200.0)
    lit = 90.0 * np.exp(-0.5 * ((columns - 60.0) / 2.0) ** 2) * rng.uniform(0.9, 1.1, (160, 1))
    pixels = (4.0 + lit).astype(np.uint8)
    check_lines(Frame(pixels, name="dark"))
    pixels[80, 137] = 255
    check_lines(Frame(pixels, name="a speck"))
