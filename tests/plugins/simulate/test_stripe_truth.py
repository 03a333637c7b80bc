"""Stripe centres against closed forms: where an image row, a light plane and a body meet."""

import numpy as np
import pytest

from roemetry.io.meshes import Triangles
from roemetry_simulate.optics import fan_through, looking_down
from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.mesh import close, lay
from roemetry_simulate.ray_caster import stripe_centres
from roemetry_simulate.solid import Block, EmptyBelt
from tests.plugins.simulate.gridded import on_grid

CAMERA = looking_down(
    200, 40, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0, tilt_x_deg=1.0, tilt_y_deg=-0.4
)
LASER = fan_through((160.0, -4.0, 300.0), [-9.0, 0.0, 8.7], yaw_deg=0.6, sigma_mm=0.3, peak_grey=300.0)
BOX = Triangles(
    np.array([[x, y, z] for x in (0, 60) for y in (0, 30) for z in (0, 7)], dtype=float),
    np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
              [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]),
)  # fmt: skip


def line(i, row):
    """Line in which the plane of an image row meets a light plane: a point and a unit direction."""
    normal = CAMERA.rotation @ np.array([0.0, CAMERA.focal_length_px, -(row - CAMERA.principal_px[1])])
    normal /= np.linalg.norm(normal)
    planes = np.array([normal, LASER.normals[i]])
    base = np.linalg.lstsq(planes, np.array([normal @ CAMERA.centre_mm, LASER.offsets_mm[i]]), rcond=None)[0]
    along = np.cross(*planes)
    return base, along / np.linalg.norm(along)


def on_quadric(centre, radii):
    """Give the formula of the highest point on an ellipsoid; an endless radius makes it a cylinder."""

    def point(i, row):
        base, along = line(i, row)
        p, q = (base - centre) / radii, along / radii
        roots = np.roots([q @ q, 2.0 * p @ q, p @ p - 1.0]).real
        return max((base + t * along for t in roots), key=lambda at: at[2])

    return point


def on_plane(normal, offset):
    def point(i, row):
        base, along = line(i, row)
        return base + (offset - np.dot(normal, base)) / np.dot(normal, along) * along

    return point


def draw(name, **options):
    family = PRODUCTS[name]
    return family.draw(1, family.Options(**options)).solid


@pytest.mark.parametrize(
    ("solid", "formula", "least"),
    [
        (EmptyBelt(), on_plane([0.0, 0.0, 1.0], 0.0), 120),
        (Block(60.0, 60.0, 7.5, yaw_deg=3.0), on_plane([0.0, 0.0, 1.0], 7.5), 120),
        (draw("sphere", radius_mm=15.0), on_quadric([0.0, 0.0, 15.0], [15.0] * 3), 60),
        (draw("sphere", radius_mm=40.0, height_mm=9.0), on_quadric([0.0, 0.0, -31.0], [40.0] * 3), 110),
        (draw("cylinder", radius_mm=12.0), on_quadric([0.0, 0.0, 0.0], [np.inf, 12.0, 12.0]), 80),
        (draw("cylinder", radius_mm=12.0, half=False), on_quadric([0, 0, 12.0], [np.inf, 12.0, 12.0]), 80),
        (draw("wedge"), on_plane([-0.25, 0.0, 1.0], 10.0), 100),
        (lay(close(BOX), Pose(0.0, 0.0, 3.0)), on_plane([0.0, 0.0, 1.0], 7.0), 100),
    ],
    ids=["belt", "block", "ball", "cap", "half cylinder", "cylinder", "wedge", "mesh"],
)  # fmt: skip
def test_stripes_lie_where_plane_and_row_meet_the_body(solid, formula, least):
    truth = stripe_centres(CAMERA, LASER, solid)
    found = list(
        zip(*np.nonzero(truth.on_product == (0 if isinstance(solid, EmptyBelt) else 1)), strict=True)
    )
    assert len(found) >= least
    assert (truth.hits[truth.on_product >= 0] >= 1).all()
    for i, row in found:
        np.testing.assert_allclose(truth.xyz_mm[i, row], formula(i, row), rtol=0, atol=1e-6)
        assert truth.x_px[i, row] == pytest.approx(CAMERA.project(formula(i, row))[0], abs=1e-6)


def test_stripes_on_a_gridded_ellipsoid_are_the_roots_of_a_quadratic():
    axes = np.array([19.0, 14.0, 9.0])

    def cap(x, y):
        return axes[2] ** 2 * np.maximum(1.0 - (x / axes[0]) ** 2 - (y / axes[1]) ** 2, -0.4)

    dome = on_grid(
        (-22, 22, -18, 18), 0.125, lambda x, y: 0 * x, cap, lambda x, y: np.minimum(cap(x, y), 0.0)
    )
    truth, formula = stripe_centres(CAMERA, LASER, dome), on_quadric(np.zeros(3), axes)
    found = list(zip(*np.nonzero(truth.on_product == 1), strict=True))
    assert len(found) > 100
    for i, row in found:
        assert truth.x_px[i, row] == pytest.approx(CAMERA.project(formula(i, row))[0], abs=0.003)
        np.testing.assert_allclose(truth.xyz_mm[i, row], formula(i, row), rtol=0, atol=1e-3)


def test_stripes_beside_a_block_stay_on_the_belt_and_the_edge_hides_some_rows():
    truth = stripe_centres(CAMERA, LASER, Block(60.0, 4.0, 3.0))
    for on, z_mm in ((0, 0.0), (1, 3.0)):
        found = list(zip(*np.nonzero(truth.on_product == on), strict=True))
        assert found
        points = np.array([on_plane([0.0, 0.0, 1.0], z_mm)(i, row) for i, row in found])
        np.testing.assert_allclose(truth.xyz_mm[truth.on_product == on], points, rtol=0, atol=1e-6)
    assert (np.abs(truth.xyz_mm[truth.on_product == 1][:, 1]) <= 2.0 + 1e-9).all()
    assert np.isnan(truth.x_px[truth.on_product == -1]).all()


def test_belt_under_a_ball_bar_s_rod_is_seen_by_neither_light_nor_camera():
    truth = stripe_centres(CAMERA, LASER, draw("ball-bar"))
    on_rod = truth.xyz_mm[truth.on_product == 1]
    np.testing.assert_allclose(np.hypot(on_rod[:, 1], on_rod[:, 2] - 12.0), 4.0, atol=1e-6)
    belt = truth.xyz_mm[truth.on_product == 0]
    # light from X = 160 falls along X here: the rod shades the belt below it and nothing beside it
    assert (np.abs(belt[:, 1]) > 3.0).all()
