"""Visible volume from scattered points and the outline, by kriging.

Model. A body that is seen from above bulges to its rim, where it stands upright: the square of the height
over the rim, u = (Z − r)·|Z − r|, is smooth there, and of an ellipsoid it is a quadratic. So u is a
quadratic in X and Y plus a Gaussian process (Matérn 5/2), observed at the dots, and 0 along the outline,
which the camera sees at the rim's height. Rim height, reach and size of the process are those that make the
points likeliest (Rasmussen and Williams 2006, chapters 2 and 5). The volume is the integral of r + √u over
the footprint; its uncertainty comes from fields drawn from the process as the points leave it, from rims that
are likely as well, and from the outline. Points outside the outline contradict it, and are refused.

Without an outline the footprint is the points' convex hull, half a spacing larger, and there is no rim.

It fails where the product has holes or corners that no dot shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Reason, Shares, Surface, Volume
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Capabilities, StageOptions, VolumeEstimator
from roemetry_kernels.compiling import float_kernel, inlined, kernel
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.lens import sight_lines
from roemetry_kernels.robust_fit import solve
from roemetry_patterns.surface_points import Chosen, points_of, same_points_of

_SLICES_MIN = 3
"""Lines that show something of the product: a cross hair has two."""
_RIM_POINTS = 60  # of a contour, evenly spaced, that stand for all of it
_NODES = 40, 12
"""Lines over the footprint, nodes on each (Gauss in the angle whose sine is the place: of upright ends, too,
so few tell the integral to 0.05 %)."""
_RIMS = 12
"""Rim heights that are tried, from the belt upwards."""
_RIM_BELOW = 0.1
"""Share of the points that may lie below the highest rim tried: what is seen lies above the rim."""
_ALIKE = 15.0
"""Points that count as one where rims are weighed: a body is not quite the process, and errs alike around."""
_WEIGHT_MIN = 1e-3
"""Of the likeliest rim's, from which on a rim counts."""
_DECIMALS = 3
"""Of volumes that are compared, mm³: their equations are solved to a hundredth of that, more or less of it by
the library that solves them."""
_REACHES = (0.35, 0.7)
"""Of the root of the footprint's area, that the process can reach."""
_SIZES = (1.0, 3.0)
"""Of what the quadratic leaves, that the process can be."""
_TREND = 10.0
"""Of the process's size, that the quadratic's coefficients may be off: hardly bound, and not so free that the
covariance cannot be inverted to many digits."""
_DRAWS = 40
"""Fields drawn: their spread is known to 11 %."""
_OUTLINE_STD_PX = 0.3
"""Taken where the outliner does not say how sure its contour is."""
_ROUNDING = 1e-8
"""Of the field's variance, added to it: where points leave nothing open, rounding may leave less."""
_WIDER = 3.0
"""Of the spread of drawn fields: near the rim, where no point lies, bodies differ from the process by more
than it leaves open, above all flat ones."""
_LEAST_STD = 0.0015
"""Of the volume: what the model itself is off by where points lie close."""
_OUTSIDE_MAX = 0.12
"""Share of points that may lie outside the outline: of whole outlines at most 3 % do, of parts 60 %."""
OUTLINE = "outline"


class DotSurface(VolumeEstimator[StageOptions]):
    """Integrates the likeliest surface through points and outline over the footprint."""

    capabilities = Capabilities(relative_tolerance=0.05)

    @property
    def states_model_error(self) -> bool:
        """Whether all of the model's error is drawn."""
        return True

    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the visible volume; StageError where there are too few points or it is not positive."""
        scene = _scene_of(product)
        best, of_rims = _likeliest(scene)
        outside = ~_inside(scene.contour(best.rim_mm), scene.xyz_mm[:, :2])
        if outside.mean() > _OUTSIDE_MAX:
            raise StageError(
                f"{outside.mean():.0%} of the points on the product lie outside its outline",
                hint="is the plain-light image of this product, and did its outline come out in one piece?",
            )
        nodes = scene.nodes(best.rim_mm)
        volume = best.volume_mm3(nodes)
        if not volume > 0.0:
            raise StageError("the surface encloses nothing", hint="look at the coding and the belt's zero")
        budget = {
            "between dots": _WIDER * best.spread_mm3(nodes),
            "rim": of_rims,
            "model": _LEAST_STD * volume,
        }
        if scene.outlined:
            # an outline a pixel larger, with rim, reach and size as they were found
            wider = _larger(scene, product, 1.0)
            moved = _krige(wider, best.rim_mm, best.reach, best.size).volume_mm3(wider.nodes(best.rim_mm))
            budget[OUTLINE] = abs(moved - volume) * scene.outline_std_px
        else:
            budget["footprint"] = float(
                scene.length_mm() * np.median(scene.xyz_mm[:, 2]) * 0.25 * scene.spacing_mm
            )
        volume += _model_error(budget, rng)
        std = math.sqrt(sum(part**2 for part in budget.values()))
        near = _near(scene, nodes)
        part = nodes[:, 2] * np.abs(best.heights_mm(nodes[:, :2]))
        seen = float(part[near].sum() / part.sum())
        return Volume(
            visible_mm3=Estimate(volume, std, budget),
            true_mm3=None,
            shares=Shares(seen, 0.0, 1.0 - seen),
            reasons=() if scene.outlined else (_NO_OUTLINE,),
            solution=_Solution(best.rim_mm, best.reach, best.size, scene.chosen),
        )

    def redraw(self, product: Product, found: Volume, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate a product that has moved a little with points, rim, reach and size as they were found."""
        solution: _Solution = found.solution
        scene = _scene_of(product, solution.chosen)
        kriged = _krige(scene, solution.rim_mm, solution.reach, solution.size)
        volume = kriged.volume_mm3(scene.nodes(kriged.rim_mm)) + _model_error(found.visible_mm3.budget, rng)
        return replace(found, visible_mm3=replace(found.visible_mm3, value=volume))

    def surface(self, product: Product) -> Surface | None:
        """Give the surface over the footprint, line by line."""
        scene = _scene_of(product)
        best, _ = _likeliest(scene)
        nodes = scene.nodes(best.rim_mm, per_line=True)
        z = best.heights_mm(nodes[:, :2])
        grid = np.column_stack([nodes[:, :2], z]).reshape(-1, _NODES[1], 3)
        return Surface(grid, ~_near(scene, nodes).reshape(grid.shape[:2]))


_NO_OUTLINE = Reason(
    "no-outline", "no outline was found: the footprint is that of the dots, half a spacing larger"
)


class _Solution(NamedTuple):
    """What an estimate found, and goes on from."""

    rim_mm: float
    reach: float
    size: float
    chosen: Chosen


@dataclass(frozen=True, eq=False, slots=True)
class _Scene:
    """Points, and rays through the outline (or the hull on the belt)."""

    xyz_mm: Floats
    std_mm: Floats
    start_mm: Floats
    way: Floats
    """start_mm, way: (contour, 3) lines of sight."""
    outlined: bool
    outline_std_px: float
    chosen: Chosen

    @property
    def spacing_mm(self) -> float:
        """Distance of neighbouring points, as their number on the footprint says."""
        return math.sqrt(abs(_area(self.contour(0.0))) / len(self.xyz_mm))

    def rims(self) -> Floats:
        """Rim heights to be tried, mm."""
        if not self.outlined:
            return np.zeros(1)
        return np.linspace(0.0, float(np.quantile(self.xyz_mm[:, 2], _RIM_BELOW)), _RIMS)

    def contour(self, rim_mm: float) -> Floats:
        """Give (contour, 2) the border where the outline is seen at the rim's height."""
        # where the lines of sight are as high as the rim
        along = (rim_mm - self.start_mm[:, 2]) / self.way[:, 2]
        return self.start_mm[:, :2] + along[:, None] * self.way[:, :2]

    def length_mm(self) -> float:
        """Length of the border."""
        steps = np.roll(self.contour(0.0), -1, axis=0) - self.contour(0.0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def nodes(self, rim_mm: float, *, per_line: bool = False) -> Floats:
        """Give (n, 3) x, y and weight (mm²) over the footprint.

        `per_line`: as many on every line, from border to border.
        """
        angle, share = _evenly() if per_line else _gauss()
        reach = 0.499 if per_line else 0.5
        return np.asarray(_nodes_within(self.contour(rim_mm), reach * np.sin(angle), share, per_line))


@float_kernel
def _nodes_within(contour: Floats, place: Floats, share: Floats, per_line: bool) -> Floats:
    """Give what `_Scene.nodes` does of a contour.

    `place` and `share` are where the nodes of a line lie, from −0.5 to 0.5, and the share of its length that
    each counts.
    """
    count, many = contour.shape[0], place.size
    low_x, high_x, low, high = contour[0, 0], contour[0, 0], contour[0, 1], contour[0, 1]
    twice_area = 0.0
    for k in range(count):
        ahead = contour[k + 1 if k + 1 < count else 0]
        twice_area += contour[k, 0] * ahead[1] - contour[k, 1] * ahead[0]
        low_x, high_x = min(low_x, contour[k, 0]), max(high_x, contour[k, 0])
        low, high = min(low, contour[k, 1]), max(high, contour[k, 1])
    # lines run across what is long, so that nodes lie close to each other in both directions
    turned = not per_line and high_x - low_x > high - low
    if turned:
        contour, low, high = contour[:, ::-1].copy(), low_x, high_x
    step = (high - low) / _NODES[0]
    y = low + step * (np.arange(_NODES[0]) + 0.5)
    line, x = _crossings(contour, y)  # every line leaves the border as often as it enters it
    nodes, n, weight, k = np.empty((line.size // 2 * many, 3)), 0, 0.0, 0
    while k < line.size:
        last = k + 1
        # from border to border, or each stretch within it by itself
        while per_line and last + 1 < line.size and line[last + 1] == line[k]:
            last += 1
        wide = x[last] - x[k]
        for j in range(many):
            nodes[n, 0], nodes[n, 1] = x[k] + wide * (0.5 + place[j]), y[line[k]]
            nodes[n, 2] = step * wide * share[j]
            weight += nodes[n, 2]
            n += 1
        k = last + 1
    for k in range(n):
        # ends of the lines are between nodes
        nodes[k, 2] *= 0.5 * abs(twice_area) / weight
        if turned:
            nodes[k, 0], nodes[k, 1] = nodes[k, 1], nodes[k, 0]
    return nodes[:n].copy()


@kernel
def _crossings(contour: Floats, y: Floats) -> tuple[Integers, Floats]:
    """Give where lines of constant, rising `y` cross a closed contour: (n,) which line and x, both rising."""
    above = np.searchsorted(y, contour[:, 1])  # (contour,) the first line that is not below each point
    count = contour.shape[0]
    first = np.zeros(y.size + 1, np.int64)
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        for k in range(min(above[i], above[j]), max(above[i], above[j])):
            first[k + 1] += 1
    first = np.cumsum(first)
    line, x, end = np.empty(first[-1], np.int64), np.empty(first[-1]), first.copy()
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        for k in range(min(above[i], above[j]), max(above[i], above[j])):
            share = (y[k] - contour[i, 1]) / (contour[j, 1] - contour[i, 1])
            at, n = contour[i, 0] + share * (contour[j, 0] - contour[i, 0]), end[k]
            line[n] = k
            # sorted as they are put in
            while n > first[k] and x[n - 1] > at:
                x[n] = x[n - 1]
                n -= 1
            x[n] = at
            end[k] += 1
    return line, x


@lru_cache(maxsize=1)
def _gauss() -> tuple[Floats, Floats]:
    """Give angles of a line's nodes, and the share of its length that each counts."""
    angle, weight = (0.5 * np.pi * one for one in np.polynomial.legendre.leggauss(_NODES[1]))
    return angle, 0.5 * weight * np.cos(angle)


def _evenly() -> tuple[Floats, Floats]:
    """Give as many angles that divide a line for drawing, with the weights of `_gauss`."""
    return np.linspace(-0.5, 0.5, _NODES[1]) * np.pi, _gauss()[1]


def _scene_of(product: Product, chosen: Chosen | None = None) -> _Scene:
    """Give a product's points and border; `chosen` says which points, if they were chosen before."""
    outline, view = product.outline, product.view
    bare = outline is None or view is None  # then all points make the border
    same = None if chosen is None or bare else same_points_of(product.profiles, chosen)
    if chosen is not None and same is not None:
        (xyz, std), every_xy = same, np.empty((0, 2))
    else:
        # dots need not lie on several lines
        lines_min = _SLICES_MIN if product.calibration.rays is None else 1
        xyz, std, every_xy, chosen = points_of(product.profiles, product.number, lines_min)
    if outline is None and view is not None and len(view.cones):
        raise StageError(
            "circles need an outline, and none was found, or none that agrees with the light: between "
            "circles, and where they run along rows, no point shows where the product ends",
            hint="look at the plain-light image, and take both again; the recipe needs an outliner",
        )
    if outline is None or view is None:
        # upright lines on the hull of the points
        hull = _hull(every_xy)
        start = np.column_stack([hull, np.zeros(len(hull))])
        return _Scene(xyz, std, start, np.tile([0.0, 0.0, 1.0], (len(hull), 1)), False, math.nan, chosen)
    rows, columns = product.calibration.image_size
    contour = outline.xy_px
    if ((contour < 0.5) | (contour > np.array([columns, rows]) - 1.5)).any():
        raise StageError(
            "the product's outline reaches the image's edge: a part is not seen",
            hint="place it within the image",
        )
    start, way = sight_lines(view, outline)
    std_px = outline.xy_std_px if math.isfinite(outline.xy_std_px) else _OUTLINE_STD_PX
    return _Scene(xyz, std, start, way, True, std_px, chosen)


def _larger(scene: _Scene, product: Product, by_px: float) -> _Scene:
    """Give the scene with a larger outline."""
    assert product.outline is not None and product.view is not None
    contour = product.outline.xy_px
    start, way = product.view.rays(contour + by_px * _outwards(contour))
    return replace(scene, start_mm=start, way=way)


@dataclass(frozen=True, eq=False, slots=True)
class _Kriged:
    """The field u as points and border leave it."""

    rim_mm: float
    reach: float
    size: float
    log_likelihood: float
    place: Floats
    factor: Floats
    """Cholesky factor of the covariance of what is observed, in the lower triangle; above it is anything."""
    trend: Floats
    """(6,) mean of the quadratic's coefficients, by least squares: what is left is far smaller, and so is its
    rounding."""
    solved: Floats
    prior: Floats
    """(6,) the middle's x and y, half of the footprint's size, standard deviations of the quadratic's
    coefficients and of the process, and its reach, mm."""

    def field(self, xy: Floats) -> Floats:
        """Expected u at places (n, 2)."""
        return _expected(xy, self.place, self.solved, self.trend, self.prior)

    def heights_mm(self, xy: Floats) -> Floats:
        """Expected heights at places."""
        return _height(self.field(xy), self.rim_mm)

    def volume_mm3(self, nodes: Floats) -> float:
        """Integral of the expected surface."""
        return float(nodes[:, 2] @ self.heights_mm(nodes[:, :2]))

    def spread_mm3(self, nodes: Floats) -> float:
        """Standard deviation of the integral over fields drawn from what points and border leave open."""
        from scipy.linalg.blas import dsyrk, dtrsm
        from scipy.linalg.lapack import dpotrf

        # every second node tells the spread as well, at an eighth of the time
        some = nodes[::2]
        across = _covariance(some[:, :2], self.place, self.prior)
        known = dtrsm(1.0, self.factor, across.T, lower=1, overwrite_b=1)
        # what points and border leave of the prior's covariance, in the lower triangle alone
        left = _covariance(some[:, :2], some[:, :2], self.prior).T
        left = dsyrk(-1.0, known, beta=1.0, c=left, trans=1, lower=1, overwrite_c=1)
        own = np.einsum("ii->i", left)
        own += _ROUNDING * float(own.mean())
        # what `np.linalg.cholesky` calls after two thirds of its time
        drawn, failed = dpotrf(left, lower=1, overwrite_a=1)
        if failed:
            raise np.linalg.LinAlgError("the covariance that is left is not positive definite")
        fields = self.field(some[:, :2])[:, None] + drawn @ _draws(len(some))
        weight = some[:, 2] * nodes[:, 2].sum() / some[:, 2].sum()
        return float((weight @ _height(fields, self.rim_mm)).std(ddof=1))


@lru_cache(maxsize=4)
def _draws(count: int) -> Floats:
    """Give (count, draw) normal numbers: always the same, so that the same product gives the same volume."""
    return np.random.default_rng(0).standard_normal((count, _DRAWS))


_FIRST = _REACHES[1], _SIZES[1]
"""Reach and size with which rims are looked for."""


def _krige(scene: _Scene, rim_mm: float, reach: float = _FIRST[0], size: float = _FIRST[1]) -> _Kriged:
    """Condition the field on points and border."""
    from scipy.linalg.lapack import dpotrf, dpotrs

    contour = scene.contour(rim_mm)
    border = contour[_every(len(contour)) if scene.outlined else slice(0)]
    place, left, trend, prior, covariance, slope = _equations(
        scene.xyz_mm, scene.std_mm, contour, border, rim_mm, reach, size
    )
    factor, failed = dpotrf(covariance.T, lower=1, clean=0, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("the covariance of what is observed is not positive definite")
    solved = np.asarray(dpotrs(factor, left, lower=1)[0], np.float64)
    # of Z, not of u, the likelihood is compared over rims
    likelihood = -0.5 * float(left @ solved) - float(np.log(np.diag(factor)).sum()) + slope
    return _Kriged(rim_mm, reach, size, likelihood, place, factor, trend, solved, prior)


@lru_cache(maxsize=4)
def _every(count: int) -> Integers:
    """Give which of so many points of a contour stand for all of it."""
    return np.linspace(0, count - 1, _RIM_POINTS).astype(np.int64)


@float_kernel
def _equations(
    xyz_mm: Floats, std_mm: Floats, contour: Floats, border: Floats, rim_mm: float, reach: float, size: float
) -> tuple[Floats, Floats, Floats, Floats, Floats, float]:
    """Set up what is to be solved for a rim, and a process of that reach and size.

    Returns
    -------
    tuple
        (n, 2) places of points and border; (n,) what the quadratic leaves of u there; its (6,) coefficients;
        the prior as in `_Kriged`; (n, n) the covariance of what is observed, written from the diagonal to the
        right alone; and the sum of log |du/dZ|.
    """
    points, count = xyz_mm.shape[0], xyz_mm.shape[0] + border.shape[0]
    place, value, noise, slope = np.empty((count, 2)), np.zeros(count), np.empty(count), 0.0
    for k in range(points):
        place[k, 0], place[k, 1] = xyz_mm[k, 0], xyz_mm[k, 1]
        # du/dZ = 2 |Z − r|, and not less than what Z's noise makes of it near the rim
        over = xyz_mm[k, 2] - rim_mm
        steep = 2.0 * math.hypot(over, 2.0 * std_mm[k])
        value[k], noise[k] = over * abs(over), steep * std_mm[k]
        slope += math.log(steep)
    place[points:] = border
    # the border is as sure as points usually are
    noise[points:] = median_of(noise[:points])
    prior, trend, normal = np.empty(6), np.zeros(6), np.zeros((6, 6))
    low, high = contour[0].copy(), contour[0].copy()
    middle, twice_area = np.zeros(2), 0.0
    for k in range(contour.shape[0]):
        ahead = contour[k + 1 if k + 1 < contour.shape[0] else 0]
        twice_area += contour[k, 0] * ahead[1] - contour[k, 1] * ahead[0]
        for n in range(2):
            middle[n] += contour[k, n] / contour.shape[0]
            low[n], high[n] = min(low[n], contour[k, n]), max(high[n], contour[k, n])
    half_mm = 0.5 * max(high[0] - low[0], high[1] - low[1])
    powers = np.ones((count, 6))
    for k in range(count):
        x, y = (place[k, 0] - middle[0]) / half_mm, (place[k, 1] - middle[1]) / half_mm
        line = powers[k]
        line[1], line[2], line[3], line[4], line[5] = x, y, x * x, x * y, y * y
        for a in range(6):
            trend[a] += line[a] * value[k]
            for b in range(a + 1):
                normal[a, b] += line[a] * line[b]
    solve(normal, trend)
    left = value - powers @ trend
    # as large as what the quadratic leaves
    std = max(size * math.sqrt((left**2).mean()), 1e-3 * math.sqrt((value**2).mean()), 1e-6)
    prior[0], prior[1], prior[2] = middle[0], middle[1], half_mm
    prior[3], prior[4], prior[5] = _TREND * std, std, reach * math.sqrt(0.5 * abs(twice_area))
    covariance = np.empty((count, count))
    _fill(place, place, prior, covariance, True)
    for k in range(count):
        # the points' noise, and a little more against rounding
        covariance[k, k] = (covariance[k, k] + noise[k] ** 2 + (1e-3 * std) ** 2) * (1.0 + 1e-10)
    return place, left, trend, prior, covariance, slope


@inlined
def _matern(apart: float) -> float:
    """Give (1 + d + d²/3)·exp(−d) of a distance from 0 to some 20, in steps that a compiler takes by fours.

    The exponential is the series of exp(−d/64), to the seventh power, squared six times: right to 1e-8.
    """
    d = apart * (1.0 / 64.0)
    low = 1.0 - d * (1.0 - d * (1.0 / 2.0 - d * (1.0 / 6.0 - d * (1.0 / 24.0))))
    power = low - d**5 * (1.0 / 120.0 - d * (1.0 / 720.0 - d * (1.0 / 5040.0)))
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return (1.0 + apart * (1.0 + apart * (1.0 / 3.0))) * power


@float_kernel
def _covariance(one: Floats, other: Floats, prior: Floats) -> Floats:
    """Give (n, m) the prior's covariance between places; `prior` as in `_Kriged`."""
    found = np.empty((one.shape[0], other.shape[0]))
    _fill(one, other, prior, found, False)
    return found


@float_kernel
def _fill(one: Floats, other: Floats, prior: Floats, found: Floats, half: bool) -> None:
    """Write the covariance between places, from the diagonal on alone if it is asked for."""
    scale, trend, variance = math.sqrt(5.0) / prior[5], prior[3] ** 2, prior[4] ** 2
    # numbers of the prior are taken out of the loop: what is written might else be one of them
    middle_x, middle_y, half_mm = prior[0], prior[1], prior[2]
    x_mm, y_mm = other[:, 0].copy(), other[:, 1].copy()
    for i in range(one.shape[0]):
        at_x, at_y, line = one[i, 0], one[i, 1], found[i]
        x, y = (at_x - middle_x) / half_mm**2, (at_y - middle_y) / half_mm**2
        for j in range(i if half else 0, x_mm.size):
            across, down = x * (x_mm[j] - middle_x), y * (y_mm[j] - middle_y)
            # of 1, x, y, x², xy, y² with coefficients of variance 1
            quadratic = 1.0 + across + down + across * across + across * down + down * down
            apart = scale * math.sqrt((at_x - x_mm[j]) ** 2 + (at_y - y_mm[j]) ** 2)
            line[j] = trend * quadratic + variance * _matern(apart)


@float_kernel
def _expected(xy: Floats, place: Floats, solved: Floats, trend: Floats, prior: Floats) -> Floats:
    """Give (n,) the field at places: the trend, and the covariance with what is observed times `solved`."""
    found = np.empty(xy.shape[0])
    scale, variance = math.sqrt(5.0) / prior[5], prior[4] ** 2
    x_mm, y_mm = place[:, 0].copy(), place[:, 1].copy()
    # the prior's quadratic adds to the trend: its sums over what is observed are the same for all places
    whole = trend.copy()
    for j in range(x_mm.size):
        u, v = (x_mm[j] - prior[0]) / prior[2], (y_mm[j] - prior[1]) / prior[2]
        share = prior[3] ** 2 * solved[j]
        whole[0] += share
        whole[1] += share * u
        whole[2] += share * v
        whole[3] += share * u * u
        whole[4] += share * u * v
        whole[5] += share * v * v
    for i in range(xy.shape[0]):
        x, y = (xy[i, 0] - prior[0]) / prior[2], (xy[i, 1] - prior[1]) / prior[2]
        value = 0.0
        for j in range(x_mm.size):
            apart = scale * math.sqrt((xy[i, 0] - x_mm[j]) ** 2 + (xy[i, 1] - y_mm[j]) ** 2)
            value += solved[j] * _matern(apart)
        quadratic = whole[0] + x * (whole[1] + whole[3] * x + whole[4] * y) + y * (whole[2] + whole[5] * y)
        found[i] = quadratic + variance * value
    return found


def _likeliest(scene: _Scene) -> tuple[_Kriged, float]:
    """Give the likeliest surface, and the volume's spread over others that are likely as well, mm³.

    The rim is found first, among every second height and those beside the best, then reach and size. The
    spread is that over rims, and that over reaches and sizes.
    """
    rims = scene.rims()
    tried: dict[int, _Kriged] = {}

    def likelihood(at: int) -> float:
        if at not in tried:
            tried[at] = _krige(scene, float(rims[at]))
        return tried[at].log_likelihood

    # every second height first, then those beside the best
    top = max(range(0, rims.size, 2), key=likelihood)
    top = max((at for at in (top - 1, top, top + 1) if 0 <= at < rims.size), key=likelihood)
    others = [(reach, size) for reach in _REACHES for size in _SIZES if (reach, size) != _FIRST]
    at_top = [*(_krige(scene, float(rims[top]), *pair) for pair in others), tried[top]]
    best = max(at_top, key=lambda one: one.log_likelihood)
    return best, math.hypot(_spread_mm3(scene, [*tried.values()]), _spread_mm3(scene, at_top))


def _spread_mm3(scene: _Scene, tried: list[_Kriged]) -> float:
    """Give the standard deviation of the volumes of surfaces, each as likely as it is."""
    top = max(one.log_likelihood for one in tried)
    weight = [math.exp((one.log_likelihood - top) / _ALIKE) for one in tried]
    likely = [(one, share) for one, share in zip(tried, weight, strict=True) if share > _WEIGHT_MIN]
    volumes = np.array([one.volume_mm3(scene.nodes(one.rim_mm)) for one, _ in likely]).round(_DECIMALS)
    shares = np.array([share for _, share in likely])
    mean = float(shares @ volumes / shares.sum())
    return math.sqrt(float(shares @ (volumes - mean) ** 2 / shares.sum()))


@kernel
def _inside(contour: Floats, xy: Floats) -> Flags:
    """Say which places (n, 2) a closed contour encloses."""
    found = np.zeros(xy.shape[0], np.bool_)
    for k in range(contour.shape[0]):
        one, other = contour[k], contour[k + 1 if k + 1 < contour.shape[0] else 0]
        if one[1] == other[1]:
            # along a row no ray crosses it
            continue
        run = (other[0] - one[0]) / (other[1] - one[1])
        # each crossing to the right turns outside into inside
        for n in range(found.size):
            crossed = (one[1] <= xy[n, 1]) != (other[1] <= xy[n, 1])
            found[n] ^= crossed and one[0] + (xy[n, 1] - one[1]) * run > xy[n, 0]
    return found


def _height(field: Floats, rim_mm: float) -> Floats:
    return np.asarray(np.maximum(rim_mm + np.sign(field) * np.sqrt(np.abs(field)), 0.0))


def _model_error(budget: object, rng: np.random.Generator | None) -> float:
    """Draw all causes but the outline's place, which a run moves itself."""
    if rng is None:
        return 0.0
    return sum(std * rng.standard_normal() for cause, std in budget.items() if cause != OUTLINE)  # type: ignore[attr-defined]


def _near(scene: _Scene, nodes: Floats) -> np.ndarray:
    """Say which nodes have a dot within its own cell."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(scene.xyz_mm[:, :2]).query(nodes[:, :2])[0] < 0.75 * scene.spacing_mm)


def _area(contour: Floats) -> float:
    (x, y), ahead = contour.T, np.concatenate([contour[1:], contour[:1]])
    return 0.5 * float(x @ ahead[:, 1] - y @ ahead[:, 0])


def _outwards(contour: Floats) -> Floats:
    """Give (n, 2) unit normals of a contour, outwards."""
    ahead = np.roll(contour, -1, axis=0) - np.roll(contour, 1, axis=0)
    normal = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    normal /= np.maximum(np.hypot(normal[:, 0], normal[:, 1]), 1e-9)[:, None]
    return normal * (1.0 if _area(contour) > 0.0 else -1.0)


def _hull(xy: Floats) -> Floats:
    """Give the convex hull of points, half their spacing larger."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = xy[ConvexHull(xy).vertices]
    except QhullError as error:
        raise StageError("the points lie on one line: they enclose nothing") from error
    middle = hull.mean(axis=0)
    away = np.linalg.norm(hull - middle, axis=1)
    grown = 0.5 * math.sqrt(abs(_area(hull)) / len(xy))
    return np.asarray(middle + (hull - middle) * (1.0 + grown / away)[:, None])
