"""The coder `ordered`: right where order decides, refused where it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.testing.scenes import LinearRig, wrong_labels
from roemetry_coding.ordered import Ordered

LINEAR = LinearRig()


@pytest.mark.parametrize("dead", [0, 3, 6])
def test_a_dead_stripe_is_named_and_costs_its_own_points_only(dead: int) -> None:
    x_px = LINEAR.x_px(LINEAR.dome(8.0))
    x_px[dead] = np.nan
    found = LINEAR.peaks(x_px, 0.1)
    coded = Ordered().code(found.peaks, LINEAR.calibration())
    assert not wrong_labels(coded.peak_stripe, found.stripe).any()
    assert (coded.peak_stripe >= 0).mean() > 0.99
    (reason,) = [r for r in coded.reasons if r.code == "stripe-missing"]
    assert reason.text.endswith(f"stripe {dead + 1}")


def test_false_peaks_are_left_out(rng) -> None:
    x_px = LINEAR.x_px(LINEAR.dome(8.0))
    false = np.full((1, LINEAR.rows), np.nan)
    rows = rng.choice(LINEAR.rows, 20, replace=False)
    false[0, rows] = x_px[3, rows] + rng.uniform(8.0, 30.0, rows.size)
    found = LINEAR.peaks(np.concatenate([x_px, false]), 0.1)
    coded = Ordered().code(found.peaks, LINEAR.calibration())
    true = found.stripe < LINEAR.stripes
    assert not wrong_labels(coded.peak_stripe[true], found.stripe[true]).any()
    assert (coded.peak_stripe[~true] < 0).mean() > 0.8
    assert (coded.peak_stripe[true] >= 0).mean() > 0.97


def test_refusals_say_what_is_missing() -> None:
    found = LINEAR.peaks(LINEAR.x_px(LINEAR.belt()))
    with pytest.raises(StageError, match="needs a calibration"):
        Ordered().code(found.peaks, None)
    with pytest.raises(StageError, match="no stripe lies where the 7 rest lines are"):
        moved = replace(LINEAR, first_px=LINEAR.first_px + 15.0)
        Ordered().code(found.peaks, moved.calibration())
