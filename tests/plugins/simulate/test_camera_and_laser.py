"""The pinhole and the fan: round trips, frames, and what is refused."""

import numpy as np
import pytest

from roemetry_simulate.optics import Camera, LaserFan, fan_through, looking_down

CAMERA = looking_down(
    640, 480, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0, tilt_x_deg=1.0, tilt_y_deg=-0.4
)


def test_the_optical_axis_meets_the_belt_at_the_origin():
    np.testing.assert_allclose(CAMERA.project([0.0, 0.0, 0.0]), [319.5, 239.5], atol=1e-9)
    assert np.linalg.norm(CAMERA.centre_mm) == pytest.approx(320.0)


def test_x_goes_right_and_y_goes_up_in_the_image():
    (x1, y1), (x2, y2) = CAMERA.project([[10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
    assert x1 - 319.5 == pytest.approx(50.0, abs=0.2)
    assert abs(y1 - 239.5) < 0.2
    assert y2 - 239.5 == pytest.approx(-50.0, abs=0.2)
    assert abs(x2 - 319.5) < 0.2
    assert CAMERA.centre_mm[2] > 0.0


def test_planes_pass_through_the_projector_and_their_feet():
    lines_x = [-9.0, 0.0, 8.5]
    fan = fan_through(
        (160.0, -4.0, 300.0), lines_x, yaw_deg=0.6, pitch_deg=0.3, sigma_mm=0.3, peak_grey=200.0
    )
    np.testing.assert_allclose(fan.distance_mm((160.0, -4.0, 300.0)), 0.0, atol=1e-9)
    np.testing.assert_allclose(fan.x_mm(0.0, 0.0), lines_x, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(fan.normals, axis=1), 1.0)
    np.testing.assert_allclose(fan.normals @ fan.line_axis, 0.0, atol=1e-12)
    # a small yaw turns the lines counter-clockwise: upper ends lean to the left
    assert (fan.x_mm(40.0, 0.0) < fan.x_mm(-40.0, 0.0)).all()


def test_what_is_no_pose_and_no_line_is_refused():
    assert np.isnan(CAMERA.project([0.0, 0.0, 900.0])).all(), "behind the camera"
    for pose in (np.eye(3), 2.0 * np.eye(4)):
        with pytest.raises(ValueError, match="T_belt_camera"):
            Camera(4, 4, 0.01, 16.0, pose)
    with pytest.raises(ValueError, match="width"):
        fan_through((160.0, 0.0, 300.0), [0.0], sigma_mm=0.0, peak_grey=200.0)
    with pytest.raises(ValueError, match="normals"):
        LaserFan(np.zeros(3), np.eye(3), np.zeros(2), np.array([0.0, 1.0, 0.0]), 0.3, np.ones(3))
