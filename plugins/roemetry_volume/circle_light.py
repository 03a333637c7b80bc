"""Light of circles in the laser image, all around them: on the belt's circles, and beside them.

A coder knows of circles only where they cross rows; near its top and its bottom a circle runs along them.
But which light lies on the belt is known all around, for the belt's circles are calibrated: so ridges of the
image are light of the belt where they follow one of those, and light of a product where they are beside all
of them. Single bright pixels are no ridges.

On a rim that is thin, light lies within a pixel of the belt's circle, and leaves it farther inside: what
leaves it within an outline is the product's. Fails where the light of a product follows a circle of the belt
for long and ends there.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Flags, Floats
from roemetry.records.cones import half_on_belt
from roemetry.records.view import View
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.image_levels import median_of, plain_layout
from roemetry_volume.footprint import inside_by

_SMOOTH_PX = 1.0
"""Noise is averaged over about the width of a circle."""
_WIDE_PX = 9
"""Light beside a ridge is taken so far from it: circles are some 3 px wide, their skirts 8."""
_ON_PX, _BESIDE_PX = 1.2, 3.0
"""Ridges so near to a circle of the belt follow it; farther away than its skirts they are others."""
_NOISE, _SMOOTHED = 8.0, 0.3
"""Times the noise that a ridge rises, and how much smoothing leaves of a pixel's."""
_BELT_SHARE, _PRODUCT_SHARE = 0.4, 0.08
"""Of the usual height of the belt's circles: at the edge of what hides them half of it is left, and on
flanks that light grazes a tenth."""
_LEAST_PX = 6
"""Shorter ridges are noise, dirt or glare."""
_OUTSIDE_MIN_PX = 10
"""Of a belt's ridge that enters an outline, outside of it: where a product's light crosses a circle of the
belt, none is."""
_STRAY_PX = 5.0
"""Farther on an outline's wrong side lies another product's light, or what crosses a circle of the belt."""
_FIFTH = 5
"""Pixels by which light must lie on the wrong side: a ridge that crosses the edge has about as many there. On
five potatoes the fifth farthest lies 0.2 to 0.8 px on the right side, product's and belt's alike: half of
their difference is up to 0.3 px, and 0.8 px per percent of an image's scale."""


class CircleLight(NamedTuple):
    """Places of light in the laser image, (n, 2) px each."""

    belt: Floats
    belt_ridge: NDArray[np.int32]
    """(n,) number of the ridge that each is on."""
    product: Floats
    ridge: Flags
    """(row, column) where there is any light."""
    leaves: Flags
    """(row, column) where it follows no circle of the belt."""

    def near(self, contour: Floats, reach_px: float) -> CircleLight:
        """Give what of it lies so near to a contour."""
        low, high = contour.min(axis=0) - reach_px, contour.max(axis=0) + reach_px
        belt, product = (((one > low) & (one < high)).all(axis=1) for one in (self.belt, self.product))
        belt[belt] = np.abs(inside_by(contour, self.belt[belt])) < reach_px
        product[product] = np.abs(inside_by(contour, self.product[product])) < reach_px
        belt &= ~self._thin(contour)
        return self._replace(
            belt=self.belt[belt], belt_ridge=self.belt_ridge[belt], product=self.product[product]
        )

    def _thin(self, contour: Floats) -> Flags:
        """Say which of the belt's light is on a ridge that leaves the belt's circle within a contour."""
        import cv2

        # only what lies in the contour's box is looked at
        last = np.array(self.ridge.shape[::-1]) - 1
        low, high = (np.clip(np.rint(end(contour, axis=0)), 0, last).astype(int) for end in (np.min, np.max))
        box = np.s_[low[1] : high[1] + 1, low[0] : high[0] + 1]
        within = np.zeros(self.ridge[box].shape, np.uint8)
        cv2.fillPoly(within, [np.rint(contour).astype(np.int32) - low.astype(np.int32)], 1)
        within &= self.ridge[box]
        number = cv2.connectedComponents(within, connectivity=8)[1]
        leaving = np.bincount(number[self.leaves[box] & (number > 0)], minlength=number.max() + 1)
        place = self.belt.astype(np.int64)
        thin = ((place >= low) & (place <= high)).all(axis=1)
        column, row = (place[thin] - low).T
        thin[thin] = leaving[number[row, column]] >= _LEAST_PX
        return np.asarray(thin)

    def off_px(self, contour: Floats, shift_px: Floats) -> tuple[float, float] | None:
        """Say how far outside a contour the product's light lies, and how far inside of it the belt's.

        The contour is shifted by `shift_px` (2,). Negative: light lies on the right side. None of too little.
        """
        outside = -inside_by(contour, self.product - shift_px)
        inside = inside_by(contour, self.belt - shift_px)
        # ridges that come in from outside; others are the product's light on a circle of the belt
        comes_in = np.bincount(self.belt_ridge[inside < 0.0], minlength=1) >= _OUTSIDE_MIN_PX
        ridge = np.minimum(self.belt_ridge, comes_in.size - 1)
        inside = inside[comes_in[ridge] & (ridge == self.belt_ridge)]
        found = []
        for side in (outside, inside):
            near = side[side < _STRAY_PX]
            if near.size < _FIFTH:
                return None
            found.append(float(np.partition(near, -_FIFTH)[-_FIFTH]))
        return found[0], found[1]


def circle_light(pixels: NDArray[Any], view: View) -> CircleLight:
    """Find the light of the belt's circles and what lies beside them in a laser image (row, column)."""
    import cv2

    height = _ridges(pixels)
    away_px = _from_belt_px(view, height.shape)
    on_belt = height[(away_px <= _ON_PX) & (height > 0.0)]
    if not on_belt.size:
        nothing = np.zeros(height.shape, np.bool_)
        return CircleLight(np.empty((0, 2)), np.empty(0, np.int32), np.empty((0, 2)), nothing, nothing)
    # parts of circles are hidden, and noise lies there: the upper half is light
    usual = median_of(on_belt[on_belt >= median_of(on_belt)])
    noise = _NOISE * _SMOOTHED * _noise_of(pixels)
    belt = (away_px <= _ON_PX) & (height > max(_BELT_SHARE * usual, noise))
    ridge = height > max(_PRODUCT_SHARE * usual, noise)
    number = cv2.connectedComponents(belt.view(np.uint8), connectivity=8)[1]
    return CircleLight(
        _places(belt),
        number[belt].astype(np.int32),
        _places_of_long(ridge & (away_px > _BESIDE_PX)),
        ridge,
        ridge & (away_px > _ON_PX),
    )


def _ridges(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Give (row, column) by how much ridges rise over light beside them, along rows or columns; else 0."""
    import cv2

    # a median takes single bright pixels away, and leaves lines
    level = cv2.medianBlur(np.ascontiguousarray(pixels), 3).astype(np.float32)
    level = cv2.GaussianBlur(level, (0, 0), _SMOOTH_PX)
    wide = cv2.copyMakeBorder(level, _WIDE_PX, _WIDE_PX, _WIDE_PX, _WIDE_PX, cv2.BORDER_REPLICATE)
    return np.asarray(ridges_of(wide))


@float_kernel
def ridges_of(wide: NDArray[np.float32]) -> NDArray[np.float32]:
    """Give what `_ridges` does of smoothed light, which has a border of `_WIDE_PX` all around."""
    rows, columns = wide.shape[0] - 2 * _WIDE_PX, wide.shape[1] - 2 * _WIDE_PX
    height = np.empty((rows, columns), np.float32)
    nothing = np.float32(0.0)
    for row in range(rows):
        i, found = row + _WIDE_PX, height[row]
        # each neighbour a line of its own, and no branch: so several columns are taken at once
        here, above, below = wide[i], wide[i - 1], wide[i + 1]
        above_2, below_2, above_far, below_far = (
            wide[i - 2],
            wide[i + 2],
            wide[i - _WIDE_PX],
            wide[i + _WIDE_PX],
        )
        for column in range(np.uint64(columns)):
            j = column + np.uint64(_WIDE_PX)
            at = here[j]
            beside = max(max(above[j], below[j]), max(above_2[j], below_2[j]))
            rise = max(at - max(above_far[j], below_far[j]), nothing)
            down = rise if at >= beside else nothing
            beside = max(
                max(here[j - np.uint64(1)], here[j + np.uint64(1)]),
                max(here[j - np.uint64(2)], here[j + np.uint64(2)]),
            )
            rise = max(at - max(here[column], here[j + np.uint64(_WIDE_PX)]), nothing)
            found[column] = max(down, rise if at >= beside else nothing)
    return height


def _noise_of(pixels: NDArray[Any]) -> float:
    """Give the noise of a pixel, grey levels: light varies smoothly over three pixels nearly everywhere."""
    return 1.4826 * float(usual_bend(plain_layout(pixels))) / math.sqrt(6.0)


@kernel
def usual_bend(pixels: NDArray[Any]) -> float:
    """Give the median size of second differences along the rows of (row, column) grey levels."""
    columns = pixels.shape[1] - 2
    count = np.zeros(2 * np.int64(pixels.max()) + 1, np.int64)
    for row in range(pixels.shape[0]):
        line = pixels[row]
        for column in range(np.uint64(columns)):
            middle = 2 * np.int64(line[column + np.uint64(1)])
            count[abs(np.int64(line[column]) - middle + np.int64(line[column + np.uint64(2)]))] += 1
    many, upto, lower = pixels.shape[0] * columns, 0, -1
    for size in range(count.size):  # of an even number the middle two's mean
        upto += count[size]
        if lower < 0 and 2 * upto >= many:
            lower = size
        if 2 * upto > many:
            return 0.5 * (lower + size)
    return 0.0


@lru_cache(maxsize=2)
def _from_belt_px(view: View, size: tuple[int, ...]) -> NDArray[np.float32]:
    """Give (row, column) distance from the nearest circle of the belt, px."""
    import cv2

    away = np.full(size, 255, np.uint8)
    for cone in view.cones:
        place = view.project(half_on_belt(cone, view.T_belt_camera[:3, 0]))
        place = place[np.isfinite(place).all(axis=1)]
        cv2.polylines(away, [np.rint(place).astype(np.int32)], False, 0, 1)
    found = np.asarray(cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    found.flags.writeable = False
    return found


def _places_of_long(ridges: Flags) -> Floats:
    """Give the places of all but short ridges."""
    import cv2

    number = cv2.connectedComponents(ridges.view(np.uint8), connectivity=8)[1][ridges]
    return _places(ridges)[np.bincount(number, minlength=1)[number] >= _LEAST_PX]


def _places(where: Flags) -> Floats:
    row, column = np.divmod(np.flatnonzero(where), where.shape[1])
    return np.column_stack([column, row]).astype(np.float64)
