"""What boards and belt show of a rig whose geometry is known: points, without images."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_pinhole.bundle import chosen
from roemetry_pinhole.geometry import (
    ON_BELT,
    BeltContacts,
    Corners,
    Geometry,
    StripePoints,
    corner_residuals,
    distort,
    stripe_residuals,
    turned,
)

_COLUMNS, _ROWS = 10, 7
_WAY = 400


@dataclass(frozen=True, slots=True)
class SimulatedRig:
    """A rig in few words."""

    focal_px: float
    distance_mm: float
    """focal_px, distance_mm: focal length, and camera to belt along the optical axis."""
    tilt_deg: tuple[float, float] = (2.0, -3.0)
    """Turn of the camera about its x and y axes."""
    lens: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3."""
    image_size: tuple[int, int] = (1024, 1280)
    """Rows and columns."""
    stripes: int = 11
    poses: int = 12
    """stripes, poses: planes of light, and poses of the board; the first lies on the belt."""
    angle_deg: float = 30.0
    """Of the laser to the vertical, at the belt's middle."""
    rows: int = 20
    """Image rows in which each stripe is seen on each board."""


@dataclass(frozen=True, eq=False, slots=True)
class Shown:
    """The true geometry, and what it shows without noise."""

    geometry: Geometry
    corners: Corners
    points: StripePoints
    contacts: BeltContacts


def shown(rig: SimulatedRig, rng: np.random.Generator) -> Shown:
    """Draw poses, and give what is seen of them.

    With one stripe the empty belt tells nothing of its tilt: then the first board's contacts do.
    """
    turn = turned(np.radians([[rig.tilt_deg[0], 0.0, 0.0], [0.0, rig.tilt_deg[1], 0.0]]))
    rotation = turn[0] @ turn[1] @ np.diag([1.0, -1.0, -1.0])
    shift = np.array([0.0, 0.0, rig.distance_mm])
    width_mm = rig.image_size[1] / rig.focal_px * rig.distance_mm
    planes = _planes(rig, width_mm)
    normal = planes[:, :3] @ rotation.T
    up = rotation[:, 2]
    middle = 0.5 * (np.array(rig.image_size[::-1]) - 1.0) + [7.0, -5.0]
    geometry = Geometry(
        camera=np.array([rig.focal_px, 1.001 * rig.focal_px, *middle, *rig.lens, 0.0, 0.0, 0.0]),
        rotation=np.empty((0, 3, 3)),
        shift=np.empty((0, 3)),
        planes=normal / (planes[:, 3] + normal @ shift)[:, None],
        belt=up / (up @ shift),
        travel=np.zeros(3),
    )
    pitch_mm = 0.9 * width_mm / (_COLUMNS + 2)
    turns, places = _poses(rig, rng, width_mm, pitch_mm)
    geometry = replace(geometry, rotation=rotation @ turns, shift=places @ rotation.T + shift)
    corners = _corners(geometry, rig.image_size, pitch_mm)
    points = _points(geometry, rig, pitch_mm)
    none = np.empty(0)
    contacts = BeltContacts(none.astype(np.int64), np.empty((0, 3)), none)
    if rig.stripes == 1:
        points = chosen(points, points.pose != ON_BELT)
        at = pitch_mm * np.array([[0.0, 0.0, 0.0], [_COLUMNS - 1.0, 0.0, 0.0], [4.5, _ROWS - 1.0, 0.0]])
        contacts = BeltContacts(np.zeros(3, np.int64), at, np.zeros(3))
    return Shown(geometry, corners, points, contacts)


def noisy(
    exact: Shown, rng: np.random.Generator, mark_px: float, stripe_px: float, contact_mm: float
) -> Shown:
    """Add normal noise: to marks in x and y, to stripe peaks along the row, to the heights of contacts."""
    contacts = exact.contacts.board_mm.copy()
    contacts[:, 2] += rng.normal(0.0, contact_mm, len(contacts))
    xy = exact.corners.xy_px + rng.normal(0.0, mark_px, exact.corners.xy_px.shape)
    x = exact.points.x_px + rng.normal(0.0, stripe_px, exact.points.x_px.size)
    return replace(
        exact,
        corners=replace(exact.corners, xy_px=xy),
        points=replace(exact.points, x_px=x),
        contacts=replace(exact.contacts, board_mm=contacts),
    )


def _planes(rig: SimulatedRig, width_mm: float) -> Floats:
    """(stripe, 4) n, d in the belt frame, of a fan from one projector."""
    high = 0.9 * rig.distance_mm
    projector = np.array([high * np.tan(np.radians(rig.angle_deg)), 3.0, high])
    at = np.linspace(-0.35, 0.35, rig.stripes) * width_mm if rig.stripes > 1 else np.zeros(1)
    axis = np.array([-0.01, 1.0, 0.005])
    normal = np.cross(np.column_stack([at, 0.0 * at, 0.0 * at]) - projector, axis / np.linalg.norm(axis))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return np.column_stack([normal, normal @ projector])


def _poses(
    rig: SimulatedRig, rng: np.random.Generator, width_mm: float, pitch_mm: float
) -> tuple[Floats, Floats]:
    """(pose, 3, 3) and (pose, 3) to the belt frame from the board's."""
    half = 0.5 * pitch_mm * np.array([_COLUMNS - 1.0, _ROWS - 1.0, 0.0])
    turns, places = np.empty((rig.poses, 3, 3)), np.empty((rig.poses, 3))
    for number in range(rig.poses):
        tilt = 0.0 if number == 0 else np.radians(rng.uniform(15.0, 32.0))
        way = 2.0 * np.pi * (number + rng.uniform(-0.3, 0.3)) / max(rig.poses - 1, 1)
        yaw = np.radians(rng.uniform(-10.0, 10.0))
        both = turned(np.array([[tilt * np.cos(way), tilt * np.sin(way), 0.0], [0.0, 0.0, yaw]]))
        turns[number] = both[0] @ both[1] @ np.diag([1.0, -1.0, -1.0])
        aside = rng.uniform(-0.12, 0.12, 2) * width_mm * [1.0, rig.image_size[0] / rig.image_size[1]]
        up = 0.0 if number == 0 else rng.uniform(0.1, 1.0) * 0.12 * rig.distance_mm
        places[number] = np.array([*aside, up]) - turns[number] @ half
    return turns, places


def _corners(geometry: Geometry, image_size: tuple[int, int], pitch_mm: float) -> Corners:
    x, y = np.meshgrid(np.arange(_COLUMNS) * pitch_mm, np.arange(_ROWS) * pitch_mm)
    board = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    poses = len(geometry.shift)
    pose = np.repeat(np.arange(poses), len(board))
    zero = np.zeros(pose.size)
    origin = Corners(pose, np.tile(board, (poses, 1)), np.zeros((pose.size, 2)), zero, 0 * pose)
    xy = corner_residuals(geometry, origin).reshape(-1, 2)
    inside = ((xy > 2.0) & (xy < np.array(image_size[::-1]) - 3.0)).all(axis=1)
    return Corners(pose[inside], origin.board_mm[inside], xy[inside], zero[inside], 0 * pose[inside])


def _points(geometry: Geometry, rig: SimulatedRig, pitch_mm: float) -> StripePoints:
    found: list[Floats] = []
    rows, columns = rig.image_size
    for place in (*range(rig.poses), ON_BELT):
        for number, plane in enumerate(geometry.planes):
            at = _on_board(geometry, place, plane, pitch_mm) if place >= 0 else _on_belt(geometry, plane)
            xy = distort(at[:, :2] / at[:, 2:], geometry.camera[4:]).xy
            xy = xy * geometry.camera[:2] + geometry.camera[2:4]
            xy = xy[np.argsort(xy[:, 1])]
            if len(xy) < 5 or (np.diff(xy[:, 1]) <= 0.0).any():
                continue
            seen = np.arange(max(np.ceil(xy[0, 1]), 0.0), min(xy[-1, 1], rows - 1.0))
            if seen.size < 8:
                continue
            seen = seen[np.unique(np.linspace(0, seen.size - 1, rig.rows).astype(int))]
            x = np.interp(seen, xy[:, 1], xy[:, 0])
            good = (x > 1.0) & (x < columns - 2.0)
            label = np.ones(int(good.sum()))
            found.append(np.column_stack([place * label, number * label, x[good], seen[good]]))
    table = np.concatenate(found)
    pose, stripe = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
    one, zero = np.ones(len(table)), np.zeros(len(table))
    points = StripePoints(pose, stripe, table[:, 2], table[:, 3], one, zero)
    for _ in range(4):
        points = replace(points, x_px=points.x_px - stripe_residuals(geometry, points))
    return points


def _on_board(geometry: Geometry, pose: int, plane: Floats, pitch_mm: float) -> Floats:
    """Places of one stripe on one board, camera frame, mm."""
    y = np.linspace(-0.5, _ROWS - 0.5, _WAY) * pitch_mm
    by_x, by_y, _ = plane @ geometry.rotation[pose]
    x = (1.0 - plane @ geometry.shift[pose] - by_y * y) / by_x
    on = (x > -0.5 * pitch_mm) & (x < (_COLUMNS - 0.5) * pitch_mm)
    board = np.column_stack([x, y, np.zeros(_WAY)])[on]
    return np.asarray(board @ geometry.rotation[pose].T + geometry.shift[pose])


def _on_belt(geometry: Geometry, plane: Floats) -> Floats:
    """Places of one stripe on the belt, camera frame, mm."""
    along = np.cross(plane, geometry.belt)
    along /= np.linalg.norm(along)
    near = np.linalg.lstsq(np.stack([plane, geometry.belt, along]), np.array([1.0, 1.0, 0.0]), rcond=None)[0]
    away = 1.0 / float(np.linalg.norm(geometry.belt))
    return np.asarray(near + np.linspace(-1.0, 1.0, 2 * _WAY)[:, None] * away * along)
