"""Planes of light from a sphere plate on a belt that is known: each stripe's cut through the balls.

With the belt known, a plane of light through its line on the belt may only lean, and those of one projector
lean together: places for it are tried, the plate is looked for with each, all is adjusted from the best one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roemetry.arrays import Flags, Floats
from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet, Observation, Peaks, SpherePlate
from roemetry_pinhole.adjustment import Adjusted
from roemetry_pinhole.ball_plate import Plate, centres, find_plate
from roemetry_pinhole.equations import ON_BELT, Feet, StripePoints
from roemetry_pinhole.frames import belt_pose, parameters_of
from roemetry_pinhole.from_solids import OnSolids
from roemetry_pinhole.geometry import Geometry, turned, unknowns_of
from roemetry_pinhole.measured import Measured
from roemetry_pinhole.solid_shapes import Shape
from roemetry_pinhole.solid_start import belt_lines, numbered

_HEIGHTS = (0.6, 0.8, 1.0, 1.3)
"""Of the projector over the belt, in distances of the camera."""
_ANGLES_DEG = np.arange(10.0, 61.0, 2.5)
_TRIED = 8
_TRIED_VIEWS = 2
_PEAKS_MAX = 1500
_ROUNDS = 5
_STRIPE_POINTS_MIN = 12
_BELT_POINTS_MAX = 3000
_LIES_STD_MM = 0.01


def from_plate(
    observed: CalibrationSet, plate: SpherePlate, boards: Measured, free_camera: Flags, belt: Floats | None
) -> OnSolids:
    """Find the planes of light.

    Parameters
    ----------
    observed
        Images of the sphere plate and of the empty belt.
    plate
        As described.
    boards, free_camera, belt
        As of `from_solids`; the belt must be known.

    Raises
    ------
    CalibrationError
        The belt is not known or its empty image is missing; the plate is not seen; a stripe lies on no ball.
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
    for number in range(_ROUNDS):
        plates = [_seen(geometry, view, plate) for view in views]
        _check_stripes(plates, stripes)
        measured = _measured(boards, free_camera, geometry, on_belt, plates, plate, first)
        geometry = measured.nearly() if number + 1 < _ROUNDS else geometry
    adjusted = measured.adjusted()
    return OnSolids(
        measured,
        adjusted,
        (_shape(plate),),
        tuple(_if_longer(measured, adjusted, plates, plate)),
        0.0,
    )


def _start(boards: Geometry, lines: Floats, views: tuple[Observation, ...], plate: SpherePlate) -> Geometry:
    """Try places of the projector; give the geometry by which most peaks lie on balls."""
    pose = belt_pose(boards.belt)
    away = float(pose[2, 3])
    line = np.column_stack([np.ones(len(lines)), -lines[:, 1], -lines[:, 0]])
    peaks = [_thinned(view.peaks) for view in views[:: max(1, len(views) // _TRIED_VIEWS)]]
    tried: list[tuple[int, int, Geometry]] = []
    for share in _HEIGHTS:
        for angle in np.radians([*-_ANGLES_DEG, *_ANGLES_DEG]):
            high = share * away
            at = pose[:3, :3].T @ (np.array([high * np.tan(angle), 0.0, high]) - pose[:3, 3])
            planes = boards.belt + line * ((1.0 - boards.belt @ at) / (line @ at))[:, None]
            geometry = replace(boards, planes=planes)
            parameters = parameters_of(geometry, travel=False)
            found = [find_plate(parameters, one, plate) for one in peaks]
            on_balls = sum(one.ball.size for one in found if one is not None)
            tried.append((-on_balls, len(tried), geometry))
    fits: list[tuple[float, int, Geometry]] = []
    for _, number, geometry in sorted(tried)[:_TRIED]:
        found = [find_plate(parameters_of(geometry, travel=False), view.peaks, plate) for view in views]
        points = sum(one.ball.size for one in found if one is not None)
        off_mm = max((one.rms_mm for one in found if one is not None), default=np.inf)
        fits.append((off_mm / max(points, 1), number, geometry))
    best = min(fits)
    if not np.isfinite(best[0]):
        raise CalibrationError(
            f"{views[0].frame.name}: the sphere plate is not seen",
            hint="lay it under the stripes, its columns across them; are its lengths right?",
        )
    return best[2]


def _thinned(peaks: Peaks) -> Peaks:
    """Some of an image's rows, for trying."""
    every = max(1, len(peaks) // _PEAKS_MAX)
    keep = peaks.row % every == 0
    columns = ("row", "x_px", "x_std_px", "amplitude", "background", "width_px", "flags")
    return Peaks(image_size=peaks.image_size, **{name: getattr(peaks, name)[keep] for name in columns})


def _seen(geometry: Geometry, view: Observation, plate: SpherePlate) -> Plate:
    found = find_plate(parameters_of(geometry, travel=False), view.peaks, plate)
    if found is None:
        raise CalibrationError(
            f"{view.frame.name}: the sphere plate is not seen",
            hint="lay it under the stripes, its columns across them; are its lengths right?",
        )
    return found


def _check_stripes(plates: list[Plate], stripes: int) -> None:
    many = np.bincount(np.concatenate([one.stripe for one in plates]), minlength=stripes)
    missing = np.flatnonzero(many < _STRIPE_POINTS_MIN)
    if missing.size:
        names = ", ".join(str(stripe + 1) for stripe in missing)
        raise CalibrationError(
            f"stripe {names} lies on no ball: that determines no plane",
            hint="add images of the sphere plate with the plate moved across the stripes",
        )


def _measured(
    boards: Measured,
    free_camera: Flags,
    geometry: Geometry,
    on_belt: Floats,
    plates: list[Plate],
    plate: SpherePlate,
    first: int,
) -> Measured:
    pose = belt_pose(geometry.belt)
    turns = np.stack([pose[:3, :3].T @ _yaw(one) for one in plates])
    places = np.stack([pose[:3, :3].T @ ([*one.pose[:2], 0.0] - pose[:3, 3]) for one in plates])
    start = replace(
        geometry,
        rotation=np.concatenate([geometry.rotation[:first], turns]),
        shift=np.concatenate([geometry.shift[:first], places]),
    )
    side = 0.5 * plate.pitch_mm * max(plate.columns, plate.rows)
    under = side * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    mine = first + np.repeat(np.arange(len(plates)), 3)
    feet = Feet(
        np.concatenate([boards.feet.pose, mine]),
        np.concatenate([boards.feet.board_mm, *([under] * len(plates))]),
        np.concatenate([boards.feet.counts, np.zeros(mine.size)]),
    )
    of_boards = np.broadcast_to(boards.foot_std_mm, boards.feet.pose.shape)
    return Measured(
        start,
        unknowns_of(
            start,
            free_camera=free_camera,
            planes=True,
            belt=True,
            travel=False,
            bend=start.bend is not None,
        ),
        boards.corners,
        _points(on_belt, plates, plate, first),
        feet,
        np.concatenate([of_boards, np.full(mine.size, _LIES_STD_MM)]),
    )


def _points(on_belt: Floats, plates: list[Plate], plate: SpherePlate, first: int) -> StripePoints:
    """Peaks on the belt and on balls; a ball's surface at a peak is the plane that touches it there."""
    tables = [np.column_stack([np.full(len(on_belt), ON_BELT), on_belt])]
    faces = [np.tile([0.0, 0.0, 1.0, 0.0], (len(on_belt), 1))]
    for number, one in enumerate(plates):
        same = np.ones(one.ball.size)
        std = np.median(on_belt[:, 3]) * same
        tables.append(np.column_stack([(first + number) * same, one.stripe, one.x_px, one.row_px, std]))
        faces.append(np.column_stack([_out(one, plate), _distances(one, plate, plate)]))
    pose, stripe, x_px, row_px, std_px = np.ascontiguousarray(np.concatenate(tables).T)
    return StripePoints(
        pose.astype(np.int64),
        stripe.astype(np.int64),
        x_px,
        row_px,
        std_px,
        np.zeros(pose.size),
        np.concatenate(faces),
    )


def _if_longer(
    measured: Measured, adjusted: Adjusted, plates: list[Plate], plate: SpherePlate
) -> list[Geometry]:
    """Adjust again for each length, longer by its standard uncertainty; the touching planes stay parallel."""
    found = []
    for name in ("pitch_mm", "diameter_mm", "centre_height_mm"):
        longer = replace(plate, **{name: getattr(plate, name) + plate.tolerance_mm / np.sqrt(3.0)})
        if measured.points.face is None:
            raise AssertionError("peaks lie on faces")
        face = measured.points.face.copy()
        face[-sum(one.ball.size for one in plates) :, 3] = np.concatenate(
            [_distances(one, plate, longer) for one in plates]
        )
        found.append(replace(measured, points=replace(measured.points, face=face)).stepped(adjusted))
    return found


def _out(one: Plate, plate: SpherePlate) -> Floats:
    """(point, 3) directions away from the balls' centres, in the plate's frame."""
    way = one.at_mm - centres(plate, one.pose)[one.ball]
    return np.asarray((way / np.sqrt((way**2).sum(axis=1))[:, None]) @ _yaw(one))


def _distances(one: Plate, plate: SpherePlate, longer: SpherePlate) -> Floats:
    """(point,) distance of each touching plane from the plate's origin, of a plate with other lengths, mm."""
    own = centres(longer, np.array([0.0, 0.0, 0.0, 1.0]))[one.ball]
    return np.asarray((_out(one, plate) * own).sum(axis=1) + 0.5 * longer.diameter_mm)


def _yaw(one: Plate) -> Floats:
    """(3, 3) to the belt frame from the plate's."""
    return np.asarray(turned(np.array([[0.0, 0.0, one.pose[2]]]))[0])


def _shape(plate: SpherePlate) -> Shape:
    """For its name and height."""
    top = plate.centre_height_mm + 0.5 * plate.diameter_mm
    along = plate.rows * plate.pitch_mm
    return Shape("sphere-plate", plate.name, (), 0, top, along, top, False, (0.0,))
