"""A body whose labels are off gets its number by the uneven spacing of the fan, and only by that."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.testing.scenes import LinearRig
from roemetry_coding.planes.vetoes import numbered_by_pattern
from roemetry_kernels.rest_lines import calibrated_rest_lines

ROWS, STRIPES = 120, 12


def scene(
    rng: np.random.Generator, *, uneven_px: float, off: int, dome_px: float = 0.0, alternating: bool = False
):
    """Peaks of a body on stripes 3 to 9, 50 px up, labelled `off` stripes on."""
    rig = LinearRig(rows=ROWS, columns=640, stripes=STRIPES, first_px=60.0)
    calibration = rig.calibration()
    rest_px = calibration.rest_px.copy()
    by = np.resize([1.0, -1.0], STRIPES) if alternating else rng.uniform(-1.0, 1.0, STRIPES)
    rest_px[:, 0] += uneven_px * by
    object.__setattr__(calibration, "rest_px", rest_px)
    x_px = calibration.rest_line_px(np.arange(ROWS, dtype=np.float64))
    body = np.s_[3:10, 30:90]
    stripes = np.arange(3, 10)[:, None]
    x_px[body] += 50.0 + dome_px * np.cos((stripes - 6.0) / 4.0)
    drawn = rig.peaks(x_px, scatter_px=0.1)
    rest = calibrated_rest_lines(drawn.peaks, calibration)
    on_body = (drawn.stripe >= 3) & (drawn.stripe < 10) & (drawn.peaks.row >= 30) & (drawn.peaks.row < 90)
    stripe = np.where(on_body, drawn.stripe + off, drawn.stripe)
    rest = rest._replace(line=np.where(on_body, -1, drawn.stripe))
    return numbered_by_pattern(drawn.peaks.row, drawn.peaks.x_px, stripe, rest), on_body


@pytest.mark.parametrize("off", [1, -1, 2])
@pytest.mark.parametrize("dome_px", [0.0, 6.0])
def test_a_body_that_is_off_gets_its_number_or_none(
    off: int, dome_px: float, rng: np.random.Generator
) -> None:
    (shift, wrong), on_body = scene(rng, uneven_px=2.0, off=off, dome_px=dome_px)
    np.testing.assert_array_equal((shift != 0) | wrong, on_body)
    assert set(shift[on_body]) <= {0, -off}, "never a wrong one"
    if dome_px == 0.0:
        assert (shift[on_body] == -off).all(), "a level body is told apart from all others"


@pytest.mark.parametrize("dome_px", [0.0, 6.0, 30.0])
@pytest.mark.parametrize("uneven_px", [0.0, 2.0])
def test_a_body_that_is_right_is_kept(uneven_px: float, dome_px: float, rng: np.random.Generator) -> None:
    (shift, wrong), _ = scene(rng, uneven_px=uneven_px, off=0, dome_px=dome_px)
    assert not shift.any()
    assert not wrong.any()


def test_a_fan_that_repeats_itself_refuses(rng: np.random.Generator) -> None:
    """Every second distance alike: a number that is odd by one fits as well as one that is odd by three."""
    (shift, wrong), on_body = scene(rng, uneven_px=2.0, off=1, alternating=True)
    assert not shift.any()
    np.testing.assert_array_equal(wrong, on_body)
