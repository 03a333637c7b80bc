"""What a camera of known geometry sees of stripes on a solid: exact peaks, for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roemetry.calibrating.sphere_plate import centres
from roemetry.records import CalibrationSet, Frame, Observation, Peaks, SpherePlate
from roemetry.records.view import View
from roemetry_pinhole.geometry import ON_BELT, Geometry, StripePoints, stripe_residuals, turned
from roemetry_pinhole.pinhole_plane import belt_pose, lines_at_height, parameters_of
from roemetry_pinhole.solids import Shape, inside
from roemetry_pinhole.verdict import lifted


def on_belt(geometry: Geometry, x_mm: float, y_mm: float, yaw_deg: float) -> Geometry:
    """Lay a solid on the belt: the geometry with that one pose."""
    pose = belt_pose(geometry.belt)
    turn = pose[:3, :3].T @ turned(np.radians([[0.0, 0.0, yaw_deg]]))[0]
    at = pose[:3, :3].T @ (np.array([x_mm, y_mm, 0.0]) - pose[:3, 3])
    return replace(geometry, rotation=turn[None], shift=at[None])


def crossings(geometry: Geometry, shape: Shape | None, size: tuple[int, int]) -> np.ndarray:
    """Give (stripe, row) x of the stripes on belt and solid, px; nearest to the camera where several are."""
    count, rows = geometry.stripe_count, size[0]
    stripe, row = (index.ravel() for index in np.indices((count, rows)))
    best, depth = np.full(stripe.size, np.nan), np.full(stripe.size, np.inf)
    faces = [None, *(shape.faces if shape else ())]
    for face in faces:
        plane = np.array([0.0, 0.0, 1.0, 0.0]) if face is None else face.plane
        pose = np.full(stripe.size, ON_BELT if face is None else 0)
        middle, ones = np.full(stripe.size, 0.5 * size[1]), np.ones(stripe.size)
        planes = np.tile(plane, (stripe.size, 1))
        points = StripePoints(pose, stripe, middle, row.astype(float), ones, 0.0 * ones, planes)
        for _ in range(12):
            points = replace(points, x_px=points.x_px - stripe_residuals(geometry, points))
        at = lifted(geometry, points)
        seen = np.abs(stripe_residuals(geometry, points)) < 1e-6
        if face is not None:
            there = (at - geometry.shift[0]) @ geometry.rotation[0]
            seen &= inside(face, there[:, :2]) >= 0.0
        nearer = seen & (at[:, 2] < depth)
        best[nearer], depth[nearer] = points.x_px[nearer], at[nearer, 2]
    best[(best < 1.0) | (best > size[1] - 2.0)] = np.nan
    return best.reshape(count, rows)


def seen_as(
    shows: str, x_px: np.ndarray, size: tuple[int, int], rng: np.random.Generator, noise_px: float
) -> Observation:
    """Make an observation of stripes with noise on each peak."""
    order = np.argsort(x_px, axis=0)
    x = np.take_along_axis(x_px, order, axis=0).T
    row, column = np.nonzero(np.isfinite(x))
    at = x[row, column] + rng.normal(0.0, noise_px, row.size)
    again = np.lexsort((at, row))
    full, none = np.ones(row.size), np.zeros(row.size, np.uint8)
    row, at = row[again], at[again]
    peaks = Peaks(size, row, at, noise_px * full, 100.0 * full, 0.0 * full, 4.0 * full, none)
    return Observation(shows, Frame(np.zeros(size, np.uint8), name=shows), peaks)


def set_of(observations, stripes: int, **targets) -> CalibrationSet:
    """Make a calibration set without boards."""
    return CalibrationSet(
        tuple(observations), stripes, targets.pop("block", None), None, {"use": "exact"}, **targets
    )


def over_balls(view: View, plate: SpherePlate, pose: np.ndarray, x_px: np.ndarray) -> np.ndarray:
    """Put balls into (stripe, row) crossings of the empty belt; `pose` is x, y, turn (rad) and size.

    A plane of light cuts a ball in a circle; the part of it that faces both camera and light is seen.
    """
    seen = x_px.copy()
    turn = np.linspace(-np.pi, np.pi, 4001)
    for centre in centres(plate, pose):
        radius = 0.5 * pose[3] * plate.diameter_mm
        for stripe, (*normal, distance) in enumerate(view.planes):
            normal = np.array(normal)
            away = distance - normal @ centre
            if abs(away) >= 0.97 * radius:
                continue
            along = np.cross(normal, [0.0, 1.0, 0.0])
            along /= np.linalg.norm(along)
            other = np.cross(normal, along)
            circle = np.sqrt(radius**2 - away**2)
            at = centre + away * normal
            at = at + circle * (np.cos(turn)[:, None] * along + np.sin(turn)[:, None] * other)
            out = (at - centre) / radius
            to_camera, to_light = view.camera_mm - at, view.projector_mm - at
            facing = ((out * to_camera).sum(axis=1) > 0.15 * np.linalg.norm(to_camera, axis=1)) & (
                (out * to_light).sum(axis=1) > 0.15 * np.linalg.norm(to_light, axis=1)
            )
            at = at[facing]
            if len(at) < 20:
                continue
            xy = view.project(at)
            xy = xy[np.argsort(xy[:, 1])]
            rows = np.arange(max(0, int(np.ceil(xy[0, 1]))), min(x_px.shape[1] - 1, int(xy[-1, 1])) + 1)
            seen[stripe, rows] = np.interp(rows, xy[:, 1], xy[:, 0])
    seen[(seen < 1.0) | (seen > view.image_size[1] - 2.0)] = np.nan
    return seen


def height_errors(true: Geometry, views: list[View], levels, size: tuple[int, int]):
    """Heights, mm, of exact stripes on levels by the first view less the true ones; the others' scatter."""
    rows = np.linspace(0.1, 0.9, 5) * (size[0] - 1)
    off, std = [], []
    for level in levels:
        x_px = lines_at_height(parameters_of(true, travel=False), rows, level)
        stripe, row = np.nonzero((x_px > 0) & (x_px < size[1] - 1))
        at = np.column_stack([x_px[stripe, row], rows[row]])
        z = np.array([view.lift(at, stripe)[:, 2] for view in views])
        off.append(z[0] - level)
        std.append(z[1:].std(axis=0))
    return np.concatenate(off), np.concatenate(std)


def assert_derivatives(
    rows, geometry: Geometry, unknowns, what, sizes: dict[int, float], within: float
) -> None:
    """Hold the derivatives that `rows` gives to its own differences, by the unknowns of `sizes`."""
    found = rows(geometry, unknowns, what)
    given = np.zeros((found.residual.size, unknowns.count))
    row, place = np.nonzero(found.columns >= 0)
    np.add.at(given, (row, found.columns[row, place]), found.values[row, place])
    for number, size in sizes.items():
        step = size * (np.arange(unknowns.count) == number)
        up, down = (rows(unknowns.moved(geometry, s * step), unknowns, what).residual for s in (1.0, -1.0))
        slope = (up - down) / (2.0 * size)
        off = np.abs(slope - given[:, number]).max()
        assert off <= within * max(np.abs(slope).max(), 1e-3), (rows.__name__, number)


def step_sizes(unknowns) -> dict[int, float]:
    """Steps for all unknowns: in pixels, the lens's and the planes' coefficients, millimetres and radians."""
    sizes = dict.fromkeys(range(unknowns.count), 1e-5)
    sizes |= dict.fromkeys(unknowns.camera[:4], 1e-2)
    return sizes | dict.fromkeys([*unknowns.planes.ravel(), *unknowns.belt], 1e-8)
