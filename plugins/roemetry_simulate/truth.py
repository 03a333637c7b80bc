"""Where every stripe truly is: float64 roots of the laser planes along the rows' first-hit curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.camera import Camera
from roemetry_simulate.laser import LaserFan
from roemetry_simulate.lens import camera_ray
from roemetry_simulate.raycast import AnyBody, Reach, first_hit_in, normal_at, sees_in
from roemetry_simulate.solid import Solid

Floats = NDArray[np.float64]

_TOLERANCE_PX = 1e-7
_MAX_RESIDUAL_MM = 1e-4


@dataclass(frozen=True, eq=False)
class StripeTruth:
    """Every stripe's centre in every pixel row. S stripes from left to right, R rows.

    Attributes
    ----------
    x_px : ndarray, shape (S, R)
        Sub-pixel position in the row, NaN where no point of the plane is both lit and seen.
    xyz_mm : ndarray, shape (S, R, 3)
        That point in the belt frame, millimetres, NaN alike.
    on_product : ndarray of int8, shape (S, R)
        1 on the product, 0 on the belt, -1 nothing.
    hits : ndarray of int8, shape (S, R)
        How many lit and seen points the plane has in the row; above 1 the one kept is on the product
        rather than the belt, and the highest of these.
    """

    x_px: Floats
    xyz_mm: Floats
    on_product: NDArray[np.int8]
    hits: NDArray[np.int8]


def stripe_centres(camera: Camera, laser: LaserFan, solid: Solid, *, step_px: float = 0.125) -> StripeTruth:
    """Find all stripe centres.

    Parameters
    ----------
    camera, laser, solid
        The scene.
    step_px : float
        Pitch at which a row is searched for changes of side; two crossings closer than this may be missed.

    Returns
    -------
    StripeTruth
        Centres refined to better than 1e-6 px.
    """
    # a dead plane lights nothing
    planes = np.column_stack([laser.normals, laser.offsets_mm, laser.peak_grey])
    found = _search(
        solid.body(),
        camera.packed(),
        camera.rotation,
        laser.projector_mm,
        planes,
        camera.height_px,
        camera.width_px,
        step_px,
    )
    for array in found:
        array.flags.writeable = False
    return StripeTruth(*found)


@kernel
def _side(
    body: AnyBody,
    reach: Reach,
    pinhole: Floats,
    rotation: Floats,
    plane: Floats,
    x_px: float,
    y_px: float,
    view: Floats,
    point: Floats,
) -> tuple[float, int]:
    """Signed distance to the plane of what the camera sees at an image point; also on what it lies."""
    camera_ray(pinhole, rotation, x_px, y_px, view)
    on = first_hit_in(body, reach, pinhole[:3], view, 1e-12, point)
    if on < 0:
        return np.nan, on
    return plane[0] * point[0] + plane[1] * point[1] + plane[2] * point[2] - plane[3], on


@kernel
def _search(
    body: AnyBody, pinhole: Floats, rotation: Floats, projector: Floats, planes: Floats,
    rows: int, columns: int, step_px: float,
) -> tuple[Floats, Floats, NDArray[np.int8], NDArray[np.int8]]:  # fmt: skip
    count = planes.shape[0]
    x_out = np.full((count, rows), np.nan)
    xyz_out = np.full((count, rows, 3), np.nan)
    on_out = np.full((count, rows), -1, dtype=np.int8)
    hits_out = np.zeros((count, rows), dtype=np.int8)
    point, normal, view = np.zeros(3), np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    reach = body.reach
    steps = int(np.ceil(columns / step_px))
    sides = np.empty((steps + 1, count))
    for row in range(rows):
        for k in range(steps + 1):
            camera_ray(pinhole, rotation, -0.5 + k * step_px, row, view)
            on = first_hit_in(body, reach, pinhole[:3], view, 1e-4, point)
            for i in range(count):
                sides[k, i] = np.nan
                if on >= 0:
                    sides[k, i] = -planes[i, 3]
                    for m in range(3):
                        sides[k, i] += planes[i, m] * point[m]
        for i in range(count):
            if planes[i, 4] == 0.0:
                continue
            for k in range(steps):
                if (sides[k, i] <= 0.0) == (sides[k + 1, i] <= 0.0):
                    continue
                low, high = -0.5 + k * step_px, -0.5 + (k + 1) * step_px
                low_negative = sides[k, i] <= 0.0
                while high - low > _TOLERANCE_PX:
                    middle = 0.5 * (low + high)
                    f, on = _side(body, reach, pinhole, rotation, planes[i], middle, row, view, point)
                    if (f <= 0.0) == low_negative:
                        low = middle
                    else:
                        high = middle
                x_px = 0.5 * (low + high)
                f, on = _side(body, reach, pinhole, rotation, planes[i], x_px, row, view, point)
                if not abs(f) < _MAX_RESIDUAL_MM or x_px > columns - 0.5:
                    continue  # a jump from one surface to another, not a crossing
                normal_at(body, on, point, normal)
                if sees_in(body, reach, point, normal, projector, beam, scratch) == 0.0:
                    continue
                hits_out[i, row] += 1
                if on < on_out[i, row] or (on == on_out[i, row] and point[2] <= xyz_out[i, row, 2]):
                    continue
                x_out[i, row] = x_px
                xyz_out[i, row] = point
                on_out[i, row] = on
    return x_out, xyz_out, on_out, hits_out
