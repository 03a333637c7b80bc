"""From an acquisition to the frame the extractor sees."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.errors import DataError
from roemetry.preparing import prepare
from roemetry.records import Acquisition, Frame

PICTURE = np.arange(12, dtype=np.uint8).reshape(3, 4)


def acquisition(**frames: np.ndarray) -> Acquisition:
    return Acquisition("a", tuple(Frame(pixels, role=role) for role, pixels in frames.items()))


def ready(given: Acquisition, channel: str = "grey", turn_deg: int = 0, subtract: str = "none") -> Frame:
    return prepare(given, channel=channel, turn_deg=turn_deg, subtract=subtract)


def test_a_turn_is_a_rotation_counter_clockwise_and_no_mirror() -> None:
    turned = ready(acquisition(laser=PICTURE), turn_deg=90)
    assert turned.pixels.tolist() == [[3, 7, 11], [2, 6, 10], [1, 5, 9], [0, 4, 8]]
    assert turned.turn_deg == 90
    again = ready(Acquisition("a", (turned,)), turn_deg=270)
    assert again.pixels.tolist() == PICTURE.tolist()
    assert again.turn_deg == 0


def test_channels() -> None:
    colour = np.zeros((1, 2, 3), np.uint8)
    colour[0, 0] = (10, 20, 200)
    given = acquisition(laser=colour)
    assert ready(given, "red").pixels[0, 0] == 200
    assert ready(given, "blue").pixels[0, 0] == 10
    assert ready(given, "max").pixels[0, 0] == 200
    assert ready(given, "grey").pixels[0, 0] == round(0.299 * 200 + 0.587 * 20 + 0.114 * 10)


def test_dark_is_taken_away_and_never_wraps() -> None:
    dark = np.full((3, 4), 5, np.uint8)
    frame = ready(acquisition(laser=PICTURE, dark=dark), subtract="dark")
    assert frame.pixels.tolist() == np.maximum(PICTURE.astype(int) - 5, 0).tolist()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (acquisition(plain=PICTURE), "no laser image"),
        (acquisition(laser=PICTURE), "no dark image"),
        (acquisition(laser=PICTURE, dark=PICTURE.T.copy()), "the dark image is"),
    ],
)
def test_refusals(given: Acquisition, says: str) -> None:
    with pytest.raises(DataError, match=says):
        ready(given, subtract="dark")
