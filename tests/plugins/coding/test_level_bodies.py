"""A flat body one label height high lies where its neighbours' belt does: refused, never guessed."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import AMBIGUOUS
from roemetry.testing.scenes import LinearRig, wrong_labels
from roemetry_coding.planes import Planes
from roemetry_kernels.consistency import refuse_unexplained_gaps


def level(linear: LinearRig, stripes: slice, rows: slice, spacings: float) -> np.ndarray:
    """(stripe, row) heights, mm, of a flat body that displaces its stripes by some spacings."""
    height = linear.belt()
    height[stripes, rows] = spacings * linear.spacing_px / linear.px_per_mm
    return height


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("stripes", [slice(1, 4), slice(2, 5)])
def test_exactly_one_spacing_high_is_refused(stripes: slice, mirrored: bool) -> None:
    """Beyond the body a stripe is hidden; what lies on the rest lines may be belt or body."""
    plain = LinearRig()
    rig = plain.mirrored() if mirrored else plain
    x_px = rig.x_px(level(rig, stripes, slice(70, 130), 1.0))
    hidden = (stripes.stop if not mirrored else stripes.start - 1), slice(70, 130)
    x_px[hidden] = np.nan  # it would lie where the body's last stripe does
    found = rig.peaks(x_px, 0.1)
    coded = Planes().code(found.peaks, rig.calibration())
    body = np.zeros(x_px.shape, np.bool_)
    body[stripes, 75:125] = True
    on_body = body[found.stripe, found.peaks.row]
    assert not wrong_labels(coded.peak_stripe, found.stripe)[on_body].any()
    assert (coded.peak_stripe[~on_body] >= 0).mean() > 0.6


def test_a_gap_that_nothing_explains_casts_doubt_up_to_the_next_stripe_that_is_missing() -> None:
    """Bodies that go on from the shifted belts are refused with them."""
    linear = LinearRig()
    rest_px = linear.rest_px()
    x_px = rest_px.copy()
    x_px[1, 60:120] = np.nan  # interrupted, nothing near
    x_px[4, 60:120] += 9.0  # a body
    x_px[5, 60:120] = np.nan  # the next that is missing
    found = linear.peaks(x_px)
    line = np.where(found.stripe == 4, -1, found.stripe)
    line[(found.stripe == 4) & ((found.peaks.row < 60) | (found.peaks.row >= 120))] = 4
    displacement_px = np.full(linear.stripes, linear.px_per_mm)
    for whole in (False, True):
        said, reasons = refuse_unexplained_gaps(
            found.peaks, found.stripe, line, rest_px, displacement_px, 20, on_bodies_too=whole
        )
        refused = np.unique(found.stripe[(said == AMBIGUOUS) & (np.abs(found.peaks.row - 90) < 25)])
        np.testing.assert_array_equal(refused, [2, 3, 4] if whole else [2, 3])
        assert [reason.code for reason in reasons] == ["unexplained-gap"]


@pytest.mark.parametrize("refused", [False, True])
@pytest.mark.parametrize("off_spacings, doubted", [(0.1, True), (0.4, False)])
def test_only_a_body_that_is_high_enough_explains_a_hidden_stripe(
    off_spacings: float, doubted: bool, refused: bool
) -> None:
    """Beside an interrupted stripe all others are displaced, a little or much; the nearest may be refused."""
    linear = LinearRig()
    x_px = linear.rest_px()
    x_px[1, 60:120] = np.nan
    x_px[2:, 60:120] += off_spacings * linear.spacing_px
    found = linear.peaks(x_px)
    within = (found.peaks.row >= 60) & (found.peaks.row < 120)
    line = np.where(within & (found.stripe >= 2), -1, found.stripe)
    displacement_px = np.full(linear.stripes, linear.px_per_mm)
    given = np.where(refused & within & (found.stripe == 2), AMBIGUOUS, found.stripe)
    said, _ = refuse_unexplained_gaps(
        found.peaks, given, line, linear.rest_px(), displacement_px, 20, on_bodies_too=True
    )
    inside = (found.peaks.row >= 65) & (found.peaks.row < 115) & (found.stripe >= 3)
    outside = (found.peaks.row < 55) | (found.peaks.row >= 125)
    assert ((said == AMBIGUOUS) == doubted)[inside].all()
    assert not (said == AMBIGUOUS)[outside].any()
