"""The coder `tracing`: stripes followed over gaps and past their neighbours, doubt refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.testing.scenes import LinearRig, wrong_labels
from roemetry_coding.tracing import Tracing, TracingOptions
from roemetry_kernels.coding.trace_linking import linked_traces


@pytest.fixture
def linear() -> LinearRig:
    return LinearRig()


def test_a_stripe_is_followed_over_a_gap_by_its_direction(linear) -> None:
    """A lean stripe that is broken for 12 rows is one trace; one that begins beside its end another."""
    rows = np.arange(linear.rows)
    lean = 60.0 + 0.8 * rows
    lean[80:92] = np.nan
    beside = np.where(rows < 90, np.nan, 60.0 + 0.8 * 70.0)
    found = linear.peaks(np.array([lean, beside]))
    peaks = found.peaks
    trace, _ = linked_traces(peaks.row_start, peaks.x_px, 3.5, 20)
    of_lean = trace[found.stripe == 0]
    assert np.unique(of_lean).size == 1
    assert of_lean[0] not in trace[found.stripe == 1]


def test_a_longer_gap_ends_a_trace(linear) -> None:
    x_px = linear.x_px(linear.belt())[:1]
    x_px[0, 60:85] = np.nan
    peaks = linear.peaks(x_px).peaks
    assert np.unique(linked_traces(peaks.row_start, peaks.x_px, 3.5, 20)[0]).size == 2
    assert np.unique(linked_traces(peaks.row_start, peaks.x_px, 3.5, 25)[0]).size == 1


@pytest.mark.parametrize("height_mm", [4.0, 8.0, 15.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_smooth_dome_is_labelled_from_the_belt(linear, height_mm: float, mirrored: bool) -> None:
    """Nothing is broken: every stripe hangs together with its belt and has its number."""
    rig = linear.mirrored() if mirrored else linear
    found = rig.peaks(rig.x_px(rig.dome(height_mm)), 0.1)
    coded = Tracing().code(found.peaks, rig.calibration())
    assert not wrong_labels(coded.peak_stripe, found.stripe).any()
    assert (coded.peak_stripe >= 0).mean() > 0.99


def test_breaks_cost_labels_and_never_the_truth(linear, rng) -> None:
    """Each stripe broken once: a body cut off from its belt has its stripe from the other side, or none."""
    x_px = linear.x_px(linear.dome(8.0))
    for stripe in range(linear.stripes):
        start = int(rng.integers(40, 140))
        x_px[stripe, start : start + int(rng.integers(5, 18))] = np.nan
    found = linear.peaks(x_px, 0.1)
    coded = Tracing().code(found.peaks, linear.calibration())
    assert not wrong_labels(coded.peak_stripe, found.stripe).any()
    assert (coded.peak_stripe >= 0).mean() > 0.85


@pytest.mark.parametrize("dead", [0, 3, 6])
def test_a_dead_stripe_is_named_and_costs_its_own_points_only(linear, dead: int) -> None:
    x_px = linear.x_px(linear.dome(8.0))
    x_px[dead] = np.nan
    found = linear.peaks(x_px, 0.1)
    coded = Tracing().code(found.peaks, linear.calibration())
    assert not wrong_labels(coded.peak_stripe, found.stripe).any()
    assert (coded.peak_stripe >= 0).mean() > 0.99
    (reason,) = [r for r in coded.reasons if r.code == "stripe-missing"]
    assert reason.text.endswith(f"stripe {dead + 1}")


def test_single_false_peaks_are_noise(linear, rng) -> None:
    x_px = linear.x_px(linear.dome(8.0))
    false = np.full((1, linear.rows), np.nan)
    rows = np.arange(3, linear.rows, 9)
    false[0, rows] = x_px[3, rows] + rng.uniform(8.0, 30.0, rows.size)
    found = linear.peaks(np.concatenate([x_px, false]), 0.1)
    coded = Tracing().code(found.peaks, linear.calibration())
    true = found.stripe < linear.stripes
    assert (coded.peak_stripe[~true] < 0).all()
    assert not wrong_labels(coded.peak_stripe[true], found.stripe[true]).any()


def test_a_greater_margin_labels_no_more_and_only_what_was_sure(linear) -> None:
    x_px = linear.x_px(linear.dome(12.0))
    x_px[2:5, 60:75] = np.nan
    found = linear.peaks(x_px, 0.1)
    loose, strict = (
        Tracing(TracingOptions(margin_min=m)).code(found.peaks, linear.calibration()) for m in (0.0, 0.95)
    )
    assert ((strict.peak_stripe >= 0) <= (loose.peak_stripe >= 0)).all()
    given = strict.peak_stripe >= 0
    margins = strict.margin[strict.peak_stripe[given], found.peaks.row[given]]
    assert (margins >= 0.95).all()


def test_refusals_say_what_is_missing(linear) -> None:
    found = linear.peaks(linear.x_px(linear.belt()))
    with pytest.raises(StageError, match="needs a calibration"):
        Tracing().code(found.peaks, None)
    with pytest.raises(StageError, match="no stripe lies where the 7 rest lines are"):
        moved = replace(linear, first_px=linear.first_px + 15.0)
        Tracing().code(found.peaks, moved.calibration())


def test_noise_is_refused_as_a_frame(linear, rng) -> None:
    """The belt's stripes and ten times as many false peaks: no frame to be coded."""
    x_px = linear.x_px(linear.belt())
    noise = rng.uniform(2.0, linear.columns - 3.0, (70, linear.rows))
    peaks = linear.peaks(np.concatenate([x_px, noise])).peaks
    with pytest.raises(StageError, match=r"of the peaks lie on traces|no stripe lies"):
        Tracing().code(peaks, linear.calibration())
