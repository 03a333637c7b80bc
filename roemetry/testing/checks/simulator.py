"""What every simulator keeps."""

from __future__ import annotations

from typing import Any

import numpy as np

from roemetry.stages import Simulator
from roemetry.testing.comparing import difference
from roemetry.testing.verdict import require


def check_numbers_and_seeds_make_others(simulator: Simulator[Any]) -> None:
    """Another number and another seed make another image."""
    one, number, seed = (simulator.simulate(*which) for which in ((0, 1), (1, 1), (0, 2)))
    require(difference(one.frames, number.frames) is not None, "numbers 0 and 1 are the same image")
    require(difference(one.frames, seed.frames) is not None, "seeds 1 and 2 make the same image")


def check_truth_fits_the_image(simulator: Simulator[Any]) -> None:
    """True stripe centres have a row for each row of the laser frame and lie within it."""
    made = simulator.simulate(0, 1)
    frame = next((frame for frame in made.frames if frame.role == "laser"), None)
    require(frame is not None, "there is no laser frame")
    if frame is None or made.truth.stripes is None:
        return
    x_px = made.truth.stripes.x_px
    require(x_px.shape[1] == frame.size[0], f"truth of {x_px.shape[1]} rows for {frame.size[0]} rows")
    known = x_px[np.isfinite(x_px)]
    require(bool(((known >= -0.5) & (known <= frame.size[1] - 0.5)).all()), "true centres lie outside")


CHECKS = (check_numbers_and_seeds_make_others, check_truth_fits_the_image)
