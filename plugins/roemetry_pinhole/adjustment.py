"""One joint adjustment of all unknowns, robust first, then by least squares, with its covariance.

Bundle adjustment (Triggs, McLauchlan, Hartley, Fitzgibbon 2000) with Huber's loss until it stands still; then
what is far off its kind's noise is left out, and the rest has equal rights. The noise of marks and of stripe
peaks is estimated from their residuals and the leverage of the unknowns (variance components); peaks count
the less, the more their residuals are correlated along a stripe.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.arrays import Flags, Floats
from roemetry_pinhole.edges import Edges, no_edges
from roemetry_pinhole.equations import (
    ON_BELT,
    Corners,
    Feet,
    StripePoints,
    corner_residuals,
    stripe_residuals,
)
from roemetry_pinhole.geometry import Geometry, Unknowns
from roemetry_pinhole.problem import STD_MIN_PX, STILL, Problem, Weights, inverse

_OUTLIER = 4.5
_STRAY = 12.0
_STRAY_MIN_PX = 1.0
_LAGS = 150
_MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False, slots=True)
class Adjusted:
    """What the adjustment found.

    Attributes
    ----------
    geometry
        The unknowns' best values.
    unknowns
        Where each stands in `covariance`.
    covariance
        (n, n) of all unknowns.
    corner_px
        (mark, 2) residuals, px.
    stripe_px
        (point,) residuals, px.
    corner_used, stripe_used
        (mark,), (point,) False for what was left out as far off.
    corner_std_px
        Noise of a mark in x or y, px.
    stripe_scale
        Noise of a stripe peak over its stated standard uncertainty.
    correlation
        Factor by which the peaks' correlation along the stripes widens the variance of their mean; so much
        less they count.
    conflict
        Factor by which they count less still, for contradicting the marks; 1 where they do not.
    """

    geometry: Geometry
    unknowns: Unknowns
    covariance: Floats
    corner_px: Floats
    stripe_px: Floats
    corner_used: Flags
    stripe_used: Flags
    corner_std_px: float
    stripe_scale: float
    correlation: float
    conflict: float


def adjust(
    geometry: Geometry,
    unknowns: Unknowns,
    corners: Corners,
    points: StripePoints,
    feet: Feet,
    *,
    foot_std_mm: float | Floats,
    edges: Edges | None = None,
) -> Adjusted:
    """Find the unknowns.

    Parameters
    ----------
    geometry
        Where to start; near enough for the nearest minimum to be the right one.
    unknowns
        What is looked for.
    corners, points, feet
        What was seen.
    foot_std_mm
        Standard uncertainty of the feet's heights, of all or of each.
    edges
        What was seen of solids' edges; None: nothing.

    Raises
    ------
    CalibrationError
        What was seen does not determine the unknowns.
    """
    weights = Weights(1.0, 1.0, np.ones(corners.pose.size), np.ones(points.pose.size))
    problem = Problem(unknowns, corners, points, feet, foot_std_mm, weights, edges or no_edges())
    geometry = nearly(problem, geometry)
    _without_strays(problem, geometry)
    points = problem.points = _by_surface(problem, geometry)
    weights.robust = False
    geometry = problem.settled(geometry, 1e-6)
    problem.estimate_noise(geometry)
    off, far = problem.distances(geometry)
    weights.corner = (off <= _OUTLIER * 1.2 * weights.corner_std_px).astype(np.float64)
    weights.stripe = (far <= _OUTLIER * weights.stripe_scale).astype(np.float64)
    weights.correlation = _correlation(stripe_residuals(geometry, points) / points.std_px, points, weights)
    geometry, conflict = _in_peace(problem, geometry)
    problem.estimate_noise(geometry)
    covariance = inverse(problem.normal(geometry)[0])
    marks, stripes = corner_residuals(geometry, corners), stripe_residuals(geometry, points)
    return Adjusted(
        geometry=geometry,
        unknowns=unknowns,
        covariance=covariance,
        corner_px=marks.reshape(-1, 2),
        stripe_px=stripes,
        corner_used=weights.corner > 0,
        stripe_used=weights.stripe > 0,
        corner_std_px=weights.corner_std_px,
        stripe_scale=weights.stripe_scale,
        correlation=weights.correlation,
        conflict=conflict,
    )


def nearly(problem: Problem, geometry: Geometry) -> Geometry:
    """Find the unknowns robustly and not to the last digit; the noise is estimated into the weights."""
    weights = problem.weights
    for still in (1e-2, 1e-4):
        geometry = problem.settled(geometry, still)
        off, far = problem.distances(geometry)
        weights.corner_std_px = max(_spread(off / np.sqrt(2.0)) * _RAYLEIGH, STD_MIN_PX)
        weights.stripe_scale = max(_spread(far), problem.scale_min)
    return geometry


def _without_strays(problem: Problem, geometry: Geometry) -> None:
    """Give no weight to what is far off by the median's measure: squares of many strays would hide them all.

    A stripe that would lose more than half is left as it is: it shall be named, not lost.
    """
    weights, stripe = problem.weights, problem.points.stripe
    off, far = problem.distances(geometry)
    weights.corner = (off <= max(_STRAY * weights.corner_std_px, _STRAY_MIN_PX)).astype(np.float64)
    keep = (far <= _STRAY * weights.stripe_scale) | (far * problem.points.std_px <= _STRAY_MIN_PX)
    for number in np.unique(stripe):
        if keep[stripe == number].mean() < 0.5:
            keep[stripe == number] = True
    weights.stripe = keep.astype(np.float64)


def _by_surface(problem: Problem, geometry: Geometry) -> StripePoints:
    """Give the points, those on the belt with larger standard uncertainties if they scatter more than stated.

    Extractors state uncertainties in proportion within a surface. On printed boards they overstate (speckle
    and noise on dark print), so one factor for all would state the belt's stripes, and with them heights at
    belt level, too well. The other way round nothing is gained: what scatters less needs no mending.
    """
    points, used = problem.points, problem.weights.stripe > 0
    far = problem.distances(geometry)[1]
    belt = points.pose == ON_BELT
    on_belt, elsewhere = far[belt & used], far[~belt & used]
    if min(on_belt.size, elsewhere.size) < _SURFACE_POINTS_MIN:
        return points
    factor = _spread(on_belt) / max(_spread(elsewhere), problem.scale_min)
    if factor < _SURFACE_FACTOR_MIN:
        return points
    return replace(points, std_px=np.where(belt, factor, 1.0) * points.std_px)


_SURFACE_POINTS_MIN = 50
"""Of fewer points the spread is uncertain by more than a tenth."""
_SURFACE_FACTOR_MIN = 1.2
"""Less is within what the spread of correlated residuals tells, and changes weights by less than a half."""


def _in_peace(problem: Problem, geometry: Geometry) -> tuple[Geometry, float]:
    """Settle, with stripes that count so little that they do not pull camera and poses off the marks.

    Stripes tell of each board's plane, three numbers, and of the camera. If they agree with the marks, the
    marks' squares grow by less than that many when stripes are added. If they grow by more, the stripes have
    an error in common that their scatter does not show (a bowed line, light that bleeds, an uneven board).
    """
    weights = problem.weights
    own = weights.correlation
    if not (weights.stripe.any() and weights.corner.any()):
        return problem.settled(geometry, STILL), 1.0
    weights.correlation = own * _ALMOST_NOTHING
    alone = problem.marks_cost(problem.settled(geometry, 1e-6))
    poses = np.unique(problem.corners.pose).size
    shared = float((problem.unknowns.camera >= 0).sum() + 3 * poses)
    weights.correlation, conflict = own, 1.0
    for _ in range(_PEACE_ROUNDS):
        geometry = problem.settled(geometry, STILL)
        grown = (problem.marks_cost(geometry) - alone) / shared
        if grown <= 1.0:
            break
        conflict *= min(max(1.5 * grown, 2.0), 10.0)
        weights.correlation = own * conflict
    return geometry, conflict


_ALMOST_NOTHING = 1e6
_PEACE_ROUNDS = 6
_RAYLEIGH = 1.0 / (np.sqrt(np.log(2.0)) * _MAD_TO_STD)
"""The median of √((x² + y²)/2) of normal x and y is √(ln 2) of their standard deviation."""


def _correlation(off: Floats, points: StripePoints, weights: Weights) -> float:
    """1 + 2 Σ ρ over the lags along a stripe up to the first that is not significant."""
    order = np.lexsort((points.row_px, points.stripe, points.pose))
    order = order[weights.stripe[order] > 0]
    pose, stripe, row = points.pose[order], points.stripe[order], points.row_px[order]
    value = off[order]
    if value.size < 100:
        return 1.0
    square = float((value**2).mean())
    apart = np.diff(row)[(np.diff(pose) == 0) & (np.diff(stripe) == 0)]
    step = float(np.median(apart)) if apart.size else 1.0
    factor = 1.0
    for lag in range(1, _LAGS + 1):
        together = (pose[lag:] == pose[:-lag]) & (stripe[lag:] == stripe[:-lag])
        together &= row[lag:] - row[:-lag] <= (lag + 0.5) * step
        if together.sum() < 100:
            break
        share = float((value[lag:] * value[:-lag])[together].mean()) / square
        if share < 2.0 / np.sqrt(together.sum()):
            break
        factor += 2.0 * share
    return factor


def _spread(distance: Floats) -> float:
    """Standard deviation by the median; 1 where there is nothing."""
    return _MAD_TO_STD * float(np.median(distance)) if distance.size else 1.0
