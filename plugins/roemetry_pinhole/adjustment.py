"""One joint adjustment of all unknowns, robust first, then by least squares, with its covariance.

Bundle adjustment (Triggs, McLauchlan, Hartley, Fitzgibbon 2000) with Huber's loss until it stands still; then
what is far off its kind's noise is left out, and the rest has equal rights. The noise of marks and of stripe
peaks is estimated from their residuals and the leverage of the unknowns (variance components); peaks count
the less, the more their residuals are correlated along a stripe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.arrays import Flags, Floats
from roemetry.errors import CalibrationError
from roemetry_pinhole.equations import (
    Corners,
    Feet,
    StripePoints,
    corner_residuals,
    corner_rows,
    foot_rows,
    stripe_residuals,
    stripe_rows,
)
from roemetry_pinhole.geometry import Geometry, Unknowns

_HUBER = 2.0
_OUTLIER = 4.5
_ROUNDS_MAX = 60
_DAMPING_MAX = 1e6
_STD_MIN_PX = 2e-3  # nobody finds a mark or a stripe better than that
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


@dataclass(eq=False, slots=True)
class _Weights:
    """Noise and share of every observation."""

    corner_std_px: float
    stripe_scale: float
    corner: Floats
    stripe: Floats
    robust: bool = True
    correlation: float = 1.0


def adjust(
    geometry: Geometry,
    unknowns: Unknowns,
    corners: Corners,
    points: StripePoints,
    feet: Feet,
    *,
    foot_std_mm: float,
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
        Standard uncertainty of the feet's heights.

    Raises
    ------
    CalibrationError
        What was seen does not determine the unknowns.
    """
    weights = _Weights(1.0, 1.0, np.ones(corners.pose.size), np.ones(points.pose.size))
    problem = _Problem(unknowns, corners, points, feet, foot_std_mm, weights)
    for still in (1e-2, 1e-4):
        geometry = problem.settled(geometry, still)
        off, far = problem.distances(geometry)
        weights.corner_std_px = max(_spread(off / np.sqrt(2.0)) * _RAYLEIGH, _STD_MIN_PX)
        weights.stripe_scale = max(_spread(far), problem.scale_min)
    weights.robust = False
    geometry = problem.settled(geometry, 1e-6)
    problem.estimate_noise(geometry)
    off, far = problem.distances(geometry)
    weights.corner = (off <= _OUTLIER * 1.2 * weights.corner_std_px).astype(np.float64)
    weights.stripe = (far <= _OUTLIER * weights.stripe_scale).astype(np.float64)
    weights.correlation = _correlation(stripe_residuals(geometry, points) / points.std_px, points, weights)
    geometry, conflict = _in_peace(problem, geometry)
    problem.estimate_noise(geometry)
    covariance = _inverse(problem.normal(geometry)[0])
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


def _in_peace(problem: _Problem, geometry: Geometry) -> tuple[Geometry, float]:
    """Settle, with stripes that count so little that they do not pull camera and poses off the marks.

    Stripes tell of each board's plane, three numbers, and of the camera. If they agree with the marks, the
    marks' squares grow by less than that many when stripes are added. If they grow by more, the stripes have
    an error in common that their scatter does not show (a bowed line, light that bleeds, an uneven board).
    """
    weights = problem.weights
    own = weights.correlation
    if not (weights.stripe.any() and weights.corner.any()):
        return problem.settled(geometry, _STILL), 1.0
    weights.correlation = own * _ALMOST_NOTHING
    alone = problem.marks_cost(problem.settled(geometry, 1e-6))
    poses = np.unique(problem.corners.pose).size
    shared = float((problem.unknowns.camera >= 0).sum() + 3 * poses)
    weights.correlation, conflict = own, 1.0
    for _ in range(_PEACE_ROUNDS):
        geometry = problem.settled(geometry, _STILL)
        grown = (problem.marks_cost(geometry) - alone) / shared
        if grown <= 1.0:
            break
        conflict *= min(max(1.5 * grown, 2.0), 10.0)
        weights.correlation = own * conflict
    return geometry, conflict


_STILL = 1e-11
_ALMOST_NOTHING = 1e6
_PEACE_ROUNDS = 6
_RAYLEIGH = 1.0 / (np.sqrt(np.log(2.0)) * _MAD_TO_STD)
"""The median of √((x² + y²)/2) of normal x and y is √(ln 2) of their standard deviation."""


@dataclass(eq=False, slots=True)
class _Problem:
    """What was seen, what is looked for, and how much each observation counts."""

    unknowns: Unknowns
    corners: Corners
    points: StripePoints
    feet: Feet
    foot_std_mm: float
    weights: _Weights

    @property
    def scale_min(self) -> float:
        """Least factor on the peaks' standard uncertainties."""
        return _STD_MIN_PX / float(np.median(self.points.std_px)) if self.points.std_px.size else 1.0

    def settled(self, geometry: Geometry, still: float) -> Geometry:
        """Levenberg–Marquardt until a step gains less than the share `still` of the cost."""
        damping, cost = 1e-4, self.cost(geometry)
        for _ in range(_ROUNDS_MAX):
            normal, gradient = self.normal(geometry)
            diagonal = np.diag(normal).copy()
            if not (diagonal > 0).all():
                raise _undetermined()
            while True:
                step = _solved(normal, diagonal, damping, gradient)
                moved = self.unknowns.moved(geometry, -step)
                new_cost = self.cost(moved)
                if new_cost <= cost * (1.0 + 1e-12):
                    break
                damping *= 8.0
                if damping > _DAMPING_MAX:
                    return geometry
            gained = cost - new_cost
            geometry, cost = moved, new_cost
            # a small gain under strong damping is no sign of having arrived
            if gained <= still * cost and (damping < 1e-9 or still > _STILL):
                break
            damping = max(damping / 100.0, 1e-14)
        return geometry

    def normal(self, geometry: Geometry) -> tuple[Floats, Floats]:
        """Normal matrix and gradient."""
        from roemetry_kernels.normal_equations import add_rows

        size = self.unknowns.count
        normal, gradient = np.zeros((size, size)), np.zeros(size)
        marks = corner_rows(geometry, self.unknowns, self.corners)
        stripes = stripe_rows(geometry, self.unknowns, self.points)
        stands = foot_rows(geometry, self.unknowns, self.feet)
        off, far = self._off(marks.residual), self._far(stripes.residual)
        for rows, weight in (
            (marks, np.repeat(self._share(off, self.weights.corner), 2) / self.weights.corner_std_px**2),
            (stripes, self._share(far, self.weights.stripe) / self._stripe_variance()),
            (stands, np.full(stands.residual.size, self.foot_std_mm**-2)),
        ):
            add_rows(rows.columns, rows.values, rows.residual, weight, normal, gradient)
        return normal + np.tril(normal, -1).T, gradient

    def cost(self, geometry: Geometry) -> float:
        """Weighted squares, or Huber's loss; infinite where the geometry is impossible."""
        off = self._off(corner_residuals(geometry, self.corners))
        far = self._far(stripe_residuals(geometry, self.points))
        total = ((foot_rows(geometry, self.unknowns, self.feet).residual / self.foot_std_mm) ** 2).sum()
        for distance, share in (
            (off, self.weights.corner),
            (far, self.weights.stripe / self.weights.correlation),
        ):
            square = distance**2
            if self.weights.robust:
                square = np.where(distance > _HUBER, _HUBER * (2.0 * distance - _HUBER), square)
            total += (share * square).sum()
        return float(total) if np.isfinite(total) else np.inf

    def marks_cost(self, geometry: Geometry) -> float:
        """Squares of the marks alone."""
        off = self._off(corner_residuals(geometry, self.corners))
        return float((self.weights.corner * off**2).sum())

    def distances(self, geometry: Geometry) -> tuple[Floats, Floats]:
        """Distances of the marks, px, and of the peaks in their own standard uncertainties."""
        marks = corner_residuals(geometry, self.corners)
        far = np.abs(stripe_residuals(geometry, self.points)) / self.points.std_px
        return np.hypot(marks[::2], marks[1::2]), far

    def estimate_noise(self, geometry: Geometry) -> None:
        """Variance components: squares of the residuals over their degrees of freedom."""
        from roemetry_kernels.normal_equations import row_variances

        weights = self.weights
        covariance = _inverse(self.normal(geometry)[0])
        marks = corner_rows(geometry, self.unknowns, self.corners)
        taken = row_variances(marks.columns, marks.values, covariance) / weights.corner_std_px**2
        share = np.repeat(weights.corner, 2)
        free = float((share * (1.0 - taken)).sum())
        if free > 0:
            weights.corner_std_px = max(float(np.sqrt((share * marks.residual**2).sum() / free)), _STD_MIN_PX)
        stripes = stripe_rows(geometry, self.unknowns, self.points)
        taken = row_variances(stripes.columns, stripes.values, covariance) / self._stripe_variance()
        free = float((weights.stripe * (1.0 - taken)).sum())
        if free > 0:
            square = (weights.stripe * (stripes.residual / self.points.std_px) ** 2).sum() / free
            weights.stripe_scale = max(float(np.sqrt(square)), self.scale_min)

    def _off(self, marks: Floats) -> Floats:
        return np.hypot(marks[::2], marks[1::2]) / self.weights.corner_std_px

    def _far(self, stripes: Floats) -> Floats:
        return np.abs(stripes) / (self.points.std_px * self.weights.stripe_scale)

    def _share(self, distance: Floats, share: Floats) -> Floats:
        """Huber's weights while robust."""
        if not self.weights.robust:
            return share
        return share * np.minimum(1.0, _HUBER / np.maximum(distance, 1e-300))

    def _stripe_variance(self) -> Floats:
        return (self.points.std_px * self.weights.stripe_scale) ** 2 * self.weights.correlation


def _correlation(off: Floats, points: StripePoints, weights: _Weights) -> float:
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


def _solved(normal: Floats, diagonal: Floats, damping: float, gradient: Floats) -> Floats:
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    scale = 1.0 / np.sqrt(diagonal)
    matrix = normal * scale[:, None] * scale[None, :]
    matrix[np.diag_indices_from(matrix)] += damping
    try:
        return np.asarray(scale * cho_solve(cho_factor(matrix, lower=True), scale * gradient))
    except LinAlgError as error:
        raise _undetermined() from error


def _inverse(normal: Floats) -> Floats:
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    scale = 1.0 / np.sqrt(np.diag(normal))
    try:
        factor = cho_factor(normal * scale[:, None] * scale[None, :], lower=True)
    except LinAlgError as error:
        raise _undetermined() from error
    inverse = cho_solve(factor, np.eye(len(normal)))
    return np.asarray(0.5 * (inverse + inverse.T) * scale[:, None] * scale[None, :])


def _spread(distance: Floats) -> float:
    """Standard deviation by the median; 1 where there is nothing."""
    return _MAD_TO_STD * float(np.median(distance)) if distance.size else 1.0


def _undetermined() -> CalibrationError:
    return CalibrationError(
        "what was seen does not determine camera, planes and belt",
        hint="add poses of the board at other heights and tilts, and see that every stripe lies on it",
    )
