"""Local polynomials along each stripe: less noise, paid for in resolution.

Around each row a polynomial is fitted to the rows next to it by least squares with weights 1/s², s the
standard uncertainty of each position x:

    minimise Σ (x_j − c₀ − c₁ t_j − c₂ t_j²)² / s_j²,   t_j = row_j − row_i,   the smoothed position is c₀.

c₀ = Σ w_j x_j is linear in the positions, so its variance is Σ Σ w_j w_k s_j s_k exp(−Δ²/(4 ℓ²)), ℓ the
correlation length of the errors along the stripe in rows. A line with the bend c₂ of a window twice as wide
is tried first, then a parabola, then one over half of the rows; one that leaves more than the uncertainties
explain is not taken.

A stripe is cut where it steps: the height of a step beside a cubic over 8 rows on both sides, in its own
standard deviations; of all places the highest first, until none is above 4. A single row that a cubic through
the others does not foretell within 4.5 standard deviations, and that neither neighbour is like, is left out.

Assumed: the stated uncertainties are right; the surface is smooth over the window. Fails where detail is
shorter than the window but within its noise: it is smoothed away, and the reason `smoothed` says so.

Source: Savitzky, Golay (1964), Analytical Chemistry 36:1627; steps and the wider bend are ours.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import Field, field_validator

from roemetry.records import Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Smoother, StageOptions
from roemetry_kernels.compiling import kernel

_OF_SECOND_DIFFERENCE = 0.6745 * math.sqrt(6.0)  # median size of white noise's second differences
_POINTS_MIN = 3  # rows of a run: with fewer there is no second difference


class LocalPolynomialOptions(StageOptions):
    """Options of `LocalPolynomial`."""

    rows: int = Field(
        default=9,
        ge=3,
        le=201,
        description="rows (odd) that a line is put through; so long is what is no longer resolved",
    )

    @field_validator("rows")
    @classmethod
    def _odd(cls, rows: int) -> int:
        if rows % 2 == 0:
            raise ValueError(f"rows is {rows}, expected an odd number")
        return rows


class LocalPolynomial(Smoother[LocalPolynomialOptions]):
    """Puts a line, bent as a wider window is, through the rows around each; stops at breaks and steps."""

    def smooth(self, stripes: StripeMap) -> StripeMap:
        """Smooth what was seen; bridged points and labels stay as they are."""
        rows = self.options.rows
        x_px, x_std_px = stripes.x_px.copy(), stripes.x_std_px.copy()
        before: list[Floats] = []
        after: list[Floats] = []
        steps = 0
        for stripe in range(stripes.stripe_count):
            own_px = _scatter_px(stripes.x_px[stripe])
            for at in _runs(stripes, stripe, rows):
                position = stripes.x_px[stripe, at]
                stated = stripes.x_std_px[stripe, at]
                std = np.where(stated > 0.0, stated, own_px)
                points = Points(
                    at.astype(np.float64), position, std, np.ones(at.size, np.bool_), stripes.correlation_rows
                )
                out, out_std, kept = smoothed_run(points, rows)
                steps += kept
                x_px[stripe, at] = out
                x_std_px[stripe, at] = np.where(stated > 0.0, out_std, np.nan)
                before.append(std)
                after.append(out_std)
        if not before:
            return stripes
        kept = f"; {steps} steps kept" if steps else ""
        return replace(
            stripes,
            x_px=x_px,
            x_std_px=x_std_px,
            correlation_rows=_reach(np.concatenate(before), np.concatenate(after), stripes.correlation_rows),
            reasons=(
                *stripes.reasons,
                Reason(
                    "smoothed",
                    f"stripes are smoothed over {rows} rows: what is shorter along a stripe is not "
                    f"resolved{kept}",
                ),
            ),
        )


def _runs(stripes: StripeMap, stripe: int, rows: int) -> Iterator[Integers]:
    """Rows of each piece of a stripe that was seen, is one product or belt, and has no long gap."""
    seen = np.flatnonzero(stripes.seen[stripe])
    product = stripes.product[stripe, seen]
    breaks = np.flatnonzero((np.diff(product) != 0) | (np.diff(seen) > rows // 2)) + 1
    for run in np.split(seen, breaks):
        if run.size >= _POINTS_MIN:
            yield run


def _scatter_px(x_px: Floats) -> float:
    """Scatter of a stripe from its second differences, for points that state no uncertainty, px."""
    second = np.diff(x_px, 2)
    second = second[np.isfinite(second)]
    if not second.size:
        return 1.0
    return max(float(np.median(np.abs(second))) / _OF_SECOND_DIFFERENCE, 1e-6)


def _reach(before: Floats, after: Floats, length: float) -> float:
    """Correlation afterwards, rows: smoothing keeps the sum of the autocovariance and lowers the variance."""
    rows = np.arange(1, 1 + int(8 * length + 1))
    # sum of the autocorrelation along the stripe
    own = 1.0 + 2.0 * float(np.exp(-(rows**2) / (4.0 * length**2)).sum()) if length > 0.0 else 1.0
    left = float(np.median(after**2 / before**2))
    # for a Gaussian correlation that sum is 2√π times the length
    return max(own / left / (2.0 * math.sqrt(math.pi)), length) if left < 1.0 else length


_FEW = 3  # rows on either side, for a line and its scatter


class Points(NamedTuple):
    """One unbroken piece of a stripe, one element a point."""

    row: Floats
    x_px: Floats
    std_px: Floats
    """row, x_px, std_px: row, increasing; position and its standard uncertainty, px."""
    use: Flags
    """Whether a point counts: outliers are taken out in place."""
    length: float
    """Correlation of the errors along the stripe, rows, as in `Peaks.correlation_rows`."""


@kernel
def smoothed_run(points: Points, rows: int) -> tuple[Floats, Floats, int]:
    """Smooth a piece of a stripe by a line through `rows` rows.

    Returns
    -------
    tuple
        (point,) smoothed positions, px, their standard uncertainty, px; number of steps found and kept.
    """
    row, x_px = points.row, points.x_px
    n = row.shape[0]
    leave_outliers_out(points)
    begin = np.zeros(n, np.int64)  # where the piece between steps that a point lies in begins, and ends
    end = np.full(n, n, np.int64)
    steps = 0
    # the most certain step divides its piece; then the next one is looked for
    for _ in range(n):
        at = highest_step(points, begin, end)
        if at < 0:
            break
        steps += 1
        first, last = begin[at], end[at]
        for i in range(first, at):
            end[i] = at
        for i in range(at, last):
            begin[i] = at
    weights, other = np.zeros(n), np.zeros(n)
    out_px, out_std_px = x_px.copy(), points.std_px.copy()
    for i in range(n):
        for way in range(3):
            # A line with the bend of a wider window; a parabola; a parabola over half of the rows.
            first, last = nearest(row, begin[i], end[i], i, rows if way < 2 else rows // 2 + 1)
            low, high = first, last
            if way == 0:
                low, high = nearest(row, begin[i], end[i], i, 2 * rows - 1)
            if not _weights(points, i, first, last, low, high, way == 0, weights, other):
                continue
            # what does not fit is tried in the next, more pliant way
            if way < 2 and _misfit(points, i, first, last, low, high, way == 0, other):
                continue
            # a point that was left out and fits in no way stays as it is
            if way == 2 and not points.use[i]:
                continue
            value = 0.0
            for j in range(low, high):
                value += weights[j] * x_px[j]
            out_px[i] = value
            out_std_px[i] = math.sqrt(variance_of(points, weights, low, high, points.length))
            break
    return out_px, out_std_px, steps


@kernel
def _weights(
    points: Points,
    i: int,
    first: int,
    last: int,
    low: int,
    high: int,
    line: bool,
    weights: Floats,
    other: Floats,
) -> bool:
    """Weights on the points low … high that give the position at point i."""
    row = points.row
    for j in range(low, high):
        weights[j] = 0.0
    if not line:
        return functional(points, row[i], first, last, 3, -1, 0, weights)
    if not functional(points, row[i], first, last, 2, -1, 0, weights):
        return False
    # what a bend of 1 would do to the line's value here
    bent = 0.0
    for j in range(first, last):
        bent += weights[j] * (row[j] - row[i]) ** 2
    # the bend is that of the wider window
    if high - low > 2 * _FEW and functional(points, row[i], low, high, 3, -1, 2, other):
        for j in range(low, high):
            weights[j] -= bent * other[j]
    return True


@kernel
def _misfit(
    points: Points, i: int, first: int, last: int, low: int, high: int, line: bool, weights: Floats
) -> bool:
    """Whether what is left of the points first … last is more than their uncertainty explains."""
    row, x_px = points.row, points.x_px
    coefficients = np.zeros(3)
    for which in range(3):
        begin, end = (low, high) if line and which == 2 else (first, last)
        powers = 2 if line and which < 2 else 3
        if not functional(points, row[i], begin, end, powers, -1, which, weights):
            continue
        for j in range(begin, end):
            coefficients[which] += weights[j] * x_px[j]
    if line:
        # The line is put through what the bend leaves.
        for which in range(2):
            functional(points, row[i], first, last, 2, -1, which, weights)
            for j in range(first, last):
                coefficients[which] -= weights[j] * coefficients[2] * (row[j] - row[i]) ** 2
    return too_much(points, row[i], first, last, coefficients)


_STEP_REACH = 8  # rows on either side that a step is judged by
_STEP_STDS = 4.0  # a step is one if it is so many standard deviations high
_OUTLIER_STDS = 4.5  # a row is left out if it is so far from what its neighbours foretell
_FEW_AT_BREAK = 3  # rows of either side of a break: the same


@kernel
def highest_step(points: Points, begin: Integers, end: Integers) -> int:
    """First point behind the most certain step, or −1: a step beside a cubic over 8 rows on both sides."""
    row, x_px = points.row, points.x_px
    best, at = _STEP_STDS, -1
    weights = np.zeros(row.shape[0])
    for i in range(1, row.shape[0]):
        if begin[i] == i:
            continue
        first, last = i, i
        while first > begin[i] and row[i] - row[first - 1] <= _STEP_REACH:
            first -= 1
        while last < end[i] and row[last] - row[i] < _STEP_REACH:
            last += 1
        few = min(i - first, last - i)
        if few < _FEW_AT_BREAK:
            continue
        # As many on either side: so a bend, which is even, is not taken for a step, which is odd.
        first, last = i - few, i + few
        # a cubic, where there are enough rows; else a line
        powers = 4 if few > _FEW_AT_BREAK + 1 else 2
        if not functional(points, row[i], first, last, powers, i, powers, weights):
            continue
        height = 0.0
        for j in range(first, last):
            height += weights[j] * x_px[j]
        variance = variance_of(points, weights, first, last, 0.0)
        if height * height <= best * best * variance:
            continue
        # Correlation, which costs more to count, only makes a step less certain.
        variance = max(variance, variance_of(points, weights, first, last, points.length))
        if height * height > best * best * variance:
            best, at = abs(height) / math.sqrt(variance), i
    return at


@kernel
def leave_outliers_out(points: Points) -> None:
    """Mark points that a cubic through the others does not foretell while it fits these.

    A point beside a step has one neighbour that it is like; an outlier has none.
    """
    row, x_px, std_px, use = points.row, points.x_px, points.std_px, points.use
    n = row.shape[0]
    weights = np.zeros(n)
    for i in range(n):
        first, last = nearest(row, 0, n, i, 2 * _STEP_REACH + 1)
        if last - first < 2 * _FEW_AT_BREAK + 2:
            continue
        # the point itself does not help to foretell it
        use[i] = False
        if functional(points, row[i], first, last, 4, -1, 0, weights):
            foretold = 0.0
            for j in range(first, last):
                foretold += weights[j] * x_px[j]
            limit = _OUTLIER_STDS * std_px[i]
            alone = i == 0 or abs(x_px[i] - x_px[i - 1]) > 0.5 * limit
            alone = alone and (i == n - 1 or abs(x_px[i] - x_px[i + 1]) > 0.5 * limit)
            if alone and abs(x_px[i] - foretold) > limit and _fits(points, row[i], first, last):
                variance = variance_of(points, weights, first, last, points.length) + std_px[i] ** 2
                if abs(x_px[i] - foretold) > _OUTLIER_STDS * math.sqrt(variance):
                    continue
        use[i] = True


@kernel
def _fits(points: Points, centre: float, first: int, last: int) -> bool:
    """Whether a cubic leaves of the points no more than their uncertainty explains."""
    x_px = points.x_px
    weights, coefficients = np.zeros(x_px.shape[0]), np.zeros(4)
    for which in range(4):
        if not functional(points, centre, first, last, 4, -1, which, weights):
            return False
        for j in range(first, last):
            coefficients[which] += weights[j] * x_px[j]
    return not too_much(points, centre, first, last, coefficients)


_CORRELATED = 4.0  # lengths beyond which errors count as independent
_MISFIT_STDS = 4.0  # squares are too much if they exceed their expectation by so many standard deviations


@kernel
def nearest(row: Floats, begin: int, end: int, i: int, rows: int) -> tuple[int, int]:
    """Points of a window of `rows` rows around point i, moved inwards at the ends of its piece."""
    half = rows // 2
    top, bottom = row[i] - half, row[i] + half
    # at an end the window moves inwards and keeps its length
    if top < row[begin]:
        bottom += row[begin] - top
        top = row[begin]
    if bottom > row[end - 1]:
        top = max(top - (bottom - row[end - 1]), row[begin])
        bottom = row[end - 1]
    first, last = i, i + 1
    while first > begin and row[first - 1] >= top:
        first -= 1
    while last < end and row[last] <= bottom:
        last += 1
    return first, last


@kernel
def functional(
    points: Points,
    centre: float,
    first: int,
    last: int,
    powers: int,
    step_at: int,
    which: int,
    weights: Floats,
) -> bool:
    """Weights on points that give one coefficient of a polynomial, with a step from point `step_at` on.

    Rows are counted from `centre`. Writes ``weights[first:last]``; False where the points do not suffice.
    """
    row, std_px, use = points.row, points.std_px, points.use
    size = powers + (1 if step_at >= 0 else 0)
    # in shares of the window, so that all powers are of like size
    scale = max(abs(row[first] - centre), abs(row[last - 1] - centre), 1.0)
    normal = np.zeros((5, 6))
    basis = np.empty(5)
    count = 0
    for j in range(first, last):
        weights[j] = 0.0
        if not use[j]:
            continue
        count += 1
        _basis((row[j] - centre) / scale, powers, step_at >= 0, j >= step_at, basis)
        w = 1.0 / (std_px[j] * std_px[j])
        for k in range(size):
            for m in range(size):
                normal[k, m] += w * basis[k] * basis[m]
    if count < size:
        return False
    # one row of the inverse by Gauss and Jordan's elimination, with pivots
    normal[which, 5] = 1.0
    for k in range(size):
        pivot = k
        for m in range(k + 1, size):
            if abs(normal[m, k]) > abs(normal[pivot, k]):
                pivot = m
        # as good as singular
        if abs(normal[pivot, k]) < 1e-10 * abs(normal[0, 0]) or normal[pivot, k] == 0.0:
            return False
        for m in range(6):
            normal[k, m], normal[pivot, m] = normal[pivot, m], normal[k, m]
        for m in range(size):
            if m != k:
                factor = normal[m, k] / normal[k, k]
                for c in range(k, 6):
                    normal[m, c] -= factor * normal[k, c]
    # back from shares of the window to rows
    unit = scale ** (-which) if which < powers else 1.0
    for j in range(first, last):
        if use[j]:
            _basis((row[j] - centre) / scale, powers, step_at >= 0, j >= step_at, basis)
            total = 0.0
            for k in range(size):
                total += basis[k] * normal[k, 5] / normal[k, k]
            weights[j] = unit * total / (std_px[j] * std_px[j])
    return True


@kernel
def _basis(t: float, powers: int, stepped: bool, behind: bool, basis: Floats) -> None:
    value = 1.0
    for k in range(powers):
        basis[k] = value
        value *= t
    if stepped:
        basis[powers] = 1.0 if behind else 0.0


@kernel
def variance_of(points: Points, weights: Floats, low: int, high: int, length: float) -> float:
    """Variance of a weighted sum of points whose errors correlate by exp(−Δ²/(4 length²)), px²."""
    row, std_px = points.row, points.std_px
    total = 0.0
    for j in range(low, high):
        own = weights[j] * std_px[j]
        total += own * own
        if length <= 0.0:
            continue
        for k in range(j + 1, high):
            off = row[k] - row[j]
            # beyond, less than e^(−4) is left of the correlation
            if off > _CORRELATED * length + 1.0:
                break
            total += 2.0 * own * weights[k] * std_px[k] * math.exp(-off * off / (4.0 * length * length))
    return max(total, 0.0)


@kernel
def too_much(points: Points, centre: float, first: int, last: int, coefficients: Floats) -> bool:
    """Whether what a polynomial leaves of the points is more than their uncertainty explains."""
    row, x_px, std_px, use = points.row, points.x_px, points.std_px, points.use
    squares, count = 0.0, 0
    for j in range(first, last):
        if use[j]:
            t = row[j] - centre
            off = x_px[j]
            power = 1.0
            for k in range(coefficients.shape[0]):
                off -= coefficients[k] * power
                power *= t
            squares += (off / std_px[j]) ** 2
            count += 1
    free = max(count - coefficients.shape[0] + 1, 1)
    # n squares of normal deviates have mean n and variance 2 n
    return squares > free + _MISFIT_STDS * math.sqrt(2.0 * free)
