"""The joint adjustment on simulated points: derivatives, the truth comes back, and with the stated spread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated_points import SimulatedRig, noisy, shown
from roemetry.errors import CalibrationError
from roemetry_pinhole.bundle import Measured, adjust, with_disagreement
from roemetry_pinhole.geometry import (
    CAMERA,
    ON_BELT,
    BeltContacts,
    contact_rows,
    corner_rows,
    stripe_residuals,
    stripe_rows,
    unknowns_of,
)
from tests.plugins.pinhole.solids_seen import assert_derivatives, step_sizes

LENS = (-0.2, 0.1, 0.001, -0.0005, 0.02)
RIG = SimulatedRig(1600.0, 350.0, tilt_deg=(6.0, -4.0), lens=LENS, stripes=5, poses=8)
FREE = np.arange(CAMERA) < 9


def unknowns(geometry, **kept):
    return unknowns_of(
        geometry, **({"free_camera": FREE, "planes": True, "belt": True, "travel": False} | kept)
    )


def adjusted(seen, start=None, contact_std_mm=0.03):
    start = start or seen.geometry
    return adjust(
        start, unknowns(start), seen.corners, seen.points, seen.contacts, contact_std_mm=contact_std_mm
    )


def test_derivatives_are_those_of_the_equations(rng) -> None:
    exact = shown(RIG, rng)
    geometry = replace(exact.geometry, travel=np.array([0.1, 0.02, -0.01]))
    every = unknowns(geometry, free_camera=np.ones(CAMERA, bool), travel=True)
    counts = rng.uniform(-2.0, 2.0, exact.points.pose.size) * (exact.points.pose >= 0)
    points = replace(exact.points, counts=counts)
    points = replace(points, x_px=points.x_px - stripe_residuals(geometry, points))
    corners = replace(exact.corners, counts=rng.uniform(-2.0, 2.0, exact.corners.pose.size))
    contacts = BeltContacts(np.array([0, 3]), rng.uniform(0.0, 40.0, (2, 3)), np.array([0.0, 1.5]))
    for rows, seen in ((corner_rows, corners), (stripe_rows, points), (contact_rows, contacts)):
        assert_derivatives(rows, geometry, every, seen, step_sizes(every), 1e-4)


def test_without_noise_the_truth_comes_back(rng) -> None:
    exact = shown(RIG, rng)
    free = unknowns(exact.geometry)
    step = np.zeros(free.count)
    step[free.camera[:4]] = 30.0, -20.0, 8.0, -6.0
    step[free.camera[4]] = 0.02
    step[free.poses.ravel()] = rng.normal(0.0, 0.005, free.poses.size)
    found = adjusted(exact, start=free.moved(exact.geometry, step)).geometry
    assert np.abs(found.camera[:4] - exact.geometry.camera[:4]).max() < 1e-4, "px"
    assert np.abs(found.planes / exact.geometry.planes - 1.0).max() < 1e-6
    assert np.abs(found.belt - exact.geometry.belt).max() < 1e-6 * np.abs(exact.geometry.belt).max()


def test_the_spread_is_the_stated_one(rng) -> None:
    """χ² of planes over their three degrees of freedom, and of the camera's focal length."""
    exact = shown(replace(RIG, rows=12), rng)
    squares, focal = [], []
    for _ in range(12):
        found = adjusted(noisy(exact, rng, 0.08, 0.15, 0.03))
        at = found.unknowns.planes
        off = found.geometry.planes - exact.geometry.planes
        covariance = found.covariance[at[:, :, None], at[:, None, :]]
        squares.append(np.einsum("si,sij,sj->s", off, np.linalg.inv(covariance), off) / 3.0)
        std = np.sqrt(found.covariance[0, 0])
        focal.append((found.geometry.camera[0] - exact.geometry.camera[0]) / std)
        assert found.corner_std_px == pytest.approx(0.08, rel=0.1)
        assert found.stripe_scale == pytest.approx(0.15, rel=0.1)
        assert found.conflict == 1.0
    assert 0.5 < np.mean(squares) < 1.6, "twelve draws with one camera in common"
    assert np.sqrt(np.mean(np.square(focal))) < 1.6


def test_strays_are_left_out(rng) -> None:
    seen = noisy(shown(RIG, rng), rng, 0.05, 0.1, 0.03)
    x, xy = seen.points.x_px.copy(), seen.corners.xy_px.copy()
    x[::40] += 25.0
    xy[::50] += 12.0
    spoilt = replace(seen, points=replace(seen.points, x_px=x), corners=replace(seen.corners, xy_px=xy))
    found, clean = adjusted(spoilt), adjusted(seen)
    assert not found.stripe_used[::40].any()
    assert not found.corner_used[::50].any()
    std = np.sqrt(np.diag(clean.covariance)[clean.unknowns.planes])
    assert (np.abs(found.geometry.planes - clean.geometry.planes) < 1.5 * std).all()


def test_correlated_peaks_count_less(rng) -> None:
    exact = shown(replace(RIG, rows=80), rng)
    order = np.lexsort((exact.points.row_px, exact.points.stripe, exact.points.pose))
    white = rng.normal(0.0, 0.15, order.size + 8)
    smooth = np.convolve(white, np.ones(9) / 3.0, "valid")
    x = exact.points.x_px.copy()
    x[order] += smooth
    found = adjusted(replace(exact, points=replace(exact.points, x_px=x)))
    assert 5.0 < found.correlation < 13.0, "a moving mean over nine has 9"


def test_a_lens_that_refocuses_makes_all_less_certain(rng) -> None:
    exact = shown(RIG, rng)

    def disagreement(drift: float) -> tuple[float, float]:
        seen = noisy(exact, rng, 0.08, 0.15, 0.03)
        grown = 1.0 + drift * (np.arange(RIG.poses + 2) % 3 - 1.0)
        middle = exact.geometry.camera[2:4]
        xy = middle + grown[seen.corners.pose, None] * (seen.corners.xy_px - middle)
        at = np.where(seen.points.pose < 0, RIG.poses, seen.points.pose)
        x = middle[0] + grown[at] * (seen.points.x_px - middle[0])
        corners, points = replace(seen.corners, xy_px=xy), replace(seen.points, x_px=x)
        start = seen.geometry
        measured = Measured(start, unknowns(start), corners, points, seen.contacts, 0.03)
        found = measured.adjusted()
        told = with_disagreement(measured, found)
        assert told.covariance == pytest.approx(told.disagreement * found.covariance)
        return told.disagreement, float(np.sqrt(told.covariance[0, 0]))

    (steady, certain_px), (drifting, doubtful_px) = disagreement(0.0), disagreement(0.008)
    assert steady == 1.0, "noise alone is no disagreement"
    assert drifting > 4.0
    assert doubtful_px > 2.0 * certain_px


def test_one_stripe_and_an_empty_belt_do_not_tell_the_belt(rng) -> None:
    exact = shown(replace(RIG, stripes=1), rng)
    nobody = BeltContacts(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0))
    with pytest.raises(CalibrationError, match="does not determine"):
        adjusted(replace(exact, contacts=nobody))
    assert (exact.points.pose != ON_BELT).all()
    assert np.isfinite(adjusted(noisy(exact, rng, 0.05, 0.1, 0.02)).covariance).all()
