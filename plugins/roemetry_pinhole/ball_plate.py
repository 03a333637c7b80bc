"""A sphere plate on the belt, measured with a calibration: where it lies, and how large it comes out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry.records import EDGE, WIDE, Peaks, SpherePlate
from roemetry_pinhole.frames import belt_pose, camera_of
from roemetry_pinhole.lens import straightened

_BELT_MM = 0.6
_CAP_RISE_MIN = 0.35
"""Points are used where the ball's surface rises by less than some 70°: further down it shades itself."""
_WAYS = 72
_ANCHORS = 8
_YAWS_DEG = np.arange(-45.0, 46.0, 1.0)
_ROUNDS = (0.20, 0.12, 0.08, 0.05, 0.05, 0.05)
"""Of each round, how far off a ball its points may be, in radii."""
_STEPS = 4
_STRAY_MADS = 4.5
_ALONG_SHARE = 0.2
_BALL_POINTS_MIN = 12
_POINTS_MIN = 60
_EXPLAINED_MIN = 0.15
"""Share of the peaks at the balls' heights that must lie on balls: in images with the plate's level and
shadows it is 0.28 to 0.38, without them above 0.7."""
_MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False, slots=True)
class Plate:
    """A sphere plate as measured.

    Attributes
    ----------
    pose
        (4,) x, y of its middle in the belt frame, mm; its turn about Z, rad; its lengths over the described.
    stripe, x_px, row_px, ball
        (point,) peaks on balls: stripe, place, and which ball.
    at_mm, per_px
        (point, 3) where they lie in the belt frame; (point,) how far a pixel moves them across the ball, mm.
    slopes
        (point, 4) derivatives of the points' residuals by the pose.
    residual
        (point,) distance from the ball's surface over `per_px`: px.
    rms_mm
        Rms distance of the points from their balls.
    """

    pose: Floats
    stripe: Integers
    x_px: Floats
    row_px: Floats
    ball: Integers
    at_mm: Floats
    per_px: Floats
    slopes: Floats
    residual: Floats
    rms_mm: float

    @property
    def balls(self) -> int:
        """Number of balls that are seen."""
        return int(np.unique(self.ball).size)

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
        spare = max(sums.size - 4, 1)
        return max(alone, float(np.sqrt((sums**2).sum() * sums.size / spare)))


def find_plate(parameters: Mapping[str, Floats], peaks: Peaks, plate: SpherePlate) -> Plate | None:
    """Find a sphere plate and fit its place and size; None where it is not seen.

    Every peak is taken for every stripe; those of the right stripe lie on balls.

    Parameters
    ----------
    parameters
        Of a calibration.
    peaks
        Of one image.
    plate
        What lies there; its columns run across the stripes, within 45°.
    """
    near = _on_heights(parameters, peaks, plate)
    if near.stripe.size < _POINTS_MIN:
        return None
    across = _across(parameters, near.stripe, near.x_px, near.row_px)
    start = _first(near.at_mm, plate)
    found = _fitted(near.at_mm, across, near.stripe, near.x_px, near.row_px, plate, start)
    # a peak is one, however many stripes it might belong to
    explained = 0.0 if found is None else found.ball.size / np.unique(near.peak).size
    return found if explained > _EXPLAINED_MIN else None


class _Near(NamedTuple):
    """Peaks taken for stripes by which they lie at the balls' heights: (point,) and (point, 3)."""

    peak: Integers
    stripe: Integers
    x_px: Floats
    row_px: Floats
    at_mm: Floats


def _on_heights(parameters: Mapping[str, Floats], peaks: Peaks, plate: SpherePlate) -> _Near:
    good = np.flatnonzero((peaks.flags & (EDGE | WIDE)) == 0)
    stripes = len(parameters["planes_per_mm"])
    stripe, peak = (index.ravel() for index in np.indices((stripes, good.size)))
    x_px, row_px = peaks.x_px[good][peak], peaks.row[good][peak].astype(np.float64)
    at = points_of(parameters, stripe, x_px, row_px)
    on_belt = np.asarray((np.abs(at[:, 2].reshape(stripes, -1)) < _BELT_MM).any(axis=0))
    radius = 0.5 * plate.diameter_mm
    high = np.abs(at[:, 2] - plate.centre_height_mm - 0.6 * radius) < 0.7 * radius
    use = np.flatnonzero(high & ~on_belt[peak])
    return _Near(peak[use], stripe[use], x_px[use], row_px[use], at[use])


def points_of(parameters: Mapping[str, Floats], stripe: Integers, x_px: Floats, row_px: Floats) -> Floats:
    """Give (point, 3) where peaks lie in the belt frame, mm."""
    camera = camera_of(parameters)
    xy = straightened((np.column_stack([x_px, row_px]) - camera[2:4]) / camera[:2], camera[4:])
    ray = np.column_stack([xy, np.ones(len(xy))])
    pose = belt_pose(parameters["belt_per_mm"])
    with np.errstate(divide="ignore"):
        depth = 1.0 / (ray * parameters["planes_per_mm"][stripe]).sum(axis=1)
    return np.asarray((ray * depth[:, None]) @ pose[:3, :3].T + pose[:3, 3])


def off_balls(at_mm: Floats, ball: Integers, plate: SpherePlate, pose: Floats) -> tuple[Floats, Floats]:
    """Give (point,) distances of points outwards from their balls, mm, and (point, 3) the way out."""
    way = at_mm - centres(plate, pose)[ball]
    size = np.sqrt((way**2).sum(axis=1))
    return size - 0.5 * pose[3] * plate.diameter_mm, way / size[:, None]


def centres(plate: SpherePlate, pose: Floats) -> Floats:
    """Give (ball, 3) the balls' centres in the belt frame, mm."""
    u = (np.arange(plate.columns) - 0.5 * (plate.columns - 1)) * plate.pitch_mm
    v = (np.arange(plate.rows) - 0.5 * (plate.rows - 1)) * plate.pitch_mm
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    xy = pose[3] * grid @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    return np.column_stack([xy, np.full(len(xy), pose[3] * plate.centre_height_mm)])


def _across(parameters: Mapping[str, Floats], stripe: Integers, x_px: Floats, row_px: Floats) -> Floats:
    """(point, 3) way of each point for a pixel along the row, mm."""
    step = 0.25
    up, down = (points_of(parameters, stripe, x_px + s * step, row_px) for s in (1.0, -1.0))
    return np.asarray((up - down) / (2.0 * step))


def _first(at: Floats, plate: SpherePlate) -> Floats:
    """Pose by votes: each point says on which circle the centre of its ball lies."""
    radius = 0.5 * plate.diameter_mm
    cell = 0.08 * radius
    reach = np.sqrt(np.maximum(radius**2 - (at[:, 2] - plate.centre_height_mm) ** 2, 0.0))
    turn = 2.0 * np.pi * np.arange(_WAYS) / _WAYS
    x = (at[:, 0, None] + reach[:, None] * np.cos(turn)).ravel()
    y = (at[:, 1, None] + reach[:, None] * np.sin(turn)).ravel()
    low = np.array([x.min(), y.min()]) - 2.0 * cell
    size = [int(np.ptp(one) / cell) + 6 for one in (x, y)]
    voted = ((x - low[0]) / cell).astype(int) * size[1] + ((y - low[1]) / cell).astype(int)
    votes = np.bincount(voted, minlength=size[0] * size[1]).reshape(size).astype(np.float64)
    for axis in (0, 1):
        votes = votes + np.roll(votes, 1, axis) + np.roll(votes, -1, axis)
    # one ball with many stripes must not outvote the others
    votes = np.sqrt(votes)
    anchors = low + (_peaks_of(votes, int(radius / cell)) + 0.5) * cell
    yaws = np.radians(_YAWS_DEG)
    flat = _turned(plate)
    # (anchor, yaw, ball at the anchor, other ball)
    at_all = anchors[:, None, None, None] + flat[None, :, None] - flat[None, :, :, None]
    place = np.floor((at_all - low) / cell).astype(int)
    inside = np.asarray(((place >= 0) & (place < votes.shape)).all(axis=-1))
    u, v = np.moveaxis(np.where(inside[..., None], place, 0), -1, 0)
    score = (votes[u, v] * inside).sum(axis=-1)
    which, turn, ball = np.unravel_index(score.argmax(), score.shape)
    return np.array([*(anchors[which] - flat[turn, ball]), yaws[turn], 1.0])


@lru_cache(maxsize=8)
def _turned(plate: SpherePlate) -> Floats:
    """(yaw, ball, 2) centres of the balls of a plate at the origin, mm, for each turn that is tried."""
    yaws = np.radians(_YAWS_DEG)
    return np.stack([centres(plate, np.array([0.0, 0.0, yaw, 1.0]))[:, :2] for yaw in yaws])


def _peaks_of(votes: Floats, apart: int) -> Floats:
    """(anchor, 2) the highest cells, none nearer to another than so many cells."""
    left = votes.copy()
    found = []
    for _ in range(_ANCHORS):
        u, v = np.unravel_index(left.argmax(), left.shape)
        found.append((u, v))
        left[max(u - apart, 0) : u + apart + 1, max(v - apart, 0) : v + apart + 1] = 0.0
    return np.array(found, np.float64)


def _fitted(
    at: Floats,
    across: Floats,
    stripe: Integers,
    x_px: Floats,
    row_px: Floats,
    plate: SpherePlate,
    pose: Floats,
) -> Plate | None:
    """Gauss and Newton, the points on balls chosen anew in each round."""
    radius = 0.5 * plate.diameter_mm
    found = None
    for share in _ROUNDS:
        centre = centres(plate, pose)
        ball = ((at[:, None, :2] - centre[None, :, :2]) ** 2).sum(axis=2).argmin(axis=1)
        off, out = off_balls(at, ball, plate, pose)
        on = (np.abs(off) < share * radius) & (out[:, 2] > _CAP_RISE_MIN)
        on &= np.bincount(ball[on], minlength=len(centre))[ball] >= _BALL_POINTS_MIN
        use = np.flatnonzero(on)
        for _ in range(_STEPS):
            if use.size < _POINTS_MIN:
                return None
            found = _measured(at, across, stripe, x_px, row_px, ball, use, plate, pose)
            pose = pose + np.linalg.lstsq(found.slopes, -found.residual, rcond=None)[0]
            limit = _STRAY_MADS * _MAD_TO_STD * float(np.median(np.abs(found.residual))) + 1e-6
            use = use[np.abs(found.residual) < limit]
    return found


def _measured(
    at: Floats,
    across: Floats,
    stripe: Integers,
    x_px: Floats,
    row_px: Floats,
    ball: Integers,
    use: Integers,
    plate: SpherePlate,
    pose: Floats,
) -> Plate:
    off, out = off_balls(at[use], ball[use], plate, pose)
    per_px = np.abs((out * across[use]).sum(axis=1))
    # a point that a pixel moves along the surface says nothing that could be weighed
    per_px = np.maximum(per_px, _ALONG_SHARE * float(np.median(per_px)))
    return Plate(
        pose,
        stripe[use],
        x_px[use],
        row_px[use],
        ball[use],
        at[use],
        per_px,
        _slopes(out, ball[use], plate, pose) / per_px[:, None],
        off / per_px,
        float(np.sqrt((off**2).mean())),
    )


def _slopes(out: Floats, ball: Integers, plate: SpherePlate, pose: Floats) -> Floats:
    """(point, 4) derivatives of the distances from the balls by the pose."""
    own = centres(plate, pose)[ball] - [*pose[:2], 0.0]
    turned = np.column_stack([-own[:, 1], own[:, 0], np.zeros(len(own))])
    by_size = -(out * own).sum(axis=1) / pose[3] - 0.5 * plate.diameter_mm
    return np.column_stack([-out[:, 0], -out[:, 1], -(out * turned).sum(axis=1), by_size])
