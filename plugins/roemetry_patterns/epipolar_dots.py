"""Which ray made each dot: by its epipolar line, and where two rays may have, by its neighbours.

Model. Each ray is seen along a short curve, from the belt up to the greatest height. A dot whose image lies
on it, by the dot's own covariance, is a candidate, with the height that the ray has there. A pattern whose
columns lean keeps these curves apart, and most dots have one candidate. Where there are more, the
neighbours of the ray in the pattern decide: surfaces are continuous, so heights of neighbouring rays differ
by no more than their distance times a steep slope, and a candidate costs its misfit and, for each
neighbour, the least that any of the neighbour's candidates costs beside it (min-sum on the pattern's graph;
Kschischang, Frey, Loeliger 2001).

A label is given where the next best one costs more by what makes it improbable, and above the belt only if
two neighbours in the pattern confirm its height, or all where fewer have a label; else it is ambiguous.
If too few dots lie on any ray, or too few rays are seen, the pattern is not the calibrated one, and the
frame is refused.

It fails where false light falls onto the curve of a ray whose own dot is hidden, at a height that its
neighbours confirm.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import (
    AMBIGUOUS,
    BELT,
    EDGE,
    NOTHING,
    UNLABELLED,
    WIDE,
    Dots,
    Peaks,
    Rays,
    StripeMap,
)
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.light import at_height
from roemetry.records.view import View
from roemetry.stages import Capabilities, Coder, StageOptions
from roemetry_kernels.compiling import kernel
from roemetry_kernels.rays import meet_rays

_OFF_MAX = 5.0
"""Standard deviations that a dot may lie off the curve of its ray."""
_MODEL_PX = 0.06
"""Beside a dot's own covariance: what dots on slopes and edges are off their rays by."""
_NODES = 5
"""Places of a ray's curve in the image, straight in between."""
_BENT_PX = 0.5
"""That a curve may lie beside these straight parts: a lens that bends lines by 8 px leaves 0.3 px."""
_CUT_PX = 0.4
"""Standard uncertainty of the centre of a dot that a product's edge has cut: a third of a dot's size."""
_CUT_OFF_MAX = 2.5
"""Of these, that it may lie off its ray's curve: of what a ray's light makes elsewhere a third is nearer."""
_BELOW_MM, _ABOVE = 1.0, 0.05
"""Candidates reach below the belt by so much, and above the greatest height by this share of it."""
_STEEP = 2.0
"""Slope of surfaces, in heights per distance, that costs 1: 63°."""
_BROKEN = 9.0
"""The most that a neighbour can cost: where it is over an edge, or has no candidate, nothing is known."""
_EVIDENCE_MIN = 12.0
"""Cost of the next best label over the best, from which on a label is given: odds of 1 to 400."""
_CONFIRMED_MIN = 2
"""Neighbours on a surface that is less steep, of those that have a label. Of 1,038 dots on products all that
were right have two; two cut dots on the rays of others, 28 mm too high, confirmed each other alone."""
_ROUNDS = 4  # in which each dot's costs take in what its neighbours cost
_ON_RAY_MIN = 0.6
"""Share of the dots that must lie on some ray's curve: of another pattern's, a fifth does."""
_SEEN_MIN = 0.55
"""Share of the rays that must be seen: every second dot may not be missing."""
_TOGETHER_MIN = 4
"""Dots that lie above the belt and are neighbours; of fewer none is a product."""


class EpipolarDotsOptions(StageOptions):
    """What is belt, and what a product."""

    product_min_mm: float = Field(
        default=0.5, gt=0.0, le=100.0, description="height from which on a dot lies on a product, mm"
    )


class EpipolarDots(Coder[EpipolarDotsOptions]):
    """Labels dots by the rays of the calibration."""

    capabilities = Capabilities(pattern="dots")

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Label the dots.

        Raises
        ------
        StageError
            There is no calibration with rays, peaks are of lines, or the dots are another pattern's.
        """
        if calibration is None or calibration.rays is None or calibration.view is None:
            raise StageError("the calibration has no rays of dots", hint="calibrate with pinhole-dots")
        if peaks.dots is None:
            raise StageError("the extractor finds lines, not dots", hint="set stages.extractor to dots")
        rays, view = calibration.rays, calibration.view
        lines = rays.moved(calibration.parameters)
        usable = np.flatnonzero((peaks.flags & (EDGE | WIDE)) == 0)
        low, high = calibration.height_range_mm
        reach_mm = low - _BELOW_MM, high * (1.0 + _ABOVE)
        found = candidates(peaks, usable, view, lines, rays, reach_mm)
        _refuse_other_pattern(found, usable.size, lines)
        evidence, best = decided(found, lines.shape[:2])
        # what an edge has cut lies off its ray: it is asked where a ray is free, and is that much less sure
        cut = np.setdiff1d(np.flatnonzero((peaks.flags & EDGE) == 0), found.dot)
        peaks = _wider(peaks, cut)
        more = candidates(peaks, cut, view, lines, rays, reach_mm)
        free = ~np.isin(more.ray, found.ray[best]) & (more.misfit < _CUT_OFF_MAX)
        more = Candidates._make(one[free] for one in more)
        if more.dot.size:
            found = Candidates._make(np.concatenate(pair) for pair in zip(found, more, strict=True))
            evidence_of_all, best_of_all = decided(found, lines.shape[:2])
            evidence = np.append(evidence, evidence_of_all[evidence.size :])
            best = np.append(best, best_of_all[best.size :])
        return _map(peaks, calibration, found, best, evidence, self.options.product_min_mm)


def _wider(peaks: Peaks, cut: Integers) -> Peaks:
    """Add to the covariance of dots what an edge moves their centres by."""
    assert peaks.dots is not None
    covariance = peaks.dots.covariance_px2.copy()
    covariance[cut] = np.nan_to_num(covariance[cut]) + _CUT_PX**2 * np.eye(2)
    return replace(
        peaks,
        x_std_px=np.sqrt(covariance[:, 0, 0]),
        dots=replace(peaks.dots, covariance_px2=covariance),
    )


class Candidates(NamedTuple):
    """Rays that may have made dots, in the order of dots."""

    dot: Integers
    """(n,) which peak."""
    ray: Integers
    """(n,) stripe · lines + line."""
    xyz_mm: Floats
    """(n, 3) where the dot would be."""
    foot_mm: Floats
    """(n, 2) where the ray meets the belt."""
    misfit: Floats
    """(n,) standard deviations off the ray's curve."""
    x_std_px: Floats
    """(n,) error of x alone that moves the height as the dot's whole error does."""
    height_std_mm: Floats


def candidates(
    peaks: Peaks, usable: Integers, view: View, lines: Floats, rays: Rays, reach_mm: tuple[float, float]
) -> Candidates:
    """Find the rays on whose curves dots lie."""
    assert peaks.dots is not None
    flat = lines.reshape(-1, 4)
    xy = np.column_stack([peaks.x_px, peaks.dots.y_px])
    heights = np.linspace(*reach_mm, _NODES)
    every = at_height(np.repeat(flat, _NODES, axis=0), np.tile(heights, len(flat)))
    curve = view.project(every).reshape(len(flat), _NODES, 2)
    near = _OFF_MAX * (_MODEL_PX + float(np.nan_to_num(peaks.x_std_px[usable]).max(initial=0.0)))
    pairs = _near_curves(xy[usable], curve, near + _BENT_PX)
    dot, ray = usable[pairs[:, 0]], pairs[:, 1]
    covariance = peaks.dots.covariance_px2[dot] + _MODEL_PX**2 * np.eye(2)
    own = rays.covariance.reshape(-1, 4, 4)[ray]
    met = meet_rays(view, flat[ray], xy[dot], covariance, own)
    with np.errstate(invalid="ignore"):
        good = (met.misfit < _OFF_MAX) & (met.z_mm > reach_mm[0]) & (met.z_mm < reach_mm[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x_std = met.z_std_mm / np.abs(met.z_by_px[:, 0])
    place = at_height(flat[ray], met.z_mm)
    return Candidates(
        dot[good],
        ray[good],
        place[good],
        flat[ray[good], :2],
        met.misfit[good],
        x_std[good],
        met.z_std_mm[good],
    )


@kernel
def _near_curves(xy_px: Floats, curve_px: Floats, near_px: float) -> Integers:
    """Give (n, 2) which dots lie near which curves (ray, node, 2); none near one that is not known."""
    found = np.empty((xy_px.shape[0] * 8, 2), np.int64)
    count = 0
    for dot in range(xy_px.shape[0]):
        for ray in range(curve_px.shape[0]):
            # first the box around the curve's ends
            first, last = curve_px[ray, 0], curve_px[ray, -1]
            if not (
                min(first[0], last[0]) - near_px < xy_px[dot, 0] < max(first[0], last[0]) + near_px
                and min(first[1], last[1]) - near_px < xy_px[dot, 1] < max(first[1], last[1]) + near_px
            ):
                continue
            near = False
            for node in range(curve_px.shape[1] - 1):
                one, other = curve_px[ray, node], curve_px[ray, node + 1]
                way_x, way_y = other[0] - one[0], other[1] - one[1]
                off_x, off_y = xy_px[dot, 0] - one[0], xy_px[dot, 1] - one[1]
                # the nearest place of each straight part
                share = (off_x * way_x + off_y * way_y) / max(way_x**2 + way_y**2, 1e-12)
                share = min(max(share, 0.0), 1.0)
                if (off_x - share * way_x) ** 2 + (off_y - share * way_y) ** 2 < near_px**2:
                    near = True
            if near:
                if count == found.shape[0]:
                    found = np.concatenate((found, np.empty_like(found)))
                found[count, 0], found[count, 1] = dot, ray
                count += 1
    return found[:count]


def _refuse_other_pattern(found: Candidates, dots: int, lines: Floats) -> None:
    columns, count = lines.shape[:2]
    known = int(np.isfinite(lines[..., 0]).sum())
    on_ray = np.unique(found.dot).size
    said = f"the calibration knows {columns} columns of {count} dots"
    if dots and on_ray < _ON_RAY_MIN * dots:
        raise StageError(
            f"{on_ray} of {dots} dots lie where a ray of the calibration can be seen: {said}",
            hint="another pattern, columns and lines exchanged, a turned image, or a rig that has moved?",
        )
    if on_ray < _SEEN_MIN * known:
        raise StageError(
            f"{on_ray} dots are seen on {known} rays: {said}",
            hint="are dots missing, too faint, or saturated? See the extractor's options",
        )


def decided(found: Candidates, shape: tuple[int, int]) -> tuple[Floats, Flags]:
    """Give of each candidate the cost of the best other label over its own, and whether it is the best.

    `shape` is that of the pattern: columns and lines.
    """
    partner, step = _neighbours(found, shape)
    own = found.misfit**2
    cost = own.copy()
    for _ in range(_ROUNDS):
        # what a neighbour's candidate costs beside its dot's best one counts too
        beside = cost - _least(cost, found.dot)
        cost = own.copy()
        for other, apart in zip(partner, step, strict=True):
            cost += np.where(other >= 0, np.minimum(apart + beside[other], _BROKEN), _BROKEN).min(
                axis=1, initial=_BROKEN
            )
    evidence = _second(cost, found.dot) - cost
    best = np.flatnonzero(evidence > 0.0)
    # of two dots that want the same ray, one is wrong
    evidence[best] = np.minimum(evidence[best], _second(cost[best], found.ray[best]) - cost[best])
    return evidence, evidence > 0.0


def _neighbours(found: Candidates, shape: tuple[int, int]) -> tuple[list[Integers], list[Floats]]:
    """Give, for each of four directions, (n, k) candidates of the neighbouring ray, −1 of none, and costs."""
    columns, lines = shape
    of_ray: list[list[int]] = [[] for _ in range(columns * lines)]
    for number, ray in enumerate(found.ray.tolist()):
        of_ray[ray].append(number)
    most = max((len(one) for one in of_ray), default=1)
    # rows of rays with fewer candidates are filled up; the last row is that of no ray
    table = np.full((columns * lines + 1, max(most, 1)), -1)
    for ray, one in enumerate(of_ray):
        table[ray, : len(one)] = one
    stripe, line = np.divmod(found.ray, lines)
    partners, costs = [], []
    for right, down in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        inside = (
            (stripe + right >= 0) & (stripe + right < columns) & (line + down >= 0) & (line + down < lines)
        )
        other = table[np.where(inside, (stripe + right) * lines + line + down, columns * lines)]
        # along the surface: from ray to ray at the same height, for the point itself moves with its height
        apart = np.linalg.norm(found.foot_mm[other] - found.foot_mm[:, None], axis=2)
        rise = found.xyz_mm[other, 2] - found.xyz_mm[:, None, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            cost = (rise / (_STEEP * np.maximum(apart, 1e-6))) ** 2
        # one dot cannot be both
        cost = np.where(found.dot[other] == found.dot[:, None], _BROKEN, cost)
        partners.append(other)
        costs.append(cost)
    return partners, costs


def _confirmed(found: Candidates, sure: Integers, shape: tuple[int, int]) -> Flags:
    """Say of each label whether two neighbours, or all of fewer, lie with it on no steep surface."""
    partner, step = _neighbours(Candidates._make(one[sure] for one in found), shape)
    there = np.sum([(other >= 0).any(axis=1) for other in partner], axis=0)
    agree = np.sum(
        [((other >= 0) & (cost < 1.0)).any(axis=1) for other, cost in zip(partner, step, strict=True)], axis=0
    )
    return np.asarray(agree >= np.minimum(there, _CONFIRMED_MIN))


def _raised(found: Candidates, sure: Integers, least_mm: float) -> Flags:
    """Say which labels lie above the belt."""
    return np.asarray(found.xyz_mm[sure, 2] > np.maximum(least_mm, 4.0 * found.height_std_mm[sure]))


def _least(cost: Floats, of: Integers) -> Floats:
    least = np.full(int(of.max(initial=-1)) + 1, np.inf)
    np.minimum.at(least, of, cost)
    return np.asarray(least[of])


def _second(cost: Floats, of: Integers) -> Floats:
    """Give the least cost among the others of the same group; without others, that of no label at all."""
    order = np.lexsort((cost, of))
    group, value = of[order], cost[order]
    if not group.size:
        return cost
    first = np.ones(group.size, np.bool_)
    first[1:] = group[1:] != group[:-1]
    start = np.maximum.accumulate(np.where(first, np.arange(group.size), 0))
    # without a label a dot costs as much as one far off, of which no neighbour knows
    nothing = _OFF_MAX**2 + 4.0 * _BROKEN
    beyond = np.minimum(start + 1, group.size - 1)
    runner_up = np.where((beyond > start) & (group[beyond] == group), value[beyond], nothing)
    second = np.empty(group.size)
    second[order] = np.where(first, runner_up, value[start])
    return second


def _map(
    peaks: Peaks, calibration: Calibration, found: Candidates, best: Flags, evidence: Floats, least_mm: float
) -> StripeMap:
    assert calibration.rays is not None and peaks.dots is not None
    columns, lines = calibration.rays.stripe_count, calibration.rays.line_count
    shape = columns, peaks.image_size[0]
    sure = np.flatnonzero(best & (evidence >= _EVIDENCE_MIN))
    # of two dots that one column has in a row the surer stays
    sure = sure[np.argsort(-evidence[sure], kind="stable")]
    place = np.column_stack([found.ray[sure] // lines, peaks.row[found.dot[sure]]])
    sure = sure[np.sort(np.unique(place, axis=0, return_index=True)[1])]
    sure = sure[~_raised(found, sure, least_mm) | _confirmed(found, sure, (columns, lines))]
    stripe, line = np.divmod(found.ray[sure], lines)
    dot = found.dot[sure]
    row = peaks.row[dot]
    number = _numbered(found, sure, (columns, lines), least_mm)
    kept = number >= 0
    sure, stripe, line, dot, row, number = (one[kept] for one in (sure, stripe, line, dot, row, number))

    def dense(values: Floats, *inner: int) -> Floats:
        made = np.full((*shape, *inner), np.nan)
        made[stripe, row] = values
        return made

    x_px = dense(peaks.x_px[dot])
    product = np.full(shape, NOTHING, np.int16)
    product[stripe, row] = number
    line_at = np.full(shape, -1, np.int16)
    line_at[stripe, row] = line
    peak_stripe = np.full(len(peaks), UNLABELLED, np.int16)
    open_dots = np.setdiff1d(found.dot, dot)
    peak_stripe[open_dots] = AMBIGUOUS
    peak_stripe[dot] = stripe
    ambiguous = np.zeros(shape, np.bool_)
    doubtful = np.isin(found.dot, open_dots)
    ambiguous[found.ray[doubtful] // lines, peaks.row[found.dot[doubtful]]] = True
    return StripeMap(
        x_px=x_px,
        x_std_px=dense(found.x_std_px[sure]),
        product=product,
        seen=np.isfinite(x_px),
        margin=dense(np.tanh(evidence[sure] / 4.0)),
        ambiguous=ambiguous,
        rest_px=calibration.rest_line_px(np.arange(shape[1], dtype=np.float64)),
        peak_stripe=peak_stripe,
        dots=Dots(dense(peaks.dots.y_px[dot]), dense(peaks.dots.covariance_px2[dot], 2, 2), line_at),
    )


def _numbered(found: Candidates, sure: Integers, shape: tuple[int, int], least_mm: float) -> Integers:
    """Give each labelled dot 0 on the belt, 1…n on products, −1 where it lies above the belt alone."""
    from scipy.ndimage import binary_dilation, label

    high = np.zeros(shape, np.bool_)
    at = np.divmod(found.ray[sure], shape[1])
    raised = _raised(found, sure, least_mm)
    high[at[0][raised], at[1][raised]] = True
    # dots in a shadow or of a wrong shape are missing: neighbours of neighbours belong together
    parts = label(binary_dilation(high, np.ones((3, 3))), np.ones((3, 3)))[0] * high
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    kept = np.flatnonzero(sizes >= _TOGETHER_MIN)
    number = np.full(sizes.size, NOTHING)
    number[kept] = np.arange(1, kept.size + 1)
    return np.where(raised, number[parts[at]], BELT)
