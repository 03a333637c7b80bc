"""The belt's plane in slices, and the products on it.

The belt is the plane with most points near it and next to none below: three points at a time are tried
(Fischler and Bolles 1981), the best plane is fitted anew to what lies near it until that does not change.
A product is what rises over it: a connected region that is clearly above the belt somewhere, with all of it
that noise does not explain. Regions closer together than a gap are one product.

Fails where less than a tenth of what is seen is belt, and where a flat product hides it wholly: `belt: zero`
then takes Z = 0 as it is.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records.arrays import Flags, Floats, Labels
from roemetry.stages import StageOptions
from roemetry_kernels.compiling import float_kernel, kernel

Belt = tuple[Floats, Floats]
"""(3, 3) rotation and (3,) point of a belt plane: its Z is 0 at R·(p − point)."""

_TRIES = 400
_SAMPLE = 4000
"""Planes that are tried, on so many points: with a tenth of belt, one try in a thousand hits it thrice, with
a third one in 27."""
_BELOW = 4.0
"""A point below a plane counts against so many near it: nothing lies below the belt."""
_LEAN_MAX = 0.35
"""Of a belt against Z, tangent: 19°. What leans more is a product's flank."""
_EDGE_MM = 0.15
"""Least height over the belt that is product, where its points' scatter would allow less."""
_NOISE_FACTOR = 4.0
"""Standard deviations above the belt from which a point is no noise."""
_EDGE_POINTS, _EDGE_SHARE = 3, 0.3
"""Points that a cut-off line may lift at the far edge of a shadow, and how high they are at most, as a share
of the product's height at the other edge of the shadow."""


_AREA_MIN_MM2 = 25.0
"""Smaller regions are dirt: half the area of a pea. Crumbs that are as high as a product are smaller."""


class BeltOptions(StageOptions):
    """What is belt and what is product."""

    belt: Literal["fit", "zero"] = Field(
        default="fit", description="where Z = 0 lies: on the belt as these slices show it, or as it is given"
    )
    height_min_mm: float = Field(
        default=1.5, gt=0, le=500, description="a product rises so far over the belt somewhere, mm"
    )
    gap_mm: float = Field(default=2.0, ge=0, le=500, description="closer pieces are one product, mm")


def plane_of_belt(points_mm: Floats, near_mm: float) -> Floats:
    """Find a, b, c of the belt z = a + b·x + c·y in points (n, 3), among products.

    `near_mm` is how far belt may lie from a plane. StageError where no plane has a tenth of the points.
    """
    # a fixed seed: the same scan has the same belt in every run
    rng = np.random.default_rng(0)
    some = points_mm[rng.integers(0, len(points_mm), min(_SAMPLE, len(points_mm)))]
    three = some[rng.integers(0, len(some), (_TRIES, 3))]
    design = np.concatenate([np.ones((_TRIES, 3, 1)), three[..., :2]], axis=2)
    # three points on one line span no plane
    good = ~(np.abs(np.linalg.det(design)) < 1e-6)
    planes = np.linalg.solve(design[good], three[good][..., 2:])[..., 0]
    # no plane that leans as a flank does
    planes = np.ascontiguousarray(planes[~(np.hypot(planes[:, 1], planes[:, 2]) > _LEAN_MAX)])
    best: Floats = np.zeros(3)
    if len(planes):
        best = planes[int(_scores(planes, some, near_mm).argmax())]
    near = np.abs(points_mm[:, 2] - best[0] - points_mm[:, :2] @ best[1:]) <= near_mm
    # a tenth of all points at least: the best of many wrong planes has fewer
    if near.mean() < 0.1:
        raise StageError(
            f"no belt is seen: the best plane has {near.mean():.0%} of the points near it",
            hint="let bare belt be seen beside the product, or take `belt: zero` if Z = 0 is the belt",
        )
    for _ in range(10):
        best = fitted_plane(points_mm[near])
        over = points_mm[:, 2] - best[0] - points_mm[:, :2] @ best[1:]
        spread = 1.4826 * float(np.median(np.abs(over[near])))
        # narrower as the fit settles, but never wider than at first
        again = np.abs(over) <= min(max(3.0 * spread, 1e-6), near_mm)
        if np.array_equal(again, near):
            # the same points again: settled
            break
        near = again
    return best


@float_kernel
def _scores(planes: Floats, some: Floats, near_mm: float) -> Floats:
    """Give (plane,) how many points lie near each, less what those below it count."""
    scores = np.empty(planes.shape[0])
    for p in range(planes.shape[0]):
        a, b, c = planes[p, 0], planes[p, 1], planes[p, 2]
        near = below = 0
        for k in range(some.shape[0]):
            over = some[k, 2] - a - some[k, 0] * b - some[k, 1] * c
            near += (over <= near_mm) & (over >= -near_mm)
            below += over < -near_mm
        scores[p] = near - _BELOW * below
    return scores


def fitted_plane(points_mm: Floats) -> Floats:
    """Give a, b, c of z = a + b·x + c·y by least squares."""
    # about the middle, or offset and slopes would hang together
    middle = points_mm.mean(axis=0)
    design = np.column_stack([np.ones(len(points_mm)), points_mm[:, :2] - middle[:2]])
    a, b, c = np.linalg.lstsq(design, points_mm[:, 2], rcond=None)[0]
    return np.array([a - b * middle[0] - c * middle[1], b, c])


def frame_on(plane: Floats) -> Belt:
    """Give the rotation and the point that lay Z = 0 on a plane, X and Y as near as they may stay."""
    up = np.array([-plane[1], -plane[2], 1.0]) / np.sqrt(1.0 + plane[1] ** 2 + plane[2] ** 2)
    # X stays as it was, but for what leaves the plane
    along = np.array([1.0, 0.0, 0.0]) - up[0] * up
    along /= np.sqrt(along @ along)
    return np.stack([along, np.cross(up, along), up]), np.array([0.0, 0.0, plane[0]])


def products_on(
    height_mm: Floats, steps_mm: tuple[float, float], noise_mm: float, options: BeltOptions
) -> Labels:
    """Number the products in heights over the belt.

    Parameters
    ----------
    height_mm
        (slice, point) NaN where nothing was seen.
    steps_mm
        Usual distance of neighbouring slices and of neighbouring points, mm.
    noise_mm
        Scatter of single points on the belt, mm.

    Returns
    -------
    ndarray
        (slice, point) int16: 1… product by its first slice, then by its first point; 0 belt; −1 not seen.
    """
    import cv2

    edge = max(_EDGE_MM, _NOISE_FACTOR * noise_mm)
    seen = np.isfinite(height_mm)
    with np.errstate(invalid="ignore"):
        high = np.ascontiguousarray((height_mm > edge).astype(np.uint8))
    reach = [max(1, round(0.5 * options.gap_mm / step)) for step in steps_mm]
    # half a gap to either side: pieces nearer than the gap grow together
    kernel = np.ones((2 * reach[0] + 1, 2 * reach[1] + 1), np.uint8)
    # a border of nothing: closing would else join to the image's edge
    padded = cv2.copyMakeBorder(high, reach[0], reach[0], reach[1], reach[1], cv2.BORDER_CONSTANT)
    joined = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)
    joined = joined[reach[0] : joined.shape[0] - reach[0], reach[1] : joined.shape[1] - reach[1]]
    count, region = cv2.connectedComponents(np.ascontiguousarray(joined), connectivity=8)
    # the pieces themselves; what the closing added is not product
    on: Flags = seen & (region > 0) & (high > 0)
    index = region[on]
    top = np.full(count, -np.inf)
    np.maximum.at(top, index, height_mm[on])
    area = np.bincount(index, minlength=count) * steps_mm[0] * steps_mm[1]
    good = (top >= options.height_min_mm) & (area >= _AREA_MIN_MM2)
    # region 0 is what no product covers
    good[0] = False
    number = np.zeros(count, np.int16)
    first = {int(k): int(np.flatnonzero((region == k).any(axis=1))[0]) for k in np.flatnonzero(good)}
    side = {k: int(np.flatnonzero(region[at] == k)[0]) for k, at in first.items()}
    # by first slice, then by first point: the order in which they came
    for place, k in enumerate(sorted(first, key=lambda k: (first[k], side[k])), start=1):
        number[k] = place
    found = np.where(seen, np.where(on, number[region], 0), -1).astype(np.int16)
    low_mm = options.height_min_mm
    # along slices and across them: shadows fall both ways
    found[_beyond_shadow(height_mm, found, low_mm) | _beyond_shadow(height_mm.T, found.T, low_mm).T] = 0
    return found


@kernel
def _beyond_shadow(height_mm: Floats, label: Labels, low_mm: float) -> Flags:
    """Mark what of a product's section, a row of both arrays, is belt at the far edge of its shadow.

    There a line of light is cut off, and its middle lies off: islands of up to three points at the section's
    end, behind points that are not seen, that are far lower than the product and lower than `low_mm`, which a
    product reaches somewhere.
    """
    rows, points = label.shape
    found = np.zeros(label.shape, np.bool_)
    for i in range(rows):
        for way in (1, -1):
            k, islands = 0 if way == 1 else points - 1, 0
            first = k
            while 0 <= k < points:
                if label[i, k] <= 0:
                    if label[i, k] == 0:
                        # belt amid ends the run of islands: what follows is no island behind a shadow
                        islands = 0
                    k += way
                    continue
                begin = k
                while 0 <= k < points and label[i, k] == label[i, begin]:
                    k += way
                first = begin if islands == 0 else first
                islands += 1
                # still small: perhaps another island
                if abs(k - begin) <= _EDGE_POINTS:
                    continue
                # the body begins: what stood before it is lifted belt, where it is low enough
                for m in range(first, begin, way):
                    mine = label[i, m] == label[i, begin]
                    found[i, m] |= mine and height_mm[i, m] < min(_EDGE_SHARE * height_mm[i, begin], low_mm)
                # on to what is not of this body
                while 0 <= k < points and label[i, k] != 0:
                    k += way
    return found
