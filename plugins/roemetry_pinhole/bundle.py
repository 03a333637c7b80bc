"""Bundle adjustment: camera, poses, planes of light and belt from all that was seen, with their covariance.

Model (Triggs, McLauchlan, Hartley and Fitzgibbon 2000). Unknowns are the camera's numbers, six for each
pose of the board, three for each plane of light (p·X = 1) and for the belt, and, if asked for, the belt's
travel and the board's shape. Observed are marks (x, y in the image), stripe peaks (x along the row: the ray
must meet board and plane of light in one point), belt contacts (corners of boards that lie on the belt) and
edges of solids. The sum of squares over variances is minimised by Levenberg and Marquardt's method
with analytic derivatives.

1. Robust start: Huber's loss; noise by medians.
2. What is far off its kind's noise is left out, and the rest has equal rights.
3. Variance components: the noise of marks and of stripe peaks is estimated from their residuals and the
   leverage of the unknowns. Peaks count less by the autocorrelation of their residuals along a stripe.
4. If adding the stripes makes the marks' squares grow by more than the numbers that both share, the stripes
   have an error in common (a bowed line, light that bleeds) that their scatter does not show, and count less.
5. The covariance is the inverse of the normal matrix; of boards under stripes, times the factor by which
   poses disagree about what they share beyond their residuals' scatter: a lens that refocuses or a board
   that bends in the hand leaves small residuals, alike within a pose (cluster-robust variance, as one
   factor; Liang and Zeger 1986, Biometrika 73:13).

It fails where what was seen does not determine the unknowns (parallel boards, a stripe on one surface), which
is refused, and it believes errors that all observations share: a wrong pitch, a laser that is no plane.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_pinhole.geometry import (
    NO_CONTACTS,
    NO_CORNERS,
    NO_EDGES,
    NO_POINTS,
    ON_BELT,
    BeltContacts,
    Corners,
    Edges,
    Geometry,
    StripePoints,
    Unknowns,
    contact_rows,
    corner_residuals,
    corner_rows,
    edge_rows,
    stripe_residuals,
    stripe_rows,
)

TOLERANCE = 1e-11
"""Relative gain of a step at which the last adjustment ends."""
STD_MIN_PX = 2e-3
"""Smallest standard deviation of a board corner or a peak: no detector is more precise."""
_HUBER = 2.0
"""Standard deviations where Huber's loss becomes linear: 95 % efficient at 1.35, 98 % at 2. It gives a start
only; heights change by 0.01 µm at 1.2 and 3.2."""
_ROUNDS_MAX = 60  # steps; where these do not do, there is no minimum near the start
_DAMPING_MAX = 1e6  # no step is found beyond: the minimum is reached to rounding


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
    contacts: BeltContacts
    contact_std_mm: float | Floats
    weights: Weights
    edges: Edges = NO_EDGES

    @property
    def scale_min(self) -> float:
        """Least factor on the peaks' standard uncertainties."""
        return STD_MIN_PX / float(np.median(self.points.std_px)) if self.points.std_px.size else 1.0

    def solve(self, geometry: Geometry, tolerance: float) -> Geometry:
        """Levenberg–Marquardt until a step gains less than the share `tolerance` of the cost."""
        from scipy.linalg import cho_solve

        damping, cost = 1e-4, self.cost(geometry)
        for _ in range(_ROUNDS_MAX):
            normal, gradient = self.normal(geometry)
            while True:
                factor, scale = _factored(normal, damping)
                moved = self.unknowns.moved(geometry, -scale * cho_solve(factor, scale * gradient))
                new_cost = self.cost(moved)
                # not worse but for rounding: the step is taken
                if new_cost <= cost * (1.0 + 1e-12):
                    break
                damping *= 8.0
                if damping > _DAMPING_MAX:
                    return geometry
            gained = cost - new_cost
            geometry, cost = moved, new_cost
            # a small gain under strong damping is no sign of having arrived
            if gained <= tolerance * cost and (damping < 1e-9 or tolerance > TOLERANCE):
                break
            # near the minimum the damping vanishes, and steps are Gauss and Newton's
            damping = max(damping / 100.0, 1e-14)
        return geometry

    def normal(self, geometry: Geometry) -> tuple[Floats, Floats]:
        """Normal matrix and gradient."""
        size, weights = self.unknowns.count, self.weights
        normal, gradient = np.zeros((size, size)), np.zeros(size)
        marks = corner_rows(geometry, self.unknowns, self.corners)
        stripes = stripe_rows(geometry, self.unknowns, self.points)
        stands = contact_rows(geometry, self.unknowns, self.contacts)
        rims = edge_rows(geometry, self.unknowns, self.edges)
        corner, stripe = weights.corner, weights.stripe
        if weights.robust:
            corner = corner * _huber_weight(self._off(marks.residual))
            stripe = stripe * _huber_weight(self._far(stripes.residual))
        # edges stay robust, for a corner or a chip is always among them
        rim = _huber_weight(np.abs(rims.residual) / self.edges.std_px)
        for rows, weight in (
            (marks, np.repeat(corner, 2) / weights.corner_std_px**2),
            (stripes, stripe / self._stripe_variance()),
            (stands, np.full(stands.residual.size, 1.0) / np.square(self.contact_std_mm)),
            (rims, rim / self.edges.std_px**2),
        ):
            add_rows(rows.columns, rows.values, rows.residual, weight, normal, gradient)
        # rows were added to the lower triangle alone
        return normal + np.tril(normal, -1).T, gradient

    def cost(self, geometry: Geometry) -> float:
        """Weighted squares, or Huber's loss; infinite where the geometry is impossible."""
        weights, loss = self.weights, _huber if self.weights.robust else np.square
        off = self._off(corner_residuals(geometry, self.corners))
        far = self._far(stripe_residuals(geometry, self.points))
        total = (
            (contact_rows(geometry, self.unknowns, self.contacts).residual / self.contact_std_mm) ** 2
        ).sum()
        rims = np.abs(edge_rows(geometry, self.unknowns, self.edges).residual) / self.edges.std_px
        total += _huber(rims).sum()
        total += (weights.corner * loss(off)).sum()
        total += (weights.stripe / weights.correlation * loss(far)).sum()
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
        weights = self.weights
        covariance = inverse(self.normal(geometry)[0])
        marks = corner_rows(geometry, self.unknowns, self.corners)
        # what the unknowns take of each row's variance: its leverage
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

    def _stripe_variance(self) -> Floats:
        return (self.points.std_px * self.weights.stripe_scale) ** 2 * self.weights.correlation


def _huber(distance: Floats) -> Floats:
    return np.where(distance > _HUBER, _HUBER * (2.0 * distance - _HUBER), distance**2)


def _huber_weight(distance: Floats) -> Floats:
    return np.minimum(1.0, _HUBER / np.maximum(distance, 1e-300))


def _factored(normal: Floats, damping: float = 0.0) -> tuple[Any, Floats]:
    """Factor a normal matrix whose unknowns differ by many powers of ten, scaled to a diagonal of 1."""
    from scipy.linalg import LinAlgError, cho_factor

    diagonal = np.diag(normal)
    if not (diagonal > 0).all():
        raise _undetermined()
    scale = 1.0 / np.sqrt(diagonal)
    matrix = normal * scale[:, None] * scale[None, :]
    matrix[np.diag_indices_from(matrix)] += damping
    try:
        return cho_factor(matrix, lower=True), scale
    except LinAlgError as error:
        raise _undetermined() from error


def inverse(normal: Floats) -> Floats:
    """Invert a normal matrix: the covariance."""
    from scipy.linalg import cho_solve

    factor, scale = _factored(normal)
    inverse = cho_solve(factor, np.eye(len(normal)))
    return np.asarray(0.5 * (inverse + inverse.T) * scale[:, None] * scale[None, :])


def _undetermined() -> CalibrationError:
    return CalibrationError(
        "what was seen does not determine camera, planes and belt",
        hint="add poses of the board at other heights and tilts, and see that every stripe lies on it",
    )


_OUTLIER = 4.5
"""Standard deviations beyond which an observation is left out at last: one normal error in 150,000. Heights
change by 2 µm at 2.7, where good points go as well, by 0.5 µm at 7."""
_STRAY = 12.0
"""The same before anything is settled, by the median's measure: far, for the start is not exact. No change
from 7 to 19."""
_STRAY_MIN_PX = 1.0
"""Nearer than this nothing is left out before anything is settled, px. No change from 0.6 to 1.6."""
_CHANCE = 2.5
"""Factor up to which poses may disagree by chance, or by what renderings have as well: 1.2 to 1.9 on five
rigs of three renderers. Two real sets, of which fewer poses gave heights off by more than was stated, have 4
and 8."""
_LAGS = 150
"""Points along a stripe over which residuals are tried for correlation; it ends at the first that is not
significant."""
MAD_TO_STD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, eq=False, slots=True)
class Adjusted:
    """What the adjustment found."""

    geometry: Geometry
    unknowns: Unknowns
    covariance: Floats
    """geometry, unknowns, covariance: best values, where each unknown stands, and (n, n) of all of them."""
    corner_px: Floats
    stripe_px: Floats
    """corner_px, stripe_px: (mark, 2), (point,) residuals, px."""
    corner_used: Flags
    stripe_used: Flags
    """corner_used, stripe_used: (mark,), (point,) False for what was left out as far off."""
    corner_std_px: float
    """Noise of a mark in x or y, px."""
    stripe_scale: float
    """Noise of a stripe peak over its stated standard uncertainty."""
    correlation: float
    """Factor by which the peaks' correlation along the stripes widens the variance of their mean; so much
    less they count."""
    conflict: float
    """Factor by which they count even less, for contradicting the marks; 1 where they do not."""
    disagreement: float = 1.0
    """Factor, in variance, by which poses scatter about what they share more than their residuals explain. It
    is in the covariance; 1 where it may be chance."""


def adjust(
    geometry: Geometry,
    unknowns: Unknowns,
    corners: Corners,
    points: StripePoints,
    contacts: BeltContacts,
    *,
    contact_std_mm: float | Floats,
    edges: Edges = NO_EDGES,
) -> Adjusted:
    """Find the unknowns from a start whose nearest minimum is the right one.

    `contact_std_mm` is the standard uncertainty of the contacts' heights, of all or of each.

    Raises
    ------
    CalibrationError
        What was seen does not determine the unknowns.
    """
    weights = Weights(1.0, 1.0, np.ones(corners.pose.size), np.ones(points.pose.size))
    problem = Problem(unknowns, corners, points, contacts, contact_std_mm, weights, edges)
    # in this order: a robust start, strays out, then noise, and equal rights for the rest
    geometry = robust_prefit(problem, geometry)
    _reject_outliers(problem, geometry)
    points = problem.points = _by_surface(problem, geometry)
    weights.robust = False
    geometry = problem.solve(geometry, 1e-6)
    problem.estimate_noise(geometry)
    off, far = problem.distances(geometry)
    # a mark's distance is of two coordinates, its standard deviation of one
    weights.corner = (off <= _OUTLIER * 1.2 * weights.corner_std_px).astype(np.float64)
    weights.stripe = (far <= _OUTLIER * weights.stripe_scale).astype(np.float64)
    weights.correlation = _correlation(stripe_residuals(geometry, points) / points.std_px, points, weights)
    geometry, conflict = _reweight_stripes(problem, geometry)
    problem.estimate_noise(geometry)
    return Adjusted(
        geometry,
        unknowns,
        inverse(problem.normal(geometry)[0]),
        corner_residuals(geometry, corners).reshape(-1, 2),
        stripe_residuals(geometry, points),
        weights.corner > 0,
        weights.stripe > 0,
        weights.corner_std_px,
        weights.stripe_scale,
        weights.correlation,
        conflict,
    )


def robust_prefit(problem: Problem, geometry: Geometry) -> Geometry:
    """Find the unknowns robustly and not to the last digit; the noise is estimated into the weights."""
    weights = problem.weights
    # twice, since the noise, and with it what counts as far, changes
    for tolerance in (1e-2, 1e-4):
        geometry = problem.solve(geometry, tolerance)
        off, far = problem.distances(geometry)
        weights.corner_std_px = max(_spread(off / np.sqrt(2.0)) * _RAYLEIGH, STD_MIN_PX)
        weights.stripe_scale = max(_spread(far), problem.scale_min)
    return geometry


def _reject_outliers(problem: Problem, geometry: Geometry) -> None:
    """Give no weight to what is far off by the median's measure: squares of many outliers hide them all.

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


_SURFACE_POINTS_MIN = 50  # of fewer points the spread is uncertain by more than a tenth
_SURFACE_FACTOR_MIN = 1.2
"""Less is within what the spread of correlated residuals tells, and changes weights by less than a half."""


def _reweight_stripes(problem: Problem, geometry: Geometry) -> tuple[Geometry, float]:
    """Settle, with stripes that count so little that they do not pull camera and poses off the marks.

    Stripes tell of each board's plane, three numbers, and of the camera. If they agree with the marks, the
    marks' squares grow by less than that many when stripes are added. If they grow by more, the stripes have
    an error in common that their scatter does not show (a bowed line, light that bleeds, an uneven board).
    """
    weights = problem.weights
    own = weights.correlation
    if not (weights.stripe.any() and weights.corner.any()):
        return problem.solve(geometry, TOLERANCE), 1.0
    # stripes that hardly count: the marks' own minimum, to compare with
    weights.correlation = own * _ALMOST_NOTHING
    alone = problem.marks_cost(problem.solve(geometry, 1e-6))
    # numbers that both determine: the camera's, and three of each board's plane
    shared = float((problem.unknowns.camera >= 0).sum() + 3 * np.unique(problem.corners.pose).size)
    weights.correlation, conflict = own, 1.0
    for _ in range(_REWEIGHT_ROUNDS):
        geometry = problem.solve(geometry, TOLERANCE)
        grown = (problem.marks_cost(geometry) - alone) / shared
        if grown <= 1.0:
            break
        # at least halved, at most a tenth: growth is no linear function of the weight
        conflict *= min(max(1.5 * grown, 2.0), 10.0)
        weights.correlation = own * conflict
    return geometry, conflict


_ALMOST_NOTHING = 1e6  # times less, so that stripes do not move the camera: marks alone count
_REWEIGHT_ROUNDS = 6  # each round divides the weight by up to ten: a million in all
_RAYLEIGH = 1.0 / (np.sqrt(np.log(2.0)) * MAD_TO_STD)
"""The median of √((x² + y²)/2) of normal x and y is √(ln 2) of their standard deviation."""


def _correlation(off: Floats, points: StripePoints, weights: Weights) -> float:
    """1 + 2 Σ ρ over the lags along a stripe up to the first that is not significant."""
    # along each stripe of each pose by row: neighbours in the list are neighbours on the stripe
    order = np.lexsort((points.row_px, points.stripe, points.pose))
    order = order[weights.stripe[order] > 0]
    pose, stripe, row, value = (of[order] for of in (points.pose, points.stripe, points.row_px, off))
    if value.size < _CORRELATED_MIN:
        return 1.0
    apart = np.diff(row)[(np.diff(pose) == 0) & (np.diff(stripe) == 0)]
    step = float(np.median(apart)) if apart.size else 1.0
    square, factor = float((value**2).mean()), 1.0
    for lag in range(1, _LAGS + 1):
        together = (pose[lag:] == pose[:-lag]) & (stripe[lag:] == stripe[:-lag])
        # rows that are missing between two make them no neighbours of this lag
        together &= row[lag:] - row[:-lag] <= (lag + 0.5) * step
        if together.sum() < _CORRELATED_MIN:
            break
        share = float((value[lag:] * value[:-lag])[together].mean()) / square
        # two standard errors of the correlation of independent values, 2/√n
        if share < 2.0 / np.sqrt(together.sum()):
            break
        factor += 2.0 * share
    return factor


_CORRELATED_MIN = 100  # points, or pairs of them, from which a correlation is known to a tenth


def _spread(distance: Floats) -> float:
    """Standard deviation by the median; 1 where there is nothing."""
    return MAD_TO_STD * float(np.median(distance)) if distance.size else 1.0


_Rows = TypeVar("_Rows", Corners, StripePoints, BeltContacts)


@dataclass(frozen=True, eq=False, slots=True)
class Measured:
    """What was seen, where the adjustment starts, and what it looks for: the arguments of `adjust`."""

    start: Geometry
    unknowns: Unknowns
    corners: Corners = NO_CORNERS
    points: StripePoints = NO_POINTS
    contacts: BeltContacts = NO_CONTACTS
    contact_std_mm: float | Floats = 0.01
    """Standard uncertainty of the contacts' heights, mm: of all, or of each."""
    edges: Edges = NO_EDGES

    def adjusted(self) -> Adjusted:
        """Adjust; raises as `adjust`."""
        seen = self.corners, self.points, self.contacts
        return adjust(self.start, self.unknowns, *seen, contact_std_mm=self.contact_std_mm, edges=self.edges)

    def robust_prefit(self) -> Geometry:
        """Adjust robustly and not to the last digit; raises as `adjust`."""
        return robust_prefit(self.problem(None), self.start)

    def step_of(self, found: Adjusted) -> tuple[Geometry, Floats]:
        """Give where what was found goes if this was seen instead, and the covariance of all unknowns.

        By one step, the weights as they were.
        """
        normal, gradient = self.problem(found).normal(found.geometry)
        covariance = inverse(normal)
        return self.unknowns.moved(found.geometry, -covariance @ gradient), covariance

    def problem(self, found: Adjusted | None) -> Problem:
        """Give what is to be solved, weighted as it was found; None: before anything is known."""
        weights = Weights(1.0, 1.0, np.ones(self.corners.pose.size), np.ones(self.points.pose.size))
        if found is not None:
            used = found.corner_used.astype(np.float64), found.stripe_used.astype(np.float64)
            correlation = found.correlation * found.conflict
            weights = Weights(
                found.corner_std_px, found.stripe_scale, *used, robust=False, correlation=correlation
            )
        seen = self.corners, self.points, self.contacts
        return Problem(self.unknowns, *seen, self.contact_std_mm, weights, self.edges)

    def of(self, poses: Integers, start: Geometry) -> Measured:
        """Give what boards in some poses (ascending) and the bare belt show, from another start."""
        contacts = np.isin(self.contacts.pose, poses)
        start = replace(start, rotation=start.rotation[poses], shift=start.shift[poses])
        return Measured(
            start,
            self.unknowns.of(start, self.unknowns.prints >= 0),
            chosen(self.corners, np.isin(self.corners.pose, poses), poses),
            chosen(self.points, np.isin(self.points.pose, [ON_BELT, *poses]), poses),
            chosen(self.contacts, contacts, poses),
            self.contact_std_mm if isinstance(self.contact_std_mm, float) else self.contact_std_mm[contacts],
        )


def with_disagreement(measured: Measured, found: Adjusted) -> Adjusted:
    """Give what was found with the poses' disagreement in its covariance; raise where it is undetermined."""
    factor = _disagreement(measured.problem(found), found.geometry)
    if factor <= _CHANCE:
        return found
    return replace(found, covariance=factor * found.covariance, disagreement=factor)


def _disagreement(problem: Problem, geometry: Geometry) -> float:
    """Squares of what poses pull camera, planes and belt by, over what the residuals' noise makes of them.

    At the minimum these pulls cancel. With R a pose's share of the normal matrix, its own unknowns
    eliminated, and N the sum of all, independent noise gives its pull r the covariance R − R N⁻¹ R.
    """
    from scipy.linalg import solve_triangular

    unknowns = problem.unknowns
    # what every pose has in common: camera, planes, belt, travel
    shared = np.setdiff1d(np.arange(unknowns.count), unknowns.poses)
    numbers = [ON_BELT, *range(len(unknowns.poses))]
    parts = np.array([_shared_part(problem, geometry, pose, shared) for pose in numbers])
    # the normal matrix of what is shared, summed over belt and poses
    (root, _), scale = _factored(parts[:, :, :-1].sum(axis=0))
    pulled = expected = 0.0
    for part in parts[1:]:
        # whitened by the sum, so that all directions count alike
        white = solve_triangular(root, scale[:, None] * part, lower=True)
        share = solve_triangular(root, scale[:, None] * white[:, :-1].T, lower=True)
        pulled += float(white[:, -1] @ white[:, -1])
        # trace of R N⁻¹ less that of its square: what noise alone makes of the pull
        expected += float(np.trace(share) - (share**2).sum())
    return pulled / expected if expected > 0.0 else 1.0


def _shared_part(problem: Problem, geometry: Geometry, pose: int, shared: Integers) -> Floats:
    """Give a pose's normal matrix and gradient of the shared unknowns, side by side, without its own."""
    corners, points, contacts = (
        rows.pose == pose for rows in (problem.corners, problem.points, problem.contacts)
    )
    weights, std_mm = problem.weights, problem.contact_std_mm
    of_pose = Problem(
        problem.unknowns,
        chosen(problem.corners, corners),
        chosen(problem.points, points),
        chosen(problem.contacts, contacts),
        std_mm if isinstance(std_mm, float) else std_mm[contacts],
        replace(weights, corner=weights.corner[corners], stripe=weights.stripe[points]),
        problem.edges if pose == ON_BELT else NO_EDGES,
    )
    normal, gradient = of_pose.normal(geometry)
    both = np.column_stack([normal, gradient])
    # the belt has no pose of its own
    own = np.empty(0, np.int64) if pose == ON_BELT else problem.unknowns.poses[pose]
    # Schur complement: the pose's own unknowns are eliminated
    gone = np.linalg.solve(normal[np.ix_(own, own)], both[own])
    return np.asarray((both - normal[:, own] @ gone)[np.ix_(shared, np.append(shared, -1))])


def chosen(rows: _Rows, keep: Flags, poses: Integers | None = None) -> _Rows:
    """Give some of the rows; with `poses` (ascending) their poses numbered by the place in there."""
    given = {field.name: getattr(rows, field.name) for field in fields(rows)}
    parts: dict[str, Any] = {name: None if column is None else column[keep] for name, column in given.items()}
    if poses is not None:
        pose = rows.pose[keep]
        parts["pose"] = np.where(pose == ON_BELT, ON_BELT, np.searchsorted(poses, pose))
    return replace(rows, **parts)


@kernel
def add_rows(
    columns: Integers, values: Floats, residual: Floats, weight: Floats, normal: Floats, gradient: Floats
) -> None:
    """Add rows of a sparse Jacobian to JᵀWJ (n, n), of which the lower triangle alone, and JᵀWr (n,).

    `columns` (row, k) says which parameter each of the derivatives `values` (row, k) belongs to, −1 for none.
    """
    for row in range(columns.shape[0]):
        w = weight[row]
        if w == 0.0:
            continue
        for i in range(columns.shape[1]):
            a = columns[row, i]
            if a < 0:
                continue
            scaled = w * values[row, i]
            gradient[a] += scaled * residual[row]
            # symmetric: the lower triangle is enough
            for j in range(columns.shape[1]):
                b = columns[row, j]
                if 0 <= b <= a:
                    normal[a, b] += scaled * values[row, j]


@kernel
def row_variances(columns: Integers, values: Floats, covariance: Floats) -> Floats:
    """Give (row,) J C Jᵀ: the variance of what each row predicts, C being the parameters' covariance."""
    found = np.zeros(columns.shape[0])
    for row in range(columns.shape[0]):
        total = 0.0
        for i in range(columns.shape[1]):
            a = columns[row, i]
            if a < 0:
                continue
            for j in range(columns.shape[1]):
                b = columns[row, j]
                if b >= 0:
                    total += values[row, i] * covariance[a, b] * values[row, j]
        found[row] = total
    return found
