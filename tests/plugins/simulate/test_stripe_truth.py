"""Stripe centres against closed forms: three planes meet in a point, a plane and a row cut an ellipsoid."""

import numpy as np
import pytest

from roemetry_simulate.optics import fan_through, looking_down
from roemetry_simulate.solid import Block, EmptyBelt, on_grid
from roemetry_simulate.truth import stripe_centres

CAMERA = looking_down(
    200, 40, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0, tilt_x_deg=1.0, tilt_y_deg=-0.4
)
LASER = fan_through((160.0, -4.0, 300.0), [-9.0, 0.0, 8.7], yaw_deg=0.6, sigma_mm=0.3, peak_grey=300.0)


def row_plane(row):
    """Plane of all rays of a pixel row: normal and offset in the belt frame."""
    normal = CAMERA.rotation @ np.array([0.0, CAMERA.focal_length_px, -(row - CAMERA.principal_px[1])])
    normal /= np.linalg.norm(normal)
    return normal, normal @ CAMERA.centre_mm


def on_level(z_mm):
    """Points of every (stripe, row) on a level surface, shape (S, R, 3)."""
    points = np.empty((LASER.count, CAMERA.height_px, 3))
    for i in range(LASER.count):
        for row in range(CAMERA.height_px):
            normal, offset = row_plane(row)
            planes = np.array([normal, LASER.normals[i], [0.0, 0.0, 1.0]])
            points[i, row] = np.linalg.solve(planes, [offset, LASER.offsets_mm[i], z_mm])
    return points


def on_ellipsoid(i, row, axes_mm):
    """Highest point of one (stripe, row) on an ellipsoid about the origin, None where there is none."""
    normal, offset = row_plane(row)
    planes = np.array([normal, LASER.normals[i]])
    base = np.linalg.lstsq(planes, np.array([offset, LASER.offsets_mm[i]]), rcond=None)[0]
    along = np.cross(*planes)
    along /= np.linalg.norm(along)
    p, q = base / axes_mm, along / axes_mm
    a, b, c = q @ q, 2 * p @ q, p @ p - 1.0
    root = b * b - 4 * a * c
    if root <= 0.0:
        return None
    ends = [base + t * along for t in ((-b - np.sqrt(root)) / (2 * a), (-b + np.sqrt(root)) / (2 * a))]
    return max(ends, key=lambda point: point[2])


def assert_is(truth, points, on, where=np.s_[:]):
    assert (truth.on_product[where] == on).all()
    assert (truth.hits[where] == 1).all()
    np.testing.assert_allclose(truth.x_px[where], CAMERA.project(points)[where][..., 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(truth.xyz_mm[where], points[where], rtol=0, atol=1e-6)


def test_stripes_on_the_empty_belt_are_where_three_planes_meet():
    assert_is(stripe_centres(CAMERA, LASER, EmptyBelt()), on_level(0.0), on=0)


def test_stripes_on_a_block_are_where_three_planes_meet():
    truth = stripe_centres(CAMERA, LASER, Block(60.0, 60.0, 7.5, yaw_deg=3.0))
    assert_is(truth, on_level(7.5), on=1)


def test_stripes_beside_a_block_stay_on_the_belt_and_the_edge_hides_some_rows():
    truth = stripe_centres(CAMERA, LASER, Block(60.0, 4.0, 3.0))
    belt, top = on_level(0.0), on_level(3.0)
    on_belt, on_top = truth.on_product == 0, truth.on_product == 1
    assert on_belt.any()
    assert on_top.any()
    np.testing.assert_allclose(truth.xyz_mm[on_belt], belt[on_belt], rtol=0, atol=1e-6)
    np.testing.assert_allclose(truth.xyz_mm[on_top], top[on_top], rtol=0, atol=1e-6)
    assert (np.abs(top[on_top][:, 1]) <= 2.0 + 1e-9).all()
    assert np.isnan(truth.x_px[truth.on_product == -1]).all()


def test_stripes_on_an_ellipsoid_are_the_roots_of_a_quadratic():
    axes = np.array([19.0, 14.0, 9.0])

    def cap(x, y):
        return axes[2] ** 2 * np.maximum(1.0 - (x / axes[0]) ** 2 - (y / axes[1]) ** 2, -0.4)

    dome = on_grid(
        (-22, 22, -18, 18), 0.125, lambda x, y: 0 * x, cap, lambda x, y: np.minimum(cap(x, y), 0.0)
    )
    truth = stripe_centres(CAMERA, LASER, dome)
    compared = 0
    for i, row in zip(*np.nonzero(truth.on_product == 1), strict=True):
        point = on_ellipsoid(i, row, axes)
        assert point is not None
        assert truth.x_px[i, row] == pytest.approx(CAMERA.project(point)[0], abs=0.003)
        np.testing.assert_allclose(truth.xyz_mm[i, row], point, rtol=0, atol=1e-3)
        compared += 1
    assert compared > 100


def test_found_points_lie_on_their_plane_and_on_their_row():
    dome = Block(12.0, 5.0, 6.0, yaw_deg=20.0)
    truth = stripe_centres(CAMERA, LASER, dome)
    seen = truth.on_product >= 0
    stripe, row = np.nonzero(seen)
    assert np.abs(LASER.distance_mm(truth.xyz_mm[seen])[np.arange(stripe.size), stripe]).max() < 1e-6
    pixels = CAMERA.project(truth.xyz_mm[seen])
    np.testing.assert_allclose(pixels[:, 0], truth.x_px[seen], rtol=0, atol=1e-6)
    np.testing.assert_allclose(pixels[:, 1], row, rtol=0, atol=1e-6)


def test_a_laser_that_misses_the_view_leaves_nothing():
    aside = fan_through((160.0, 0.0, 300.0), [80.0], sigma_mm=0.3, peak_grey=300.0)
    truth = stripe_centres(CAMERA, aside, EmptyBelt())
    assert np.isnan(truth.x_px).all()
    assert (truth.on_product == -1).all()
    assert (truth.hits == 0).all()
