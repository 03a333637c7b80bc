"""Frames one after another: which are lost by their numbers, and which of several lights belong together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.records import Frame
from roemetry.records.live import LiveFrame
from roemetry_line.feeds.camera import FrameNumbers
from roemetry_line.station import Exposures


@pytest.mark.parametrize(
    ("counting", "numbers", "lost"),
    [
        ("64-bit", [7, 8, 16, 26], [0, 0, 7, 9]),
        ("64-bit", [0, 1, 2], [0, 0, 0]),
        ("64-bit", [900, 1, 2], [0, 0, 0]),  # the camera was started again
        ("16-bit", [65534, 65535, 1, 2], [0, 0, 0, 0]),
        ("16-bit", [65534, 1, 3], [0, 1, 1]),
        ("16-bit", [65535, 65535], [0, 0]),
        ("16-bit", [200, 100], [0, 0]),
    ],
)
def test_gaps_wraps_and_restarts(counting, numbers, lost) -> None:
    count = FrameNumbers(counting)
    assert [count.lost_before(number) for number in numbers] == lost


@given(st.integers(1, 10**6), st.lists(st.integers(0, 5000), min_size=1, max_size=50))
def test_a_16_bit_counter_that_leaves_0_out_is_followed_across_its_end(first, gaps) -> None:
    count = FrameNumbers("16-bit")
    index = first
    count.lost_before(1 + index % 65535)
    for gap in gaps:
        index += gap + 1
        assert count.lost_before(1 + index % 65535) == gap


@given(
    st.sampled_from([("laser",), ("laser", "plain"), ("plain", "laser", "dark")]),
    st.lists(st.sampled_from(["whole", "whole", "whole", "not whole", "lost"]), max_size=40),
)
def test_a_product_has_the_frames_that_were_taken_of_it(lights, fates) -> None:
    exposures, lost, found = Exposures(lights), 0, []
    for number, fate in enumerate(fates):
        if fate == "lost":
            lost += 1
            continue
        frame = Frame(np.full((2, 2), number, np.uint8)) if fate == "whole" else None
        frames = exposures.add(LiveFrame(frame, number, lost, fault="" if frame else "half of it"))
        lost = 0
        if frames is not None:
            found.append([(frame.role, int(frame.pixels[0, 0])) for frame in frames])
    many = len(lights)
    assert found == [
        [(role, begin + index) for index, role in enumerate(lights)]
        for begin in range(0, len(fates) - many + 1, many)
        if set(fates[begin : begin + many]) == {"whole"}
    ]
