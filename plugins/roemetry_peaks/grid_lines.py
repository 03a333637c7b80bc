"""Lines of a grid in both directions, each as if the other family were not there.

Model. The light of two families of lines adds. Each family is measured by the rows it crosses: one in the
image, the other in the image turned by 90° counter-clockwise, both by `gaussian`. First only peaks count
around which the image changes more along its row than down its rows, by the structure tensor; so crossings
are left out. Peaks in neighbouring rows form lines, and where a line ends and goes on a few rows further, its
place, height and width are interpolated. So the light of the other family is known, also at crossings, and
taken away; what is left is measured again. Neither line is then broken or bent where they cross.

Uncertainty. The light that was taken away leaves its speckle: where it was L beside a peak of height a, the
peak's standard uncertainty grows by √(1 + (6 L / a)²). A pixel that was white stays white, for nobody knows
how bright it was.

It fails where lines of both families run alike, within some 10° of the diagonal, and where lines stand
nearer together than three of their widths. Source: Bigün, Granlund (1987), Optimal orientation detection of
linear symmetry; the rest is ours.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_peaks.gaussian import Gaussian, GaussianOptions
from roemetry_peaks.peak_window import FWHM_OF_SIGMA

_FINE_PX = 1.0
"""Standard deviation of the Gaussian that the image is smoothed with, px: below the width of a line."""
_AROUND_PX = 7
"""Side of the square over which squared gradients are averaged, px: two to three widths of a line."""
_DIRECTED = 4.0
"""Times the squared gradient down the rows, that the one along them is in a line that crosses rows."""
_OWN_DIRECTED = 1.5
"""The same when the other family's light has been taken away: of lines up to 39° oblique."""
_STEP_PX = 1.5
"""Of a line from one row to the next: lines steeper than 56° belong to the other family."""
_GAP_ROWS = 16
"""Longest part of a line that is hidden by a crossing: three widths of an oblique line."""
_SLOPE_OFF = 0.35
"""By which a line's slope over a gap may differ from those at its ends."""
_REACH = 3.5
"""Standard deviations over which a line's light is taken away: 0.2 % of its height is left."""
_OWN_MIN = 0.4
"""Of the light that was taken away, that a peak is at least high: what is lower may be its remains."""
_REMAINS = 6.0
"""Times its share of a peak's height, that light taken away adds to the peak's uncertainty. Found by drawing:
its speckle lies on the flanks of the peak, too, which the fit takes for dark and sure."""
_TIMES = 2
"""That both families are measured: what the second time finds at crossings changes no line any more."""
_SAME_PX = 3.0
"""In a row, within which two peaks are of one line."""
_ALONE = 0.02
"""Of a peak's height, below which the other line's light does not move it."""
_CLIPPED_PX = 7
"""Along the row, in which no pixel of a crossing may be white."""


class GridLinesOptions(StageOptions):
    """What counts as a line."""

    threshold: Annotated[float, Field(ge=1.0, le=255.0)] | Literal["auto"] = Field(
        default="auto",
        description="grey levels (of 0…255, scaled for deeper images) by which a line must rise above the "
        "light beside it; auto: from the image's own noise, and from how high its lines are",
    )
    width_max_px: float = Field(
        default=16.0, gt=2.0, le=100.0, description="largest full width at half height, px"
    )


class GridLines(Extractor[GridLinesOptions]):
    """Takes the light of each family away before it measures the other."""

    capabilities = Capabilities(tolerance_px=0.1, saturated_tolerance_px=0.3, pattern="grid")

    def extract(self, frame: Frame) -> Peaks:
        """Find the lines of a frame; those across in `Peaks.across`."""
        given = self.options
        one = Gaussian(GaussianOptions(threshold=given.threshold, width_max_px=given.width_max_px))
        frames = (frame, turned(frame))
        light = []
        for each in frames:
            peaks = one.extract(each)
            along, down = _gradients(each.pixels, peaks)
            light.append(_light_of(peaks, along > _DIRECTED * down))
        # where a line ends behind a crossing, too near for its direction to show, the second round knows it
        for _ in range(_TIMES - 1):
            found = self._both(one, frames, light)
            light = [_light_of(*family) for family in found]
        found = self._both(one, frames, light)
        return replace(found[0][0], across=found[1][0])

    @staticmethod
    def _both(
        one: Gaussian, frames: tuple[Frame, Frame], light: list[Floats]
    ) -> tuple[tuple[Peaks, Flags, Flags], tuple[Peaks, Flags, Flags]]:
        upright, across = light
        return (
            _without(one, frames[0], np.ascontiguousarray(np.rot90(across, -1))),
            _without(one, frames[1], np.ascontiguousarray(np.rot90(upright))),
        )


def turned(frame: Frame) -> Frame:
    """Give the frame turned by 90° counter-clockwise."""
    return replace(frame, pixels=np.ascontiguousarray(np.rot90(frame.pixels)))


def _light_of(peaks: Peaks, kept: Flags, crossing: Flags | None = None) -> Floats:
    """Give the light of the lines that cross rows, as an image, grey levels over what is beside them.

    `kept` (peak,) says which peaks are known to be of such lines, `crossing` which are, where light was taken
    away: they count where the line does not go on behind, for what lies between its sound parts is surer.
    """
    row = peaks.row[kept]
    numbers = _numbers(peaks, kept)
    ahead = _neighbour(row, numbers[:, 0])
    hidden_row, hidden = _hidden(row, numbers, ahead)
    row, numbers = np.concatenate([row, hidden_row]), np.concatenate([numbers, hidden])
    if crossing is not None and crossing.any():
        at_row, more = peaks.row[crossing], _numbers(peaks, crossing)
        free = _apart(at_row, more[:, 0], hidden_row, hidden[:, 0]) > _SAME_PX
        row = np.concatenate([row, at_row[free]])
        numbers = np.concatenate([numbers, more[free]])
    return _painted(row, numbers, peaks.image_size)


def _numbers(peaks: Peaks, which: Flags) -> Floats:
    """Give (n, 3) place, height and standard deviation of some peaks."""
    return np.column_stack([peaks.x_px, peaks.amplitude, peaks.width_px / FWHM_OF_SIGMA])[which]


def _gradients(pixels: Any, peaks: Peaks) -> tuple[Floats, Floats]:
    """Give (peak,) the squared change of the image along its rows and down its rows, averaged around each."""
    import cv2

    image = cv2.GaussianBlur(pixels.astype(np.float32), (0, 0), _FINE_PX)
    changes = [cv2.Sobel(image, cv2.CV_32F, *way, ksize=3) for way in ((1, 0), (0, 1))]
    along, down = _squares_around(*changes, peaks.row, np.rint(peaks.x_px).astype(np.int64))
    return along, down


@float_kernel
def _squares_around(along: Any, down: Any, row: Integers, column: Integers) -> tuple[Floats, Floats]:
    """Give (n,) means of both images' squares in a square around places, mirrored at the border."""
    (rows, columns), half = along.shape, _AROUND_PX // 2
    found = np.empty((2, row.size))
    for n in range(row.size):
        one, other = np.float32(0.0), np.float32(0.0)
        for i in range(row[n] - half, row[n] + half + 1):
            y = abs(i) if i < rows else 2 * (rows - 1) - i
            first, end = column[n] - half, column[n] + half + 1
            if first >= 0 and end <= columns:
                for x in range(np.uint64(first), np.uint64(end)):
                    one += along[y, x] * along[y, x]
                    other += down[y, x] * down[y, x]
                continue
            for j in range(first, end):
                x = abs(j) if j < columns else 2 * (columns - 1) - j
                one += along[y, x] * along[y, x]
                other += down[y, x] * down[y, x]
        found[0, n], found[1, n] = one, other
    return found[0] / _AROUND_PX**2, found[1] / _AROUND_PX**2


def _neighbour(row: Integers, x_px: Floats) -> Integers:
    """Give (peak,) the nearest peak in the next row, of peaks sorted by row and x; −1 where none is near."""
    if row.size == 0:
        return np.empty(0, np.int64)
    wide = float(x_px.max()) + 10.0 * _STEP_PX
    key = row * wide + x_px
    at = np.searchsorted(key, key + wide)
    before, after = np.maximum(at - 1, 0), np.minimum(at, row.size - 1)
    nearest = np.where(np.abs(key[before] - key - wide) < np.abs(key[after] - key - wide), before, after)
    near = np.abs(key[nearest] - key - wide) <= _STEP_PX
    return np.where(near, nearest, -1)


def _apart(row: Integers, x_px: Floats, other_row: Integers, other_px: Floats) -> Floats:
    """Give how far the nearest of other places in the same row is; more than the image is wide of none."""
    wide = 2.0 * max(float(x_px.max(initial=0.0)), float(other_px.max(initial=0.0))) + 1.0
    key, others = row * wide + x_px, np.sort(np.concatenate([[-np.inf, np.inf], other_row * wide + other_px]))
    at = np.searchsorted(others, key)
    return np.asarray(np.minimum(key - others[at - 1], others[at] - key))


def _hidden(row: Integers, numbers: Floats, ahead: Integers) -> tuple[Integers, Floats]:
    """Give rows and numbers, x, height and size, of what lies between ends of lines and where they go on."""
    behind = np.full(row.size, -1)
    behind[ahead[ahead >= 0]] = np.flatnonzero(ahead >= 0)
    end, begin = np.flatnonzero((ahead < 0) & (behind >= 0)), np.flatnonzero((behind < 0) & (ahead >= 0))
    far = row[begin][None, :] - row[end][:, None]
    way = numbers[begin, 0][None, :] - numbers[end, 0][:, None]
    slope = way / np.maximum(far, 1)
    steep = np.maximum(
        np.abs(slope - _slope(numbers[:, 0], behind, end)[:, None]),
        np.abs(slope - _slope(numbers[:, 0], ahead, begin)[None, :]),
    )
    steep = np.where((far > 1) & (far <= _GAP_ROWS), steep, np.inf)
    if not steep.size:
        return np.empty(0, np.int64), np.empty((0, 3))
    best = steep.argmin(axis=1)
    own = (steep[np.arange(end.size), best] < _SLOPE_OFF) & (
        steep.argmin(axis=0)[best] == np.arange(end.size)
    )
    one, other = end[own], begin[best[own]]
    between = row[other] - row[one] - 1
    which = np.repeat(np.arange(one.size), between)
    step = np.arange(which.size) - np.repeat(np.cumsum(between) - between, between) + 1
    share = step / (between[which] + 1)
    way = numbers[other] - numbers[one]
    return row[one[which]] + step, numbers[one[which]] + share[:, None] * way[which]


def _slope(x_px: Floats, way: Integers, at: Integers) -> Floats:
    """Give px a row, over as many as eight rows, of lines that lead from peaks away by `way`."""
    last, steps = at.copy(), np.zeros(at.size)
    for _ in range(8):
        on = way[last] >= 0
        last, steps = np.where(on, way[last], last), steps + on
    moved = x_px[last] - x_px[at]
    return np.asarray(moved / np.maximum(steps, 1.0) * np.where(last < at, -1.0, 1.0))


def _painted(row: Integers, numbers: Floats, size: tuple[int, int]) -> Floats:
    """Draw a Gaussian along its row for each of (n, 3) x, height and standard deviation."""
    light = np.zeros(size)
    _paint(light, row, numbers)
    return light


@kernel
def _paint(light: Floats, row: Integers, numbers: Floats) -> None:
    # two lines of one family that come near each other share their light: the brighter one is drawn
    columns = light.shape[1]
    for k in range(row.size):
        x, height, sigma = numbers[k]
        half = math.ceil(_REACH * min(sigma, 0.1 * columns))
        middle = int(np.rint(x))
        for column in range(max(middle - half, 0), min(middle + half + 1, columns)):
            value = height * math.exp(-0.5 * ((column - x) / sigma) ** 2)
            light[row[k], column] = max(light[row[k], column], value)


@kernel
def _take_away(pixels: Any, light: Floats, left: Any, white: int) -> bool:
    """Write to `left` what is left of pixels without light; what is white stays white. Says if any is."""
    some = False
    for row in range(pixels.shape[0]):
        for column in range(pixels.shape[1]):
            value = pixels[row, column]
            if value >= white:
                left[row, column], some = white, True
            elif light[row, column] == 0.0:
                left[row, column] = value
            else:
                left[row, column] = max(np.rint(value - light[row, column]), 0.0)
    return some


def _without(one: Gaussian, frame: Frame, light: Floats) -> tuple[Peaks, Flags, Flags]:
    """Measure the lines that are left when the other family's light is taken away.

    Gives also (peak,) which of them run across the rows beyond doubt: where they are alone, and at crossings.
    """
    from scipy.ndimage import maximum_filter1d

    pixels = frame.pixels
    left = np.empty_like(pixels)
    some_white = _take_away(pixels, light, left, frame.highest)
    peaks = one.extract(replace(frame, pixels=left))
    at = peaks.row, np.rint(peaks.x_px).astype(np.int64)
    beside = light[at]
    # what the other family has left shows where one of its lines ends, or was not followed
    along, down = _gradients(left, peaks)
    clean = along > _OWN_DIRECTED * down
    # where both together are white, nobody knows how much of it is the other line's
    own = clean & (peaks.amplitude > _OWN_MIN * beside)
    if some_white:
        own &= ~maximum_filter1d((pixels >= frame.highest) & (light >= 1.0), _CLIPPED_PX)[at]
    with np.errstate(divide="ignore", invalid="ignore"):
        grown = np.hypot(1.0, _REMAINS * beside / peaks.amplitude)
    kept = np.flatnonzero(own)
    left_over = replace(
        peaks,
        row=peaks.row[kept],
        x_px=peaks.x_px[kept],
        x_std_px=(peaks.x_std_px * grown)[kept],
        amplitude=peaks.amplitude[kept],
        background=peaks.background[kept],
        width_px=peaks.width_px[kept],
        flags=peaks.flags[kept],
    )
    sure, alone = (along > _DIRECTED * down)[kept], (beside < _ALONE * peaks.amplitude)[kept]
    return left_over, sure & alone, sure & ~alone
