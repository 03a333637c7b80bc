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
REGISTRY = discover()
CODERS = {stage.entry.name: REGISTRY.load(stage)() for stage in REGISTRY.of_kind("coder")}
pytestmark = pytest.mark.parametrize("coder", CODERS.values(), ids=CODERS)


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


def wrong(stripes: StripeMap, true: np.ndarray) -> np.ndarray:
    """(peak,) True where a number is given that is not the peak's."""
    return (stripes.peak_stripe >= 0) & (stripes.peak_stripe != true)


def refused_or_told(stripes: StripeMap | None) -> bool:
    """Say whether a coder gave no answer, or one with reasons in which less than a tenth is numbered."""
    return stripes is None or (bool(stripes.reasons) and (stripes.peak_stripe >= 0).mean() < 0.1)


def test_no_peaks(coder: Any) -> None:
    stripes = coded(coder, drawn(np.full((1, RIG.rows), np.nan))[0], RIG.calibration())
    if stripes is not None:
        assert not stripes.seen.any()
        assert stripes.reasons


@pytest.mark.parametrize("kept", ["three stripes", "one row"])
def test_fewer_stripes_than_there_are_planes(coder: Any, kept: str) -> None:
    """Three of seven stripes are left, or one row: none takes another's number, and what lacks is told."""
    x_px = np.full((RIG.stripes, RIG.rows), np.nan)
    left = np.s_[[1, 3, 4]] if kept == "three stripes" else np.s_[:, 100]
    x_px[left] = RIG.x_px(RIG.dome() if kept == "three stripes" else RIG.belt())[left]
    peaks, true = drawn(x_px)
    stripes = coded(coder, peaks, RIG.calibration())
    if stripes is not None:
        assert not wrong(stripes, true).any()
        assert stripes.reasons or kept == "one row"


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
    stripes = coded(coder, peaks, replace(RIG, stripes=planes).calibration())
    if stripes is not None:
        assert not wrong(stripes, true).any()


def test_a_calibration_whose_stripes_lie_elsewhere(coder: Any) -> None:
    """Rest lines half a spacing beside the belt's stripes: nothing fits, so nothing is numbered."""
    other = replace(RIG, first_px=RIG.first_px + 0.5 * RIG.spacing_px, stripes=6)
    assert refused_or_told(coded(coder, drawn(RIG.x_px(RIG.belt()))[0], other.calibration()))


def test_rest_lines_that_cross(coder: Any) -> None:
    """Two rest lines change places in the image: order means nothing."""
    calibration = RIG.calibration()
    rest = calibration.rest_px.copy()
    rest[3, 1] += 0.5  # px per row: crosses its neighbour 80 rows off the middle
    stripes = coded(coder, drawn(RIG.x_px(RIG.dome()))[0], replace(calibration, rest_px=rest))
    if stripes is not None:
        assert stripes.reasons


def test_an_image_turned_the_other_way(coder: Any) -> None:
    """Half a turn: stripes do not lie on rest lines, and bodies bow to the side that light cannot."""
    rig = replace(RIG, first_px=30.0)  # not symmetric in the image
    found = rig.peaks(rig.columns - 1 - rig.x_px(rig.dome())[::-1, ::-1], 0.1)
    assert refused_or_told(coded(coder, found.peaks, rig.calibration()))


def test_noise_without_stripes(coder: Any, rng: np.random.Generator) -> None:
    """Two thousand peaks anywhere: what little is numbered is told of."""
    row = rng.integers(0, RIG.rows, 2000)
    x_px = rng.uniform(0.0, RIG.columns - 1.0, 2000)
    order = np.lexsort((x_px, row))
    flat, size = np.full(2000, 5.0), (RIG.rows, RIG.columns)
    none = np.zeros(2000, np.uint8)
    peaks = Peaks(size, row[order], x_px[order], 0.02 * flat, 8.0 * flat, flat, flat, none)
    assert refused_or_told(coded(coder, peaks, RIG.calibration()))


def test_light_that_no_plane_can_make(coder: Any) -> None:
    """One line beside all rest lines, on the side on which light would lie far below the belt."""
    assert refused_or_told(coded(coder, drawn(np.full((1, RIG.rows), 5.0))[0], RIG.calibration()))
