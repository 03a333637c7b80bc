"""Plates with balls: found in images, as a reference for scale, and as the source of planes of light.

Model. Every peak is taken for every stripe and lifted by its plane; those of the right stripe lie on balls.
A point at a known height says on which circle its ball's centre lies (a Hough transform); the plate's place
and turn follow from the votes, then place, turn and size from least squares of the points' distances off the
balls, over how far a pixel moves them. As a reference, the size over the described one checks the scale.

As the source of planes the belt must be known: then a plane through its line on the belt may only lean, and
those of one projector lean together. Places of the projector are tried, the plate is looked for with each,
and all is adjusted from the best one, a ball's surface at a peak being the plane that touches it there.

It fails where a stripe meets no ball, and for plates turned by more than 45°.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from roemetry.calibrating.sphere_plate import centres, place_of
from roemetry.errors import CalibrationError
from roemetry.records import EDGE, WIDE, CalibrationSet, Observation, Peaks, SpherePlate
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry_pinhole.bundle import MAD_TO_STD, Measured
from roemetry_pinhole.from_solids import OnSolids, resting
from roemetry_pinhole.geometry import ON_BELT, Geometry, StripePoints, turned
from roemetry_pinhole.pinhole_plane import belt_pose, by_parameter, parameters_of, points_of
from roemetry_pinhole.solids import Shape, belt_lines, numbered

BELT_MM = 0.6
"""A peak this near to the belt on any stripe may be belt, and is not used."""
_CAP_RISE_MIN = 0.35
"""Points are used where the ball's surface rises by less than some 70°: further down it shades itself."""
_TURN_MAX_DEG = 45.0  # as targets are laid: a square grid turned by more is one turned by less
_ROUNDS = (0.20, 0.12, 0.08, 0.05, 0.05, 0.05)
"""Of each round, how far off a ball its points may be, in radii."""
_STEPS = 4  # Gauss–Newton steps of a round; the points are chosen anew after them
_STRAY_MADS = 4.5  # standard deviations beyond which a point is left out: one normal error in 150,000
_ALONG_SHARE = 0.2
"""Of the median way across a ball for a pixel: points seen along the surface count as if they had so much."""
_BALL_POINTS_MIN = 12  # points on a ball: fewer lie there by chance
_POINTS_MIN = 60  # points on all balls, for four unknowns and their scatter
_EXPLAINED_MIN = 0.15
"""Share of the peaks at the balls' heights that must lie on balls: in images with the plate's level and
shadows it is 0.28 to 0.38, without them above 0.7."""


@dataclass(frozen=True, eq=False, slots=True)
class Plate:
    """A sphere plate as measured."""

    pose: Floats
    """(4,) x, y of its middle in the belt frame, mm; its turn about Z, rad; its lengths over the described.
    """
    stripe: Integers
    x_px: Floats
    row_px: Floats
    ball: Integers
    """stripe, x_px, row_px, ball: (point,) peaks on balls: stripe, place, and which ball."""
    at_mm: Floats
    per_px: Floats
    """at_mm, per_px: (point, 3) where they lie in the belt frame; (point,) how far a pixel moves them across
    the ball, mm."""
    slopes: Floats
    """(point, 4) derivatives of the points' residuals by the pose."""
    residual: Floats
    """(point,) distance from the ball's surface over `per_px`: px."""
    rms_mm: float
    """Rms distance of the points from their balls."""

    @property
    def balls(self) -> int:
        """Number of balls that are seen."""
        return int(np.unique(self.ball).size)

    @property
    def turn(self) -> Floats:
        """(3, 3) to the belt frame from the plate's."""
        return np.asarray(turned(np.array([[0.0, 0.0, self.pose[2]]]))[0])

    def answer(self, change: Floats) -> float:
        """Give the change of ln(size) if the points' residuals (point,) change."""
        normal = self.slopes.T @ self.slopes
        return float(-np.linalg.solve(normal, self.slopes.T @ change)[3] / self.pose[3])

    def random_std(self) -> float:
        """Give the standard uncertainty of ln(size) by the scatter of the points.

        Peaks along one stripe over one ball err together: the larger of what single points and what such
        groups tell.
        """
        inverse = np.linalg.inv(self.slopes.T @ self.slopes)
        way = inverse[3] @ self.slopes.T / self.pose[3]
        alone = float(np.sqrt((way**2).sum() * (self.residual**2).mean()))
        group = np.unique(self.stripe * 10_000 + self.ball, return_inverse=True)[1]
        sums = np.bincount(group, way * self.residual)
        # four numbers were fitted
        spare = max(sums.size - 4, 1)
        return max(alone, float(np.sqrt((sums**2).sum() * sums.size / spare)))


def find_plate(parameters: Mapping[str, Floats], peaks: Peaks, plate: SpherePlate) -> Plate | None:
    """Find a sphere plate, its columns within 45° across the stripes, and fit its place and size.

    `parameters` are a calibration's. None where the plate is not seen. Every peak is taken for every stripe;
    those of the right stripe lie on balls.
    """
    good = np.flatnonzero((peaks.flags & (EDGE | WIDE)) == 0)
    stripes = len(parameters["planes_per_mm"])
    stripe, peak = (index.ravel() for index in np.indices((stripes, good.size)))
    x_px, row_px = peaks.x_px[good][peak], peaks.row[good][peak].astype(np.float64)
    at = points_of(parameters, stripe, x_px, row_px)
    on_belt = np.asarray((np.abs(at[:, 2].reshape(stripes, -1)) < BELT_MM).any(axis=0))
    radius = 0.5 * plate.diameter_mm
    high = np.abs(at[:, 2] - plate.centre_height_mm - 0.6 * radius) < 0.7 * radius
    use = np.flatnonzero(high & ~on_belt[peak])
    if use.size < _POINTS_MIN:
        return None
    stripe, x_px, row_px = stripe[use], x_px[use], row_px[use]
    # central difference over half a pixel
    up, down = (points_of(parameters, stripe, x_px + way, row_px) for way in (0.25, -0.25))
    near = _Near(stripe, x_px, row_px, at[use], (up - down) / 0.5)
    found = _fitted(near, plate, np.append(place_of(near.at_mm, plate, _TURN_MAX_DEG), 1.0))
    # a peak is one, however many stripes it might belong to
    explained = 0.0 if found is None else found.ball.size / np.unique(peak[use]).size
    return found if explained > _EXPLAINED_MIN else None


class _Near(NamedTuple):
    """Peaks taken for stripes by which they lie at the balls' heights: (point,) and (point, 3)."""

    stripe: Integers
    x_px: Floats
    row_px: Floats
    at_mm: Floats
    across: Floats
    """Way of each point for a pixel along the row, mm."""

    def some(self, use: Integers) -> _Near:
        """Give some of the points."""
        parts: list[Any] = [column[use] for column in self]
        return _Near(*parts)


def off_balls(at_mm: Floats, ball: Integers, plate: SpherePlate, pose: Floats) -> tuple[Floats, Floats]:
    """Give (point,) distances of points outwards from their balls, mm, and (point, 3) the way out."""
    way = at_mm - centres(plate, pose)[ball]
    size = np.sqrt((way**2).sum(axis=1))
    return size - 0.5 * pose[3] * plate.diameter_mm, way / size[:, None]


def _fitted(near: _Near, plate: SpherePlate, pose: Floats) -> Plate | None:
    """Gauss and Newton, the points on balls chosen anew in each round."""
    radius = 0.5 * plate.diameter_mm
    found = None
    for share in _ROUNDS:
        centre = centres(plate, pose)
        # by X and Y: balls stand apart
        ball = ((near.at_mm[:, None, :2] - centre[None, :, :2]) ** 2).sum(axis=2).argmin(axis=1)
        off, out = off_balls(near.at_mm, ball, plate, pose)
        on = (np.abs(off) < share * radius) & (out[:, 2] > _CAP_RISE_MIN)
        on &= np.bincount(ball[on], minlength=len(centre))[ball] >= _BALL_POINTS_MIN
        use = np.flatnonzero(on)
        for _ in range(_STEPS):
            if use.size < _POINTS_MIN:
                return None
            found = _measured(near.some(use), ball[use], plate, pose)
            pose = pose + np.linalg.lstsq(found.slopes, -found.residual, rcond=None)[0]
            limit = _STRAY_MADS * MAD_TO_STD * float(np.median(np.abs(found.residual))) + 1e-6
            use = use[np.abs(found.residual) < limit]
    return found


def _measured(near: _Near, ball: Integers, plate: SpherePlate, pose: Floats) -> Plate:
    off, out = off_balls(near.at_mm, ball, plate, pose)
    per_px = np.abs((out * near.across).sum(axis=1))
    # a point that a pixel moves along the surface says nothing that could be weighed
    per_px = np.maximum(per_px, _ALONG_SHARE * float(np.median(per_px)))
    # derivatives of the distances from the balls by the pose
    # about the plate's middle: (−y, x)
    own = centres(plate, pose)[ball] - [*pose[:2], 0.0]
    around = np.column_stack([-own[:, 1], own[:, 0], np.zeros(len(own))])
    by_size = -(out * own).sum(axis=1) / pose[3] - 0.5 * plate.diameter_mm
    slopes = np.column_stack([-out[:, 0], -out[:, 1], -(out * around).sum(axis=1), by_size])
    return Plate(
        pose,
        near.stripe,
        near.x_px,
        near.row_px,
        ball,
        near.at_mm,
        per_px,
        slopes / per_px[:, None],
        off / per_px,
        float(np.sqrt((off**2).mean())),
    )


class PlateScale(NamedTuple):
    """A sphere plate's lengths over those described."""

    ratio: float
    own_std: float
    """ratio, own_std: see `Reference` in `scale`."""
    by_parameter: Floats
    """(n,) derivative of ln ratio by the calibration's parameters."""
    said: str
    """What was seen, in words."""


def plate_scale(calibration: Calibration, images: list[Peaks], plate: SpherePlate) -> PlateScale | None:
    """Measure a sphere plate in one or more images; None where it is seen in none."""
    found = [one for peaks in images if (one := find_plate(calibration.parameters, peaks, plate)) is not None]
    if not found:
        return None
    weight = np.array([max(one.random_std(), 1e-7) ** -2 for one in found])
    share = weight / weight.sum()
    own = float(weight.sum() ** -0.5)
    # the plate is the same in all images: what its lengths are wrong by does not average out
    lengths = np.stack([_by_length(one, plate) for one in found])
    of_lengths = (share @ lengths) * plate.tolerance_mm / np.sqrt(3.0)

    def size_by_parameter(one: Plate) -> Floats:
        """Give (n,) derivatives of ln size: each parameter moves the points, and the fit answers."""

        def off_px(parameters: Mapping[str, Floats]) -> Floats:
            at = points_of(parameters, one.stripe, one.x_px, one.row_px)
            return off_balls(at, one.ball, plate, one.pose)[0] / one.per_px

        return np.array([one.answer(change) for change in by_parameter(calibration, off_px)])

    ways = np.stack([size_by_parameter(one) for one in found])
    balls, points = sum(one.balls for one in found), sum(one.ball.size for one in found)
    rms_mm = float(np.sqrt(sum(one.rms_mm**2 * one.ball.size for one in found) / points))
    return PlateScale(
        float(np.exp(share @ np.log([one.pose[3] for one in found]))),
        float(np.sqrt(own**2 + of_lengths @ of_lengths)),
        np.asarray(share @ ways),
        f"sphere plate: {points} points on {balls} balls lie {rms_mm:.3f} mm (rms) off them",
    )


def _by_length(found: Plate, plate: SpherePlate) -> Floats:
    """(3,) derivatives of ln ratio by the described pitch, diameter and centres' height, 1/mm."""
    before = off_balls(found.at_mm, found.ball, plate, found.pose)[0]
    after = [off_balls(found.at_mm, found.ball, longer, found.pose)[0] for longer in _longer(plate, _STEP_MM)]
    return np.array([found.answer((one - before) / found.per_px) / _STEP_MM for one in after])


def _longer(plate: SpherePlate, more_mm: float) -> list[SpherePlate]:
    """Give plates whose pitch, diameter or centres' height is longer."""
    names = ("pitch_mm", "diameter_mm", "centre_height_mm")
    return [replace(plate, **{name: getattr(plate, name) + more_mm}) for name in names]


_STEP_MM = 1e-3  # step of derivatives by described lengths, mm: lengths are some 30 mm, rounding 1e-14


_HEIGHTS = (0.6, 0.8, 1.0, 1.3)  # of the projector over the belt, in distances of the camera
_ANGLES_DEG = np.arange(10.0, 61.0, 2.5)  # of the light to the vertical that are tried, to either side
_TRIED = 8  # best places of the projector by a part of the peaks that are tried with all of them
_TRIED_VIEWS = 2  # images that are looked at in the first trial
_PEAKS_MAX = 1500  # peaks of each of them: more tell nothing more and take their time
_PLATE_ROUNDS = 5  # of finding the balls and adjusting
_STRIPE_POINTS_MIN = 12  # points of a stripe on balls, besides its belt line, that determine its plane
_BELT_POINTS_MAX = 3000
"""Peaks on the belt that are used: so that they do not outnumber those on balls by far."""


def from_plate(
    observed: CalibrationSet, plate: SpherePlate, boards: Measured, free_camera: Flags, belt: Floats | None
) -> OnSolids:
    """Find the planes of light from images of the sphere plate and of the empty belt; the belt must be known.

    The other parameters are those of `from_solids`.

    Raises
    ------
    CalibrationError
        The belt is not known or its empty image is missing; the plate is not seen; a stripe lies on no
        ball.
    """
    if belt is None or not observed.showing("belt"):
        raise CalibrationError(
            "a sphere plate alone does not tell where the belt is",
            hint="name an image of the board lying on the belt, laser off (images.board_on_belt), and one of "
            "the empty belt (images.belt); or take a truncated pyramid",
        )
    camera, stripes = boards.start.camera, observed.stripe_count
    bare = [numbered(view, camera, stripes) for view in observed.showing("belt")]
    lines = belt_lines(bare[0], bare[0], stripes, float(camera[0]))
    views = observed.showing("sphere_plate")
    geometry = _start(replace(boards.start, belt=belt), lines, views, plate)
    on_belt = np.concatenate(
        [np.column_stack([one.stripe, one.x_px, one.row_px, one.std_px]) for one in bare]
    )
    on_belt = on_belt[:: max(1, -(-len(on_belt) // _BELT_POINTS_MAX))]
    first = len(boards.start.shift)
    under = 0.5 * plate.pitch_mm * max(plate.columns, plate.rows) * _UNDER
    for number in range(_PLATE_ROUNDS):
        plates = [_seen(geometry, view, plate) for view in views]
        many = np.bincount(np.concatenate([one.stripe for one in plates]), minlength=stripes)
        missing = np.flatnonzero(many < _STRIPE_POINTS_MIN)
        if missing.size:
            raise CalibrationError(
                f"stripe {', '.join(str(stripe + 1) for stripe in missing)} lies on no ball: that determines "
                "no plane",
                hint="add images of the sphere plate with the plate moved across the stripes",
            )
        pose = belt_pose(geometry.belt)
        # to the camera's frame
        turns = [pose[:3, :3].T @ one.turn for one in plates]
        places = [pose[:3, :3].T @ ([*one.pose[:2], 0.0] - pose[:3, 3]) for one in plates]
        start = replace(
            geometry,
            rotation=np.concatenate([geometry.rotation[:first], turns]),
            shift=np.concatenate([geometry.shift[:first], places]),
        )
        points = _points(on_belt, plates, plate, first)
        measured = resting(boards, free_camera, start, points, [under] * len(plates), first)
        geometry = measured.robust_prefit() if number + 1 < _PLATE_ROUNDS else geometry
    adjusted = measured.adjusted()
    # adjusted again for each length, longer by its standard uncertainty; the touching planes stay parallel
    by_tolerance = []
    for longer in _longer(plate, plate.tolerance_mm / np.sqrt(3.0)):
        points = _points(on_belt, plates, plate, first, longer)
        by_tolerance.append(replace(measured, points=points).step_of(adjusted)[0])
    top, along = plate.centre_height_mm + 0.5 * plate.diameter_mm, plate.rows * plate.pitch_mm
    shape = Shape("sphere-plate", plate.name, (), 0, top, along, top, False)
    return OnSolids(measured, adjusted, (shape,), tuple(by_tolerance), 0.0)


_UNDER = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
"""Three points under a plate that touch the belt, in halves of its longer side."""


def _start(boards: Geometry, lines: Floats, views: tuple[Observation, ...], plate: SpherePlate) -> Geometry:
    """Try places of the projector; give the geometry by which most peaks lie on balls."""
    pose = belt_pose(boards.belt)
    away = float(pose[2, 3])
    # rays of the line on the belt: (1, −slope, −start)·m = 0
    line = np.column_stack([np.ones(len(lines)), -lines[:, 1], -lines[:, 0]])
    some = [_thinned(view.peaks) for view in views[:: max(1, len(views) // _TRIED_VIEWS)]]

    def seen(geometry: Geometry, images: list[Peaks]) -> tuple[int, float]:
        """Give how many points lie on balls, and how far off, mm."""
        parameters = parameters_of(geometry, travel=False)
        found = [plates for one in images if (plates := find_plate(parameters, one, plate)) is not None]
        off_mm = max((one.rms_mm for one in found), default=np.inf)
        return sum(one.ball.size for one in found), off_mm

    tried: list[tuple[int, Geometry]] = []
    for share in _HEIGHTS:
        for angle in np.radians([*-_ANGLES_DEG, *_ANGLES_DEG]):
            high = share * away
            at = pose[:3, :3].T @ (np.array([high * np.tan(angle), 0.0, high]) - pose[:3, 3])
            # through the line on the belt and the projector's place
            planes = boards.belt + line * ((1.0 - boards.belt @ at) / (line @ at))[:, None]
            geometry = replace(boards, planes=planes)
            tried.append((seen(geometry, some)[0], geometry))
    fits = []
    for _, geometry in sorted(tried, key=lambda one: -one[0])[:_TRIED]:
        points, off_mm = seen(geometry, [view.peaks for view in views])
        # few mm off, and many points
        fits.append((off_mm / max(points, 1), geometry))
    return min(fits, key=lambda one: one[0])[1]


def _thinned(peaks: Peaks) -> Peaks:
    """Some of an image's rows, for trying."""
    every = max(1, len(peaks) // _PEAKS_MAX)
    return peaks.some(peaks.row % every == 0)


def _seen(geometry: Geometry, view: Observation, plate: SpherePlate) -> Plate:
    found = find_plate(parameters_of(geometry, travel=False), view.peaks, plate)
    if found is None:
        raise CalibrationError(
            f"{view.frame.name}: the sphere plate is not seen",
            hint="lay it under the stripes, its columns across them; are its lengths right?",
        )
    return found


def _points(
    on_belt: Floats, plates: list[Plate], plate: SpherePlate, first: int, longer: SpherePlate | None = None
) -> StripePoints:
    """Peaks on the belt and on balls; a ball's surface at a peak is the plane that touches it there.

    Its distance from the plate's origin is that of a plate with other lengths, if one is given.
    """
    tables = [np.column_stack([np.full(len(on_belt), ON_BELT), on_belt])]
    faces = [np.tile([0.0, 0.0, 1.0, 0.0], (len(on_belt), 1))]
    lengths = longer or plate
    for number, one in enumerate(plates):
        same = np.ones(one.ball.size)
        std = np.median(on_belt[:, 3]) * same
        tables.append(np.column_stack([(first + number) * same, one.stripe, one.x_px, one.row_px, std]))
        way = one.at_mm - centres(plate, one.pose)[one.ball]
        out = (way / np.sqrt((way**2).sum(axis=1))[:, None]) @ one.turn
        own = centres(lengths, np.array([0.0, 0.0, 0.0, 1.0]))[one.ball]
        # the plane that touches: n·X = n·centre + radius
        faces.append(np.column_stack([out, (out * own).sum(axis=1) + 0.5 * lengths.diameter_mm]))
    pose, stripe, x_px, row_px, std_px = np.ascontiguousarray(np.concatenate(tables).T)
    whole = pose.astype(np.int64), stripe.astype(np.int64)
    return StripePoints(*whole, x_px, row_px, std_px, np.zeros(pose.size), np.concatenate(faces))
