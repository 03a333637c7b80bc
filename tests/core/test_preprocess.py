"""From an acquisition to the frame the extractor sees."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.errors import DataError
from roemetry.records import Acquisition, Frame, Sensor
from roemetry.run.preprocess import prepare, prepare_plain

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


def test_the_plain_image_is_turned_alike_and_keeps_its_colours() -> None:
    colour = np.zeros((3, 4, 3), np.uint8)
    colour[0, 3] = (1, 2, 3)
    given = acquisition(laser=PICTURE, plain=colour)
    plain = prepare_plain(given, turn_deg=90)
    assert plain is not None
    assert plain.pixels[0, 0].tolist() == [1, 2, 3]
    assert plain.turn_deg == ready(given, turn_deg=90).turn_deg
    assert prepare_plain(acquisition(laser=PICTURE), turn_deg=90) is None


def test_a_stated_sensor_goes_before_the_sources() -> None:
    stated = Sensor(0.02, 1.5)
    frame = Frame(PICTURE, sensor=Sensor(0.5, 0.5))
    given = Acquisition("a", (frame,))
    assert prepare(given, channel="grey", turn_deg=0, subtract="none", sensor=stated).sensor == stated
    assert ready(given).sensor == frame.sensor
    with pytest.raises(DataError, match="gain_grey_per_electron is 0"):
        Sensor(0.0, 1.0)
