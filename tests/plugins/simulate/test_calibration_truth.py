"""The true rig in a data set is the rig its images were made with, for any lens and any number of planes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.config.dataset import Dataset
from roemetry.records.view import View
from roemetry.run.simulate import simulate

RIG: dict[str, Any] = {
    "camera": {
        "focal_length_mm": 4.5,
        "distance_mm": 110,
        "tilt_x_deg": -9,
        "tilt_y_deg": 12,
        "distortion": {"k1": -0.28, "k2": 0.09, "p1": 0.002, "p2": -0.001, "k3": -0.01},
    },
    "laser": {"planes": 30, "spacing_mm": 3.4},
}
"""Wide angle, strong distortion, tilted camera, 30 stripes."""


def view_of(rig: dict[str, Any]) -> View:
    return View(**{key: np.array(v) if key != "image_size" else tuple(v) for key, v in rig.items()})


def test_the_true_rig_sees_every_true_point_where_the_image_does(scene) -> None:
    stage = scene(**RIG, product={"family": "egg"}).make()
    view = view_of(stage.calibration_truth(1)["rig"])
    stripes = stage.simulate(0, 1).truth.stripes
    known = np.isfinite(stripes.x_px)
    assert known.sum() > 500
    stripe, row = np.nonzero(known)
    np.testing.assert_allclose(
        view.project(stripes.xyz_mm[known]), np.column_stack([stripes.x_px[known], row]), rtol=0, atol=1e-5
    )
    off = (view.planes[stripe, :3] * stripes.xyz_mm[known]).sum(axis=1) - view.planes[stripe, 3]
    assert np.abs(off).max() < 1e-5
    assert stripes.on_product.any()


def test_a_set_holds_the_truth_of_rig_and_targets_and_the_noise(scene, tmp_path: Path) -> None:
    camera = {"width_px": 360, "height_px": 270, "pixel_size_um": 17.78, "distortion": {"k1": -0.1}}
    loaded = scene(product={"family": "egg"}, targets={"board": {"poses": 1}}, camera=camera)
    simulate(loaded, tmp_path / "set", count=0, calibration="basic")
    data = Dataset(tmp_path / "set")
    assert list(data.faults()) == []
    truth = data.calibration_truth()
    assert truth["block"]["height_mm"] == 16.5
    assert data.sensor.gain_grey_per_electron == 0.0255
    assert data.sensor.read_noise_grey == pytest.approx(1.0)
    board = truth["chessboard"]
    assert list(board["T_belt_board"]) == ["pose_01", "on_belt"]
    view = view_of(truth["rig"])
    frames = loaded.make().calibration_frames(1)["chessboard"]
    assert frames["pose_01_plain"].sensor == data.sensor
    for name, pose in board["T_belt_board"].items():
        pixels = frames[f"{name}_plain"].pixels
        found, corners = cv2.findChessboardCornersSB(pixels, (board["columns"] - 1, board["rows"] - 1))
        assert found, name
        columns, rows = np.meshgrid(np.arange(1, board["columns"]), np.arange(1, board["rows"]))
        points = np.stack([columns.ravel(), rows.ravel(), 0 * rows.ravel()], axis=-1) * board["square_mm"]
        expected = view.project(points @ np.array(pose)[:3, :3].T + np.array(pose)[:3, 3])
        off = np.linalg.norm(corners.reshape(-1, 1, 2) - expected[None], axis=-1).min(axis=1)
        assert np.median(off) < 0.1
        assert off.max() < 0.4
    (tmp_path / "set" / "truth" / "calibration.yaml").write_text("rig: {}\n", encoding="utf-8")
    assert any("calibration.yaml: has changed" in fault for fault in data.faults())
