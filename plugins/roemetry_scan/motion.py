"""The belt's motion from a known body that it carries once through the light.

Unknown are the motion t, mm per count, and the body's pose; camera and planes of light are the calibration's.
A point p that the rig saw at the count c lies at q = p − t·c on the body, so the sum of squares of

    the distances of all q from the body's surface

is least at the true t (Gauss-Newton; derivatives by differences). A wrong t shears and stretches the body:
balls become ellipsoids that lean, the faces of a frustum meet at other angles, and both are of another
length. So one pass tells all three components, but only while the body is the one that is described.

The covariance is that of the fit, with as many independent points as there are lengths over which their
errors hang together, and of the body's own lengths. What the calibration's errors make of t is told by its
derivatives, found by moving each of their independent steps by one standard deviation: the same errors
enlarge the products, so both add up (a volume's std is 0.060 % where their root of squares is 0.046 %). A
body that is its own mirror image cannot tell which way the belt runs: `right` or `left` in the image has to
be said.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError, RoemetryError
from roemetry.records import Pyramid, ScanLines, SpherePlate, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.scan import Motion
from roemetry.stages import Triangulator
from roemetry_scan.belt import plane_of_belt
from roemetry_scan.encoder_places import encoder_places
from roemetry_scan.line_ends import line_ends
from roemetry_scan.rows import placed, points_of_rows

Distances = Callable[[Floats], Floats]
"""Of points (n, 3) in the body's own frame: signed distances from its surface, mm."""

_POINTS = 6000
"""Points that are fitted: their own noise then is a hundredth of what calibrations allow."""
_YAWS_DEG = range(-40, 45, 5)
"""Turns that are tried first: squares and grids look alike every 90°."""
_ROUNDS, _ROUNDS_FIRST = 40, 15
"""At most; and so many until outliers are left out, which a quarter of the points tell."""
_SETTLED_MM = 1e-5
"""No point moves farther with another round: a thousandth of their scatter."""
_TOGETHER = 9.0
"""Points whose errors hang together as one: three neighbouring rows in three neighbouring lines."""
_FAR = 3.0
"""Robust standard deviations from which a point belongs to nothing of the body: dirt, a base plate."""
_BALL_SHARE = 0.33
"""Of a ball's radius above its centre: below, plate and rim are seen."""
_RMS_MAX_SHARE = 0.01
"""Of the body's height: a worse fit is another body, or a calibration that is none."""
_CONDITION_MAX = 1e6
"""Of the derivatives, each unknown in its own unit: beyond, rounding leaves few digits of a covariance, whose
condition is the square of that."""
_PITCH_STD_MAX, _LEAN_STD_MAX_DEG = 0.002, 0.1
"""Above these one pass did not tell the motion: relative, and of its direction."""
_NEAR_MM = 0.3  # of the belt's plane: points as near to it are belt


def measured_motion(
    stripes: StripeMap,
    lines: ScanLines,
    calibration: Calibration,
    triangulator: Triangulator[Any],
    target: Pyramid | SpherePlate,
    right: bool,
) -> tuple[Motion, Mapping[str, float]]:
    """Fit the motion; CalibrationError says why it could not be told."""
    try:
        # repeated and reversed lines would put a point at two places of the body
        found = encoder_places(lines.count, lines.number)
    except RoemetryError as error:
        raise CalibrationError(f"the scan of the target: {error.message}", hint=error.hint) from error
    line = np.flatnonzero(found.used)
    way = found.direction * found.way[line]
    # counts in the belt's direction, whichever way the counter runs
    seen, index = _rig_points(stripes, line, calibration, triangulator)
    start, pose, length, some = _started(seen, way[index], target, right)
    surface = _surface_of(target)
    unknowns = np.concatenate([start, pose])
    unknowns, kept = _fitted(unknowns, seen, way[index], surface, length, some)
    # derivatives at the end, by all points that count, for the covariance
    residual, slopes = _linearised(unknowns, seen[kept], way[index][kept], surface)
    rms = float(np.sqrt(np.mean(residual**2)))
    if not rms < _RMS_MAX_SHARE * _height(target):
        raise CalibrationError(
            f"the scan does not fit the {target.name}: its points lie {rms:.2g} mm (rms) off its surface",
            hint="is the target the one that the rig file describes, and does the belt run the way it says?",
        )
    scale = np.sqrt((slopes**2).sum(axis=0))
    if not scale.all() or np.linalg.cond(slopes / scale) > _CONDITION_MAX:
        raise CalibrationError(
            f"the scan does not fit the {target.name}: what fits lies on too few of its faces",
            hint="is the target the one that the rig file describes, and does the belt run the way it says?",
        )
    inverse = np.linalg.inv(slopes.T @ slopes)
    # errors of neighbouring rows and lines hang together: the covariance is so many times that of single
    # points
    covariance = rms**2 * _TOGETHER * inverse[:3, :3]
    # what a change of all distances moves the unknowns by, to first order
    step_solve = inverse @ slopes.T
    steps, changes = [], []
    for step in calibration.independent_steps():
        if not step.any():
            continue
        moved = calibration.shifted(step, triangulator.view)
        # the same lines, seen by a calibration that is off by one of its independent steps
        try:
            other = _rig_points(stripes, line, moved, triangulator)[0]
        except RoemetryError:
            continue
        # other places are seen then, and distances cannot be compared point by point
        if other.shape != seen.shape:
            continue
        # only the first three unknowns are the motion; the pose may move as it likes
        off, _ = _linearised(unknowns, other[kept], way[index][kept], surface, slopes=False)
        steps.append(step)
        changes.append(-(step_solve @ (off - residual))[:3])
    # the body's own lengths are known to their tolerance only
    relative = target.tolerance_mm / math.sqrt(3.0) / length
    covariance = covariance + relative**2 * np.outer(unknowns[:3], unknowns[:3])
    # where the line ends on the belt is kept, for later scans to compare with
    middle = line * calibration.stripe_count + calibration.stripe_count // 2
    motion = Motion(
        unknowns[:3],
        covariance,
        _per_parameter(steps, changes, calibration),
        line_ends(stripes.x_px[middle], stripes.x_std_px[middle]),
    )
    # the calibration's own errors, independent of one another
    for change in changes:
        covariance = covariance + np.outer(change, change)
    # along the motion: the pitch; across it: the direction
    size = float(np.sqrt(motion.mm_per_count @ motion.mm_per_count))
    along = motion.mm_per_count / size
    pitch_std = math.sqrt(float(along @ covariance @ along)) / size
    across = covariance - np.outer(along, along) * float(along @ covariance @ along)
    lean_std = math.degrees(math.sqrt(max(0.0, float(np.linalg.eigvalsh(across)[-1]))) / size)
    if pitch_std > _PITCH_STD_MAX or lean_std > _LEAN_STD_MAX_DEG:
        raise CalibrationError(
            f"one pass of the {target.name} determines the belt's motion only to {pitch_std:.2%} and its "
            f"direction to {lean_std:.2f}°; {_PITCH_STD_MAX:.1%} and {_LEAN_STD_MAX_DEG:g}° are required",
            hint="take a larger target, or lines that lie closer together",
        )
    return motion, {
        "motion_rms_mm": rms,
        "motion_points": float(kept.size),
        "motion_pitch_std_percent": 100.0 * pitch_std,
        "motion_direction_std_deg": lean_std,
    }


def _per_parameter(steps: list[Floats], changes: list[Floats], calibration: Calibration) -> Floats:
    """Give (3, parameter) derivatives of the motion, from its changes with independent steps."""
    size = len(calibration.covariance)
    if not steps:
        return np.zeros((3, size))
    # in units of each parameter's own uncertainty: they differ by orders
    own = np.sqrt(np.diag(calibration.covariance))
    scale = np.where(own > 0.0, own, 1.0)
    found, *_ = np.linalg.lstsq(np.array(steps) / scale, np.array(changes), rcond=1e-9)
    return np.asarray(found.T / scale)


def _rig_points(
    stripes: StripeMap, line: Any, calibration: Calibration, triangulator: Triangulator[Any]
) -> tuple[Floats, Any]:
    """Give (n, 3) points as the rig saw them, mm, and which of the lines each is of, thinned out evenly."""
    per_line = calibration.stripe_count
    middle = calibration.stripe_count // 2
    at = line * per_line + middle
    # every row's places in the rig's frame, without any shift: that is what is looked for
    table = points_of_rows(calibration, triangulator)
    x_px = stripes.x_px[at]
    points, _ = placed(x_px, np.ones_like(x_px), table, middle, np.zeros((len(at), 3)))
    index, row = np.nonzero(np.isfinite(x_px))
    return points[index, row], index


def _started(
    seen: Floats, way: Floats, target: Pyramid | SpherePlate, right: bool
) -> tuple[Floats, Floats, float, Integers]:
    """Give a first motion and pose (turn vector, place), the target's length, mm, and which points may be it.

    Of a ball plate these are its balls' alone: with a pose that is not known yet, its face would be theirs.
    """
    length = _length(target)
    # the belt's line stands still in the rig's frame: its plane there is that of the line alone
    level = np.column_stack([way / max(np.ptp(way), 1.0) * 100.0, seen[:, 1:]])
    plane = plane_of_belt(level, _NEAR_MM)
    over = seen[:, 2] - plane[0] - level[:, :2] @ plane[1:]
    cut_mm = _cut(target)
    # the body alone: belt, rim and plate lie lower
    on = over > cut_mm
    if np.count_nonzero(on) < 100:
        raise CalibrationError(
            f"the {target.name} is not seen in the scan: {int(on.sum())} points rise above {cut_mm:.1f} mm",
            hint="carry it through the light as a whole, with bare belt before and behind it",
        )
    # between quantiles, so that stray points add no length
    counts = float(np.ptp(np.quantile(way[on], [0.002, 0.998])))
    if counts <= 0.0:
        raise CalibrationError("the target is seen in one line only")
    seen_length = _length_at(target, cut_mm)
    # the length that is known over the counts that it takes: a first pitch, along X
    start = np.array([(1.0 if right else -1.0) * seen_length / counts, 0.0, 0.0])
    placed_at = seen - way[:, None] * start
    # the middle of the body's bounding box, without strays
    middle = 0.5 * (np.quantile(placed_at[on], 0.01, axis=0) + np.quantile(placed_at[on], 0.99, axis=0))
    surface, some = _surface_of(target), np.flatnonzero(on)
    some = some[:: max(1, some.size // 1500)]
    best, least = np.zeros(6), np.inf
    for yaw in _YAWS_DEG:
        pose = np.array([0.0, 0.0, math.radians(yaw), middle[0], middle[1], plane[0]])
        off = surface(_in_body(placed_at[some], pose))
        # median: up to half of the points may be of something else
        score = float(np.nanmedian(np.abs(off)))
        if score < least:
            best, least = pose, score
    may_be = np.arange(len(seen)) if isinstance(target, Pyramid) else np.flatnonzero(on)
    return start, best, length, may_be[:: max(1, may_be.size // (6 * _POINTS))]


def _fitted(
    unknowns: Floats, seen: Floats, way: Floats, surface: Distances, length: float, some: Integers
) -> tuple[Floats, Any]:
    """Fit motion and pose to some points; give them and the points that count."""
    # at first anything within a tenth of the length may be the body
    limit = 0.1 * length
    kept = some
    for round_ in range(_ROUNDS):
        off = surface(_in_body(seen[some] - way[some, None] * unknowns[:3], unknowns[3:]))
        good = np.isfinite(off) & (np.abs(off) < limit)
        if np.count_nonzero(good) < 200:
            raise CalibrationError(
                "the scan does not fit the target anywhere: another body, or the belt runs the other way"
            )
        kept = some[good]
        # a quarter of the points until it has settled
        wanted = _POINTS if round_ > _ROUNDS_FIRST else _POINTS // 4
        kept = kept[:: max(1, kept.size // wanted)]
        residual, slopes = _linearised(unknowns, seen[kept], way[kept], surface)
        # columns are of mm a count, radians and mm: scaled, or the equations would be ill-conditioned
        size = np.sqrt((slopes**2).sum(axis=0))
        size = np.where(size > 0.0, size, 1.0)
        scaled = slopes / size
        # what another body's points do not determine stays where it is
        change = -np.linalg.lstsq(scaled.T @ scaled, scaled.T @ residual, rcond=1e-14)[0] / size
        unknowns = unknowns + change
        spread = 1.4826 * float(np.median(np.abs(residual)))
        # narrowed slowly while the pose is still being found
        limit = max(_FAR * spread, 0.8 * limit) if round_ < _ROUNDS_FIRST else _FAR * spread
        # in mm at the points: no unknown has a unit of its own to compare with
        if round_ > _ROUNDS_FIRST + 3 and np.abs(slopes @ change).max() < _SETTLED_MM:
            break
    return unknowns, kept


def _linearised(
    unknowns: Floats, seen: Floats, way: Floats, surface: Distances, *, slopes: bool = True
) -> tuple[Floats, Floats]:
    """Give distances, and their derivatives by the nine unknowns."""

    def off(at: Floats) -> Floats:
        return surface(_in_body(seen - way[:, None] * at[:3], at[3:]))

    here = np.nan_to_num(off(unknowns))
    if not slopes:
        return here, np.empty((0, 9))
    span = max(float(np.ptp(way)), 1.0)
    # 1 µm over the whole way, 0.01 mrad, 1 µm: far above rounding, far below any curvature
    steps = np.array([*[1e-3 / span] * 3, *[1e-5] * 3, *[1e-3] * 3])
    found = np.empty((len(seen), 9))
    for k, step in enumerate(steps):
        ahead, behind = unknowns.copy(), unknowns.copy()
        ahead[k] += step
        behind[k] -= step
        found[:, k] = (off(ahead) - off(behind)) / (2.0 * step)
    return here, np.nan_to_num(found)


def _in_body(points: Floats, pose: Floats) -> Floats:
    import cv2

    turn = np.asarray(cv2.Rodrigues(np.ascontiguousarray(pose[:3]))[0])
    return np.asarray((points - pose[3:]) @ turn)


def _surface_of(target: Pyramid | SpherePlate) -> Distances:
    return _faces(target) if isinstance(target, Pyramid) else _balls(target)


def _faces(target: Pyramid) -> Distances:
    """Distances from a frustum's top and sides; NaN near the belt, where points are of both."""
    lean = 0.5 * (target.base_mm - target.top_mm) / target.height_mm
    size = math.hypot(1.0, lean)
    normals = np.array([[0, 0, 1.0], *([sx / size, sy / size, lean / size] for sx, sy in _SIDES)])
    offsets = np.array([target.height_mm, *[0.5 * target.base_mm / size] * 4])

    def distances(points: Floats) -> Floats:
        """Give (point,) signed distances from the surface, mm, of points (point, 3); NaN near the belt."""
        # a convex body's distance is the largest of those from its planes; exact outside near faces only
        off = (points @ normals.T - offsets).max(axis=1)
        return np.where(points[:, 2] > 0.1 * target.height_mm, off, np.nan)

    return distances


_SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))


def _balls(target: SpherePlate) -> Distances:
    """Distances from the nearest ball."""
    radius = 0.5 * target.diameter_mm
    first = -0.5 * target.pitch_mm * np.array([target.columns - 1, target.rows - 1])

    def distances(points: Floats) -> Floats:
        """Give (point,) signed distances from the nearest ball's surface, mm, of points (point, 3)."""
        at = (points[:, :2] - first) / target.pitch_mm
        # balls are alike: each point belongs to the nearest of the regular places
        nearest = np.clip(np.rint(at), 0, [target.columns - 1, target.rows - 1])
        away = points.copy()
        away[:, :2] -= first + target.pitch_mm * nearest
        away[:, 2] -= target.centre_height_mm
        return np.asarray(np.sqrt((away**2).sum(axis=1)) - radius)

    return distances


def _height(target: Pyramid | SpherePlate) -> float:
    if isinstance(target, Pyramid):
        return target.height_mm
    return target.centre_height_mm + 0.5 * target.diameter_mm


def _cut(target: Pyramid | SpherePlate) -> float:
    """Give the height over the belt from which points are the body's own, and neither rim nor plate, mm."""
    if isinstance(target, Pyramid):
        return 0.3 * target.height_mm
    return target.centre_height_mm + _BALL_SHARE * 0.5 * target.diameter_mm


def _length(target: Pyramid | SpherePlate) -> float:
    if isinstance(target, Pyramid):
        return target.base_mm
    return (target.columns - 1) * target.pitch_mm + target.diameter_mm


def _length_at(target: Pyramid | SpherePlate, height_mm: float) -> float:
    """Give the target's length along the belt where it is cut at a height, mm."""
    if isinstance(target, Pyramid):
        share = height_mm / target.height_mm
        return target.base_mm + share * (target.top_mm - target.base_mm)
    radius, over = 0.5 * target.diameter_mm, height_mm - target.centre_height_mm
    # below its centre a ball hides itself
    half = math.sqrt(max(radius**2 - max(over, 0.0) ** 2, 0.0))
    return (target.columns - 1) * target.pitch_mm + 2.0 * half
