"""A board that is not flat: its shape is found with everything else, and what a flat one would cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated_points import Shown, SimulatedRig, noisy, shown
from roemetry_pinhole.bundle import Measured
from roemetry_pinhole.geometry import (
    CAMERA,
    ON_BELT,
    WARP_COEFFICIENTS,
    BoardWarp,
    Geometry,
    corner_residuals,
    corner_rows,
    distort,
    stripe_residuals,
    stripe_rows,
    unknowns_of,
)
from roemetry_pinhole.verdict import cross_validate, lifted, stripe_offsets
from tests.plugins.pinhole.solids_seen import assert_derivatives

RIG = SimulatedRig(1600.0, 350.0, tilt_deg=(6.0, -4.0), lens=(-0.2, 0.1, 0.0, 0.0, 0.0), stripes=5, poses=10)
FREE = np.arange(CAMERA) < 9


def bowed(exact: Shown, bow_mm: float) -> Shown:
    """What a board shows that is bent like a roof tile, with a twist; marks projected by hand."""
    extent = exact.corners.board_mm[:, :2].max(axis=0)
    warp = BoardWarp.none(*extent)
    coefficients = np.zeros(WARP_COEFFICIENTS)
    coefficients[[0, 1, 5]] = bow_mm, -0.4 * bow_mm, 0.2 * bow_mm  # x², xy, and xy² of the third order
    warp = warp.moved(coefficients)
    geometry = replace(exact.geometry, warp=warp)
    x, y = (exact.corners.board_mm[:, :2] - 0.5 * extent).T / (0.5 * extent.max())
    print_mm = exact.corners.board_mm.copy()
    print_mm[:, 2] = bow_mm * (x**2 - 0.4 * x * y + 0.2 * x * y**2)
    pose = exact.corners.pose
    at = (geometry.rotation[pose] @ print_mm[:, :, None])[:, :, 0] + geometry.shift[pose]
    xy = distort(at[:, :2] / at[:, 2:], geometry.camera[4:]).xy * geometry.camera[:2] + geometry.camera[2:4]
    points = exact.points
    for _ in range(4):
        points = replace(points, x_px=points.x_px - stripe_residuals(geometry, points))
    return replace(exact, geometry=geometry, corners=replace(exact.corners, xy_px=xy), points=points)


def measured(seen: Shown, start: Geometry, *, warp: bool) -> Measured:
    free = unknowns_of(start, free_camera=FREE, planes=True, belt=True, travel=False, warp=warp)
    return Measured(start, free, seen.corners, seen.points, seen.contacts, 0.03)


def test_marks_and_stripes_lie_on_the_bent_print(rng) -> None:
    exact = bowed(shown(RIG, rng), 0.8)
    assert np.abs(corner_residuals(exact.geometry, exact.corners)).max() < 1e-9, "px"
    # where ray and plane of light meet, the print is
    on = exact.points.pose != ON_BELT
    pose = exact.points.pose[on]
    at = lifted(exact.geometry, exact.points)[on] - exact.geometry.shift[pose]
    board = (at[:, None, :] @ exact.geometry.rotation[pose])[:, 0]
    off = board[:, 2] - exact.geometry.warp.height_mm(board[:, :2])
    assert np.abs(off).max() < 1e-6, "mm"
    assert np.ptp(board[:, 2]) > 0.3, "mm"


def test_derivatives_are_those_of_the_equations(rng) -> None:
    exact = bowed(shown(RIG, rng), 0.8)
    every = measured(exact, exact.geometry, warp=True).unknowns
    for rows, seen in ((corner_rows, exact.corners), (stripe_rows, exact.points)):
        assert_derivatives(rows, exact.geometry, every, seen, dict.fromkeys(every.warp, 1e-3), 2e-3)


def test_the_shape_is_found_and_planes_are_right_again(rng) -> None:
    exact = bowed(shown(RIG, rng), 0.5)
    seen = noisy(exact, rng, 0.05, 0.1, 0.03)
    flat = replace(exact.geometry, warp=None)
    start = replace(exact.geometry, warp=exact.geometry.warp.moved(-exact.geometry.warp.coefficients_mm))
    found = measured(seen, start, warp=True).adjusted()
    assert found.corner_std_px == pytest.approx(0.05, rel=0.15)
    off = found.geometry.planes - exact.geometry.planes
    at = found.unknowns.planes
    covariance = found.covariance[at[:, :, None], at[:, None, :]]
    square = np.einsum("si,sij,sj->s", off, np.linalg.inv(covariance), off).mean() / 3.0
    assert square < 2.5
    assert found.geometry.warp.range_mm() == pytest.approx(exact.geometry.warp.range_mm(), abs=0.03), "mm"
    taken_for_flat = measured(seen, flat, warp=False).adjusted()
    assert taken_for_flat.corner_std_px > 1.5 * found.corner_std_px


def test_held_out_views_know_the_shape(rng) -> None:
    exact = bowed(shown(RIG, rng), 0.5)
    seen = noisy(exact, rng, 0.05, 0.1, 0.03)
    every = measured(seen, exact.geometry, warp=True)
    found = every.adjusted().geometry
    held = cross_validate(every, found)
    assert np.sqrt((held.mark_px**2).mean()) == pytest.approx(0.05, rel=0.2), "px"
    assert abs(held.height_mm.mean()) < 0.02, "mm"
    assert np.sqrt((stripe_offsets(found, seen.points)[0] ** 2).mean()) < 0.02, "mm"
