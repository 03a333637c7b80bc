"""Points, views and rest lines of a known pinhole rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.simulated_points import SimulatedRig, shown
from roemetry.errors import DataError
from roemetry.records import StripeMap
from roemetry.records.calibration import Calibration
from roemetry_pinhole.known_files import plane_from, read_camera
from roemetry_pinhole.pinhole_plane import (
    METHOD,
    PinholePlane,
    displacements,
    lines_at_height,
    parameters_of,
    projector_of,
    rest_polynomials,
    view_of,
)

SIZE = (480, 640)
RIGS = {
    "gentle": SimulatedRig(1600.0, 320.0, image_size=SIZE),
    "strong": SimulatedRig(
        600.0, 200.0, tilt_deg=(12.0, -9.0), lens=(-0.3, 0.12, 0.001, -0.0005, -0.02), image_size=SIZE
    ),
}


@pytest.fixture(params=RIGS)
def calibration(request, rng) -> Calibration:
    geometry = shown(RIGS[request.param], rng).geometry
    parameters = parameters_of(geometry, travel=False)
    count = sum(array.size for array in parameters.values())
    root = rng.normal(0.0, 1e-7, (count, count))
    return Calibration(
        METHOD,
        SIZE,
        0,
        rest_polynomials(parameters, SIZE),
        displacements(parameters, SIZE),
        (0.0, 30.0),
        parameters,
        root @ root.T,
        view=view_of(parameters, SIZE),
    )


def stripes_at(calibration: Calibration, z_mm: float, shift_px: float = 0.0) -> StripeMap:
    rows = np.arange(SIZE[0], dtype=np.float64)
    x = lines_at_height(calibration.parameters, rows, z_mm) + shift_px
    x[(x < 0) | (x > SIZE[1] - 1)] = np.nan
    seen = np.isfinite(x)
    return StripeMap(
        x_px=x,
        x_std_px=np.where(seen, 0.1, np.nan),
        product=np.where(seen, 1, -1).astype(np.int16),
        seen=seen,
        margin=np.where(seen, 1.0, np.nan),
        ambiguous=np.zeros(x.shape, np.bool_),
        rest_px=calibration.rest_line_px(rows),
        peak_stripe=np.empty(0, np.int16),
    )


def test_points_are_where_the_view_says(calibration) -> None:
    stripes = stripes_at(calibration, 9.0, 0.7)
    profiles = PinholePlane().triangulate(stripes, calibration)
    view = PinholePlane().view(calibration)
    xy = np.stack([profiles.x_px, profiles.row_px], axis=2)
    lifted = view.lift(xy, np.arange(stripes.stripe_count)[:, None])
    seen = profiles.seen
    assert np.abs(lifted[seen] - profiles.xyz_mm[seen]).max() < 1e-8, "mm"
    assert np.abs(view.project(profiles.xyz_mm)[seen] - xy[seen]).max() < 1e-8, "px"


def test_the_random_part_is_what_a_peak_does_to_its_height(calibration) -> None:
    step = 1e-4
    one = PinholePlane().triangulate(stripes_at(calibration, 9.0), calibration)
    other = PinholePlane().triangulate(stripes_at(calibration, 9.0, step), calibration)
    both = one.seen & other.seen
    slope = np.abs(other.xyz_mm[..., 2] - one.xyz_mm[..., 2])[both] / step
    assert np.abs(0.1 * slope - one.height_std_mm[both]).max() < 1e-5, "mm"


def test_rest_lines_and_displacements_are_those_of_the_planes(calibration) -> None:
    rows = np.arange(SIZE[0], dtype=np.float64)
    lines = lines_at_height(calibration.parameters, rows, 0.0)
    inside = (lines > 0) & (lines < SIZE[1] - 1)
    assert np.abs(calibration.rest_line_px(rows) - lines)[inside].max() < 0.02, "px"
    middle = np.array([(SIZE[0] - 1) / 2.0])
    moved = lines_at_height(calibration.parameters, middle, 0.5) - lines_at_height(
        calibration.parameters, middle, -0.5
    )
    assert np.abs(moved[:, 0] - calibration.displacement_px_per_mm).max() < 1e-3, "px/mm"


def test_a_redrawn_calibration_moves_points_and_view_together(calibration, rng) -> None:
    drawn = calibration.redraw(rng, PinholePlane().view)
    assert calibration.redraw(rng).view is None, "the view of other parameters is not kept"
    stripes = stripes_at(calibration, 9.0)
    profiles = PinholePlane().triangulate(stripes, drawn)
    seen = profiles.seen
    assert np.abs(profiles.xyz_mm[seen][:, 2] - 9.0).max() > 1e-6, "mm"
    xy = np.stack([profiles.x_px, profiles.row_px], axis=2)
    lifted = drawn.view.lift(xy, np.arange(stripes.stripe_count)[:, None])
    assert np.abs(lifted[seen] - profiles.xyz_mm[seen]).max() < 1e-8, "mm"


def test_redraws_have_the_stated_covariance_whatever_the_units(calibration, rng) -> None:
    size = len(calibration.covariance)
    own = 10.0 ** rng.uniform(-9.0, 0.0, size)
    root = rng.normal(size=(size, size)) / np.sqrt(size)
    wanted = own[:, None] * (root @ root.T + 0.1 * np.eye(size)) * own[None, :]
    stated = replace(calibration, covariance=wanted)
    draws = stated.redraws(rng)
    drawn = np.array(
        [
            np.concatenate([a.ravel() for a in draw.parameters.values()])
            for _, draw in zip(range(3000), draws, strict=False)
        ]
    )
    found = np.cov(drawn.T) / own[:, None] / own[None, :]
    assert np.abs(found - wanted / own[:, None] / own[None, :]).max() < 0.2


def test_a_camera_file_without_a_camera(tmp_path: Path) -> None:
    path = tmp_path / "no.yaml"
    path.write_text("%YAML:1.0\n---\nnumber: 3\n", encoding="utf-8")
    with pytest.raises(DataError, match="no 3 × 3 camera matrix"):
        read_camera(path)
    with pytest.raises(DataError, match="cannot be read"):
        read_camera(tmp_path / "none.yaml")


def test_planes_in_either_sign() -> None:
    point = np.array([3.0, -4.0, 200.0])
    a, b, c = 0.6, 0.1, 0.8
    d = a * point[0] + b * point[1] + c * point[2]
    assert plane_from(a, b, c, -d, sign=1) @ point == pytest.approx(1.0)
    assert plane_from(a, b, c, d, sign=-1) @ point == pytest.approx(1.0)
    with pytest.raises(DataError, match="camera's centre"):
        plane_from(1.0, 0.0, 0.0, 0.0, sign=1)


def fan(projector_mm: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Give (stripe, 4) planes through a projector and points 12 mm apart on the belt, each along its axis."""
    at = np.column_stack([np.arange(len(axes)) * 12.0 - 40.0, np.zeros(len(axes)), np.zeros(len(axes))])
    normal = np.cross(at - projector_mm, axes)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return np.column_stack([normal, normal @ projector_mm])


def test_a_fan_about_one_line_leaves_the_projector_beside_the_camera(rng) -> None:
    true = np.array([120.0, -4.0, 310.0])
    planes = fan(true, np.tile([0.01, 1.0, 0.005], (11, 1)))
    planes[:, 3] += rng.normal(0.0, 0.02, 11)
    found = projector_of(planes)
    assert abs(found[1]) < 1.0  # mm; the noise alone would put it anywhere
    assert np.linalg.norm((found - true)[[0, 2]]) < 2.0


def test_planes_turned_against_each_other_show_where_the_projector_is(rng) -> None:
    true = np.array([120.0, 60.0, 310.0])
    axes = np.column_stack([np.linspace(-0.5, 0.5, 11) ** 2, np.ones(11), np.zeros(11)])
    planes = fan(true, axes)
    planes[:, 3] += rng.normal(0.0, 0.02, 11)
    assert np.abs(projector_of(planes) - true).max() < 1.5  # mm
