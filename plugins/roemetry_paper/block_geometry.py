"""What a block calibration says of camera and planes: enough for coding and outlines, not exact."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats
from roemetry.records.camera_model import undistorted
from roemetry.records.view import View

_ABOVE_MM = 1000.0
"""Where the camera of a telecentric view is put; nothing depends on it."""


def block_view(
    image_size: tuple[int, int],
    rest_px: Floats,
    omega_mm_per_px: Floats,
    mm_per_px: float,
    working_distance_mm: float | None,
) -> View:
    """Give a camera that looks straight down at the belt, and planes through the rest lines.

    Each plane leans so that its stripe moves by 1/Ω px for the first millimetre of height in the middle row.

    Parameters
    ----------
    image_size
        Rows and columns.
    rest_px
        (stripe, coefficient) rest lines, as in `Calibration`.
    omega_mm_per_px
        (stripe,) height for each pixel of displacement, mm/px.
    mm_per_px
        Scale at belt level, mm/px.
    working_distance_mm
        Centre of projection to belt, mm; None makes the view telecentric.
    """
    rows, columns = image_size
    telecentric = working_distance_mm is None
    height = _ABOVE_MM if working_distance_mm is None else working_distance_mm
    focal = 1.0 / mm_per_px if telecentric else height / mm_per_px
    middle_x, middle_y = (columns - 1) / 2.0, (rows - 1) / 2.0
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = height
    k1 = 0.0 if telecentric else _bow(rest_px, middle_x, focal)
    straight_px, grown = _straightened(rest_px, middle_x, middle_y, focal, k1)
    return View(
        image_size=image_size,
        camera_matrix=np.array([[focal, 0.0, middle_x], [0.0, focal, middle_y], [0.0, 0.0, 1.0]]),
        T_belt_camera=pose,
        planes=light_planes(
            straight_px, omega_mm_per_px * grown, mm_per_px, middle_x, 0.0 if telecentric else 1.0 / height
        ),
        distortion=np.array([k1, 0.0, 0.0, 0.0]) if k1 else np.empty(0),
        telecentric=telecentric,
        exact=False,
    )


def _bow(rest_px: Floats, middle_px: float, focal_px: float) -> float:
    """Give k1 of the lens from the bow of the belt's lines (plumb lines: Brown 1971); 0 where none is seen.

    At distance 1 a straight line x = a is seen as a (1 + k1 (a² + y²)): its bow is k1 a.
    """
    if rest_px.shape[1] < 3:
        return 0.0
    place = (rest_px[:, 0] - middle_px) / focal_px
    return float((rest_px[:, 2] * focal_px * place).sum() / max(float((place**2).sum()), 1e-12))


def _straightened(
    rest_px: Floats, middle_px: float, half_px: float, focal_px: float, k1: float
) -> tuple[Floats, Floats]:
    """Give (stripe, 2) rest lines without the lens, and by how much it stretches displacements there."""
    if not k1:
        return rest_px[:, :2], np.ones(rest_px.shape[0])
    y = np.linspace(-half_px, half_px, 9)
    seen = np.polynomial.polynomial.polyval(y, rest_px.T) - middle_px
    xy = np.stack([seen / focal_px, np.broadcast_to(y / focal_px, seen.shape)], axis=-1)
    straight = undistorted(xy.reshape(-1, 2), np.array([k1, 0.0, 0.0, 0.0])).reshape(xy.shape) * focal_px
    lines = np.array([np.polynomial.polynomial.polyfit(one[:, 1], one[:, 0], 1) for one in straight])
    lines[:, 0] += middle_px
    place = (lines[:, 0] - middle_px) / focal_px
    return lines, 1.0 + 3.0 * k1 * place**2


def light_planes(
    rest_px: Floats, omega_mm_per_px: Floats, mm_per_px: float, middle_px: float, per_distance: float = 0.0
) -> Floats:
    """(stripe, 4) planes n·X = d in the belt frame, mm, through the rest lines.

    `per_distance` is 1/working distance (1/mm), 0 for parallel rays: seen in perspective, a higher point
    must stand nearer to the optical axis to be seen at the same pixel.
    """
    lean = rest_px[:, 1] if rest_px.shape[1] > 1 else np.zeros(rest_px.shape[0])
    x_mm = (rest_px[:, 0] - middle_px) * mm_per_px
    # In the plane lie (lean, −1, 0), along the rest line, and (up, 0, 1), up the light.
    up = mm_per_px / omega_mm_per_px - x_mm * per_distance
    length = np.sqrt(1.0 + lean**2 + up**2)
    planes = np.empty((x_mm.size, 4))
    for column, part in enumerate((1.0, lean, -up)):
        planes[:, column] = part / length
    planes[:, 3] = planes[:, 0] * x_mm
    return planes
