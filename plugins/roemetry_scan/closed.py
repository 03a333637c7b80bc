"""The closed body that two heads see: sections of top and bottom in one frame, and what neither saw.

Model. The lower head's points are carried into the upper head's frame by the rigid motion that lays the balls
of a plate, seen by both, on one another (Kabsch 1976). At stations along the belt, the area between the upper
curve and the rim's height, and between that and the lower curve, make a section; sections times their
distance are the volume. The rim's height is where the flanks of both sides, followed as conics, meet.
Flanks that a head does not see are followed to it (`roemetry_scan.flanks`): those of the underside
as far as the upper head sees no belt. Beyond the first and last section areas fall as an ellipsoid's do.

Uncertainty: `registration` its standard uncertainty across the heads, times the footprint; `flanks` what was
followed on both sides, as of one-sided scans, by what the upper head tells of the body's flanks: the lower
one sees no belt that would end them; `unseen rim` a fifth of what lies beyond the curves' ends, and what one
head alone sees; `between sections` what every other station changes; `motion`, `damaged lines`, `belt off its
zero` and `length of the line` as of one-sided scans: damaged lines of both, of the others the larger.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.calibrating.sphere_plate import fit_sphere
from roemetry.errors import CalibrationError, StageError
from roemetry.records import Estimate, Profiles, SpherePlate
from roemetry.records.arrays import Flags, Floats
from roemetry_scan.dense import FAULTS_UNSEEN, TO_RIM, estimate_of, flanks_std_mm3, told_of
from roemetry_scan.flanks import conic, followed_to
from roemetry_scan.slip import resampled

CAUSES = (
    "registration", "unseen rim", "flanks", "between sections", "motion", "damaged lines",
    "belt off its zero", "length of the line",
)  # fmt: skip
"""Parts of a true volume's budget."""
_STATIONS, _ACROSS = 240, 240  # sections along the belt, and places across it
_FLANK_POINTS = 12
"""Of a section's end, which tell how it goes on."""
_EVERY, _HALVINGS = 4, 10
"""Sections that are asked for the rim's height, one in so many, and steps to find it: a thousandth of the way
between both sides' ends."""
_RIM_SHARE = 0.2
"""Of what lies beyond both sides' ends: conics missed it by 20 % (root mean square) on twelve superquadrics
and supershapes of `mitsuba-belt`, by up to 40 on two of them."""
_ALONE_MAX = 0.02
"""Of the volume, what one head may see where the other sees nothing of the product: 0.06 % at most of nine
potatoes, superquadrics and supershapes of two simulators."""
_BALL_SHARE = 0.33
"""As in `roemetry_scan.motion`."""
_UNDER_RIM_MM = 1.0
"""Zero from which the underside is followed lies so far over the rim: conics are fitted to what rises."""
OFF_MAX_MM = 0.5
"""Centres that fit one another worse than this are not those of one plate."""
_PITCH_OFF_MAX = 0.005
"""Balls may be nearer or farther than the plate's file says by this share: the shipped heads see them 0.04 %
nearer. Half a percent in every length is 1.5 % of a volume."""


class Registration(NamedTuple):
    """How the lower head's frame lies in the upper one's."""

    T_top_bottom: Floats
    """(4, 4) to the upper head's frame from the lower one's, mm."""
    rms_mm: float
    """Distance of the balls' centres as both heads have them, root of the mean square."""
    balls: int
    first_counts: tuple[float, float] | None = None
    """Counts at which the plate's slices begin in the upper and the lower head; None where lines were not
    placed by counts, as in height maps."""

    @property
    def std_mm(self) -> float:
        """Standard uncertainty of the mean height of one head against the other, mm."""
        return self.rms_mm / math.sqrt(max(self.balls - 2, 1))


def registered(top: Floats, bottom: Floats) -> Registration:
    """Find the rigid motion that lays centres (n, 3) on centres, the lower head looking up.

    Raises
    ------
    CalibrationError
        The heads share fewer than three balls, or the centres do not fit.
    """
    if min(len(top), len(bottom)) < 3:
        raise CalibrationError(
            f"the heads see {len(top)} and {len(bottom)} balls: three that both see are the least",
            hint="carry one plate, whose balls are seen from both sides, through both heads",
        )
    start = np.diag([1.0, -1.0, -1.0])
    carried = (bottom - bottom.mean(axis=0)) @ start.T + top.mean(axis=0)
    best: Registration | None = None
    for _ in range(20):
        near = np.sqrt(((carried[:, None] - top[None]) ** 2).sum(axis=2))
        match = near.argmin(axis=1)
        mutual = near.argmin(axis=0)[match] == np.arange(len(bottom))
        if np.count_nonzero(mutual) < 3:
            break
        a, b = bottom[mutual], top[match[mutual]]
        pose, rms_mm = laid_on(a, b)
        best = Registration(pose, rms_mm, len(a))
        carried = bottom @ pose[:3, :3].T + pose[:3, 3]
    if best is None or best.rms_mm > OFF_MAX_MM:
        said = (
            "fewer than three balls match"
            if best is None
            else f"centres are {best.rms_mm:.2f} mm apart (rms)"
        )
        raise CalibrationError(
            f"the heads do not share the plate: {said}",
            hint="is it one plate, and has it moved between heads?",
        )
    return best


def refuse_other_pitch(centres: Floats, plate: SpherePlate, head: str) -> None:
    """Raise CalibrationError where balls (n, 3), mm, are not as far apart as the plate's file says.

    Either the file is of another plate, or the head's calibration has wrong lengths: the volumes of such
    heads are wrong by three times as much.
    """
    apart = np.sqrt(((centres[:, None] - centres[None]) ** 2).sum(axis=2))
    np.fill_diagonal(apart, np.inf)
    pitch_mm = float(np.median(apart.min(axis=1))) if len(centres) > 1 else plate.pitch_mm
    if abs(pitch_mm / plate.pitch_mm - 1.0) > _PITCH_OFF_MAX:
        raise CalibrationError(
            f"{head}: the balls are {pitch_mm:.2f} mm from their neighbours, the plate's file says "
            f"{plate.pitch_mm:g} mm",
            hint="is it this plate's file? If so, the head's calibration has wrong lengths: calibrate again",
        )


def laid_on(a: Floats, b: Floats) -> tuple[Floats, float]:
    """Give the rigid motion (4, 4) that lays points (n, 3) on others, and what is left, mm rms (Kabsch)."""
    u, _, v = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    turn = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, b.mean(axis=0) - turn @ a.mean(axis=0)
    off = a @ turn.T + pose[:3, 3] - b
    return pose, float(np.sqrt((off**2).sum(axis=1).mean()))


def ball_centres(profiles: Profiles, plate: SpherePlate) -> Floats:
    """Give (n, 3) centres of the balls in slices, mm: a sphere of the known radius fitted to each cap."""
    import cv2

    radius = 0.5 * plate.diameter_mm
    z = profiles.xyz_mm[..., 2]
    top = float(np.nanquantile(z, 0.9995))
    with np.errstate(invalid="ignore"):
        high = (z > top - (1.0 - _BALL_SHARE) * radius).astype(np.uint8)
    count, region = cv2.connectedComponents(high, connectivity=8)
    found = []
    for one in range(1, count):
        points = profiles.xyz_mm[(region == one) & profiles.seen]
        if len(points) < 50:
            continue
        centre = np.array([*points[:, :2].mean(axis=0), points[:, 2].max() - radius])
        found.append(fit_sphere(points, centre, radius, known_radius=True)[0])
    return np.array(found).reshape(-1, 3)


def closed_volume(
    top: Profiles, bottom: Profiles, registration: Registration, numbers: tuple[int, int] = (1, 1)
) -> Estimate:
    """Give the volume of the body that is product of these numbers in both heads' slices, mm³.

    Raises
    ------
    StageError
        One head does not see it or a good part of it, both see it at different places, or a scan begins or
        ends within it.
    """
    sides: list[Floats] = []
    pose = registration.T_top_bottom
    moved = begun_later(top, bottom, registration)
    for profiles, number in zip((top, bottom), numbers, strict=True):
        mine = profiles.product == number
        if np.count_nonzero(mine & profiles.seen) < 100:
            raise StageError("the product was seen by one head only: no closed body")
        if sides:  # what was followed there knows neither belt nor rim
            mine = mine & profiles.seen
        if profiles.scan is not None and (mine[profiles.frame % (profiles.scan.lines - 1) == 0]).any():
            raise StageError("a scan begins or ends within the product: a part is not seen")
        points = np.where(mine[..., None], profiles.xyz_mm, np.nan)
        sides.append(points if not sides else points @ pose[:3, :3].T + pose[:3, 3] + moved)
    known = [one[np.isfinite(one[..., 0])] for one in sides]
    low, high = (np.stack([f(one[:, :2], axis=0) for one in known]) for f in (np.min, np.max))
    if (low.max(axis=0) >= high.min(axis=0)).any():
        raise StageError("both heads see a product, but not at one place: is the registration theirs?")
    edge = 0.5 * (high.max(axis=0) - low.min(axis=0)) / _STATIONS
    x = np.linspace(low[:, 0].min() + edge[0], high[:, 0].max() - edge[0], _STATIONS)
    y = np.linspace(low[:, 1].min() - 1.0, high[:, 1].max() + 1.0, _ACROSS)
    upper, lower = (resampled(one, x, y) for one in sides)
    seen = resampled(np.where(top.seen[..., None], sides[0], np.nan), x, y)
    rim = _rim_of(y, np.where(np.isfinite(seen), upper, np.nan), lower)
    added = np.isfinite(upper) & ~np.isfinite(seen)
    low_flank = added & (upper < rim)  # followed to the belt: the flank of a closed body ends at the rim
    upper, added = np.where(low_flank, np.nan, upper), added & ~low_flank
    lower, hidden = _underside_followed(x, y, upper, lower, rim)
    followed = abs(float((upper - rim)[added].sum())) + abs(float((rim - lower)[hidden].sum()))
    over, under = (np.array([_half(y, line) for line in half]) for half in (upper - rim, rim - lower))
    both = (over[:, :1] > 0.0) & (under[:, :1] > 0.0)
    areas, beyond = np.where(both, over + under, 0.0).T
    step = float(x[1] - x[0])
    halves = np.maximum(over[:, 0], 0.0) + np.maximum(under[:, 0], 0.0)
    alone = float(halves[~both[:, 0]].sum() * step)
    ends = _cap(x, areas + beyond) + _cap(-x[::-1], (areas + beyond)[::-1])
    value = float((areas + beyond).sum() * step) + ends
    if not value > 0.0:
        raise StageError("top and bottom enclose nothing")
    if alone > _ALONE_MAX * value:
        raise StageError(
            f"one head sees {alone / 1000.0:.2f} cm³ of the product where the other sees nothing of it; "
            f"both see {value / 1000.0:.2f} cm³",
            hint="look at both scans: is the line followed everywhere, and is the registration theirs?",
        )
    cell = step * float(y[1] - y[0])
    footprint = float(np.isfinite(upper).sum()) * cell
    coarse = [float((areas + beyond)[first::2].sum() * 2.0 * step) for first in (0, 1)]
    scans = [one.scan for one in (top, bottom) if one.scan is not None]
    return estimate_of(
        value,
        {
            "registration": registration.std_mm * footprint,
            "unseen rim": _RIM_SHARE * (float(beyond.sum() * step) + ends) + alone,
            "flanks": flanks_std_mm3(followed * cell, value, told_of(top, numbers[0])),
            "between sections": 0.5 * abs(coarse[0] - coarse[1]),
            "motion": value * max((scan.pitch_rel_std for scan in scans), default=0.0),
            "damaged lines": value * FAULTS_UNSEEN * sum(scan.damaged / scan.lines for scan in scans),
            "belt off its zero": value * max((scan.belt_off_rel_std for scan in scans), default=0.0),
            "length of the line": value
            * max((np.nan_to_num(scan.line_length_rel_std) for scan in scans), default=0.0),
        },
    )


def _rim_of(y: Floats, upper: Floats, lower: Floats) -> float:
    """Give the height at which the flanks that both heads see meet, mm; the middle of their ends if nowhere.

    Where no section has points of both sides, the mean of the upper one.

    Each flank is a conic over the rim (`roemetry_scan.flanks`): a rim set too high lets those of the upper
    side end too far in and those of the lower side too far out.
    """
    both = [k for k in range(len(upper)) if (np.isfinite([upper[k], lower[k]]).sum(axis=1) > 1).all()]
    edges = [half[[k, k], np.flatnonzero(np.isfinite(half[k]))[[0, -1]]]
             for half in (upper, lower) for k in both]  # fmt: skip
    if not edges:
        return float(np.nanmean(upper))
    high, low = (float(np.mean(part)) for part in (edges[: len(both)], edges[len(both) :]))

    def apart(rim: float) -> float:
        """Give how much farther out the upper flanks end, summed over sections."""
        return float(sum(_span(y, upper[k] - rim) - _span(y, rim - lower[k]) for k in both[::_EVERY]))

    if not apart(low) > 0.0 > apart(high):
        return 0.5 * (low + high)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if apart(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)


def _span(y: Floats, height: Floats) -> float:
    """Give from where to where half a section reaches, its flanks followed to the rim, mm."""
    on = np.flatnonzero(np.isfinite(height))
    return float(np.ptp(y[on])) + sum(length for length, _ in _flanks(y[on], height[on]))


def _underside_followed(
    x: Floats, y: Floats, upper: Floats, lower: Floats, rim: float
) -> tuple[Floats, Flags]:
    """Give (x, y) the lower side with its flanks followed to the rim, and where they were.

    The upper head has told how high the rim lies and, all around it, where there is only belt.
    """
    base = rim + _UNDER_RIM_MM
    grid = np.stack([*np.meshgrid(x, y, indexing="ij"), np.maximum(base - lower, 0.0)], axis=-1)
    label = np.where(np.isfinite(lower), 1, np.where(np.isfinite(upper), -1, 0)).astype(np.int16)
    grid[label == 0, 2] = 0.0
    plane = np.column_stack([np.ones(x.size), np.zeros((x.size, 2)), x])
    rims = np.array([0.0, _UNDER_RIM_MM])
    by_row = np.repeat(rims[:, None], y.size, axis=1)
    points, label, added = followed_to(grid, label, plane, rims, by_row, np.ones(by_row.shape))
    return np.where(label > 0, base - points[..., 2], np.nan), added


def first_counts(top: Profiles, bottom: Profiles) -> tuple[float, float] | None:
    """Give the counts at which both heads' slices begin, None where neither was placed by counts.

    Raises
    ------
    StageError
        One head's lines were placed by counts and the other's were not.
    """
    upper, lower = (one.scan.first_count if one.scan is not None else math.nan for one in (top, bottom))
    if math.isnan(upper) != math.isnan(lower):
        raise StageError(
            f"encoder count of the first line: upper head {upper:g}, lower head {lower:g}; both have to be "
            "known, or neither",
            hint="give both heads the counts of one encoder",
        )
    return None if math.isnan(upper) else (upper, lower)


def begun_later(top: Profiles, bottom: Profiles, registration: Registration) -> Floats:
    """Give (3,) mm in the upper (left) frame that the lower (right) slices move by, by other first counts.

    X counts from each scan's own first line. The registration holds for the counts that lay between both
    heads' first lines when the plate went through; the belt has run what the product's differ from those.
    """
    counts, known = first_counts(top, bottom), registration.first_counts
    if (counts is None) != (known is None):
        raise StageError(
            "the encoder count of the first line is known of "
            + ("the plate's scans only" if counts is None else "the products' scans, not of the plate's")
            + ": how far both heads' lines lie apart cannot be told",
            hint="run register-heads anew, with plate and products placed by the same encoder",
        )
    if counts is None or known is None or top.scan is None:
        return np.zeros(3)
    apart = (counts[0] - counts[1]) - (known[0] - known[1])
    return np.array(top.scan.mm_per_count) * apart


def _cap(x: Floats, area: Floats) -> float:
    """Give what lies before the first section that both heads see: areas of an ellipsoid are a parabola."""
    there = np.flatnonzero(area > 0.0)
    if there.size < 20:
        return 0.0
    near = there[: there.size // 4]
    a, b, c = np.polyfit(x[near] - x[near[0]], area[near], 2)
    inside = b * b - 4.0 * a * c
    if inside < 0.0 or b <= 0.0:
        return 0.0
    root = -2.0 * c / (b + math.sqrt(inside))  # where the parabola that rises inwards was zero
    length = min(max(-root, 0.0), 0.25 * float(np.ptp(x[there])))
    return max(c * length - 0.5 * b * length**2 + a * length**3 / 3.0, 0.0)


def _half(y: Floats, height: Floats) -> tuple[float, float]:
    """Give the area of half a section over the rim's height, and what lies beyond its outermost points."""
    from scipy.integrate import trapezoid  # numpy has it from 2.0 on only

    on = np.flatnonzero(np.isfinite(height))
    if on.size < 2:
        return 0.0, 0.0
    at, over = y[on], height[on]
    beyond = sum(TO_RIM * length * last for length, last in _flanks(at, over))
    return float(trapezoid(over, at)), beyond


def _flanks(at: Floats, over: Floats) -> list[tuple[float, float]]:
    """Give how far a section's flanks go on beyond its outermost points, and the heights of these, mm."""
    found = []
    for side in (slice(None, _FLANK_POINTS), slice(None, -_FLANK_POINTS - 1, -1)):
        z = np.ascontiguousarray(over[side])
        last = float(z[0])
        found.append((conic(np.abs(at[side] - at[side][0]), z, z.size, max(last, 0.0), 0.0)[4], last))
    return found
