"""What the centre of gravity of a run promises beyond the contract of an extractor."""

import numpy as np
from roemetry_example.extractor import RunCentroid, RunCentroidOptions

from roemetry.records import SATURATED, Frame


def test_the_middle_of_a_drawn_stripe_is_found():
    x = np.arange(64)
    truth = np.linspace(20.0, 40.0, 32)
    image = 200.0 * np.exp(-0.5 * ((x - truth[:, None]) / 2.0) ** 2)
    peaks = RunCentroid(RunCentroidOptions(threshold=10)).extract(Frame(np.rint(image).astype(np.uint8)))
    assert np.array_equal(peaks.row, np.arange(32))
    np.testing.assert_allclose(peaks.x_px, truth, atol=0.02)  # px


def test_a_white_plateau_has_its_centre_in_the_middle_and_is_flagged():
    pixels = np.zeros((3, 20), np.uint8)
    pixels[1, 8:13] = 255
    peaks = RunCentroid().extract(Frame(pixels))
    assert peaks.x_px.tolist() == [10.0]
    assert peaks.flags.tolist() == [SATURATED]
