"""The image sorted along the lines in which light and sight meet: epipolar lines.

A plane through the camera's and the projector's centre cuts the image in an epipolar line, and every plane of
light in a ray. Along that line stripes keep their order exactly, whatever the lens or the angle; along an
image row they do so nearly. On such a line, with u the place on it, a peak has as stripe k the height

    z = (α u + β) / (γ u + δ)

with four numbers for each line and stripe, for any camera.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.records import Peaks
from roemetry.view import View

_LINES_MAX_FACTOR = 4
_BORDER_PX = 0.5


class SightLines(NamedTuple):
    """Peaks and planes of light on the epipolar lines of an image.

    Attributes
    ----------
    line, u
        (peak,) place across the lines, counted in lines from 0 (not rounded), and along them; u increases
        with the stripe.
    plane
        (line, stripe, 4) α, β, γ, δ, see above, mm.
    lean
        (peak,) how far the line of sight goes towards higher stripes for each millimetre down.
    enters, leaves
        (stripe,) lines on which the rest lines enter and leave the image.
    u_min, u_max
        (line,) where each line enters and leaves the image; NaN where it does not cross it.
    """

    line: Floats
    u: Floats
    plane: Floats
    lean: Floats
    enters: Floats
    leaves: Floats
    u_min: Floats
    u_max: Floats


def sight_lines(peaks: Peaks, calibration: Calibration, rest_px: Floats) -> SightLines:
    """Sort peaks along epipolar lines, or along image rows where the calibration knows no centres.

    Parameters
    ----------
    peaks
        The frame's peaks.
    calibration
        Its `view` gives camera and planes; without one, or with a telecentric one, rows are taken, and
        heights from rest lines and displacements.
    rest_px
        (stripe, row) rest lines, px.
    """
    view = calibration.view
    if view is not None and not view.telecentric:
        projector_mm = _projector(view)
        if projector_mm is not None:
            found = _epipolar(peaks, view, projector_mm, rest_px)
            if found is not None:
                return found
    return _rows(peaks, calibration, rest_px)


def _rows(peaks: Peaks, calibration: Calibration, rest_px: Floats) -> SightLines:
    rows, columns = peaks.image_size
    per_px = np.broadcast_to(1.0 / calibration.displacement_px_per_mm[:, None], rest_px.shape).T
    zero, one = np.zeros_like(per_px), np.ones_like(per_px)
    plane = np.stack([per_px, -rest_px.T * per_px, zero, one], axis=2)
    return SightLines(
        peaks.row.astype(np.float64),
        peaks.x_px,
        plane,
        np.zeros(len(peaks)),
        np.zeros(rest_px.shape[0]),
        np.full(rest_px.shape[0], rows - 1.0),
        np.full(rows, -_BORDER_PX),
        np.full(rows, columns - _BORDER_PX),
    )


def _projector(view: View) -> Floats | None:
    """Give where the light comes from; if only planes are known, their point nearest to the camera."""
    if np.isfinite(view.projector_mm).all():
        return np.asarray(view.projector_mm)
    normal, distance = view.planes[:, :3], view.planes[:, 3]
    size = np.linalg.svd(normal, compute_uv=False)
    if size.size < 2 or size[1] < 1e-3 * size[0]:
        return None
    away = np.linalg.lstsq(normal, distance - normal @ view.camera_mm, rcond=1e-3)[0]
    return np.asarray(view.camera_mm + away)


def _epipolar(peaks: Peaks, view: View, projector_mm: Floats, rest_px: Floats) -> SightLines | None:
    rows, columns = peaks.image_size
    camera = view.camera_mm
    base = projector_mm - camera
    base = base / np.linalg.norm(base)
    middle = view.rays(np.array([[(columns - 1) / 2.0, (rows - 1) / 2.0]]))[1][0]
    forward = middle - (middle @ base) * base
    if np.linalg.norm(forward) < 1e-3:
        return None
    forward = np.asarray(forward / np.linalg.norm(forward))
    side = np.cross(base, forward)

    def placed(xy_px: Floats) -> tuple[Floats, Floats]:
        """Give (point,) the angle about the base at which a pixel looks, rad, and a cotangent along it."""
        way = view.rays(xy_px)[1]
        ahead, beside = way @ forward, way @ side
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (way @ base) / np.hypot(ahead, beside)
        return np.arctan2(beside, ahead), u

    border = _border(rows, columns)
    angle_border, u_border = placed(border)
    if not np.isfinite(u_border).all() or np.ptp(angle_border) > np.pi / 2:
        return None  # the image shows the projector, or sees it through a lens that folds
    centre = np.stack([np.full(rows, (columns - 1) / 2.0), np.arange(rows, dtype=np.float64)], axis=1)
    step = float(np.median(np.diff(placed(centre)[0])))
    first = float(angle_border.min() if step > 0 else angle_border.max())
    count = int(np.ptp(angle_border) / abs(step)) + 2 if step else 0
    if not 0 < count <= _LINES_MAX_FACTOR * rows:
        return None
    angle, u = placed(np.stack([peaks.x_px, peaks.row.astype(np.float64)], axis=1))
    across = placed(np.stack([rest_px[[0, -1], rows // 2], np.full(2, rows / 2.0)], axis=1))[1]
    sign = 1.0 if across[1] >= across[0] else -1.0
    line_angle = first + step * np.arange(count, dtype=np.float64)
    plane = _planes(view, base, forward, side, line_angle, sign)
    u_min, u_max = np.full(count, np.inf), np.full(count, -np.inf)
    at = np.clip(np.rint((angle_border - first) / step).astype(np.int64), 0, count - 1)
    np.minimum.at(u_min, at, sign * u_border)
    np.maximum.at(u_max, at, sign * u_border)
    outside = ~(u_min < u_max)
    u_min[outside] = u_max[outside] = np.nan
    ways = view.rays(np.stack([peaks.x_px, peaks.row.astype(np.float64)], axis=1))[1]
    towards = np.array([*view.planes[:, :2].mean(axis=0), 0.0])
    towards *= np.sign(np.median(np.diff(view.planes[:, 3] / (view.planes @ np.array([*towards, 0.0])))))
    lean = (ways @ towards) / (-ways[:, 2] * np.linalg.norm(towards))
    top = placed(np.stack([rest_px[:, 0], np.zeros(len(rest_px))], axis=1))[0]
    bottom = placed(np.stack([rest_px[:, -1], np.full(len(rest_px), rows - 1.0)], axis=1))[0]
    enters, leaves = (top - first) / step, (bottom - first) / step
    return SightLines((angle - first) / step, sign * u, plane, lean, enters, leaves, u_min, u_max)


def _planes(view: View, base: Floats, forward: Floats, side: Floats, angle: Floats, sign: float) -> Floats:
    """(line, stripe, 4) numbers that give height from the place on a line."""
    ahead = np.cos(angle)[:, None] * forward + np.sin(angle)[:, None] * side
    normal = view.planes[:, :3]
    along = normal @ base
    away = ahead @ normal.T
    reach = view.planes[:, 3] - normal @ view.camera_mm
    camera_z = view.camera_mm[2]
    alpha = np.broadcast_to(sign * (camera_z * along + reach * base[2]), away.shape)
    beta = camera_z * away + reach * ahead[:, 2:]
    gamma = np.broadcast_to(sign * along, away.shape)
    return np.ascontiguousarray(np.stack([alpha, beta, gamma, away], axis=2))


def _border(rows: int, columns: int) -> Floats:
    """Places along the image's border, px, close enough that each line meets two."""
    y = np.arange(0.0, rows, 0.25) - _BORDER_PX + 0.125
    x = np.arange(0.0, columns, 0.25) - _BORDER_PX + 0.125
    left, right = np.full_like(y, -_BORDER_PX), np.full_like(y, columns - _BORDER_PX)
    top, bottom = np.full_like(x, -_BORDER_PX), np.full_like(x, rows - _BORDER_PX)
    return np.concatenate(
        [np.stack([left, y], 1), np.stack([right, y], 1), np.stack([x, top], 1), np.stack([x, bottom], 1)]
    )
