"""The weighted problem of the adjustment, and Levenberg and Marquardt's way to its minimum."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from roemetry.arrays import Floats
from roemetry.errors import CalibrationError
from roemetry_pinhole.edges import Edges, edge_rows, no_edges
from roemetry_pinhole.equations import (
    Corners,
    Feet,
    StripePoints,
    corner_residuals,
    corner_rows,
    foot_residuals,
    foot_rows,
    stripe_residuals,
    stripe_rows,
)
from roemetry_pinhole.geometry import Geometry, Unknowns

STILL = 1e-11
"""Relative gain of a step at which the last adjustment ends."""
STD_MIN_PX = 2e-3
"""Nobody finds a mark or a stripe better than that."""
_HUBER = 2.0
_ROUNDS_MAX = 60
_DAMPING_MAX = 1e6


@dataclass(eq=False, slots=True)
class Weights:
    """Noise and share of every observation."""

    corner_std_px: float
    stripe_scale: float
    corner: Floats
    stripe: Floats
    robust: bool = True
    correlation: float = 1.0


@dataclass(eq=False, slots=True)
class Problem:
    """What was seen, what is looked for, and how much each observation counts."""

    unknowns: Unknowns
    corners: Corners
    points: StripePoints
    feet: Feet
    foot_std_mm: float | Floats
    weights: Weights
    edges: Edges = field(default_factory=no_edges)

    @property
    def scale_min(self) -> float:
        """Least factor on the peaks' standard uncertainties."""
        return STD_MIN_PX / float(np.median(self.points.std_px)) if self.points.std_px.size else 1.0

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
            if gained <= still * cost and (damping < 1e-9 or still > STILL):
                break
            damping = max(damping / 100.0, 1e-14)
        return geometry

    def normal(self, geometry: Geometry) -> tuple[Floats, Floats]:
        """Normal matrix and gradient."""
        from roemetry_kernels.calibration.normal_equations import add_rows

        size = self.unknowns.count
        normal, gradient = np.zeros((size, size)), np.zeros(size)
        marks = corner_rows(geometry, self.unknowns, self.corners)
        stripes = stripe_rows(geometry, self.unknowns, self.points)
        stands = foot_rows(geometry, self.unknowns, self.feet)
        rims = edge_rows(geometry, self.unknowns, self.edges)
        off, far = self._off(marks.residual), self._far(stripes.residual)
        for rows, weight in (
            (marks, np.repeat(self._share(off, self.weights.corner), 2) / self.weights.corner_std_px**2),
            (stripes, self._share(far, self.weights.stripe) / self._stripe_variance()),
            (stands, np.full(stands.residual.size, 1.0) / np.square(self.foot_std_mm)),
            (rims, self._rim_share(rims.residual) / self.edges.std_px**2),
        ):
            add_rows(rows.columns, rows.values, rows.residual, weight, normal, gradient)
        return normal + np.tril(normal, -1).T, gradient

    def cost(self, geometry: Geometry) -> float:
        """Weighted squares, or Huber's loss; infinite where the geometry is impossible."""
        off = self._off(corner_residuals(geometry, self.corners))
        far = self._far(stripe_residuals(geometry, self.points))
        total = ((foot_residuals(geometry, self.feet) / self.foot_std_mm) ** 2).sum()
        rims = np.abs(edge_rows(geometry, self.unknowns, self.edges).residual) / self.edges.std_px
        total += _huber(rims).sum()
        for distance, share in (
            (off, self.weights.corner),
            (far, self.weights.stripe / self.weights.correlation),
        ):
            total += (share * (_huber(distance) if self.weights.robust else distance**2)).sum()
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
        from roemetry_kernels.calibration.normal_equations import row_variances

        weights = self.weights
        covariance = inverse(self.normal(geometry)[0])
        marks = corner_rows(geometry, self.unknowns, self.corners)
        taken = row_variances(marks.columns, marks.values, covariance) / weights.corner_std_px**2
        share = np.repeat(weights.corner, 2)
        free = float((share * (1.0 - taken)).sum())
        if free > 0:
            weights.corner_std_px = max(float(np.sqrt((share * marks.residual**2).sum() / free)), STD_MIN_PX)
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

    def _rim_share(self, rims: Floats) -> Floats:
        """Huber's weights: edges stay robust, for a corner or a chip is always among them."""
        return np.minimum(1.0, _HUBER / np.maximum(np.abs(rims) / self.edges.std_px, 1e-300))

    def _stripe_variance(self) -> Floats:
        return (self.points.std_px * self.weights.stripe_scale) ** 2 * self.weights.correlation


def _huber(distance: Floats) -> Floats:
    return np.where(distance > _HUBER, _HUBER * (2.0 * distance - _HUBER), distance**2)


def _solved(normal: Floats, diagonal: Floats, damping: float, gradient: Floats) -> Floats:
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    scale = 1.0 / np.sqrt(diagonal)
    matrix = normal * scale[:, None] * scale[None, :]
    matrix[np.diag_indices_from(matrix)] += damping
    try:
        return np.asarray(scale * cho_solve(cho_factor(matrix, lower=True), scale * gradient))
    except LinAlgError as error:
        raise _undetermined() from error


def inverse(normal: Floats) -> Floats:
    """Invert a normal matrix whose unknowns differ by many powers of ten: the covariance."""
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    scale = 1.0 / np.sqrt(np.diag(normal))
    try:
        factor = cho_factor(normal * scale[:, None] * scale[None, :], lower=True)
    except LinAlgError as error:
        raise _undetermined() from error
    inverse = cho_solve(factor, np.eye(len(normal)))
    return np.asarray(0.5 * (inverse + inverse.T) * scale[:, None] * scale[None, :])


def _undetermined() -> CalibrationError:
    return CalibrationError(
        "what was seen does not determine camera, planes and belt",
        hint="add poses of the board at other heights and tilts, and see that every stripe lies on it",
    )
