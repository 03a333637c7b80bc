"""The linear rig of the conformance checks, as a pinhole camera sees it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from roemetry.records import Board, CalibrationSet, Frame, Observation, Peaks
from roemetry.records.arrays import Flags, Floats
from roemetry.records.calibration import Calibration
from roemetry_pinhole.geometry import turned
from roemetry_pinhole.pinhole_plane import METHOD, derived, flat

if TYPE_CHECKING:
    from roemetry.testing import LinearRig
    from roemetry.testing.patterns import CircleRig, DotRig
    from roemetry.testing.scenes import GridRig


_FAR_MM = 1e7  # a camera ten kilometres up sees in parallel
_NEAR_MM = 300.0  # and one at a usual distance
_BOARD = Board("board", "chessboard", columns=9, rows=6, pitch_mm=5.5, tolerance_mm=0.01, flatness_mm=0.01)
_POSES = 8  # of the board, besides the one on the belt
_SAMPLES = 4  # of a pixel in either direction, so that printed edges are grey
_SCATTER_PX = 0.03  # of peaks in calibration images


def calibration_of(rig: LinearRig) -> Calibration:
    """Give the rig's calibration: a pinhole camera so far away that perspective does not show."""
    planes = rig.planes()
    normal, distance = planes[:, :3] * [1.0, -1.0, -1.0], planes[:, 3] - planes[:, 2] * _FAR_MM
    return _calibration(rig, _FAR_MM, normal / distance[:, None])


@lru_cache(maxsize=4)
def observed_of(rig: LinearRig) -> CalibrationSet:
    """Give images of a chessboard in many poses, 300 mm from the camera, with peaks that scatter a little.

    On the belt the stripes are the rig's; each plane leans so that at belt level its stripe moves as the
    rig's does.
    """
    planes = _near_planes(rig)
    observations = [_belt(rig, rig.peaks(rig.rest_px()).peaks)]
    for number in range(_POSES):
        rotation, shift = _pose(number)
        lit = _peaks(rig, _crossings(rig, planes, rotation, shift))
        observations += _pair(rig, number, rotation, shift, _peaks(rig, np.empty((0, 2))), lit)
    return _set(rig, observations)


def _belt(rig: LinearRig | DotRig, peaks: Peaks) -> Observation:
    return Observation("belt", Frame(np.zeros((rig.rows, rig.columns), np.uint8), name="belt"), peaks)


def _pair(
    rig: LinearRig | DotRig, number: int, rotation: Floats, shift: Floats, none: Peaks, lit: Peaks | None
) -> list[Observation]:
    """Give a pose's images, with the laser off and on; None: off alone, of a board that lies on the belt."""
    image, name = _image(rig, rotation, shift), f"pose {number}"
    plain = Frame(image, role="plain", name=f"{name} plain")
    if lit is None:
        return [Observation("board_on_belt", plain, none, name)]
    glow = image.copy()  # any light that an image with the laser off has not
    glow[::5] = 255
    laser = Frame(glow, name=f"{name} laser")
    return [Observation("board", plain, none, name), Observation("board", laser, lit, name)]


def _set(rig: LinearRig | DotRig, observations: list[Observation]) -> CalibrationSet:
    return CalibrationSet(tuple(observations), rig.stripes, None, _NEAR_MM, {"use": "exact"}, board=_BOARD)


def _near_planes(rig: LinearRig) -> Floats:
    """(stripe, 3) p·X = 1 in the frame of a camera 300 mm above the belt."""
    rest = rig.rest_px()
    on_belt = (rest[:, [0, -1]] - rig.middle_column) * rig.mm_per_px
    x_mm, y_mm = on_belt.mean(axis=1), rig.middle_row * rig.mm_per_px
    slope = (on_belt[:, 0] - on_belt[:, 1]) / (2.0 * y_mm)
    lean = rig.px_per_mm * rig.mm_per_px - x_mm / _NEAR_MM
    # X − slope Y − lean Z = x_mm in the belt frame; the camera's is (X, −Y, 300 − Z)
    return np.asarray(np.column_stack([np.ones_like(lean), slope, lean]) / (x_mm + lean * _NEAR_MM)[:, None])


def grid_of(rig: GridRig) -> Calibration:
    """Give the calibration of a rig with a grid, by the camera so far away."""
    from roemetry_pinhole.grid import ACROSS, TURN
    from roemetry_pinhole.grid import METHOD as GRID

    upright, across = calibration_of(rig), calibration_of(rig.across)
    parameters = {**upright.parameters, ACROSS: across.parameters["planes_per_mm"] @ TURN}
    count = flat(parameters).size
    return replace(
        upright, method=GRID, parameters=parameters, covariance=np.zeros((count, count)), across=across
    )


@lru_cache(maxsize=4)
def grid_observed_of(rig: GridRig) -> CalibrationSet:
    """Give the chessboard in many poses under a grid whose lines scatter a little, and the belt."""
    from roemetry_pinhole.grid import TURN

    planes, observed = _near_planes(rig.across), observed_of(rig)
    observations = []
    for one in observed.observations:
        across = rig.across.peaks(rig.across.rest_px()).peaks
        if one.shows == "board":
            rotation, shift = _pose(int(one.pose.removeprefix("pose ")))
            lit = _crossings(rig.across, planes, TURN @ rotation, TURN @ shift)
            across = _peaks(rig.across, lit if one.frame.role == "laser" else np.empty((0, 2)))
        observations.append(replace(one, peaks=replace(one.peaks, across=across)))
    return replace(observed, observations=tuple(observations))


@lru_cache(maxsize=4)
def two_families_observed_of(rig: LinearRig) -> CalibrationSet:
    """Give what `observed_of` does, of lines whose colours take turns."""
    observed, planes = observed_of(rig), _near_planes(rig)
    observations = []
    for one in observed.observations:
        pose = None if one.shows == "belt" else _pose(int(one.pose.removeprefix("pose ")))
        x, row = one.peaks.x_px, one.peaks.row
        rest = rig.rest_px()[:, row]
        if pose is not None and len(one.peaks):
            ray = _rays(rig, x, row.astype(np.float64))
            depth = (pose[0][:, 2] @ pose[1]) / (ray @ pose[0][:, 2])
            rest = np.abs((ray * depth[:, None]) @ planes.T - 1.0).T + x
        family = np.abs(rest - x).argmin(axis=0) % 2
        observations.append(replace(one, peaks=replace(one.peaks, family=family.astype(np.int64))))
    return replace(observed, observations=tuple(observations))


def _calibration(rig: LinearRig, away_mm: float, planes: Floats) -> Calibration:
    size = (rig.rows, rig.columns)
    parameters = {
        "focal_px": np.full(2, away_mm / rig.mm_per_px),
        "principal_px": np.array([rig.middle_column, rig.middle_row]),
        "distortion": np.zeros(8),
        "planes_per_mm": planes,
        "belt_per_mm": np.array([0.0, 0.0, 1.0 / away_mm]),
    }
    count = flat(parameters).size
    return Calibration(
        method=METHOD,
        image_size=size,
        turn_deg=0,
        height_range_mm=(0.0, 60.0 / abs(rig.px_per_mm)),
        covariance=np.zeros((count, count)),
        extractor={"use": "exact"},
        **derived(parameters, size),
    )


def _pose(number: int) -> tuple[Floats, Floats]:
    """Rotation and shift to the camera's frame from the board's: the first lies level."""
    tilt = np.radians(0.0 if number == 0 else 24.0 + 4.0 * (number % 3))
    way = 2.0 * np.pi * number / 5.0
    rotation = turned(tilt * np.array([[np.cos(way), np.sin(way), 0.0]]))[0]
    aside = 14.0 * np.array([(number % 3) - 1.0, 0.4 * ((number % 2) - 0.5)])
    middle = np.array([*aside, _NEAR_MM - 6.0 - 1.5 * (number % 7)])
    half = 0.5 * _BOARD.pitch_mm * np.array([_BOARD.columns, _BOARD.rows, 0.0])
    return rotation, middle - rotation @ half


def _rays(rig: LinearRig, x_px: Floats, row_px: Floats) -> Floats:
    scale = rig.mm_per_px / _NEAR_MM
    x, y = (x_px - rig.middle_column) * scale, (row_px - rig.middle_row) * scale
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def _places(rays: Floats, rotation: Floats, shift: Floats) -> Floats:
    """Where rays meet the board, (…, 2) in pitches."""
    normal = rotation[:, 2]
    at = rays * ((normal @ shift) / (rays @ normal))[..., None]
    return np.asarray((at - shift) @ rotation[:, :2] / _BOARD.pitch_mm)


def _image(rig: LinearRig, rotation: Floats, shift: Floats) -> np.ndarray:
    offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    row = (np.arange(rig.rows)[:, None] + offsets).ravel()
    column = (np.arange(rig.columns)[:, None] + offsets).ravel()
    place = _places(_rays(rig, *np.meshgrid(column, row)), rotation, shift)
    x, y = place[..., 0], place[..., 1]
    printed = (x >= 0) & (x < _BOARD.columns) & (y >= 0) & (y < _BOARD.rows)
    paper = (x > -0.6) & (x < _BOARD.columns + 0.6) & (y > -0.6) & (y < _BOARD.rows + 0.6)
    black = printed & ((np.floor(x) + np.floor(y)) % 2 == 0)
    light = np.where(black, 30.0, np.where(paper, 200.0, 90.0))
    light = light.reshape(rig.rows, _SAMPLES, rig.columns, _SAMPLES).mean(axis=(1, 3))
    return np.asarray(np.rint(light).astype(np.uint8))


def _crossings(rig: LinearRig, planes: Floats, rotation: Floats, shift: Floats) -> Floats:
    """Give (peak, 2) row and x of the stripes on the board, sorted."""
    normal = rotation[:, 2]
    row = np.arange(0.3 * rig.rows, 0.7 * rig.rows).round()  # enough, and sooner done
    found = []
    for plane in planes:
        line = (normal @ shift) * plane - normal
        y = (row - rig.middle_row) * rig.mm_per_px / _NEAR_MM
        x = rig.middle_column - (line[1] * y + line[2]) / line[0] * _NEAR_MM / rig.mm_per_px
        place = _places(_rays(rig, x, row), rotation, shift)
        on = _on_squares(place) & (x >= 0) & (x <= rig.columns - 1)
        found.append(np.column_stack([row[on], x[on]]))
    stacked = np.concatenate(found)
    stacked[:, 1] += np.random.default_rng(len(stacked)).normal(0.0, _SCATTER_PX, len(stacked))
    return np.asarray(stacked[np.lexsort((stacked[:, 1], stacked[:, 0]))])


def _peaks(rig: LinearRig, crossings: Floats) -> Peaks:
    count = len(crossings)
    return Peaks(
        image_size=(rig.rows, rig.columns),
        row=crossings[:, 0].astype(np.int64),
        x_px=crossings[:, 1],
        x_std_px=np.full(count, np.nan),
        amplitude=np.full(count, 160.0),
        background=np.full(count, rig.background),
        width_px=np.full(count, 2.355 * rig.sigma_px),
        flags=np.zeros(count, np.uint8),
    )


def dots_of(rig: DotRig) -> Calibration:
    """Give the calibration of a rig with dots: a pinhole camera that is so far away as that of lines."""
    from roemetry.testing.patterns import exact_rays
    from roemetry_pinhole.dot_rays import METHOD as DOTS
    from roemetry_pinhole.dot_rays import view_of as dots_view_of

    plain = _calibration(rig, _FAR_MM, np.ones((rig.stripes, 3)))
    parameters = {name: one for name, one in plain.parameters.items() if name != "planes_per_mm"}
    count = flat(parameters).size
    return replace(
        plain,
        method=DOTS,
        rest_px=rig.calibration().rest_px,
        displacement_px_per_mm=np.full(rig.stripes, 2.0),
        height_range_mm=(0.0, 25.0),
        parameters=parameters,
        covariance=np.zeros((count, count)),
        view=dots_view_of(parameters, rig.rays(), plain.image_size),
        rays=exact_rays(rig.rays(), flat(parameters)),
    )


@lru_cache(maxsize=4)
def dots_observed_of(rig: DotRig) -> CalibrationSet:
    """Give a chessboard in many poses under a matrix of dots that scatter a little, and the belt."""
    start, way = _in_camera(rig)
    level, none = np.array([0.0, 0.0, 1.0]) / _NEAR_MM, rig.dots(np.empty((0, 2)))
    observations = [_belt(rig, _met(rig, start, way, level, None))]
    for number in range(_POSES):
        rotation, shift = _pose(number)
        normal = rotation[:, 2]
        lit = _met(rig, start, way, normal / (normal @ shift), (rotation, shift))
        observations += _pair(rig, number, rotation, shift, none, lit)
    half = 0.5 * _BOARD.pitch_mm * np.array([_BOARD.columns, _BOARD.rows, 0.0])
    shift = np.array([0.0, 0.0, _NEAR_MM - _BOARD.thickness_mm]) - half
    return _set(rig, observations + _pair(rig, _POSES, np.eye(3), shift, none, None))


def _in_camera(rig: DotRig) -> tuple[Floats, Floats]:
    """Give a point and the way of each ray (n, 3) in the frame of a camera 300 mm above the belt's origin."""
    turned_over = np.diag([1.0, -1.0, -1.0])
    lines = rig.rays().reshape(-1, 4)
    start = np.column_stack([lines[:, :2], np.zeros(len(lines))]) @ turned_over + [0.0, 0.0, _NEAR_MM]
    return start, np.column_stack([lines[:, 2:], np.ones(len(lines))]) @ turned_over


def _met(rig: DotRig, start: Floats, way: Floats, plane: Floats, pose: tuple[Floats, Floats] | None) -> Peaks:
    """Give the dots on a plane (3,) p·X = 1, of a board those on its squares."""
    at = start + ((1.0 - start @ plane) / (way @ plane))[:, None] * way
    focal = _NEAR_MM / rig.mm_per_px
    places = at[:, :2] / at[:, 2:] * focal + [rig.middle_column, rig.middle_row]
    if pose is not None:
        places[~_on_squares((at - pose[1]) @ pose[0][:, :2] / _BOARD.pitch_mm)] = np.nan
    return rig.dots(places, _SCATTER_PX)


def _on_squares(place: Floats) -> Flags:
    """Say which places (n, 2), in pitches, lie on the board's squares."""
    return np.asarray(((place > 0.02) & (place < [_BOARD.columns - 0.02, _BOARD.rows - 0.02])).all(axis=1))


def circles_of(rig: CircleRig) -> Calibration:
    """Give the calibration of a rig with circles, a pinhole camera 300 mm over the belt."""
    from roemetry_pinhole import cones

    size, lit = (rig.rows, rig.columns), rig.cones()
    flip = np.array([1.0, -1.0, -1.0])
    axis = lit[0, 3:6] * flip
    parameters = {
        "focal_px": np.full(2, _NEAR_MM / rig.mm_per_px),
        "principal_px": np.array([rig.middle_column, rig.middle_row]),
        "distortion": np.zeros(8),
        "belt_per_mm": np.array([0.0, 0.0, 1.0 / _NEAR_MM]),
        cones.LIGHT: lit[0, :3] * flip + [0.0, 0.0, _NEAR_MM],
        cones.AXIS: axis[:2] / axis[2],
        cones.ANGLES: lit[rig.circles :, 6],
    }
    count = flat(parameters).size
    return Calibration(
        method=cones.METHOD,
        image_size=size,
        turn_deg=0,
        height_range_mm=(0.0, 25.0),
        covariance=np.zeros((count, count)),
        extractor={"use": "exact"},
        **cones.derived(parameters, size),
    )


@lru_cache(maxsize=4)
def circles_observed_of(rig: CircleRig) -> CalibrationSet:
    """Give a chessboard in many poses under circles that scatter a little, and the belt."""
    from roemetry.testing.patterns import level

    none = rig.circle_peaks(np.full((rig.stripes, rig.rows), np.nan))[0]
    observations = [_belt(rig, rig.circle_peaks(rig.x_on_rows(level), _SCATTER_PX)[0])]
    flip = np.array([1.0, -1.0, -1.0])
    for number in range(_POSES):
        rotation, shift = _pose(number)
        a, b, c = rotation[:, 2] * flip  # of the board's plane in the belt frame
        origin = (shift - [0.0, 0.0, _NEAR_MM]) * flip

        def tilted(xy: Floats, a: float = a, b: float = b, c: float = c, origin: Floats = origin) -> Floats:
            return np.asarray(origin[2] - (a * (xy[:, 0] - origin[0]) + b * (xy[:, 1] - origin[1])) / c)

        def on_it(at: Floats, rotation: Floats = rotation, shift: Floats = shift) -> Flags:
            in_camera = at * flip + [0.0, 0.0, _NEAR_MM]
            return _on_squares((in_camera - shift) @ rotation[:, :2] / _BOARD.pitch_mm)

        lit = rig.circle_peaks(rig.x_on_rows(tilted, on_it), _SCATTER_PX)[0]
        observations += _pair(rig, number, rotation, shift, none, lit)
    half = 0.5 * _BOARD.pitch_mm * np.array([_BOARD.columns, _BOARD.rows, 0.0])
    shift = np.array([0.0, 0.0, _NEAR_MM - _BOARD.thickness_mm]) - half
    return _set(rig, observations + _pair(rig, _POSES, np.eye(3), shift, none, None))
