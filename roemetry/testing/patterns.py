"""Dots and circles on rigs whose light, places and heights are known exactly; and belts under each pattern.

Belts are seen by cameras at rest and by cameras that have moved since the calibration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roemetry.records import BELT, NOTHING, Dots, Peaks, Rays, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.cones import touching_planes, turned_generators
from roemetry.records.light import at_height
from roemetry.records.view import STEEP_MAX, View
from roemetry.testing.scenes import SEED, GridRig, LinearRig, moved_camera, moved_grid, moved_rig

_TURN = np.radians(14.0)  # keeps the ways of neighbouring dots apart


@dataclass(frozen=True, slots=True)
class DotRig(LinearRig):
    """The linear rig with a matrix of dots: `stripes` columns of `lines`, of light that comes from a point.

    Heights and places are (stripe, line, …); columns count from the left, dots in a column from the top.
    """

    stripes: int = 15
    lines: int = 11
    pitch_mm: float = 3.0
    """Distance of neighbouring dots on the belt."""
    projector_mm: tuple[float, float, float] = (200.0, 4.0, 400.0)

    def rays(self) -> Floats:
        """(stripe, line, 4) the rays, as `Rays` holds them."""
        across = (np.arange(self.stripes) - 0.5 * (self.stripes - 1)) * self.pitch_mm
        down = -(np.arange(self.lines) - 0.5 * (self.lines - 1)) * self.pitch_mm
        x, y = across[:, None], down[None, :]
        foot = np.stack(np.broadcast_arrays(x - np.tan(_TURN) * y, y + np.tan(_TURN) * x), axis=2)
        foot = foot - [8.0, 0.0]
        slope = (np.array(self.projector_mm[:2]) - foot) / self.projector_mm[2]
        return np.concatenate([foot, slope], axis=2)

    def level(self) -> Floats:
        """(stripe, line) heights of the bare belt: 0 mm."""
        return np.zeros((self.stripes, self.lines))

    def hill(self, height_mm: float = 10.0) -> Floats:
        """(stripe, line) heights, mm, of a dome over all but the outer dots."""
        across = np.sin(np.pi * np.arange(self.stripes) / (self.stripes - 1))
        down = np.sin(np.pi * np.arange(self.lines) / (self.lines - 1))
        return np.asarray(height_mm * across[:, None] * down[None, :])

    def points_mm(self, height_mm: Floats) -> Floats:
        """(stripe, line, 3) points at these heights; NaN heights give none."""
        return at_height(self.rays().reshape(-1, 4), height_mm.ravel()).reshape(*height_mm.shape, 3)

    def places_px(self, height_mm: Floats) -> Floats:
        """(stripe, line, 2) where dots at these heights are seen."""
        return self.view().project(self.points_mm(height_mm))

    def spots(self, places_px: Floats, amplitude: float | Floats = 160.0) -> Floats:
        """Give (row, column) grey levels of dots at places (…, 2); NaN draws nothing."""
        y, x = np.mgrid[: self.rows, : self.columns].astype(np.float64)
        light = np.full((self.rows, self.columns), self.background)
        flat = places_px.reshape(-1, 2)
        for place, height in zip(flat, np.broadcast_to(np.ravel(amplitude), len(flat)), strict=True):
            if np.isfinite(place).all():
                off = (x - place[0]) ** 2 + (y - place[1]) ** 2
                light += height * np.exp(-0.5 * off / self.sigma_px**2)
        return light

    def dots(self, places_px: Floats, scatter_px: float = 0.05) -> Peaks:
        """Give the peaks of a perfect extractor, with noise of std `scatter_px`; NaN gives none."""
        flat = places_px.reshape(-1, 2)
        flat = flat + np.random.default_rng(SEED).normal(0.0, scatter_px, flat.shape)
        limits = np.array([self.columns - 1.0, self.rows - 1.0])
        flat = flat[np.isfinite(flat).all(axis=1) & ((flat >= 0.0) & (flat <= limits)).all(axis=1)]
        row = np.rint(flat[:, 1]).astype(np.int64)
        order = np.lexsort((flat[:, 0], row))
        flat, row, many = flat[order], row[order], len(flat)
        covariance = np.tile(max(scatter_px, 0.01) ** 2 * np.eye(2), (many, 1, 1))
        return Peaks(
            image_size=(self.rows, self.columns),
            row=row,
            x_px=flat[:, 0],
            x_std_px=np.sqrt(covariance[:, 0, 0]),
            amplitude=np.full(many, 160.0),
            background=np.full(many, self.background),
            width_px=np.full(many, 2.355 * self.sigma_px),
            flags=np.zeros(many, np.uint8),
            dots=Dots(flat[:, 1], covariance, np.full(many, -1, np.int16)),
        )

    def dot_map(self, height_mm: Floats) -> StripeMap:
        """Give the true map of (stripe, line) heights, mm; NaN is not seen, 0 is belt, else product 1."""
        places = self.places_px(height_mm)
        stripe, line = np.nonzero(np.isfinite(height_mm))
        row = np.rint(places[stripe, line, 1]).astype(np.int64)
        shape = self.stripes, self.rows
        x, y = np.full(shape, np.nan), np.full(shape, np.nan)
        covariance, number = np.full((*shape, 2, 2), np.nan), np.full(shape, -1, np.int16)
        product = np.full(shape, NOTHING, np.int16)
        x[stripe, row], y[stripe, row] = places[stripe, line].T
        covariance[stripe, row], number[stripe, row] = 0.01 * np.eye(2), line
        product[stripe, row] = np.where(height_mm[stripe, line] > 0.0, 1, BELT)
        seen = np.isfinite(x)
        return StripeMap(
            x_px=x,
            x_std_px=np.where(seen, 0.1, np.nan),
            product=product,
            seen=seen,
            margin=np.where(seen, 1.0, np.nan),
            ambiguous=np.zeros(shape, np.bool_),
            rest_px=self.rest_px(),
            peak_stripe=np.zeros(0, np.int16),
            dots=Dots(y, covariance, number),
        )

    def dot_calibration(self) -> Calibration:
        """Give the true calibration, whose rays have no error."""
        plain = LinearRig.calibration(self)
        parameters = np.concatenate([np.ravel(one) for one in plain.parameters.values()])
        return replace(plain, rays=exact_rays(self.rays(), parameters), height_range_mm=(0.0, 25.0))


def moved_dots(calibration: Calibration, alignment: Alignment) -> Calibration:
    """Give a dot rig's calibration after a small motion of its camera."""
    return moved_camera(calibration, alignment, _FOCAL_PX)


_FOCAL_PX = 1000.0  # what a tilt moves the image by, px a radian: the rig's own camera is far away


def exact_rays(lines: Floats, parameters: Floats) -> Rays:
    """Give rays without error that do not follow the parameters."""
    none = np.zeros((*lines.shape, 4))
    return Rays(lines, none, np.zeros((*lines.shape, parameters.size)), parameters)


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

    def circle_map(self, x_px: Floats) -> StripeMap:
        """Give the true map of (stripe, row) places, all on a product; NaN is not seen."""
        seen = np.isfinite(x_px)
        return StripeMap(
            x_px=x_px,
            x_std_px=np.where(seen, 0.1, np.nan),
            product=np.where(seen, 1, NOTHING).astype(np.int16),
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


Motion = tuple[float, float, float, float]
"""As `Alignment` has them: px, rad, relative, rad."""
SHIFT: Motion = (0.8, 0.0, 0.0, 0.0)
_LEAN: Motion = (0.0, 0.0, 0.0, 8e-4)
_FAR_SHIFT: Motion = (5.0, 0.0, 0.0, 0.0)
_FAR_TURN: Motion = (0.0, np.radians(8.0), 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Belt:
    """A belt under a pattern, and how well an aligner of that pattern must know it."""

    calibration: Calibration
    moved: Callable[[Calibration, Alignment], Calibration]
    at_rest: Peaks
    """With a product on it, where the calibration has it."""
    seen: Callable[[Calibration], Peaks]
    """By the camera of a calibration."""
    unseen: Peaks
    places_px: Callable[[Calibration], Floats]
    """Where a calibration has the belt's light; NaN where there is none."""
    small: Sequence[Motion]
    far: Sequence[Motion]
    """small, far: motions that an aligner corrects, and those that it refuses."""
    within_px: float
    foreign: Peaks | None = None
    """Peaks that are not of this pattern."""

    def calibration_after(self, motion: Motion) -> Calibration:
        """Give the true calibration of a camera that has moved."""
        return self.moved(self.calibration, Alignment(np.array(motion), np.zeros((4, 4))))

    def after(self, motion: Motion) -> Peaks:
        """Give what that camera sees."""
        return self.seen(self.calibration_after(motion))


def belt_under(pattern: str) -> Belt:
    """Give the belt under one of the patterns that `Capabilities` names."""
    return _BELTS[pattern]()


def _of_lines() -> Belt:
    rig = LinearRig()
    rows, dome = np.arange(rig.rows, dtype=np.float64), rig.px_per_mm * rig.dome()

    def peaks(x_px: Floats) -> Peaks:
        return rig.peaks(x_px, scatter_px=0.1).peaks

    return Belt(
        rig.calibration(), moved_rig, peaks(rig.rest_px() + dome),
        lambda seen: peaks(seen.rest_line_px(rows) + dome), peaks(np.full((rig.stripes, rig.rows), np.nan)),
        lambda seen: seen.rest_line_px(rows),
        (SHIFT, _turn(8.7e-3), _zoom(6e-3)), (_FAR_TURN,), within_px=0.1,
    )  # fmt: skip


def _of_dots() -> Belt:
    rig = DotRig()
    dome = rig.points_mm(np.maximum(rig.hill(16.0) - 8.0, 0.0))

    def places(seen: Calibration, points_mm: Floats) -> Floats:
        assert seen.view is not None
        return seen.view.project(points_mm)

    at_rest = rig.dots(places(rig.dot_calibration(), dome))
    return Belt(
        rig.dot_calibration(), moved_dots, at_rest, lambda seen: rig.dots(places(seen, dome)),
        rig.dots(np.full((1, 2), np.nan)), lambda seen: places(seen, rig.points_mm(rig.level())),
        (SHIFT, _LEAN, _turn(9e-3), _zoom(9e-3)), (_FAR_SHIFT, _FAR_TURN), within_px=0.1,
        foreign=replace(at_rest, dots=None),
    )  # fmt: skip


def _of_grids() -> Belt:
    rig = GridRig()
    hill = [np.where(height > 2.0, height, 0.0) for height in rig.hill()]

    def rest_px(seen: Calibration) -> list[Floats]:
        assert seen.across is not None
        return [
            made.rest_line_px(np.arange(family.rows, dtype=np.float64))
            for family, made in ((rig, seen), (rig.across, seen.across))
        ]

    def after(seen: Calibration) -> Peaks:
        upright, across = (
            family.peaks(rest + family.px_per_mm * height, scatter_px=0.05).peaks
            for family, rest, height in zip((rig, rig.across), rest_px(seen), hill, strict=True)
        )
        return replace(upright, across=across)

    at_rest = rig.grid_peaks((hill[0], hill[1]))
    return Belt(
        rig.grid_calibration(), moved_grid, at_rest, after,
        rig.grid_peaks((np.full_like(hill[0], np.nan), np.full_like(hill[1], np.nan))),
        lambda seen: np.concatenate([rest.ravel() for rest in rest_px(seen)]),
        (SHIFT, _LEAN, _turn(7e-3), _zoom(7e-3)), (_FAR_SHIFT, _FAR_TURN), within_px=0.1,
        foreign=replace(at_rest, across=None),
    )  # fmt: skip


def _of_circles() -> Belt:
    """Give a belt without a product after a motion; where circles end, their rows tell less: 0.15 px."""
    rig = CircleRig()
    rows, there = np.arange(rig.rows, dtype=np.float64), np.isfinite(rig.x_on_rows(level))

    def places(seen: Calibration) -> Floats:
        return np.where(there, seen.rest_line_px(rows), np.nan)

    return Belt(
        rig.circle_calibration(), moved_circles, rig.circle_peaks(rig.x_on_rows(rig.circle_dome(8.0)))[0],
        lambda seen: rig.circle_peaks(places(seen))[0],
        rig.circle_peaks(np.full((rig.stripes, rig.rows), np.nan))[0], places,
        (SHIFT, _turn(9e-3), _zoom(9e-3)), (_FAR_SHIFT,), within_px=0.15,
    )  # fmt: skip


def _turn(angle_rad: float) -> Motion:
    return (0.0, angle_rad, 0.0, 0.0)


def _zoom(share: float) -> Motion:
    return (0.0, 0.0, share, 0.0)


_BELTS = {"lines": _of_lines, "dots": _of_dots, "grid": _of_grids, "circles": _of_circles}
