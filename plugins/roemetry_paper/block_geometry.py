"""What a block calibration says of camera and planes: enough for coding and outlines, not exact."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats
from roemetry.records.view import View, undistort

_ABOVE_MM = 1000.0
"""Where the camera of a telecentric view is put; nothing depends on it."""


def block_view(
    image_size: tuple[int, int],
    rest_px: Floats,
    omega_mm_per_px: Floats,
    mm_per_px: float,
    working_distance_mm: float | None,
    bow_per_px2: float,
) -> View:
    """Give a camera that looks straight down at the belt, and planes through the rest lines.

    Each plane leans so that its stripe moves by 1/Ω px for the first millimetre of height.

    Parameters
    ----------
    image_size
        Rows and columns.
    rest_px
        (stripe, coefficient) rest lines, as in `Calibration`.
    omega_mm_per_px
        (stripe,) height for each pixel of displacement without the lens's distortion, mm/px.
    mm_per_px
        Scale at belt level, mm/px.
    working_distance_mm
        Centre of projection to belt, mm; None makes the view telecentric.
    bow_per_px2
        First radial distortion, see `displacements`.
    """
    rows, columns = image_size
    telecentric = working_distance_mm is None
    height = _ABOVE_MM if working_distance_mm is None else working_distance_mm
    focal = 1.0 / mm_per_px if telecentric else height / mm_per_px
    middle_x, middle_y = (columns - 1) / 2.0, (rows - 1) / 2.0
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = height
    k1 = 0.0 if telecentric else bow_per_px2 * focal**2
    return View(
        image_size=image_size,
        camera_matrix=np.array([[focal, 0.0, middle_x], [0.0, focal, middle_y], [0.0, 0.0, 1.0]]),
        T_belt_camera=pose,
        planes=light_planes(
            _straight_lines(rest_px, middle_x, middle_y, bow_per_px2),
            omega_mm_per_px,
            mm_per_px,
            middle_x,
            0.0 if telecentric else 1.0 / height,
        ),
        distortion=np.array([k1, 0.0, 0.0, 0.0]) if k1 else np.empty(0),
        telecentric=telecentric,
        exact=False,
    )


def displacements(
    x_px: Floats, from_middle: Floats, rest_px: Floats, middle_px: float, bow_per_px2: float
) -> tuple[Floats, Floats]:
    """Give displacements from a rest line, px, and (…, 2) places from the image's middle, both undistorted.

    The lens sees a place r from the image's middle at r (1 + κ r²). Without taking that out, a displacement
    read in the middle rows is wrong elsewhere by κ (3 x² + y²), which is a percent and more near the ends.

    Parameters
    ----------
    x_px, from_middle
        Columns, and rows from the middle row; broadcast.
    rest_px
        (coefficient,) + the shape of `x_px` or what broadcasts to it: rest line x = Σ rest_px[k] row^k.
    middle_px
        Middle column.
    bow_per_px2
        κ, px⁻²; 0 for a lens without distortion.
    """
    row = np.broadcast_to(from_middle, x_px.shape).astype(np.float64)
    line_px = np.broadcast_to(np.polynomial.polynomial.polyval(row, rest_px, tensor=False), x_px.shape)
    seen = np.stack([x_px - middle_px, row], axis=-1)
    if not bow_per_px2:
        return x_px - line_px, seen
    kappa = np.array([bow_per_px2, 0.0, 0.0, 0.0])
    straight = undistort(seen.reshape(-1, 2), kappa).reshape(seen.shape)
    on_line = np.stack([line_px - middle_px, row], axis=-1)
    line = undistort(on_line.reshape(-1, 2), kappa).reshape(seen.shape)
    # the same image row is not the same row without the lens: along the leaning line to the place's row
    lean = rest_px[1] if len(rest_px) > 1 else 0.0
    return straight[..., 0] - line[..., 0] - lean * (straight[..., 1] - line[..., 1]), straight


def _straight_lines(rest_px: Floats, middle_px: float, half_px: float, bow_per_px2: float) -> Floats:
    """Give (stripe, 2) rest lines as they are without the lens's distortion."""
    if not bow_per_px2:
        return rest_px[:, :2]
    y = np.linspace(-half_px, half_px, 9)
    x = np.asarray(np.polynomial.polynomial.polyval(y, rest_px.T), np.float64)
    _, straight = displacements(x, y, np.zeros((1, 1, 1)), middle_px, bow_per_px2)
    lines = np.array([np.polynomial.polynomial.polyfit(one[:, 1], one[:, 0], 1) for one in straight])
    lines[:, 0] += middle_px
    return lines


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
