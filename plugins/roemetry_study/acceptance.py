"""Acceptance of an instrument by artefacts: sphere form, size and spacing, flatness, steps, lengths.

In the manner of ISO 10360-13 and VDI/VDE 2634 part 2, with their characteristics: probing dispersion and size
on a sphere, error of the distance between spheres, flatness of a plane, and beside them the height of steps
and the length of a side. Every measurement counts: the largest error is held against the maximum permissible
error with a guard band for the artefact's own uncertainty (ISO 14253-1, 95 %): accepted within, rejected
beyond, else undecided.

Spheres are fitted to points by least squares of the distance to their surface (Gauss and Newton, radius
free); a plane by the smallest singular vector. Dispersion is over the 95 % of points that lie nearest (ISO
10360-13, D95). A plate of spheres is found as calibrations find it (`roemetry.calibrating.sphere_plate`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from roemetry.calibrating.block_check import Light, find_block, read_block
from roemetry.calibrating.sphere_plate import centres, fit_sphere, place_of
from roemetry.errors import DataError
from roemetry.records import BELT, Block, Profiles, SpherePlate, Staircase
from roemetry.records.arrays import Floats
from roemetry.records.view import View

CHARACTERISTICS = {
    "form": "probing dispersion on a sphere",
    "size": "probing size of a sphere",
    "spacing": "distance between spheres",
    "flatness": "flatness of a plane",
    "step": "height of a step",
    "length": "length of a side",
}
"""Each with its limit in an acceptance file, mm."""

WANTED = {"form": 10, "size": 10, "spacing": 7, "flatness": 6, "step": 5, "length": 7}
"""Positions or lengths that VDI/VDE 2634 part 2 asks for; from memory of its text, and said so in the
report.
"""

GUARD = 1.645
"""Standard uncertainties of the guard band: 95 % one-sided (ISO 14253-1)."""

_NEAREST = 0.95  # share of points that dispersion is taken over (ISO 10360-13, D95)
_POINTS_MIN = 50  # on a sphere or plane: fewer do not show its form
_FIT_STD_MAX = 0.002
"""Of a sphere's radius: where noise alone makes centre or radius more uncertain, too few stripes cross it,
and the fit would be judged instead of the instrument."""
_NEAR_SHARE = 0.15
"""Of a sphere's radius: points so near its surface belong to it; farther ones are the plate's or stray."""
_ON_SPHERES_MIN = 0.5
"""Share of the points above the spheres' centres that must be so near: a flat surface there has a fifth."""
_TURN_MAX_DEG = 90.0  # a plate turned by more is one turned by less
_VOTERS = 2000  # points that vote for its place: more take their time and tell nothing more


@dataclass(frozen=True, slots=True)
class Value:
    """One measured characteristic at one place."""

    characteristic: str
    what: str
    measured_mm: float
    calibrated_mm: float
    std_mm: float
    """Standard uncertainty of the calibrated value."""

    @property
    def error_mm(self) -> float:
        """Measured less calibrated."""
        return self.measured_mm - self.calibrated_mm


@dataclass(frozen=True, slots=True)
class Outcome:
    """The decision on one characteristic."""

    characteristic: str
    limit_mm: float
    worst: Value
    count: int
    decision: str
    """``accepted``, ``rejected``, ``undecided``."""
    words: str


@dataclass(frozen=True, slots=True)
class Artefact:
    """What is measured, and how well its values are known."""

    target: SpherePlate | Block | Staircase
    std_mm: float
    """Standard uncertainty of each of its lengths, mm."""


def measure(
    profiles: Profiles, artefact: Artefact, view: View | None = None, light: Light | None = None
) -> Iterator[Value]:
    """Give every characteristic that an artefact shows in one image.

    The calibration's `view` gives lengths in X and Y by perspective, the image's `light` a block's edges:
    without it its side is not measured.

    Raises
    ------
    DataError
        The artefact is not found.
    """
    target, std_mm = artefact.target, artefact.std_mm
    if isinstance(target, SpherePlate):
        yield from _of_spheres(profiles, target, std_mm)
    elif isinstance(target, Block):
        places = find_block(profiles, target, light)
        top = profiles.xyz_mm[places.top]
        away = top - top.mean(axis=0)
        off = away @ np.linalg.svd(away, full_matrices=False)[2][-1]
        yield Value("flatness", "top of the block", dispersion(off), 0.0, 0.0)
        read = read_block(profiles, places, view)
        yield Value("step", "belt to top", read.height_mm - read.belt_mm, target.height_mm, std_mm)
        if math.isfinite(read.width_mm):
            yield Value("length", "side along the stripes", read.width_mm, target.width_mm, std_mm)
    else:
        found = _levels_of(profiles, target)
        for low, high in combinations(found, 2):
            yield Value("step", f"{low:g} to {high:g} mm", found[high] - found[low], high - low, std_mm)


def _levels_of(profiles: Profiles, stairs: Staircase) -> dict[float, float]:
    """Give the measured height of the belt and of each step by the described one, mm."""
    height = profiles.xyz_mm[..., 2][profiles.seen & (profiles.product > BELT)]
    levels = np.sort(np.array(stairs.heights_mm))
    apart = float(np.diff(np.concatenate([[0.0], levels])).min())
    found = {0.0: 0.0}
    for level in levels.tolist():
        near = height[np.abs(height - level) < 0.25 * apart]
        if near.size < _POINTS_MIN:
            raise DataError(
                f"the staircase `{stairs.name}`: {near.size} points near its step of {level:g} mm, expected "
                f"{_POINTS_MIN}",
                hint="does every step lie under a stripe?",
            )
        found[level] = float(np.median(near))
    return found


def decide(values: Sequence[Value], limits_mm: dict[str, float]) -> tuple[Outcome, ...]:
    """Hold the largest error of each characteristic against its limit.

    Raises
    ------
    DataError
        Nothing was measured of a characteristic that has a limit.
    """
    outcomes = []
    for name, limit in limits_mm.items():
        mine = [value for value in values if value.characteristic == name]
        if not mine:
            raise DataError(
                f"{CHARACTERISTICS[name]}: no artefact shows it: its limit of {limit:g} mm is not tested",
                hint="add images of an artefact that does, or take the limit away",
            )
        worst = max(mine, key=lambda value: abs(value.error_mm))
        guard, size = GUARD * worst.std_mm, abs(worst.error_mm)
        decision = "undecided"  # where the error is NaN, too
        if size <= limit - guard:
            decision = "accepted"
        elif size > limit + guard:
            decision = "rejected"
        count = "1 value" if len(mine) == 1 else f"{len(mine)} values"
        words = (
            f"{CHARACTERISTICS[name]}: {decision}: largest error {worst.error_mm:+.4f} mm ({worst.what}), "
            f"limit {limit:g} mm, guard band {guard:.4f} mm, {count}"
        )
        if len(mine) < WANTED[name]:
            words += f" of {WANTED[name]} recommended"
        outcomes.append(Outcome(name, limit, worst, len(mine), decision, words))
    return tuple(outcomes)


def _of_spheres(profiles: Profiles, plate: SpherePlate, std_mm: float) -> Iterator[Value]:
    radius = 0.5 * plate.diameter_mm
    known = profiles.seen & (profiles.product > BELT) & np.isfinite(profiles.xyz_mm).all(axis=2)
    points = profiles.xyz_mm[known]
    # above the middle of the upper half of a sphere no plate and no neighbour is near
    points = points[points[:, 2] > plate.centre_height_mm]
    fitted: dict[tuple[int, int], Floats] = {}
    for place, start in _grid_in(points, plate).items():
        centre, size = start, radius
        for _ in range(2):
            near = np.abs(np.linalg.norm(points - centre, axis=1) - size) < _NEAR_SHARE * radius
            if near.sum() < _POINTS_MIN:
                break
            own = points[near]
            centre, size = fit_sphere(own, centre, size)
        if near.sum() < _POINTS_MIN or fit_std(own, centre, size) > _FIT_STD_MAX * radius:
            continue
        name = f"sphere {place[0] + 1}, {place[1] + 1}"
        yield Value("form", name, dispersion(np.linalg.norm(own - centre, axis=1) - size), 0.0, 0.0)
        yield Value("size", name, 2.0 * size, plate.diameter_mm, std_mm)
        fitted[place] = centre
    if len(fitted) < min(2, plate.columns * plate.rows):
        raise DataError(
            f"the sphere plate `{plate.name}`: {len(fitted)} spheres are seen on enough stripes",
            hint="move the plate a little: each sphere's upper half should lie under two stripes or more",
        )
    for (a, one), (b, other) in combinations(fitted.items(), 2):
        true = plate.pitch_mm * math.dist(a, b)
        name = f"spheres {a[0] + 1}, {a[1] + 1} to {b[0] + 1}, {b[1] + 1}"
        yield Value("spacing", name, float(np.linalg.norm(one - other)), true, std_mm)


def overall(outcomes: Sequence[Outcome]) -> str:
    """Give the decision on the instrument: rejected by one, accepted by all, else undecided."""
    decisions = {outcome.decision for outcome in outcomes}
    if "rejected" in decisions:
        return "rejected"
    return "accepted" if decisions == {"accepted"} else "undecided"


def fit_std(points_mm: Floats, centre_mm: Floats, radius_mm: float) -> float:
    """Give the largest standard uncertainty of a sphere's centre and radius by its points' noise, mm."""
    away = points_mm - centre_mm
    distance = np.linalg.norm(away, axis=1)
    jacobian = np.column_stack([away / distance[:, None], np.ones(len(away))])
    noise = float(np.sqrt(((distance - radius_mm) ** 2).sum() / max(len(away) - 4, 1)))
    return noise * float(np.sqrt(np.linalg.pinv(jacobian.T @ jacobian).diagonal().max()))


def dispersion(residual_mm: Floats) -> float:
    """Give the width of the narrowest band that holds 95 % of the residuals, mm."""
    ordered = np.sort(residual_mm)
    within = math.ceil(_NEAREST * ordered.size)
    return float((ordered[within - 1 :] - ordered[: ordered.size - within + 1]).min())


def _grid_in(points: Floats, plate: SpherePlate) -> dict[tuple[int, int], Floats]:
    """Find the plate: by column and row, where its spheres' centres are, mm.

    Raises
    ------
    DataError
        Less than half of the points lie near a sphere at the best place and turn.
    """
    if len(points) < _POINTS_MIN:
        raise DataError(
            f"the sphere plate `{plate.name}` is not seen: {len(points)} points above its spheres' centres"
        )
    place = place_of(points[:: max(len(points) // _VOTERS, 1)], plate, _TURN_MAX_DEG)
    found = centres(plate, np.append(place, 1.0))
    radius = 0.5 * plate.diameter_mm
    off = np.abs(np.linalg.norm(points[:, None] - found, axis=2) - radius).min(axis=1)
    if np.mean(off < _NEAR_SHARE * radius) < _ON_SPHERES_MIN:
        raise DataError(
            f"the sphere plate `{plate.name}` is not seen: most points lie on no "
            f"sphere of {plate.diameter_mm:g} mm",
            hint="is it the plate of the target file, and does it lie on the belt alone?",
        )
    return dict(zip(product(range(plate.columns), range(plate.rows)), found, strict=True))
