"""Input that no coder can make sense of: refused or ambiguous with a reason, no exception, no guess."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.records import Peaks, StripeMap
from roemetry.records.arrays import Floats
from roemetry.stages.registry import discover
from roemetry.testing import LinearRig

RIG = LinearRig()


def coders() -> dict[str, Any]:
    """Make every registered coder with its default options."""
    registry = discover()
    return {stage.entry.name: registry.load(stage)() for stage in registry.of_kind("coder")}


def coded(coder: Any, peaks: Peaks, calibration: Any) -> StripeMap | None:
    """Code, or give None for a frame that was refused with a reason."""
    try:
        answer: StripeMap = coder.code(peaks, calibration)
    except StageError as refusal:
        assert str(refusal)
        return None
    return answer


def drawn(x_px: Floats) -> tuple[Peaks, np.ndarray]:
    """Give the peaks of (line, row) centres, and the line of each."""
    found = RIG.peaks(x_px, 0.1)
    return found.peaks, found.stripe


pytestmark = pytest.mark.parametrize("coder", list(coders().values()), ids=list(coders()))


def test_fewer_stripes_than_there_are_planes(coder: Any) -> None:
    """Three of seven stripes are left: none of them takes another's number, and the lack is told."""
    x_px = RIG.x_px(RIG.dome())
    x_px[[0, 2, 5, 6]] = np.nan
    peaks, true = drawn(x_px)
    stripes = coded(coder, peaks, RIG.calibration())
    if stripes is not None:
        assert not wrong(stripes, true).any()
        assert stripes.reasons


def test_more_stripes_than_there_are_planes(coder: Any) -> None:
    """Between seven stripes run six that are none, over a dome: no true one takes another's number."""
    x_px = RIG.x_px(RIG.dome(6.0))
    between = 0.5 * (x_px[:-1] + x_px[1:])
    peaks, line = drawn(np.sort(np.concatenate([x_px, between]), axis=0))
    true = np.where(line % 2 == 0, line // 2, -1)
    stripes = coded(coder, peaks, RIG.calibration())
    if stripes is not None:
        assert not wrong(stripes, true)[true >= 0].any()


@pytest.mark.parametrize("planes", [5, 9])
def test_a_calibration_of_another_stripe_count(coder: Any, planes: int) -> None:
    """The calibration's stripes lie where those of the frame do, but it has two fewer, or two more."""
    peaks, true = drawn(RIG.x_px(RIG.dome()))
    other = replace(RIG, stripes=planes)  # the same lines from the left
    stripes = coded(coder, peaks, other.calibration())
    if stripes is not None:
        assert not wrong(stripes, true).any()


def test_a_calibration_whose_stripes_lie_elsewhere(coder: Any) -> None:
    """Rest lines half a spacing beside the belt's stripes: nothing fits, so nothing is numbered."""
    peaks, _ = drawn(RIG.x_px(RIG.belt()))
    other = replace(RIG, first_px=RIG.first_px + 0.5 * RIG.spacing_px, stripes=6)
    refused_or_told(coded(coder, peaks, other.calibration()))


def test_rest_lines_that_cross(coder: Any) -> None:
    """Two rest lines change places in the image: order means nothing."""
    calibration = RIG.calibration()
    rest = calibration.rest_px.copy()
    rest[3, 1] += 0.5  # px per row: crosses its neighbour 80 rows off the middle
    peaks, _ = drawn(RIG.x_px(RIG.dome()))
    stripes = coded(coder, peaks, replace(calibration, rest_px=rest))
    if stripes is not None:
        assert stripes.reasons


def test_an_image_turned_the_other_way(coder: Any) -> None:
    """Half a turn: stripes do not lie on rest lines, and bodies bow to the side that light cannot."""
    rig = replace(RIG, first_px=30.0)  # not symmetric in the image
    found = rig.peaks(rig.columns - 1 - rig.x_px(rig.dome())[::-1, ::-1], 0.1)
    refused_or_told(coded(coder, found.peaks, rig.calibration()))


def test_every_peak_in_one_row(coder: Any) -> None:
    x_px = np.full((RIG.stripes, RIG.rows), np.nan)
    x_px[:, 100] = RIG.x_px(RIG.belt())[:, 100]
    peaks, true = drawn(x_px)
    stripes = coded(coder, peaks, RIG.calibration())
    if stripes is not None:
        assert not wrong(stripes, true).any()


def test_noise_without_stripes(coder: Any, rng: np.random.Generator) -> None:
    """Two thousand peaks anywhere: what little is numbered is told of."""
    row = rng.integers(0, RIG.rows, 2000)
    x_px = rng.uniform(0.0, RIG.columns - 1.0, 2000)
    order = np.lexsort((x_px, row))
    row, x_px = row[order], x_px[order]
    flat = np.full(2000, 5.0)
    peaks = Peaks(
        (RIG.rows, RIG.columns), row, x_px, 0.02 * flat, 8.0 * flat, flat, flat, np.zeros(2000, np.uint8)
    )
    refused_or_told(coded(coder, peaks, RIG.calibration()))


def wrong(stripes: StripeMap, true: np.ndarray) -> np.ndarray:
    """(peak,) True where a number is given that is not the peak's."""
    return (stripes.peak_stripe >= 0) & (stripes.peak_stripe != true)


def refused_or_told(stripes: StripeMap | None) -> None:
    """Hold a coder to it: no answer, or one with reasons in which less than a tenth is numbered."""
    if stripes is not None:
        assert stripes.reasons
        assert (stripes.peak_stripe >= 0).mean() < 0.1
