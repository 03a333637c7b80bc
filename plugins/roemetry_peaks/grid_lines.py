"""Lines of a grid in both directions, each as if the other family were not there.

Model. The light of two families of lines adds. Each family is measured by the rows it crosses: one in the
image, the other in the image turned by 90° counter-clockwise; the first time by the middles between their
flanks, then by `gaussian`. First only peaks count around which the image changes more along its row than
down its rows, by the structure tensor; so crossings are left out. Peaks in neighbouring rows form lines, and
where a line ends and goes on a few rows further, its place, height and width are interpolated. So the light
of the other family is known, also at crossings, and taken away; what is left is measured again. Neither line
is then broken or bent where they cross.

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
from roemetry_kernels.compiling import float_kernel, inlined, kernel
from roemetry_peaks.finding import found
from roemetry_peaks.gaussian import GaussianOptions, gaussian_peaks
from roemetry_peaks.peak_window import FWHM_OF_SIGMA, Stripes

_FINE_PX = 1.0
"""Standard deviation of the Gaussian that the image is smoothed with, px: below the width of a line."""
_FINE_TAPS = 9
"""Pixels of that Gaussian: out to four standard deviations."""
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
_SLOPE_ROWS = 8
"""Over which the slope at a line's end is taken: some twice its width."""
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
_TURNS = (1, -1)
"""Quarters counter-clockwise, by which the light of each family is turned to lie on the other one's frame."""


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
        options = GaussianOptions(threshold=given.threshold, width_max_px=given.width_max_px)
        frames = (frame, turned(frame))
        # nothing of this first time is kept but the light that it takes away: middles are near enough
        upright, across = (
            found(replace(each, sensor=None), options, _middles, checked=False) for each in frames
        )
        # along its rows the turned frame changes as the frame itself does down its rows
        changes = _changes(frame.pixels)
        along, down = _squares_around(*changes, *_pixels_of(upright))
        column, row = _pixels_of(across)
        other_down, other_along = _squares_around(*changes, row, frame.size[1] - 1 - column)
        others = [  # what lies on each frame of the other family's light
            _light_of(across, other_along > _DIRECTED * other_down, _TURNS[1]),
            _light_of(upright, along > _DIRECTED * down, _TURNS[0]),
        ]
        # where a line ends behind a crossing, too near for its direction to show, the second round knows it
        for _ in range(_TIMES - 1):
            measured = [
                _without(options, each, light, checked=False)
                for each, light in zip(frames, others, strict=True)
            ]
            others = [
                _light_of(peaks, sure, turns, crossing)
                for (peaks, sure, crossing), turns in zip(measured, _TURNS, strict=True)
            ][::-1]
        upright, across = (
            _without(options, each, light, checked=True)[0]
            for each, light in zip(frames, others, strict=True)
        )
        return replace(upright, across=across)


def _middles(
    levels: Any, columns: int, stripes: Stripes, white: int, noise: Floats, contrast2: Floats, x_px: Floats,
    x_std_px: Floats,
) -> None:  # fmt: skip
    """Take the middle between the flanks for the centre; the parameters are those of `gaussian_centres`."""
    x_px[:], x_std_px[:] = stripes.middle, np.nan


def turned(frame: Frame) -> Frame:
    """Give the frame turned by 90° counter-clockwise."""
    return replace(frame, pixels=np.ascontiguousarray(np.rot90(frame.pixels)))


def _light_of(peaks: Peaks, kept: Flags, turns: int, crossing: Flags | None = None) -> Floats:
    """Give the light of the lines that cross rows, as an image, grey levels over what is beside them.

    `kept` (peak,) says which peaks are known to be of such lines, `crossing` which are, where light was taken
    away: they count where the line does not go on behind, for what lies between its sound parts is surer. The
    image is turned by `turns` quarters counter-clockwise.
    """
    row = peaks.row[kept]
    numbers = _numbers(peaks, kept)
    hidden_row, hidden = _hidden(row, numbers)
    row, numbers = np.concatenate([row, hidden_row]), np.concatenate([numbers, hidden])
    if crossing is not None and crossing.any():
        at_row, more = peaks.row[crossing], _numbers(peaks, crossing)
        free = _apart(at_row, more[:, 0], hidden_row, hidden[:, 0]) > _SAME_PX
        row = np.concatenate([row, at_row[free]])
        numbers = np.concatenate([numbers, more[free]])
    light = np.zeros(peaks.image_size[::-1])
    _paint(np.rot90(light, -turns), row, numbers)
    return light


def _numbers(peaks: Peaks, which: Flags) -> Floats:
    """Give (n, 3) place, height and standard deviation of some peaks."""
    return np.column_stack([peaks.x_px[which], peaks.amplitude[which], peaks.width_px[which] / FWHM_OF_SIGMA])


def _pixels_of(peaks: Peaks) -> tuple[Integers, Integers]:
    """Give row and column of the pixel of each peak."""
    return peaks.row, np.rint(peaks.x_px).astype(np.int64)


def _changes(pixels: Any) -> list[Any]:
    """Give how an image changes along its rows and down its rows, (row, column) each."""
    import cv2

    smoothing = cv2.getGaussianKernel(_FINE_TAPS, _FINE_PX, cv2.CV_32F)
    # filtering integers directly saves a copy as floats
    whole = pixels if pixels.dtype in (np.uint8, np.uint16) else pixels.astype(np.float32)
    image = cv2.sepFilter2D(whole, cv2.CV_32F, smoothing, smoothing)
    return [cv2.Sobel(image, cv2.CV_32F, *way, ksize=3) for way in ((1, 0), (0, 1))]


@inlined
def _mirrored(at: int, size: int) -> int:
    """Give the place within a side that a place beyond its border mirrors, however short the side is."""
    period = max(2 * (size - 1), 1)
    at = abs(at) % period
    return min(at, period - at) if size > 1 else 0


@float_kernel
def _squares_around(along: Any, down: Any, row: Integers, column: Integers) -> tuple[Floats, Floats]:
    """Give (n,) means of both images' squares in a square around places, mirrored at the border."""
    (rows, columns), half = along.shape, _AROUND_PX // 2
    found = np.empty((2, row.size))
    for n in range(row.size):
        one, other = np.float32(0.0), np.float32(0.0)
        for i in range(row[n] - half, row[n] + half + 1):
            y = _mirrored(i, rows)
            first, end = column[n] - half, column[n] + half + 1
            if first >= 0 and end <= columns:
                for x in range(np.uint64(first), np.uint64(end)):
                    one += along[y, x] * along[y, x]
                    other += down[y, x] * down[y, x]
                continue
            for j in range(first, end):
                x = _mirrored(j, columns)
                one += along[y, x] * along[y, x]
                other += down[y, x] * down[y, x]
        found[0, n], found[1, n] = one, other
    return found[0] / _AROUND_PX**2, found[1] / _AROUND_PX**2


def _apart(row: Integers, x_px: Floats, other_row: Integers, other_px: Floats) -> Floats:
    """Give how far the nearest of other places in the same row is; more than the image is wide of none."""
    # rows one after the other on one axis, each longer than the image is wide
    wide = 2.0 * max(float(x_px.max(initial=0.0)), float(other_px.max(initial=0.0))) + 1.0
    key, others = row * wide + x_px, np.sort(np.concatenate([[-np.inf, np.inf], other_row * wide + other_px]))
    at = np.searchsorted(others, key)
    return np.asarray(np.minimum(key - others[at - 1], others[at] - key))


@kernel
def _hidden(row: Integers, numbers: Floats) -> tuple[Integers, Floats]:
    """Give rows and numbers, x, height and size, of what lies between ends of lines and where they go on.

    An end and a beginning belong together where each is for the other the one that bends the line least.
    Peaks are sorted by row and x.
    """
    count, ahead = row.size, _ahead(row, numbers)
    behind = np.full(count, -1)
    for k in range(count):
        if ahead[k] >= 0:
            behind[ahead[k]] = k
    least, partner = np.full(count, np.inf), np.full(count, -1)
    for end in range(count):
        # ends of lines alone
        if ahead[end] >= 0 or behind[end] < 0:
            continue
        before = _slope(row, numbers, behind, end)
        for begin in range(end + 1, count):
            far = row[begin] - row[end]
            if far > _GAP_ROWS:
                break
            # beginnings of lines alone
            if far < 2 or behind[begin] >= 0 or ahead[begin] < 0:
                continue
            slope = (numbers[begin, 0] - numbers[end, 0]) / far
            steep = max(abs(slope - before), abs(slope - _slope(row, numbers, ahead, begin)))
            if steep < least[end]:
                least[end], partner[end] = steep, begin
            if steep < least[begin]:
                least[begin], partner[begin] = steep, end
    between = 0
    for end in range(count):
        begin = partner[end]
        # each is the other's best
        if begin > end and least[end] < _SLOPE_OFF and partner[begin] == end:
            between += row[begin] - row[end] - 1
    rows, found, n = np.empty(between, np.int64), np.empty((between, 3)), 0
    for end in range(count):
        begin = partner[end]
        if begin > end and least[end] < _SLOPE_OFF and partner[begin] == end:
            far = row[begin] - row[end]
            # place, height and size change evenly across the gap
            for step in range(1, far):
                rows[n] = row[end] + step
                for k in range(3):
                    found[n, k] = numbers[end, k] + step / far * (numbers[begin, k] - numbers[end, k])
                n += 1
    return rows, found


@kernel
def _ahead(row: Integers, numbers: Floats) -> Integers:
    """Give (peak,) the nearest peak in the next row; −1 where none is near."""
    ahead, at = np.full(row.size, -1), 0
    for k in range(row.size):
        # up to the first that is not left of it there
        while at < row.size and row[at] + (numbers[at, 0] >= numbers[k, 0]) <= row[k] + 1:
            at += 1
        nearest = _STEP_PX
        for n in (at - 1, at):
            if 0 <= n < row.size and row[n] == row[k] + 1 and abs(numbers[n, 0] - numbers[k, 0]) <= nearest:
                nearest, ahead[k] = abs(numbers[n, 0] - numbers[k, 0]), n
    return ahead


@kernel
def _slope(row: Integers, numbers: Floats, way: Integers, at: int) -> float:
    """Give px a row, over as many as eight rows, of the line that leads from a peak away by `way`."""
    last = at
    for _ in range(_SLOPE_ROWS):
        if way[last] >= 0:
            last = way[last]
    far = row[last] - row[at]
    return (numbers[last, 0] - numbers[at, 0]) / far if far else 0.0


@kernel
def _paint(light: Floats, row: Integers, numbers: Floats) -> None:
    # two lines of one family that come near each other share their light: the brighter one is drawn
    columns = light.shape[1]
    for k in range(row.size):
        x, height, sigma = numbers[k]
        half = math.ceil(_REACH * min(sigma, 0.1 * columns))
        middle = int(np.rint(x))
        # from pixel to pixel outwards a Gaussian falls by a ratio that itself falls by a constant one
        curve = 1.0 / sigma**2
        top, less = height * math.exp(-0.5 * curve * (middle - x) ** 2), math.exp(-curve)
        for way in (-1, 1):
            value, ratio = top, math.exp(-curve * (way * (middle - x) + 0.5))
            for step in range(half + 1):
                column = middle + way * step
                if 0 <= column < columns:
                    light[row[k], column] = max(light[row[k], column], value)
                value *= ratio
                ratio *= less


@kernel
def _take_away(pixels: Any, light: Floats, left: Any, white: int) -> bool:
    """Write to `left` what is left of pixels without light; what is white stays white. Says if any is."""
    some: Any = False
    for row in range(pixels.shape[0]):
        for column in range(pixels.shape[1]):  # without a branch, so that several are taken at once
            value = np.float64(pixels[row, column])
            rest = max(np.rint(value - light[row, column]), 0.0)
            left[row, column] = np.int32(white if value >= white else rest)
            some |= value >= white
    return some


@kernel
def _clipped_at(pixels: Any, light: Floats, row: Integers, column: Integers, white: int) -> Flags:
    """Say (n,) where a pixel beside a place along its row is white and has light of the other family."""
    found, half = np.zeros(row.size, np.bool_), _CLIPPED_PX // 2
    for n in range(row.size):
        for x in range(max(column[n] - half, 0), min(column[n] + half + 1, pixels.shape[1])):
            found[n] |= pixels[row[n], x] >= white and light[row[n], x] >= 1.0
    return found


def _without(
    options: GaussianOptions, frame: Frame, light: Floats, *, checked: bool
) -> tuple[Peaks, Flags, Flags]:
    """Measure the lines that are left when the other family's light is taken away.

    Gives also (peak,) which of them run across the rows beyond doubt: where they are alone, and at crossings.
    `checked` as for `roemetry_peaks.finding.found`.
    """
    pixels = frame.pixels
    left = np.empty_like(pixels)
    some_white = _take_away(pixels, light, left, frame.highest)
    peaks = gaussian_peaks(replace(frame, pixels=left), options, checked=checked)
    at = _pixels_of(peaks)
    beside = light[at]
    # what the other family has left shows where one of its lines ends, or was not followed
    along, down = _squares_around(*_changes(left), *at)
    clean = along > _OWN_DIRECTED * down
    # where both together are white, nobody knows how much of it is the other line's
    own = clean & (peaks.amplitude > _OWN_MIN * beside)
    if some_white:
        own &= ~_clipped_at(pixels, light, *at, frame.highest)
    with np.errstate(divide="ignore", invalid="ignore"):
        grown = np.hypot(1.0, _REMAINS * beside / peaks.amplitude)
    kept = np.flatnonzero(own)
    left_over = peaks.some(kept, x_std_px=(peaks.x_std_px * grown)[kept])
    sure, alone = (along > _DIRECTED * down)[kept], (beside < _ALONE * peaks.amplitude)[kept]
    return left_over, sure & alone, sure & ~alone
