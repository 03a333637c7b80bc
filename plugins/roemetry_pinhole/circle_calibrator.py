"""Calibration of camera, concentric cones of light, and belt, from a board in many poses.

A place on a board in a known pose, seen from the apex of the cones, lies at the half angle of its circle
from the axis. Marks of the boards and all circles are adjusted together: with u what marks tell (camera,
poses, belt; covariance C from their own adjustment) and c the cones' numbers, the squares of the peaks'
distances from their circles over their variance and of u's step over C are made smallest by Gauss and
Newton's method (Triggs, McLauchlan, Hartley and Fitzgibbon 2000). Peaks that lie far off are left out; if
the others scatter more than they state, the covariance grows by that.

It assumes that circles are concentric and come from one point; how much peaks scatter about such cones, and
how many lie far off, is limited. It fails with few places of circles on boards.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field

from roemetry.errors import CalibrationError
from roemetry.records import EDGE, SATURATED, WIDE, CalibrationSet, Observation
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Calibrator, Capabilities
from roemetry_pinhole.boards import on_board, on_even_print
from roemetry_pinhole.bundle import Adjusted
from roemetry_pinhole.calibrator import BoardOptions
from roemetry_pinhole.circle_numbers import BeltCircles, on_belt, on_boards
from roemetry_pinhole.cones import ANGLES, AXIS, LIGHT, METHOD, derived
from roemetry_pinhole.dot_rays import surface_of
from roemetry_pinhole.geometry import ON_BELT, Geometry, rays
from roemetry_pinhole.initial_intrinsics import InitialCamera, belt_under
from roemetry_pinhole.joint_adjustment import marks_alone
from roemetry_pinhole.pinhole_plane import belt_pose

_EVERY = 3
"""Of the rows of a curve so many-th counts: neighbours share their speckle."""
_ADDED_STD_PX = 0.02  # of every peak, beside its stated error: print and paper are not quite even
_ROUNDS = 6  # Gauss–Newton steps: the search's place is within some centimetres
_STEP_PX = 0.05  # of the derivative of the angle by the place along the row
_OFF_MAX = 5.0  # standard deviations beyond which a peak is left out
_OFF_LEAST_PX = 0.3  # nearer than this a peak is never left out, px
_FACTOR_MAX = 6.0
"""Times its stated error, that a peak scatters at most: a bent board or a moved projector make it more."""
_LEFT_OUT_MAX = 0.3  # share of the peaks that may lie far off
_MAD_TO_STD = 1.4826  # of a normal distribution
_CONE_STEPS = (1e-2, 1e-2, 1e-2, 1e-5, 1e-5)  # of light (mm) and axis: all some 0.01 px


class PinholeCirclesOptions(BoardOptions):
    """What is looked for."""

    camera: Path | None = Field(
        default=None, description="file with a camera that is known and not looked for"
    )


class PinholeCirclesCalibrator(Calibrator[PinholeCirclesOptions]):
    """Camera, lens, concentric cones of light, and the belt, from a board in many poses."""

    capabilities = Capabilities(pattern="circles", fixture="roemetry_pinhole.conformance:circles_observed_of")

    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate; the set's stripes are halves of circles, two for each.

        Raises
        ------
        CalibrationError
            No board, too few poses, no board on the belt or no image of the empty belt; another number of
            circles on the belt; circles on boards that are not the belt's, or do not agree.
        """
        options = self.options
        if observed.stripe_count % 2:
            raise CalibrationError(
                f"{observed.stripe_count} stripes are not the halves of circles",
                hint="give the rig a pattern of kind circles, or an even number of stripes",
            )
        seen, first, marks = marks_alone(observed, options.lens, options.camera)
        size, belts = observed.observations[0].frame.size, observed.showing("belt")
        board = observed.board
        assert board is not None
        points, start = self._points(first, belts, observed.stripe_count // 2)
        found = _adjusted(marks, points, start)
        left_out = 1.0 - float(found.used.mean())
        if left_out > _LEFT_OUT_MAX or found.factor > _FACTOR_MAX:
            raise CalibrationError(
                f"circles on boards scatter {found.factor:.1f} times as much about cones from one point "
                f"as they should, and {left_out:.0%} of their places lie far off",
                hint="is the board flat, its pitch right, and are the circles concentric? Did projector or "
                "camera move between the images?",
            )
        geometry, used = found.geometry, found.used
        parameters = {
            "focal_px": geometry.camera[:2],
            "principal_px": geometry.camera[2:4],
            "distortion": geometry.camera[4:],
            "belt_per_mm": geometry.belt,
            LIGHT: found.cones[:3],
            AXIS: found.cones[3:5],
            ANGLES: found.cones[5:],
        }
        made = derived(parameters, size)
        pose = belt_pose(geometry.belt)
        place = _places(geometry, points.pose, points.xy_px) @ pose[:3, :3].T + pose[:3, 3]
        lifted = made["view"].lift(points.xy_px[used], points.half[used])
        off = lifted[:, 2] - place[used, 2]
        return Calibration(
            method=METHOD,
            image_size=size,
            turn_deg=observed.observations[0].frame.turn_deg,
            height_range_mm=(0.0, options.height_max_mm or float(np.percentile(place[used, 2], 99.5))),
            covariance=_covariance_of(found, marks),
            residuals={
                "circles_rms_px": float(np.sqrt((found.residual_px[used] ** 2).mean())),
                "circles_std_factor": found.factor,
                "circles_left_out": left_out,
                "heights_rms_mm": float(np.sqrt(np.nanmean(off**2))),
            },
            target={"kind": board.kind, "name": board.name, "poses": len(first.views)},
            extractor=dict(observed.extractor),
            notes=(*seen.notes, *(f"not used: {name}: {why}" for name, why in seen.left_out.items())),
            **made,
        )

    def _points(
        self, first: InitialCamera, belts: tuple[Observation, ...], circles: int
    ) -> tuple[_Points, Floats]:
        """Number the peaks of all images; give also the cones to start from, camera's frame."""
        belt = belt_under(first, next(n for n, view in enumerate(first.views) if view.on_belt))
        pose = belt_pose(belt)
        peaks = belts[0].peaks
        half = on_belt(peaks, _sound(belts[0]), circles, belts[0].frame.name)
        parts = [_Part.of(ON_BELT, belts[0], half >= 0, belt, first.camera)]
        for number, view in enumerate(first.views):
            if view.laser is None:
                continue
            use = _sound(view.laser)
            if view.plain is not None:
                use &= on_even_print(view.laser.peaks, view.plain.frame, self.options.print_contrast_max)
            sight = rays(first.camera, _xy(view.laser))[:, :2]
            place = on_board(sight, first.rotation[number], first.shift[number])
            margin = view.board.margin_mm
            use &= ((place > -margin) & (place < view.board.size_mm + margin)).all(axis=1)
            parts.append(_Part.of(number, view.laser, use, first.surface(number), first.camera))
        in_belt_frame = [one.place_mm @ pose[:3, :3].T + pose[:3, 3] for one in parts]
        on = half[half >= 0]
        rings = BeltCircles.through(in_belt_frame[0][:, :2], on, circles)
        of_boards = np.concatenate([np.empty((0, 3)), *in_belt_frame[1:]])
        if len(of_boards) < 100 * circles:
            raise CalibrationError(
                f"{len(of_boards)} places of circles are seen on boards",
                hint="hold the board under all of the pattern, in ten poses and more, laser on and off",
            )
        light, circle = on_boards(rings, of_boards, float(pose[2, 3]))
        # left and right by the side of the plane through light and middle that the camera's x is square to
        axis = np.append(rings.middle_mm, 0.0) - light
        axis /= np.linalg.norm(axis)
        across = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
        right = (of_boards - light) @ across > 0.0
        # left halves count from the largest circle inwards
        of_circle = np.where(right, circles + circle, circles - 1 - circle)
        every = np.concatenate([on, np.where(circle < 0, -1, of_circle)])
        kept = every >= 0
        points = _Points(
            np.concatenate([np.full(len(one.xy_px), one.pose) for one in parts])[kept],
            every[kept],
            np.concatenate([one.xy_px for one in parts])[kept],
            np.hypot(np.concatenate([one.std_px for one in parts])[kept], _ADDED_STD_PX),
            circles,
        )
        way = pose[:3, :3].T @ axis
        apex = pose[:3, :3].T @ (light - pose[:3, 3])
        cones = np.concatenate([apex, way[:2] / way[2], np.zeros(circles)])
        place = np.concatenate([one.place_mm for one in parts])[kept]
        angle = _angle(cones, place)
        cones[5:] = [np.median(angle[points.circle == k]) for k in range(circles)]
        return points, cones


@dataclass(frozen=True, eq=False, slots=True)
class _Points:
    """Peaks with their half circle, on boards and on the belt."""

    pose: Integers
    half: Integers
    xy_px: Floats
    std_px: Floats
    circles: int

    @property
    def circle(self) -> Integers:
        """(point,) 0 the smallest."""
        return np.where(self.half >= self.circles, self.half - self.circles, self.circles - 1 - self.half)


@dataclass(frozen=True, eq=False, slots=True)
class _Part:
    """Peaks of one image that may be used, of a pose or the belt."""

    pose: int
    xy_px: Floats
    std_px: Floats
    place_mm: Floats
    """(peak, 3) in the camera's frame."""

    @classmethod
    def of(cls, pose: int, one: Observation, use: Flags, surface: Floats, camera: Floats) -> _Part:
        """Give those to be used; they lie on the surface (3,) p·X = 1."""
        xy_px = _xy(one)[use]
        ray = rays(camera, xy_px)
        return cls(pose, xy_px, one.peaks.x_std_px[use], ray / (ray @ surface)[:, None])


@dataclass(frozen=True, eq=False, slots=True)
class _Found:
    """What the adjustment gives."""

    geometry: Geometry
    cones: Floats
    covariance: Floats
    """cones, covariance: light, axis and half angles; (n, n) of the marks' unknowns, then these."""
    residual_px: Floats
    used: Flags
    factor: float


def _sound(one: Observation) -> Flags:
    peaks = one.peaks
    sound = (peaks.flags & (EDGE | WIDE | SATURATED)) == 0
    # on boards every third row; the empty belt has few enough
    return np.asarray(sound & (peaks.row % _EVERY == 0) if one.shows != "belt" else sound)


def _xy(one: Observation) -> Floats:
    return np.column_stack([one.peaks.x_px, one.peaks.row.astype(np.float64)])


def _places(geometry: Geometry, pose: Integers, xy_px: Floats) -> Floats:
    """Give (n, 3) where peaks lie on boards or belt, camera's frame, mm."""
    ray = rays(geometry.camera, xy_px)
    return np.asarray(ray / (ray * surface_of(geometry, pose)).sum(axis=1)[:, None])


def _angle(cones: Floats, place: Floats) -> Floats:
    """Give (n,) the angle from the axis at which places are seen from the light, rad."""
    axis = np.append(cones[3:5], 1.0)
    axis /= np.linalg.norm(axis)
    away = place - cones[:3]
    along = away @ axis
    return np.asarray(np.arctan2(np.linalg.norm(away - along[:, None] * axis, axis=1), along))


def _off(geometry: Geometry, cones: Floats, points: _Points) -> Floats:
    """Give (n,) angles by which peaks lie outside their cones, rad."""
    place = _places(geometry, points.pose, points.xy_px)
    return np.asarray(_angle(cones, place) - cones[5:][points.circle])


def _adjusted(marks: Adjusted, points: _Points, cones: Floats) -> _Found:
    """Adjust cones, and with them camera, poses and belt."""
    geometry, unknowns = marks.geometry, marks.unknowns
    information = np.linalg.inv(marks.covariance)
    count, own = unknowns.count, len(cones)
    total = np.zeros(count)
    used, factor = np.ones(points.half.size, np.bool_), 1.0
    for step in range(_ROUNDS):
        place = _places(geometry, points.pose, points.xy_px)
        beside = _places(geometry, points.pose, points.xy_px + np.array([_STEP_PX, 0.0]))
        # rad for a pixel along the row
        per_px = (_angle(cones, beside) - _angle(cones, place)) / _STEP_PX
        here = _off(geometry, cones, points)
        residual = here / per_px
        used, factor = _judged(residual, points.std_px, own)
        derivative = np.zeros((here.size, count + own))
        for number, std in enumerate(np.sqrt(np.diag(marks.covariance)).tolist()):
            move = np.zeros(count)
            move[number] = 0.1 * std
            above, below = (
                _off(unknowns.moved(geometry, sign * move), cones, points) for sign in (1.0, -1.0)
            )
            derivative[:, number] = (above - below) / (0.2 * std)
        for number, size in enumerate(_CONE_STEPS):
            move = np.zeros(own)
            move[number] = size
            derivative[:, count + number] = (_off(geometry, cones + move, points) - here) / size
        # a peak's own half angle
        derivative[np.arange(here.size), count + 5 + points.circle] = -1.0
        derivative /= per_px[:, None]
        weight = np.where(used, 1.0 / (factor * points.std_px) ** 2, 0.0)
        normal = (derivative * weight[:, None]).T @ derivative
        normal[:count, :count] += information
        # unknowns in mm, rad and px: scaled before inverting
        scale = 1.0 / np.sqrt(np.diag(normal))
        covariance = scale[:, None] * np.linalg.inv(scale[:, None] * normal * scale) * scale
        if step < _ROUNDS - 1:
            right = -(derivative * weight[:, None]).T @ residual
            # u is weighed from the marks' own place
            right[:count] -= information @ total
            change = covariance @ right
            total = total + change[:count]
            geometry = unknowns.moved(geometry, change[:count])
            cones = cones + change[count:]
    return _Found(geometry, cones, covariance, residual, used, factor)


def _judged(residual: Floats, std_px: Floats, numbers: int) -> tuple[Flags, float]:
    """Say which peaks are not far off, and how much more they scatter than they state."""
    off = np.abs(residual) / std_px
    free = max(1.0 - numbers / max(off.size, 1), 0.1)
    factor = max(_MAD_TO_STD * float(np.median(off)) / np.sqrt(free), 1.0)
    return np.asarray((off < _OFF_MAX * factor) | (np.abs(residual) < _OFF_LEAST_PX)), factor


def _covariance_of(found: _Found, marks: Adjusted) -> Floats:
    """Give the covariance of the calibration's parameters; 0 for what was held fixed."""
    cones = np.arange(len(found.cones)) + marks.unknowns.count
    at = np.concatenate([marks.unknowns.camera, marks.unknowns.belt, cones])
    known = np.flatnonzero(at >= 0)
    whole = np.zeros((at.size, at.size))
    whole[np.ix_(known, known)] = found.covariance[np.ix_(at[known], at[known])]
    return 0.5 * (whole + whole.T)
