"""Triangulation by one coefficient a stripe (section 3.4, equations 3 and 4).

Model. H = Ω_i D2: the height of a point of stripe i is proportional to its displacement D2 from the stripe's
rest line (the paper's equation 4). Where the calibration knows the camera's distance W from the belt,
perspective is taken out: H = Ω D2 / (1 + Ω D2 / W), and X and Y, at belt level mm/px times pixels from the
image's centre, shrink by 1 − H/W. Without it both are the paper's: higher things look larger. The origin is
the belt point at the image's centre. Where the calibration saw the lens bow the belt's lines, places in the
image are undistorted first; where it saw displacements grow along the rows, by a tilted camera, they are
brought to the middle row.

Assumed: the camera looks straight down, pixels are square, and each plane of light cuts the belt in a line
that is straight but for the lens. It fails for a camera that is tilted across the stripes (it acts as a wrong
distance) and for lenses with more than a first radial term.

`block_view` and `light_planes` say of camera and planes what a block calibration can: enough for coding and
outlines, not exact.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.view import View, undistort
from roemetry.stages import Capabilities, StageOptions, Triangulator


class BlockLinear(Triangulator[StageOptions]):
    """H = Ω_i · D2: height is proportional to the displacement from the stripe's rest line."""

    capabilities = Capabilities(height_tolerance_mm=1e-9)

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give a slice for each stripe, with a point for each image row.

        Raises
        ------
        StageError
            The map has another number of stripes or of rows than the calibration.
        """
        if stripes.stripe_count != calibration.stripe_count:
            raise StageError(
                f"{stripes.stripe_count} stripes are labelled, the calibration has {calibration.stripe_count}"
            )
        if stripes.rows != calibration.image_size[0]:
            raise StageError(
                f"the stripes have {stripes.rows} rows, the calibration's images {calibration.image_size[0]}"
            )
        rig = _rig_of(calibration)
        omega, scale, middle_px = rig.omega_mm_per_px, rig.mm_per_px, (calibration.image_size[1] - 1) / 2.0
        x_px = stripes.x_px
        if rig.bow_per_px2 or rig.rest_px is not calibration.rest_px:
            away_px, straight = displacements(
                x_px, rig.from_middle, rig.rest_px.T[:, :, None], middle_px, rig.bow_per_px2
            )
            across_px, down_px = straight[..., 0], straight[..., 1]
        else:
            away_px, across_px, down_px = x_px - stripes.rest_px, x_px - middle_px, rig.from_middle
        # height by the displacement, then by the perspective
        height_mm = omega[:, None] * away_px / (1.0 + rig.growth_per_px * down_px)
        height_mm /= 1.0 + rig.per_distance * height_mm
        # a higher point is seen larger: it stands nearer to the axis
        shrunk = 1.0 - rig.per_distance * height_mm
        xyz_mm = np.empty((*x_px.shape, 3))
        xyz_mm[:, :, 0] = across_px * scale * shrunk
        xyz_mm[:, :, 1] = -down_px * scale * shrunk
        xyz_mm[:, :, 2] = height_mm
        return Profiles(
            xyz_mm=xyz_mm,
            product=stripes.product,
            seen=stripes.seen,
            x_px=x_px,
            row_px=rig.row_px,
            height_std_mm=np.abs(omega)[:, None] * shrunk**2 * stripes.x_std_px,
            stripe=rig.stripe,
            frame=rig.frame,
            plane=rig.plane,
        )

    def moved(self, calibration: Calibration, alignment: Alignment) -> Calibration:
        """Give the calibration of a camera that has moved: rest lines, scale and millimetres per pixel.

        The covariance of the motion is added to that of the parameters, by their numerical derivatives.
        """
        rest_px = _turned_lines(calibration, alignment.motion)
        zoom = alignment.motion[2]
        parameters = {
            name: value / (1.0 + zoom) if name in _GROW else value
            for name, value in calibration.parameters.items()
        }
        # what the motion is unsure by moves rest lines and scale together
        covariance = calibration.covariance
        if alignment.covariance.any() and "rest_error_px" in parameters:
            of_rest = [
                (_turned_lines(calibration, step * np.eye(4)[k]) - calibration.rest_px) / step
                for k, step in enumerate(_MOTION_STEPS)
            ]
            derivatives = np.stack(
                [
                    np.concatenate(
                        [
                            np.ravel(of_rest[k][:, : value.shape[1]])
                            if name == "rest_error_px"
                            else np.ravel(-value if name in _GROW and k == 2 else np.zeros(value.shape))
                            for name, value in calibration.parameters.items()
                        ]
                    )
                    for k in range(4)
                ]
            )
            covariance = covariance + derivatives.T @ alignment.covariance @ derivatives
        if alignment.planes_px.any():
            rest_px[:, 0] += alignment.planes_px
            if "rest_error_px" in parameters:
                names, width = list(parameters), parameters["rest_error_px"].shape[1]
                first = sum(parameters[name].size for name in names[: names.index("rest_error_px")])
                own = first + width * np.flatnonzero(alignment.planes_px)
                covariance = covariance.copy()
                covariance[own, own] += alignment.planes_std_px**2
        found = replace(
            calibration,
            rest_px=rest_px,
            displacement_px_per_mm=calibration.displacement_px_per_mm * (1.0 + zoom),
            parameters=parameters,
            covariance=covariance,
        )
        return replace(found, view=self.view(found))

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's parameters; the camera's distance is the calibration's own."""
        known = calibration.view
        if known is None:
            return None
        return block_view(
            calibration.image_size,
            _rest_px(calibration),
            calibration.parameters["omega_mm_per_px"],
            float(calibration.parameters["mm_per_px"][0]),
            None if not _per_distance(calibration) else 1.0 / _per_distance(calibration),
            bow_per_px2(calibration),
        )


class _Rig(NamedTuple):
    """What all frames of a calibration have in common; names as in the calibration's parameters.

    `plane` and the four before it are what `Profiles` holds; `from_middle` (row,) px.
    """

    omega_mm_per_px: Floats
    mm_per_px: float
    growth_per_px: float
    per_distance: float
    bow_per_px2: float
    rest_px: Floats
    from_middle: Floats
    row_px: Floats
    stripe: Integers
    frame: Integers
    plane: Floats


@lru_cache(maxsize=8)
def _rig_of(calibration: Calibration) -> _Rig:
    """Give what all frames of a calibration have in common, found once."""
    known = calibration.parameters
    (rows, columns), count = calibration.image_size, calibration.stripe_count
    omega, scale = known["omega_mm_per_px"], float(known["mm_per_px"][0])
    rest_px, per_distance = _rest_px(calibration), _per_distance(calibration)
    row = np.arange(rows, dtype=np.float64)
    stripe, frame = np.arange(count), np.zeros(count, np.int64)
    plane = light_planes(rest_px, omega, scale, (columns - 1) / 2.0, per_distance)
    for shared in (stripe, frame, plane):
        shared.flags.writeable = False
    growth = float(known.get("growth_per_px", np.zeros(1))[0])
    return _Rig(
        omega, scale, growth, per_distance, bow_per_px2(calibration), rest_px, row - (rows - 1) / 2.0,
        np.broadcast_to(row, (count, rows)), stripe, frame, plane,
    )  # fmt: skip


_GROW = ("omega_mm_per_px", "mm_per_px")
"""Parameters in mm/px, which shrink as the image grows."""
_MOTION_STEPS = (1e-2, 1e-5, 1e-5, 1e-5)
"""Steps of numerical derivatives for shift (px), roll (rad), zoom and tilt (rad): all some 0.01 px."""


def _turned_lines(calibration: Calibration, motion: Floats) -> Floats:
    """Give the rest lines' polynomials after a small motion of the camera (`Alignment`), to first order."""
    pan_px, roll, zoom, tilt = motion
    rows, columns = calibration.image_size
    y = np.linspace(-(rows - 1) / 2.0, (rows - 1) / 2.0, 33)
    known = calibration.rest_px
    x = np.polynomial.polynomial.polyval(y, known.T)
    slope = np.polynomial.polynomial.polyval(y, np.polynomial.polynomial.polyder(known.T))
    away = x - (columns - 1) / 2.0
    per_px = _per_distance(calibration) * float(calibration.parameters["mm_per_px"][0])
    # along the row a line slides by its slope, all to first order
    along = roll * away + zoom * y - tilt * (y * y * per_px + (1.0 / per_px if per_px else 0.0))
    moved = pan_px * (1.0 + (away * per_px) ** 2) - roll * y + zoom * away - tilt * away * y * per_px
    degree = max(known.shape[1] - 1, 1)
    powers = y[:, None] ** np.arange(degree + 1)
    lines: Floats = np.linalg.lstsq(powers, (x + moved - slope * along).T, rcond=None)[0].T
    return lines


def _per_distance(calibration: Calibration) -> float:
    """1/W, 1/mm; 0 where the distance is not known, and of calibrations made before it was told."""
    known = calibration.parameters.get("inverse_distance_per_mm")
    return 0.0 if known is None else float(known[0])


def bow_per_px2(calibration: Calibration) -> float:
    """First radial distortion, px⁻²; 0 of calibrations made before it was told."""
    known = calibration.parameters.get("bow_per_px2")
    return 0.0 if known is None else float(known[0])


def _rest_px(calibration: Calibration) -> Floats:
    """Give the rest lines; those of a redrawn calibration are off by what was drawn."""
    error_px = calibration.parameters.get("rest_error_px")
    if error_px is None or not error_px.any():
        return calibration.rest_px
    found = calibration.rest_px.copy()
    found[:, : error_px.shape[1]] += error_px
    return found


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
    # looking straight down: y and z are turned
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
