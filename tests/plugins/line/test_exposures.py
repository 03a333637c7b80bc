"""Frames in several lights: each product gets its own, whatever is lost between them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from roemetry.records import Frame
from roemetry.records.live import LiveFrame
from roemetry_line.station import Exposures


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
    expected = [
        [(role, begin + index) for index, role in enumerate(lights)]
        for begin in range(0, len(fates) - many + 1, many)
        if set(fates[begin : begin + many]) == {"whole"}
    ]
    assert found == expected
