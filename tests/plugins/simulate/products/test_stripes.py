"""Stripes on artefacts and meshes: points are where image row, light plane and body meet in closed form."""

import numpy as np
import pytest

from roemetry.io.meshes import Triangles
from roemetry_simulate.optics import fan_through, looking_down
from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.mesh import close, lay
from roemetry_simulate.truth import stripe_centres

CAMERA = looking_down(
    200, 40, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0, tilt_x_deg=1.0, tilt_y_deg=-0.4
)
LASER = fan_through((160.0, -4.0, 300.0), [-9.0, 0.0, 8.7], yaw_deg=0.6, sigma_mm=0.3, peak_grey=300.0)


def line(i, row):
    """Line in which the plane of an image row meets a light plane: a point and a unit direction."""
    normal = CAMERA.rotation @ np.array([0.0, CAMERA.focal_length_px, -(row - CAMERA.principal_px[1])])
    normal /= np.linalg.norm(normal)
    planes = np.array([normal, LASER.normals[i]])
    base = np.linalg.lstsq(planes, np.array([normal @ CAMERA.centre_mm, LASER.offsets_mm[i]]), rcond=None)[0]
    along = np.cross(*planes)
    return base, along / np.linalg.norm(along)


def highest_root(a, b, c, base, along):
    roots = np.roots([a, b, c]).real
    return max((base + t * along for t in roots), key=lambda point: point[2])


def on_ball(i, row, centre, radius):
    base, along = line(i, row)
    m = base - centre
    return highest_root(1.0, 2.0 * m @ along, m @ m - radius**2, base, along)


def on_tube(i, row, z_mm, radius):
    base, along = line(i, row)
    m, d = base[1:] - [0.0, z_mm], along[1:]
    return highest_root(d @ d, 2.0 * m @ d, m @ m - radius**2, base, along)


def draw(name, **options):
    family = PRODUCTS[name]
    return family.draw(1, family.Options(**options)).solid


def assert_lies(truth, formula, least):
    """All points on the product are those of the formula, to 1e-6 mm and 1e-6 px."""
    found = list(zip(*np.nonzero(truth.on_product == 1), strict=True))
    assert len(found) >= least
    for i, row in found:
        point = formula(i, row)
        np.testing.assert_allclose(truth.xyz_mm[i, row], point, rtol=0, atol=1e-6)
        assert truth.x_px[i, row] == pytest.approx(CAMERA.project(point)[0], abs=1e-6)


def test_stripes_on_a_ball_are_roots_of_a_quadratic():
    truth = stripe_centres(CAMERA, LASER, draw("sphere", radius_mm=15.0))
    assert_lies(truth, lambda i, row: on_ball(i, row, np.array([0.0, 0.0, 15.0]), 15.0), 60)


def test_stripes_on_a_cap_are_roots_of_a_quadratic():
    truth = stripe_centres(CAMERA, LASER, draw("sphere", radius_mm=40.0, height_mm=9.0))
    assert_lies(truth, lambda i, row: on_ball(i, row, np.array([0.0, 0.0, -31.0]), 40.0), 110)


@pytest.mark.parametrize(("half", "z_mm"), [(True, 0.0), (False, 12.0)])
def test_stripes_on_a_cylinder_are_roots_of_a_quadratic(half, z_mm):
    truth = stripe_centres(CAMERA, LASER, draw("cylinder", radius_mm=12.0, half=half))
    assert_lies(truth, lambda i, row: on_tube(i, row, z_mm, 12.0), 80)


def on_plane(i, row, normal, offset):
    base, along = line(i, row)
    return base + (offset - normal @ base) / (normal @ along) * along


def test_stripes_on_a_wedge_lie_on_its_slope():
    truth = stripe_centres(CAMERA, LASER, draw("wedge"))
    assert_lies(truth, lambda i, row: on_plane(i, row, np.array([-0.25, 0.0, 1.0]), 10.0), 100)


def test_stripes_on_a_mesh_of_a_box_lie_on_its_top():
    points = np.array([[x, y, z] for x in (0, 60) for y in (0, 30) for z in (0, 7)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [corners for a, b, c, d in quads for corners in ((a, b, c), (a, c, d))]
    box = lay(close(Triangles(points, np.array(faces))), Pose(0.0, 0.0, 3.0))
    truth = stripe_centres(CAMERA, LASER, box)
    assert_lies(truth, lambda i, row: on_plane(i, row, np.array([0.0, 0.0, 1.0]), 7.0), 100)


def test_belt_under_a_ball_bar_s_rod_is_seen_by_neither_light_nor_camera():
    truth = stripe_centres(CAMERA, LASER, draw("ball-bar"))
    on_rod = truth.xyz_mm[truth.on_product == 1]
    np.testing.assert_allclose(np.hypot(on_rod[:, 1], on_rod[:, 2] - 12.0), 4.0, atol=1e-6)
    belt = truth.xyz_mm[truth.on_product == 0]
    # light from X = 160 falls along X here: the rod shades the belt below it and nothing beside it
    assert (np.abs(belt[:, 1]) > 3.0).all()
