"""Whether an outline in the plain image and the light on the product agree.

What is seen of a stripe on the product ends on or inside the outline, and where it goes on along the belt it
lies outside: each end brackets the edge. Shadow and lens open brackets, but never shift them, and on the side
that faces the light stripes reach the outline. So of all ends around it

    σ = max(2·mean(max(−p_free, 0)), q10(p), q90(b)) − what a stripe's own width leaves open,

where p and b are how far inside the outline a product's end and the belt's next point lie, and `free` the
edge that the image shows without the stripes' bounds. An edge too far inside leaves about half of the ends
outside: hence the 2. It joins the outline's uncertainty. Where the belt's texture does not say how the images
lie over each other (`laid_over`), the plain one may be of another scale, and the edge is off all around:
light on product and belt ends at the same distance from a sound edge, so that it is too far inside by

    δ = (q90(−p_free) − q90(b_free)) / 2,   or q90(−p_free), where a shadow lies all around the product,

and σ is δ at least. An outline that is off by more but agrees when it is
shifted (belt or camera moved between the images) is left out. Where no shift explains it, or where the body
in the plain image goes on far beyond all stripes, one of the images lies (rows of the laser image are lost,
the plain image is another product's or of another scale), nobody knows which, and the product is refused.

Of a grid both families' lines have ends. Circles have few, so that all of their points are asked, and all of
their light in the laser image (`circle_light`). Dots leave some pixels free on both sides of an outline
(`DotBrackets`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from roemetry.records import Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Labels
from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import quantile_of
from roemetry_volume.circle_light import CircleLight
from roemetry_volume.edge_search import Scene, unbound
from roemetry_volume.footprint import area_of, inside_by

LEAST_ROWS = 5
"""Shorter pieces beside the product are glare in its shadow as often as not; on it they are not needed."""
_TENTH = 0.1
"""Of the ends: one side of a contour has more of them, mistaken labels have fewer."""
_LEAST_ENDS = 8  # four stripes: of three, one may lie in the shadow, and none need reach the outline
_END_PX = 0.5  # a stripe's end is seen to a row, that is half a pixel either way
_STRAY_PX, _FARTHEST_PX = 5.0, 2.5
"""A single end farther outside than an edge is searched for is glare or a mistaken label; none counts for
more than half of that."""
_RIM_ROWS = 6
"""Between a circle's end on a product and the belt, where the rim lies between: what a rim blurs."""
_STRIP_SHARE = 0.02
"""Of a product's points on circles, the outermost: more than mistaken labels, and all of them at the rim."""
_CUT = 9.0
"""Of the usual variance: the centre of a dot that a rim has cut, uncertain by as much, tells no side."""
_TOUCHES_PX = 1.0
"""Light of circles that ends at an edge lies 0.2 to 0.8 px on its right side, as `CircleLight.off_px` says:
light farther away does not reach it."""
_BY_CHANCE = 2.6
"""Standard deviations by which dots lie nearer to one side of one sound outline in a hundred."""
CONTRADICTION_PX = 0.75
"""Standard uncertainty from which an outline says less than stripes do: 3 % of a product 50 px wide."""

_SHIFT_MAX_PX, _SHIFT_STEP_PX = 12.0, 3.0
"""Shifts between the images that are tried: farther, the edge is not found around the stripes."""


class Brackets(Protocol):
    """What lies on both sides of a product's outline."""

    def disagreement_px(self) -> tuple[float, float]:
        """Say how far the outline is from what they allow, and how far of it nothing else explains."""
        ...

    def contradiction_left_px(self) -> float:
        """Say how far they contradict the outline when it is shifted as well as it may be."""
        ...


def brackets_of(
    scene: Scene,
    ring: Floats,
    stripes: StripeMap,
    number: int,
    light: CircleLight | None = None,
    *,
    placed: bool = False,
) -> Brackets | None:
    """Find what brackets a product's outline (point, 2) px; None of too little.

    `light` is that of circles, all around them; `placed` says that the belt's texture tells how the plain
    image lies over the laser image.
    """
    if stripes.circles:
        return _curves_of(scene, ring, stripes, number, light)
    if stripes.dots is not None:
        return _dots_of(scene, ring, stripes, number)
    return _ends_of(ring, unbound(scene, ring), stripes, number, placed=placed)


class _EndBrackets(NamedTuple):
    """A product's outline in plain light, and what brackets it: stripes' ends and the belt's next points.

    `ring` is the outline, `free` the edge that the image shows without the stripes' bounds, (point, 2) px;
    `ends` (end, 2) px lie on the product, `beyond` (end, 2) px next to it on the belt. `of_grid` says that
    they lie all around, also where the product turns away from the light, and no end reaches the outline: a
    tenth of them is those that do. `placed`: see `brackets_of`.
    """

    ring: Floats
    free: Floats
    ends: Floats
    beyond: Floats
    of_grid: bool
    placed: bool

    def disagreement_px(self) -> tuple[float, float]:
        """Say how far the outline is from what the ends allow, standard uncertainty.

        And how far of it nothing but a wrong outline explains: ends that lie outside it, belt that lies
        inside. Ends that stop short of it may be those of a body that turns away from light and camera, as a
        ball does.
        """
        off = -inside_by(self.free, self.ends)
        near = off < _STRAY_PX
        outside = 2.0 * float(np.clip(off[near], 0.0, _FARTHEST_PX).mean()) if near.any() else math.inf
        astray = quantile_of(off, 1.0 - _TENTH)
        if astray > _STRAY_PX or self.of_grid:  # more of them than glare and mistaken labels make
            outside = max(outside, astray)
        # the tenth that reaches farthest still lies so far inside
        short = quantile_of(inside_by(self.ring, self.ends), _TENTH)
        over = -math.inf
        if len(self.beyond) >= _LEAST_ENDS:
            over = quantile_of(inside_by(self.ring, self.beyond), 1.0 - _TENTH)
        against = max(float(max(outside, over)) - _END_PX, 0.0)
        within = 0.0 if self.placed else self._too_far_inside_px(astray)
        return max(float(short) - _END_PX, within, against), against

    def _too_far_inside_px(self, astray_px: float) -> float:
        """Say how far the edge is too far inside, were light on both of its sides to end alike."""
        next_px = -math.inf
        if len(self.beyond) >= _LEAST_ENDS:
            next_px = quantile_of(inside_by(self.free, self.beyond), 1.0 - _TENTH)
        off_px = 0.5 * (astray_px - next_px) if next_px > -_FARTHEST_PX else astray_px
        return min(off_px, _FARTHEST_PX)

    def contradiction_left_px(self) -> float:
        """Say how far nine in ten ends and belt points contradict the best shifted edge at most."""

        def left_px(shift_px: Floats) -> float:
            # shifting the image one way is shifting the ends the other way
            outside = -inside_by(self.free, self.ends - shift_px)
            inside = inside_by(self.free, self.beyond - shift_px) if len(self.beyond) else outside
            return max(float(quantile_of(which, 1.0 - _TENTH)) for which in (outside, inside))

        return _best_shifted(left_px)


class DotBrackets(NamedTuple):
    """A product's outline in plain light, and (dot, 2) px dots on the product and on the belt near it."""

    ring: Floats
    free: Floats
    on: Floats
    beside: Floats
    spacing_px: float

    def disagreement_px(self) -> tuple[float, float]:
        """Say how far the outline is from what the dots allow, and how far of it nothing else explains.

        A dot that the rim cuts is none: both sides of it keep their distance, and an outline that is off by δ
        lies nearer to one side's dots. Of n border dots, a spacing s apart, the second nearest lies within
        2s/n, give or take √2·s/n, so that half of the difference of both sides is uncertain by s/n; it is
        the second, for one may be glare or a mistaken label.
        """
        off = inside_by(self.free, self.on), -inside_by(self.ring, self.beside)
        on_px, beside_px = (float(np.partition(side, 1)[1]) for side in off)
        # dots within a spacing of the outline are its border
        border = 0.5 * sum(np.count_nonzero(np.abs(side) < self.spacing_px) for side in off)
        apart = 0.5 * (on_px - beside_px)
        chance = _BY_CHANCE * self.spacing_px / max(border, 1.0)
        against = max(-min(on_px, beside_px) - _END_PX, 0.0)
        return max(abs(apart) if abs(apart) > chance else 0.0, against), against

    def contradiction_left_px(self) -> float:
        """Say how far all dots but one contradict the best shifted edge at most."""

        def left_px(shift_px: Floats) -> float:
            outside, inside = (
                -inside_by(self.free, self.on - shift_px),
                inside_by(self.free, self.beside - shift_px),
            )
            return max(float(np.partition(side, -2)[-2]) for side in (outside, inside))

        return _best_shifted(left_px)


def _dots_of(scene: Scene, ring: Floats, stripes: StripeMap, number: int) -> DotBrackets | None:
    """Find a product's whole dots, and the belt's; None of too few."""
    assert stripes.dots is not None
    spread = np.trace(stripes.dots.covariance_px2, axis1=2, axis2=3)
    with np.errstate(invalid="ignore"):
        whole = stripes.seen & (spread < _CUT * np.median(spread[stripes.seen]))
    on, beside = (
        np.column_stack([stripes.x_px[place], stripes.dots.y_px[place]])
        for place in (whole & (stripes.product == number), whole & (stripes.product == 0))
    )
    if min(len(on), len(beside)) < _LEAST_ENDS:
        return None
    return DotBrackets(ring, unbound(scene, ring), on, beside, scene.spacing_px)


class _CurveBrackets(NamedTuple):
    """A product's outline in plain light, and (point, 2) px of circles on the product and on the belt.

    Few circles end at the rim, so that all of their points are asked. `ends` is what ends do say, if enough.
    `light` is that of the whole circles in the laser image, also where they run along rows. The outline
    `ring` is held against it, too: out of focus the product's light, which bounds it, reaches beyond a rim.
    """

    ring: Floats
    free: Floats
    on: Floats
    beside: Floats
    ends: _EndBrackets | None
    light: CircleLight | None

    def disagreement_px(self) -> tuple[float, float]:
        """Say how far the outline is from what points, ends and light allow.

        And how far of it nothing but a wrong outline explains. Light of product and belt keeps the same
        distance from a sound edge, so that half of the difference is what the edge is off by; but where light
        of the one does not reach the edge at all, no more than that of the other allows. Flanks may be dark,
        but belt that faces the light is lit up to a sound edge: as far as its light ends short of the edge,
        the edge may be too far inside.
        """
        still = np.zeros(2)
        of_ring, of_free = (self._off_px(edge, still) for edge in (self.ring, self.free))
        against = max(self._against_px(still, of_free) - _END_PX, 0.0)
        apart, of_ends = (0.0, 0.0) if self.ends is None else self.ends.disagreement_px()
        of_light = max(_off_by_light_px(off_px) for off_px in (of_ring, of_free))
        return max(against, apart, of_light), max(against, of_ends)

    def _off_px(self, edge: Floats, shift_px: Floats) -> tuple[float, float] | None:
        return None if self.light is None else self.light.off_px(edge, shift_px)

    def contradiction_left_px(self) -> float:
        """Say how far points, and nine in ten ends, contradict the best shifted edge at most."""
        left_px = _best_shifted(
            lambda shift_px: self._against_px(shift_px, self._off_px(self.free, shift_px))
        )
        return left_px if self.ends is None else max(left_px, self.ends.contradiction_left_px())

    def _against_px(self, shift_px: Floats, off_px: tuple[float, float] | None) -> float:
        """Give how far an edge is from points, and light `off_px`, that lie on its wrong side.

        So many points as the share lie in a strip within a sound edge: how wide that is, area and length of
        the outline say.
        """
        outside = -inside_by(self.free, self.on - shift_px)
        inside = inside_by(self.free, self.beside - shift_px)
        last = int(_STRIP_SHARE * len(self.on)) + 1
        found = max(float(np.partition(side, -last)[-last]) for side in (outside, inside))
        around_px = float(np.hypot(*(np.roll(self.free, -1, axis=0) - self.free).T).sum())
        found += _STRIP_SHARE * abs(area_of(self.free)) / around_px
        return found if off_px is None else max(found, *off_px)


def _off_by_light_px(off_px: tuple[float, float] | None) -> float:
    """Say how far an edge is off by what `CircleLight.off_px` says of it."""
    if off_px is None:
        return 0.0
    differs_px = min(0.5 * abs(off_px[0] - off_px[1]), max(0.0, max(off_px) + _TOUCHES_PX))
    return max(differs_px, -off_px[1] - _TOUCHES_PX)


def _curves_of(
    scene: Scene, ring: Floats, stripes: StripeMap, number: int, light: CircleLight | None
) -> _CurveBrackets | None:
    """Find a product's points of circles, and the belt's; None of too few."""
    row = np.broadcast_to(np.arange(stripes.rows, dtype=np.float64), stripes.x_px.shape)
    on, beside = (
        np.column_stack([stripes.x_px[place], row[place]])
        for place in (stripes.seen & (stripes.product == of) for of in (number, 0))
    )
    if min(len(on), _STRIP_SHARE * len(beside)) < _LEAST_ENDS:
        return None
    free = unbound(scene, ring)
    # farther belt and light stay on their side however the image is shifted
    reach_px = 2.0 * _SHIFT_MAX_PX
    near = ((beside > free.min(axis=0) - reach_px) & (beside < free.max(axis=0) + reach_px)).all(axis=1)
    if np.count_nonzero(near) > len(on):  # of fewer it could be one of the others that decides
        beside = beside[near]
    if light is not None:
        light = light.near(free, reach_px)
    ends = _ends_of(ring, free, stripes, number, placed=True)  # how the images lie, `light` tells
    return _CurveBrackets(ring, free, on, beside, ends, light)


def _best_shifted(left_px: Callable[[Floats], float]) -> float:
    """Give the least that a shift of the image leaves of a contradiction, px beyond what ends are sure to."""
    from scipy.optimize import minimize

    # on a coarse grid first: the function has steps, and more than one minimum
    steps = np.arange(-_SHIFT_MAX_PX, _SHIFT_MAX_PX + 1.0, _SHIFT_STEP_PX)
    coarse = min(((x, y) for x in steps for y in steps), key=lambda at: left_px(np.array(at)))
    found = minimize(left_px, np.array(coarse), method="Nelder-Mead", options={"xatol": 0.05, "fatol": 0.01})
    return max(float(found.fun) - _END_PX, 0.0)


def _ends_of(
    ring: Floats, free: Floats, stripes: StripeMap, number: int, *, placed: bool
) -> _EndBrackets | None:
    """Find the ends of what is seen of a product's stripes, and the belt next to them; None of too few."""
    ends, beyond = ends_of_stripes(stripes.x_px, stripes.seen, stripes.product, number, LEAST_ROWS)
    if stripes.circles:
        ends, beyond = _at_the_rim(stripes, number)
    across = stripes.across
    if across is not None:
        turned = ends_of_stripes(across.x_px, across.seen, across.product, number, LEAST_ROWS)
        # rows of the turned image are columns of this one, counted from the right
        last = across.rows - 1
        ends, beyond = (
            np.concatenate([mine, np.column_stack([last - other[:, 1], other[:, 0]])])
            for mine, other in zip((ends, beyond), turned, strict=True)
        )
    if len(ends) < _LEAST_ENDS:
        return None
    return _EndBrackets(ring, free, ends, beyond, across is not None, placed)


def _at_the_rim(stripes: StripeMap, number: int) -> tuple[Floats, Floats]:
    """Give what `ends_of_stripes` does, of halves of circles: ends that the belt follows closely.

    Others are where a half ends, which says nothing of the product.
    """
    row = np.arange(stripes.rows)
    ends, beyond = [np.empty((0, 2))], [np.empty((0, 2))]
    for x_px, seen, product in zip(stripes.x_px, stripes.seen, stripes.product, strict=True):
        on, belt = row[seen & (product == number)], row[seen & (product == 0)]
        if on.size < LEAST_ROWS:
            continue
        for end, side in ((on[0], belt[belt < on[0]][-1:]), (on[-1], belt[belt > on[-1]][:1])):
            if side.size and abs(int(side[0]) - int(end)) <= _RIM_ROWS:
                ends.append(np.array([[x_px[end], end]]))
                beyond.append(np.array([[x_px[side[0]], side[0]]]))
    return np.concatenate(ends), np.concatenate(beyond)


@kernel
def ends_of_stripes(
    x_px: Floats, seen: Flags, product: Labels, number: int, least_rows: int
) -> tuple[Floats, Floats]:
    """Give (end, 2) px of what is seen of a product's stripes, and (end, 2) px of the belt next to them.

    Of (stripe, row) stripes with fewer rows on the product one after another none are given, and shorter
    pieces are no ends: where a shadow cuts a stripe on the belt, what is left of its light in the last row or
    two lies aside, as if it were on the product.
    """
    stripes, rows = x_px.shape
    ends, beyond = np.empty((2 * stripes, 2)), np.empty((2 * stripes, 2))
    many = belts = 0
    for s in range(stripes):
        first, last, run = -1, -1, 0
        for row in range(rows):
            # the first and the last row of runs that are long enough
            run = run + 1 if seen[s, row] and product[s, row] == number else 0
            if run >= least_rows:
                first, last = row - run + 1 if first < 0 else first, row
        if first < 0:
            continue
        for row, step in ((first, -1), (last, 1)):
            ends[many, 0], ends[many, 1] = x_px[s, row], row
            many += 1
            # on along the stripe to where the belt is seen next
            on = row + step
            while 0 <= on < rows and not (seen[s, on] and product[s, on] == 0):
                on += step
            if 0 <= on < rows:
                beyond[belts, 0], beyond[belts, 1] = x_px[s, on], on
                belts += 1
    return ends[:many].copy(), beyond[:belts].copy()


def contradiction(against_px: float, left_px: float) -> Reason:
    """Say that outline and light contradict each other by so much, and how much of it any shift leaves."""
    return Reason(
        "images-contradict",
        f"the product's outline in the plain-light image and the ends of its stripes are {against_px:.1f} px "
        f"apart, and {left_px:.1f} px at the best shift of one image: rows of the laser image are lost, or "
        "the plain-light image is of another product or scale; look at both, and take them again",
    )
