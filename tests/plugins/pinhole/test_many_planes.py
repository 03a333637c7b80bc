"""Thirty-one planes of light at once, from image files to heights."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roemetry.calibrating import calibrate
from roemetry.config.rig import Rig
from tests.plugins.pinhole.board_set import FOCAL_PX, NEAR_MM, planes, written

COUNT = 31


def test_thirty_one_planes_are_told_apart_and_measure(tmp_path: Path) -> None:
    """Stripes 7 px apart, eight poses: heights of exact peaks."""
    made = calibrate(Rig.load(written(tmp_path, count=COUNT)))
    assert made.stripe_count == COUNT
    assert not any("not used" in note for note in made.notes)
    off = []
    for height in (0.0, 10.0, 20.0):
        level = np.array([0.0, 0.0, 1.0 / (NEAR_MM - height)])
        for stripe, plane in enumerate(planes(count=COUNT)):
            for row in (60.0, 150.0, 240.0):
                a, b, c = plane - level
                x_px = 199.5 - FOCAL_PX * (b * (row - 149.5) / FOCAL_PX + c) / a
                if 0.0 < x_px < 399.0:
                    off.append(made.view.lift(np.array([x_px, row]), stripe)[2] - height)
    assert np.abs(off).max() < 0.05, "mm"
    assert np.sqrt(np.mean(np.square(off))) < 0.02, "mm"
