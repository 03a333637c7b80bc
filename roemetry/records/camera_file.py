"""A calibration's camera and planes of light as a file that OpenCV reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roemetry.errors import CalibrationError, DataError
from roemetry.records.view import View

SUFFIXES = (".yaml", ".yml", ".json", ".xml")
"""By them OpenCV knows what to write."""


def write_camera(path: Path, view: View) -> None:
    """Write a view's camera as OpenCV's `FileStorage` does: camera_matrix, distortion_coefficients, size.

    Planes of light are `laser_planes`, rows A, B, C, D of Ax + By + Cz + D = 0 in the camera's frame, mm;
    `T_belt_camera` takes places from the camera's frame to the belt's.

    Raises
    ------
    CalibrationError
        The view is no camera that was calibrated.
    DataError
        The file cannot be written.
    """
    if view.telecentric or not view.exact:
        raise CalibrationError(
            "this calibration knows no camera: its view is enough for coding, not for other programs",
            hint="calibrate with pinhole-plane",
        )
    import cv2

    storage = cv2.FileStorage()
    opened = path.suffix.lower() in SUFFIXES and path.parent.is_dir()
    if not (opened and storage.open(str(path), cv2.FILE_STORAGE_WRITE)):
        raise DataError(
            f"{path}: the file cannot be written",
            hint=f"a name in a folder that is there, that ends in {', '.join(SUFFIXES)}",
        )
    storage.write("image_width", int(view.image_size[1]))
    storage.write("image_height", int(view.image_size[0]))
    storage.write("camera_matrix", np.array(view.camera_matrix))
    storage.write("distortion_coefficients", np.array(view.distortion).reshape(1, -1))
    storage.write("T_belt_camera", np.array(view.T_belt_camera))
    pose, planes = np.array(view.T_belt_camera), np.array(view.planes)
    rows = np.column_stack([planes[:, :3] @ pose[:3, :3], planes[:, :3] @ pose[:3, 3] - planes[:, 3]])
    storage.write("laser_planes", rows)
    storage.release()
