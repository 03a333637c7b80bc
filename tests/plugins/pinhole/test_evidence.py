"""What the calibrator shows for itself: held-out views, stripes against each other, and the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated_points import SimulatedRig, noisy, shown
from roemetry.calibrating import evidence_page
from roemetry_pinhole.bundle import Measured
from roemetry_pinhole.calibrator import PinholeCalibrator
from roemetry_pinhole.geometry import CAMERA, unknowns_of
from roemetry_pinhole.pinhole_plane import PinholePlane
from roemetry_pinhole.verdict import cross_validate, lifted, stripe_offsets

RIG = SimulatedRig(
    1600.0, 350.0, tilt_deg=(6.0, -4.0), lens=(-0.2, 0.1, 0.001, -0.0005, 0.02), stripes=5, poses=10
)
MARK_PX, STRIPE_PX = 0.08, 0.15


def measured(seen) -> Measured:
    free = unknowns_of(seen.geometry, free_camera=np.arange(CAMERA) < 9, planes=True, belt=True, travel=False)
    return Measured(seen.geometry, free, seen.corners, seen.points, seen.contacts, 0.03)


def test_held_out_views_fit_as_their_noise_lets_them(rng) -> None:
    seen = noisy(shown(RIG, rng), rng, MARK_PX, STRIPE_PX, 0.03)
    every = measured(seen)
    held = cross_validate(every, every.adjusted().geometry)
    assert held.skipped == 0
    assert len(held.mark_px) == len(seen.corners.pose), "every view is left out once"
    assert np.sqrt((held.mark_px**2).mean()) == pytest.approx(MARK_PX, rel=0.1), "px"
    slope = 0.5  # mm of height for a pixel along the row, about: 350 mm / 1600 px / tan 30°
    assert 0.5 * STRIPE_PX * slope < held.height_mm.std() < 2.0 * STRIPE_PX * slope, "mm"
    assert abs(held.height_mm.mean()) < 0.02, "mm"


def test_a_view_that_is_wrong_shows_when_it_is_held_out(rng) -> None:
    """A board whose stripes were seen with the laser moved by 1 px lies 0.4 mm wrong."""
    seen = noisy(shown(RIG, rng), rng, 0.02, 0.02, 0.03)
    moved = seen.points.x_px + np.where(seen.points.pose == 4, 1.0, 0.0)
    every = measured(replace(seen, points=replace(seen.points, x_px=moved)))
    held = cross_validate(every, every.adjusted().geometry)
    mean = [abs(held.height_mm[held.height_pose == pose].mean()) for pose in range(RIG.poses)]
    assert int(np.argmax(mean)) == 4
    assert 0.2 < mean[4] < 0.8, "mm"


def test_stripes_that_disagree_show_on_every_surface(rng) -> None:
    exact = shown(RIG, rng)
    offset = stripe_offsets(exact.geometry, exact.points)[0]
    assert np.abs(offset).max() < 1e-8, "mm"
    planes = exact.geometry.planes.copy()
    at = lifted(exact.geometry, exact.points)
    planes[2] *= 1.0 + 0.1 / np.abs(at[:, 2]).mean()
    offset, _, surface = stripe_offsets(replace(exact.geometry, planes=planes), exact.points)
    for pose in np.unique(surface):
        mine = offset[surface == pose]
        assert np.ptp(mine) > 0.05, "mm"


def test_the_page_of_a_calibration(observed, calibrated) -> None:
    evidence = PinholeCalibrator().evidence(observed, calibrated)
    assert evidence.verdict[0].startswith("Usable from 0 to")
    assert {one.title for one in evidence.residuals if one.held_out} == {
        "board corners of held-out views, x",
        "board corners of held-out views, y",
        "heights on held-out views",
    }
    figures = {one.title: one for one in evidence.figures}
    assert figures["heights on held-out views, mean of a board, rms"].value < 0.05, "mm"
    assert figures["stripes against each other on one surface, rms"].value < 0.05, "mm"
    text = evidence_page(calibrated, evidence, PinholePlane(), name="rig")
    for title in ("Coverage of the image", "Heights on held-out views", "Correlations of the parameters"):
        assert title in text


@pytest.mark.thorough
def test_a_failed_check_stands_in_the_verdict(observed, calibrated) -> None:
    little = replace(calibrated, residuals={**calibrated.residuals, "corners_coverage": 0.3})
    evidence = PinholeCalibrator().evidence(observed, little)
    assert "checks failed" in evidence.verdict[0]
    assert any("Board corners cover 30% of the image" in sentence for sentence in evidence.verdict)
