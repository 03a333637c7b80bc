"""Circles on a rig whose cones of light, places and heights are known exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from roemetry.records import BELT, NOTHING, Peaks, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.cones import touching_planes, turned_generators
from roemetry.records.view import STEEP_MAX, View
from roemetry.testing.scenes import SEED, LinearRig, moved_camera

Surface = Callable[[Floats], Floats]
"""Heights (n,) at places (n, 2), mm."""
CAMERA_MM = 300.0
"""Of the camera over the belt: a usual distance."""
_AZIMUTHS = 721
"""Points of a half circle: between two of them it bends by less than 0.001 px."""
_ROUNDS = 40
"""Of meeting a cone's light with a surface: each divides the error by slope times lean, some 0.3."""


@dataclass(frozen=True, slots=True)
class CircleRig(LinearRig):
    """A pinhole camera 300 mm over the belt, and circles whose halves are the stripes, from left to right."""

    stripes: int = 10
    pitch_mm: float = 6.5
    """From circle to circle at the belt, across the axis."""
    projector_mm: tuple[float, float, float] = (90.0, 3.0, 290.0)

    @property
    def circles(self) -> int:
        """How many there are."""
        return self.stripes // 2

    def cones(self) -> Floats:
        """(stripe, 7) the halves, as `View.cones` has them."""
        apex = np.array(self.projector_mm)
        axis = np.array([-2.0, 0.5, 0.0]) - apex
        away = float(np.linalg.norm(axis))
        angle = np.arctan((np.arange(self.circles) + 0.5) * self.pitch_mm / away)
        halves = np.concatenate([-angle[::-1], angle])
        return np.column_stack([np.tile(np.concatenate([apex, axis / away]), (self.stripes, 1)), halves])

    def circle_view(self) -> View:
        """Give camera and cones."""
        focal = CAMERA_MM / self.mm_per_px
        matrix = np.array([[focal, 0.0, self.middle_column], [0.0, focal, self.middle_row], [0.0, 0.0, 1.0]])
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[2, 3] = CAMERA_MM
        cones = self.cones()
        planes = touching_planes(cones, pose[:3, 0])
        projector = np.array(self.projector_mm)
        return View((self.rows, self.columns), matrix, pose, planes, projector_mm=projector, cones=cones)

    def circle_calibration(self) -> Calibration:
        """Give the true calibration, which has no error."""
        plain = LinearRig.calibration(self)
        return replace(plain, view=self.circle_view(), height_range_mm=(0.0, 25.0))

    def circle_dome(self, height_mm: float) -> Surface:
        """Give a dome over all but the outermost circles, smooth down to the belt."""
        reach = (self.circles - 1.2) * self.pitch_mm

        def height(xy_mm: Floats) -> Floats:
            far = np.hypot(xy_mm[:, 0], 1.2 * xy_mm[:, 1]) / reach
            return np.asarray(height_mm * np.clip(1.0 - far**2, 0.0, None) ** 2)

        return height

    def curves(self, surface: Surface) -> tuple[Floats, Floats]:
        """Give (stripe, azimuth, 3) where the light meets a surface, mm, and (stripe, azimuth, 2) px."""
        view = self.circle_view()
        azimuth = np.linspace(-0.5, 0.5, _AZIMUTHS) * np.pi
        points = []
        for cone in view.cones:
            way = turned_generators(cone, view.T_belt_camera[:3, 0], azimuth)
            z = np.zeros(_AZIMUTHS)
            for _ in range(_ROUNDS):
                at = cone[:3] + ((z - cone[2]) / way[:, 2])[:, None] * way
                z = surface(at[:, :2])
            points.append(at)
        found = np.array(points)
        return found, view.project(found)

    def x_on_rows(
        self, surface: Surface, keep: Callable[[Floats], Flags] | None = None, steepest: float = STEEP_MAX
    ) -> Floats:
        """(stripe, row) where halves cross rows, px; NaN where they are steeper than so many px a row.

        `keep` says of (n, 3) points which of them are seen.
        """
        points, places = self.curves(surface)
        rows = np.arange(self.rows, dtype=np.float64)
        found = np.full((self.stripes, self.rows), np.nan)
        for stripe, (at, (x, y)) in enumerate(zip(points, places.transpose(0, 2, 1), strict=True)):
            seen = np.abs(np.gradient(x)) <= steepest * np.abs(np.gradient(y))
            seen &= np.ones_like(seen) if keep is None else keep(at)
            order = np.argsort(y)
            inside = np.interp(rows, y[order], seen[order].astype(np.float64), 0.0, 0.0) == 1.0
            found[stripe, inside] = np.interp(rows, y[order], x[order])[inside]
        found[(found < 0.0) | (found > self.columns - 1.0)] = np.nan
        return found

    def circle_light(self, surface: Surface, amplitude: float = 160.0) -> Floats:
        """Give (row, column) grey levels of whole circles on a surface."""
        from scipy.spatial import cKDTree

        _, places = self.curves(surface)
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        away, _ = cKDTree(places.reshape(-1, 2)).query(np.column_stack([x.ravel(), y.ravel()]))
        light = self.background + amplitude * np.exp(-0.5 * (away / self.sigma_px) ** 2)
        return np.asarray(light.reshape(self.rows, self.columns))

    def circle_peaks(self, x_px: Floats, scatter_px: float = 0.05) -> tuple[Peaks, Integers]:
        """Give the peaks of a perfect extractor, with noise of this std, and the (peak,) stripe of each."""
        stripe, row = np.nonzero(np.isfinite(x_px))
        x = x_px[stripe, row] + np.random.default_rng(SEED).normal(0.0, scatter_px, stripe.size)
        order = np.lexsort((x, row))
        stripe, row, x, many = stripe[order], row[order], x[order], stripe.size
        peaks = Peaks(
            image_size=(self.rows, self.columns),
            row=row,
            x_px=np.clip(x, 0.0, self.columns - 1.0),
            x_std_px=np.full(many, max(scatter_px, 0.01)),
            amplitude=np.full(many, 160.0),
            background=np.full(many, self.background),
            width_px=np.full(many, 2.355 * self.sigma_px),
            flags=np.zeros(many, np.uint8),
        )
        return peaks, stripe

    def circle_map(self, x_px: Floats, product: int = 1) -> StripeMap:
        """Give the true map of (stripe, row) places, all on a product or on the belt; NaN is not seen."""
        seen = np.isfinite(x_px)
        return StripeMap(
            x_px=x_px,
            x_std_px=np.where(seen, 0.1, np.nan),
            product=np.where(seen, product, NOTHING).astype(np.int16),
            seen=seen,
            margin=np.where(seen, 1.0, np.nan),
            ambiguous=np.zeros(x_px.shape, np.bool_),
            rest_px=self.circle_view().rest_of_cones_px(np.arange(self.rows, dtype=np.float64)),
            peak_stripe=np.zeros(0, np.int16),
        )


def level(xy_mm: Floats) -> Floats:
    """Give the heights of the bare belt."""
    return np.full(len(xy_mm), float(BELT))


def moved_circles(calibration: Calibration, alignment: Alignment) -> Calibration:
    """Give a circle rig's calibration after a small motion of its camera."""
    assert calibration.view is not None
    return moved_camera(calibration, alignment, float(calibration.view.camera_matrix[0, 0]))
