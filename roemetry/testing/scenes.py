"""Stripes, or a grid's lines, on a linear rig: every centre, label and height is known exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records import BELT, NOTHING, Frame, Peaks, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.view import View

SEED = 20260711  # of all noise: two calls see the same
_WHITE_8_BIT = 255  # grey levels
_CAMERA_MM = 1000.0  # of a telecentric view: nothing depends on it


class ScenePeaks(NamedTuple):
    """Peaks and, for each, the stripe (from 0) that made it."""

    peaks: Peaks
    stripe: Integers


@dataclass(frozen=True, slots=True)
class LinearRig:
    """A rig without perspective: a stripe moves by `px_per_mm` for each millimetre of height.

    The belt frame has its origin at the image's middle: X = (x − middle) · `mm_per_px`, Y towards the image's
    top at the same scale. Stripe i rests at ``first_px + i · spacing_px`` in the middle row and leans by
    ``fan · (i − middle stripe)`` px per row. So each stripe is a plane of light, and a body's volume, a
    point's place and a stripe's centre have closed forms.
    """

    rows: int = 200
    columns: int = 320
    stripes: int = 7
    first_px: float = 38.0
    spacing_px: float = 40.0
    """first_px, spacing_px: rest x of the first stripe, and from each stripe to the next, in the middle row,
    px."""
    fan: float = 0.01
    """Lean of a rest line against its neighbour's, px per row."""
    px_per_mm: float = 2.0
    """Displacement along +x per height, px/mm; negative for a laser on the other side."""
    mm_per_px: float = 0.25
    sigma_px: float = 1.6
    """Standard deviation of a stripe's Gaussian profile, px."""
    background: float = 10.0
    """Grey level (of 0…255) beside the stripes."""

    @property
    def middle_row(self) -> float:
        """Row of the image's middle, px."""
        return (self.rows - 1) / 2.0

    @property
    def middle_column(self) -> float:
        """Column of the image's middle, px."""
        return (self.columns - 1) / 2.0

    def mirrored(self) -> LinearRig:
        """Give the rig with left and right exchanged: the laser on the other side."""
        last_px = self.first_px + (self.stripes - 1) * self.spacing_px
        return replace(self, first_px=self.columns - 1 - last_px, px_per_mm=-self.px_per_mm)

    def scaled(self, factor: float) -> LinearRig:
        """Give the rig that shows a scene `factor` times as large in the same image."""
        return replace(self, mm_per_px=self.mm_per_px * factor, px_per_mm=self.px_per_mm / factor)

    def rest_px(self) -> Floats:
        """(stripe, row) x of the stripes on the bare belt, px."""
        return self.calibration().rest_line_px(np.arange(self.rows, dtype=np.float64))

    def x_px(self, height_mm: Floats) -> Floats:
        """(stripe, row) stripe centres, px, over (stripe, row) heights, mm."""
        return self.rest_px() + self.px_per_mm * height_mm

    def belt(self) -> Floats:
        """(stripe, row) heights of the bare belt: 0 mm."""
        return np.zeros((self.stripes, self.rows))

    def dome(self, height_mm: float = 10.0) -> Floats:
        """(stripe, row) heights, mm, of a dome over all stripes but the outer two, on the middle rows."""
        across = np.sin(np.pi * np.arange(self.stripes) / max(self.stripes - 1, 1))
        return height_mm * across[:, None] * self.bump()[None, :]

    def bump(self, first: float = 0.25, last: float = 0.75) -> Floats:
        """(row,) smooth rise from 0 to 1 and back between two shares of the image's rows."""
        along = np.clip((np.arange(self.rows) / (self.rows - 1) - first) / (last - first), 0.0, 1.0)
        bump: Floats = np.sin(np.pi * along) ** 2
        return bump

    def light(self, x_px: Floats, amplitude: float | Floats = 160.0) -> Floats:
        """Give (row, column) grey levels of 0…255, not rounded and not clipped; NaN in `x_px` draws nothing.

        `x_px` are (stripe, row) centres, px; `amplitude` is the stripes' height above the background, grey
        levels: one, or one a stripe.
        """
        columns = np.arange(self.columns)
        light = np.full((self.rows, self.columns), self.background)
        for line, height in zip(x_px, np.broadcast_to(amplitude, x_px.shape[:1]), strict=True):
            off = (columns[None, :] - line[:, None]) / self.sigma_px
            light += np.nan_to_num(height * np.exp(-0.5 * off**2))
        return light

    def peaks(self, x_px: Floats, scatter_px: float = 0.0) -> ScenePeaks:
        """Give the peaks of a perfect extractor, with the stripe of each, sorted by row, then x.

        `x_px` are (stripe, row) centres, px, NaN gives no peak; noise of std `scatter_px` is added to them.
        """
        noise = np.random.default_rng(SEED).normal(0.0, scatter_px, x_px.shape) if scatter_px else 0.0
        noisy = x_px + noise
        inside = np.isfinite(noisy) & (noisy >= 0.0) & (noisy <= self.columns - 1)
        stripe, row = np.nonzero(inside)
        x = noisy[inside]
        order = np.lexsort((x, row))
        stripe, row, x = stripe[order], row[order], x[order]
        peaks = Peaks(
            image_size=(self.rows, self.columns),
            row=row,
            x_px=x,
            x_std_px=np.full(x.size, scatter_px or np.nan),
            amplitude=np.full(x.size, 160.0),
            background=np.full(x.size, self.background),
            width_px=np.full(x.size, 2.355 * self.sigma_px),
            flags=np.zeros(x.size, np.uint8),
        )
        return ScenePeaks(peaks, stripe)

    def stripe_map(self, height_mm: Floats) -> StripeMap:
        """Give the true map of (stripe, row) heights, mm; NaN is not seen, 0 is belt, else product 1."""
        x_px = self.x_px(height_mm)
        seen = np.isfinite(x_px)
        product = np.where(height_mm > 0.0, 1, BELT)
        return StripeMap(
            x_px=x_px,
            x_std_px=np.where(seen, 0.1, np.nan),
            product=np.where(seen, product, NOTHING),
            seen=seen,
            margin=np.where(seen, 1.0, np.nan),
            ambiguous=np.zeros(x_px.shape, np.bool_),
            rest_px=self.rest_px(),
            peak_stripe=self.peaks(x_px).stripe.astype(np.int16),
        )

    def xyz_mm(self, height_mm: Floats) -> Floats:
        """(stripe, row, 3) points in the belt frame, mm, of (stripe, row) heights."""
        x = (self.x_px(height_mm) - self.middle_column) * self.mm_per_px
        y = np.broadcast_to((self.middle_row - np.arange(self.rows)) * self.mm_per_px, x.shape)
        return np.stack([x, np.where(np.isnan(height_mm), np.nan, y), height_mm], axis=2)

    def planes(self) -> Floats:
        """(stripe, 4) planes of light in the belt frame: nx, ny, nz, d with n·X = d (mm), |n| = 1."""
        slope = self._rest()[:, 1]
        normal = np.stack(
            [np.ones_like(slope), slope, np.full_like(slope, -self.mm_per_px * self.px_per_mm)], axis=1
        )
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return np.column_stack(
            [normal, normal[:, 0] * (self._rest()[:, 0] - self.middle_column) * self.mm_per_px]
        )

    def calibration(self) -> Calibration:
        """Give the true calibration, without uncertainty, with the parameters of the method block-linear."""
        return Calibration(
            method="block-linear",
            image_size=(self.rows, self.columns),
            turn_deg=0,
            rest_px=self._rest(),
            displacement_px_per_mm=np.full(self.stripes, self.px_per_mm),
            height_range_mm=(0.0, 60.0 / abs(self.px_per_mm)),
            parameters={
                "omega_mm_per_px": np.full(self.stripes, 1.0 / self.px_per_mm),
                "mm_per_px": np.array([self.mm_per_px]),
            },
            covariance=np.zeros((self.stripes + 1, self.stripes + 1)),
            extractor={"use": "exact"},
            view=self.view(),
        )

    def view(self) -> View:
        """Give the true view: a telecentric camera that looks straight down."""
        scale = 1.0 / self.mm_per_px
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[2, 3] = _CAMERA_MM
        return View(
            image_size=(self.rows, self.columns),
            camera_matrix=np.array(
                [[scale, 0.0, self.middle_column], [0.0, scale, self.middle_row], [0.0, 0.0, 1.0]]
            ),
            T_belt_camera=pose,
            planes=self.planes(),
            telecentric=True,
        )

    def _rest(self) -> Floats:
        number = np.arange(self.stripes)
        lean = self.fan * (number - (self.stripes - 1) / 2.0)
        return np.column_stack([self.first_px + self.spacing_px * number, lean])


def moved_rig(calibration: Calibration, alignment: Alignment) -> Calibration:
    """Give a linear rig's calibration after a small motion of its camera, to first order.

    A telecentric camera that is tilted a little shows the belt's stripes where they were.
    """
    pan_px, roll, zoom, _ = alignment.motion
    at, lean = calibration.rest_px.T
    away = at - (calibration.image_size[1] - 1) / 2.0
    rest_px = np.column_stack([at + pan_px + (zoom - lean * roll) * away, lean - roll * (1.0 + lean**2)])
    if alignment.planes_px.size:
        rest_px[:, 0] += alignment.planes_px
    return replace(calibration, rest_px=rest_px)


def moved_grid(calibration: Calibration, alignment: Alignment) -> Calibration:
    """Give a grid's calibration after a small motion of its camera, as `moved_rig` gives a linear rig's.

    Here a tilt moves the image up.
    """
    assert calibration.across is not None
    pan_px, roll, zoom, tilt = alignment.motion
    planes, none = alignment.planes_px, np.zeros((4, 4))
    down_px = -tilt * _CAMERA_MM
    upright = moved_rig(
        calibration,
        Alignment(np.array([pan_px, roll, zoom, 0.0]), none, planes_px=planes[: calibration.stripe_count]),
    )
    across = moved_rig(
        calibration.across,
        Alignment(np.array([down_px, roll, zoom, 0.0]), none, planes_px=planes[calibration.stripe_count :]),
    )
    return replace(upright, across=across)


def moved_camera(calibration: Calibration, alignment: Alignment, focal_px: float) -> Calibration:
    """Give a calibration whose view's camera has moved a little; a tilt moves the image up by `focal_px`."""
    view = calibration.view
    assert view is not None
    pan_px, roll, zoom, tilt = alignment.motion
    matrix, pose = view.camera_matrix.copy(), view.T_belt_camera.copy()
    matrix[:2, 2] += pan_px, -tilt * focal_px
    matrix[:2, :2] *= 1.0 + zoom
    turn = np.array([[np.cos(roll), np.sin(roll), 0.0], [-np.sin(roll), np.cos(roll), 0.0], [0.0, 0.0, 1.0]])
    pose[:3, :3] = pose[:3, :3] @ turn
    return replace(calibration, view=replace(view, camera_matrix=matrix, T_belt_camera=pose))


def frame_of(light: Floats, *, bit_depth: int = 8, noise: float = 0.0) -> Frame:
    """Make a frame of (row, column) grey levels 0…255: noise added, scaled to the depth, rounded, clipped.

    `noise` is the sensor's standard deviation in grey levels of the 8-bit scale.
    """
    white = 2**bit_depth - 1
    if noise:
        light = light + np.random.default_rng(SEED).normal(0.0, noise, light.shape)
    pixels = np.clip(np.rint(light * (white / _WHITE_8_BIT)), 0, white)
    return Frame(pixels.astype(np.uint8 if bit_depth <= 8 else np.uint16), name="scene", bit_depth=bit_depth)


def in_steps(light: Floats, step: int) -> Floats:
    """Round grey levels to multiples of `step`, so that a scaled image keeps whole grey levels."""
    stepped: Floats = step * np.rint(light / step)
    return stepped


def wrong_labels(stripe: NDArray[np.integer], truth: Integers) -> Flags:
    """Say which labelled peaks carry another stripe than the one that made them; refused ones do not."""
    wrong: Flags = (stripe >= 0) & (stripe != truth)
    return wrong


_ROUNDS = 60
"""Of following a line to where it lies on the surface: each leaves a fifth of the error."""


@dataclass(frozen=True, slots=True)
class GridRig(LinearRig):
    """The linear rig with `lines` across its stripes, which heights move down the image by as much.

    Heights are (stripe, row) of the stripes, or of the lines across in the image turned by 90°
    counter-clockwise: `across` is the linear rig that sees them there.
    """

    rows: int = 240
    first_px: float = 40.0
    lines: int = 5

    @property
    def across(self) -> LinearRig:
        """The rig of the lines across, in the turned image."""
        return LinearRig(
            rows=self.columns,
            columns=self.rows,
            stripes=self.lines,
            first_px=0.5 * (self.rows - 1) - 14.0 * (self.lines - 1),
            spacing_px=28.0,
            px_per_mm=self.px_per_mm,
            mm_per_px=self.mm_per_px,
            sigma_px=self.sigma_px,
            background=self.background,
        )

    def hill(self, height_mm: float = 6.0) -> tuple[Floats, Floats]:
        """Give heights, mm, of a dome in the image's middle, of the stripes and of the lines across."""
        found = []
        for rig, turned in ((self, False), (self.across, True)):
            row = np.broadcast_to(np.arange(rig.rows, dtype=np.float64), (rig.stripes, rig.rows))
            height = np.zeros(row.shape)
            for _ in range(_ROUNDS):
                x = rig.x_px(height)
                place = (self.columns - 1.0 - row, x) if turned else (x, row)
                height = height_mm * _bump(place[0] / self.columns) * _bump(place[1] / self.rows)
            found.append(height)
        return found[0], found[1]

    def grid_light(self, heights: tuple[Floats, Floats], amplitude: float = 100.0) -> Floats:
        """Give (row, column) grey levels of a grid over these heights: the light of both families adds."""
        down, across = (
            rig.light(rig.x_px(height), amplitude)
            for rig, height in zip((self, self.across), heights, strict=True)
        )
        return np.asarray(down + np.rot90(across, -1) - self.background)

    def grid_peaks(self, heights: tuple[Floats, Floats], scatter_px: float = 0.05) -> Peaks:
        """Give the peaks of a perfect extractor, with noise of std `scatter_px`; NaN heights give none."""
        down, across = (
            rig.peaks(rig.x_px(height), scatter_px).peaks
            for rig, height in zip((self, self.across), heights, strict=True)
        )
        return replace(down, across=across)

    def grid_map(self, heights: tuple[Floats, Floats]) -> StripeMap:
        """Give the true map of heights, mm; NaN is not seen, 0 is belt, else product 1."""
        return replace(self.stripe_map(heights[0]), across=self.across.stripe_map(heights[1]))

    def grid_calibration(self) -> Calibration:
        """Give the true calibration of both families."""
        return replace(LinearRig.calibration(self), across=self.across.calibration())


def _bump(share: Floats) -> Floats:
    """Rise from 0 at a fifth of the image to 1 in its middle, and back."""
    return np.asarray(np.sin(np.pi * np.clip((share - 0.2) / 0.6, 0.0, 1.0)) ** 2)
