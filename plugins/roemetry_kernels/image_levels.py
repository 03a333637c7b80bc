"""What an extractor asks of a frame before it looks for stripes: one channel, levels within the bit depth.

And of its pixels: their noise, what its stripes reach, whether they are darker than their surroundings. The
n-th smallest and the median are loops of ours: kernels that call numpy's have all of it compiled into them,
each anew, which takes seconds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError
from roemetry.records import SATURATED, Frame
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.reasons import Reason
from roemetry_kernels.compiling import float_kernel, inlined, kernel

_WHITE_8_BIT = 255


def grey(frame: Frame) -> NDArray[Any]:
    """Give the frame's (row, column) pixels.

    Raises
    ------
    DataError
        The frame has colours, or a pixel brighter than its bit depth allows.
    """
    pixels = frame.pixels
    if pixels.ndim != 2:
        raise DataError(
            f"Frame {frame.name!r} has colours ({pixels.shape[2]} values a pixel), expected one channel",
            hint="choose one by source.channel in the recipe (red, max, grey)",
        )
    if frame.highest < np.iinfo(pixels.dtype).max and (brightest := int(pixels.max())) > frame.highest:
        raise DataError(
            f"Frame {frame.name!r} holds grey level {brightest}, "
            f"but its bit depth of {frame.bit_depth} ends at {frame.highest}",
            hint="set the source's bit depth to what the camera gives",
        )
    return pixels


def plain_layout(pixels: NDArray[Any]) -> NDArray[Any]:
    """Give pixels row by row and read-only: kernels are compiled for no other memory layout.

    Every further one would be compiled anew, at half a second or more.
    """
    plain = np.ascontiguousarray(pixels).view()
    plain.flags.writeable = False
    return plain


def scaled_level(level: float, frame: Frame) -> float:
    """Scale a grey level of the 8-bit scale to the frame's own.

    To compare whole grey levels: ``> floor(scaled)`` is the same as ``> scaled``, ``>= ceil`` as ``>=``.
    """
    return level * frame.white / _WHITE_8_BIT


def clipped_beyond(frame: Frame, row: Integers, x_px: Floats) -> NDArray[np.uint8]:
    """Give `SATURATED` for peaks on light that the camera clipped and a headroom tells more of, else 0.

    Kernels take for saturated what is at the frame's highest level; below, they use what a headroom tells.
    """
    flags = np.zeros(row.shape[0], np.uint8)
    if frame.headroom:
        # both pixels beside the centre
        for one in (np.floor(x_px), np.ceil(x_px)):
            at = np.clip(one.astype(np.int64), 0, frame.size[1] - 1)
            flags[frame.pixels[row, at] >= frame.white] = SATURATED
    return flags


_BLOCK = 16  # pixels whose differences are looked at together
_BLOCKS_MAX = 1024  # looked at in all: the estimate is then good to 2 %
_NOISE_ROWS_MAX = 32  # that they lie in: memory is read along rows
_SUMS = 4096  # sums of squares up to here are counted, not sorted
_QUANTILE = 0.2  # of the blocks' noise: the dark ones, without stripes and texture
_QUANTILE_OF_CHI = 0.791
"""That quantile of the root mean square of 15 differences of white noise, over the true one; found by drawing
ten million blocks."""
_QUANTISATION = 1.0 / math.sqrt(12.0)  # grey levels: standard deviation of rounding
_NOISES = 10.0  # that a stripe rises at least
RISE_MIN = 6.0
"""Of 255 grey levels, that a stripe rises at least."""
_STEEP_SHARE = 0.01  # of white: noisier images are looked at across the rows as well


def image_noise(image: NDArray[Any], white: int, top: int, bottom: int, left: int, right: int) -> float:
    """Estimate the standard deviation of the noise in the dark parts of an image, grey levels.

    From differences of neighbouring pixels in blocks of 16 (a low quantile of the blocks), along the rows;
    where that is much, also from row to row, and the smaller counts. Never less than the rounding to whole
    grey levels has.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels, contiguous and read-only.
    white
        The grey level that 255 stands for.
    top, bottom, left, right
        The part that is looked at: rows and columns from the first to the one after the last.
    """
    levels, columns = image.reshape(-1), image.shape[1]
    noise = _noise_of(_low_sum(levels, columns, 1, top, bottom, left, right))
    if noise > _STEEP_SHARE * white and bottom - top > 1:
        # Where stripes fill the image every block holds a slope; from row to row they hardly change.
        noise = min(noise, _noise_of(_low_sum(levels, columns, columns, top, bottom - 1, left, right)))
    return max(noise, _QUANTISATION)


def automatic_rise(image: NDArray[Any], white: int, top: int, bottom: int, left: int, right: int) -> int:
    """Choose by how much a stripe must rise: ten times the noise, at least 6 grey levels of 255.

    The parameters are those of `image_noise`.
    """
    noise = image_noise(image, white, top, bottom, left, right)
    return math.ceil(max(_NOISES * noise, RISE_MIN * white / 255.0))


def _noise_of(low: int) -> float:
    # a difference has the variance of both pixels
    return math.sqrt(low / (_BLOCK - 1.0) / 2.0) / _QUANTILE_OF_CHI


@kernel
def _low_sum(
    levels: NDArray[Any], columns: int, apart: int, top: int, bottom: int, left: int, right: int
) -> int:
    """Low quantile of the sums of 15 squared differences in blocks spread over the image; 0 without any.

    The differences are those of pixels `apart` places from each other: 1 along the row, `columns` across.
    """
    across = (right - left) // _BLOCK
    rows = min(bottom - top, _NOISE_ROWS_MAX)
    if across == 0 or rows == 0:
        return 0
    a_row = min(across, _BLOCKS_MAX // rows)
    sums, counts = np.empty(rows * a_row, np.int64), np.zeros(_SUMS, np.int64)
    # Unsigned, which no index from the end can be: only then are pixels taken many at a time.
    begins, beside = np.empty(a_row, np.uint64), np.uint64(apart)
    for n in range(a_row):
        begins[n] = left + _BLOCK * (n * across // a_row)
    for r in range(rows):
        row = np.uint64((top + (2 * r + 1) * (bottom - top) // (2 * rows)) * columns)
        for n in range(a_row):
            begin = row + begins[n]
            total: Any = np.int64(0)
            for k in range(np.uint64(_BLOCK - 1)):
                step = np.int64(levels[begin + k + beside]) - np.int64(levels[begin + k])
                total += step * step
            sums[r * a_row + n] = total
            counts[min(total, _SUMS - 1)] += 1
    # small sums are counted instead of sorted
    wanted = int(_QUANTILE * (sums.size - 1))
    upto: Any = 0
    for low in range(_SUMS - 1):
        upto += counts[low]
        if upto > wanted:
            return low
    return int(nth_smallest(sums, wanted))


SHARE_MIN = 0.08
"""Of a stripe beside it, that a stripe is high: the ripples of a JPEG are lower."""
_STEP_PX, _ALIKE = 3.0, 2.0  # from row to row along one stripe: in place, and in height at most
_ROWS_ON, _SHARE_ON = 24, 0.25
"""Rows, and share of the rows with peaks, that a stripe has gone on for before it counts: three blocks of a
JPEG; lamps and marks are smaller than a quarter of the image."""
_USUAL = 0.9  # of the rows: others may show nothing but noise
_NEAR_BY_PX = 16.0  # two blocks of a JPEG


@float_kernel
def faint(row: NDArray[Any], x_px: Floats, amplitude: Floats, share_min: float) -> Flags:
    """Say which peaks rise by too little beside the others: ringing, glare, or what a JPEG made of noise.

    Parameters
    ----------
    row, x_px, amplitude
        (peak,) image row, place, px, and height, grey levels, of peaks sorted by row, then place.
    share_min
        Of the height of a peak within 16 px in the same row, and of what stripes reach (`usual_height`).

    Returns
    -------
    ndarray
        (peak,) True where a peak is lower than that share.
    """
    count = row.shape[0]
    out = np.zeros(count, np.bool_)
    if count == 0:
        return out
    highest = 0.0
    for i in range(count):
        highest = max(highest, amplitude[i])
    least = share_min * usual_height(row, x_px, amplitude)
    for i in range(count):
        low = amplitude[i] < share_min * highest
        out[i] = amplitude[i] < least or (low and outshone(row, x_px, amplitude, i, share_min))
    return out


@inlined
def usual_height(row: NDArray[Any], x_px: Floats, amplitude: Floats) -> float:
    """What stripes reach: the highest peak of a row, in all but the brightest tenth of the rows.

    Only peaks count that go on from row to row, as stripes do. A lamp or marks that throw light back are as
    bright as can be, but end. Where nothing goes on, all peaks count.
    """
    count = row.shape[0]
    on = max(_ROWS_ON, int(_SHARE_ON * (row[count - 1] - row[0])))
    before, rows_before = np.full(count, -1, np.int64), np.zeros(count, np.int64)
    goes_on, highest = np.zeros(count, np.bool_), np.empty(count)
    begin, here = 0, 0  # of the row before: its first peak that may go on; this row's first
    for i in range(1, count):
        if row[i] != row[i - 1]:
            begin, here = (here if row[i] == row[i - 1] + 1 else i), i
        while begin < here and x_px[begin] < x_px[i] - _STEP_PX:
            begin += 1
        if begin < here and x_px[begin] <= x_px[i] + _STEP_PX:
            one, other = amplitude[i], amplitude[begin]
            if max(one, other) <= _ALIKE * min(one, other):
                before[i], rows_before[i] = begin, rows_before[begin] + 1
    any_goes_on = False
    for i in range(count - 1, -1, -1):
        goes_on[i] |= rows_before[i] >= on
        any_goes_on |= goes_on[i]
        # back along the stripe: what leads to such a peak goes on, too
        if goes_on[i] and before[i] >= 0:
            goes_on[before[i]] = True
    rows, last = 0, -1
    for i in range(count):
        if any_goes_on and not goes_on[i]:
            continue
        rows += 1 if row[i] != last else 0
        highest[rows - 1] = max(amplitude[i], highest[rows - 1]) if row[i] == last else amplitude[i]
        last = row[i]
    return float(nth_smallest(highest[:rows], int(_USUAL * (rows - 1))))


@inlined
def outshone(row: NDArray[Any], x_px: Floats, amplitude: Floats, i: int, share_min: float) -> bool:
    """Say whether a peak of the same row near by is so much higher."""
    least = amplitude[i] / max(share_min, 1e-9)
    j = i - 1
    while j >= 0 and row[j] == row[i] and x_px[i] - x_px[j] <= _NEAR_BY_PX:
        if amplitude[j] > least:
            return True
        j -= 1
    j = i + 1
    while j < row.shape[0] and row[j] == row[i] and x_px[j] - x_px[i] <= _NEAR_BY_PX:
        if amplitude[j] > least:
            return True
        j += 1
    return False


_LOOKED_AT = 200  # pairs of neighbours
_FEWEST = 8  # pairs, or rows, below which nothing is said
_FILLED = 0.5  # of a row, that stripes fill at most
_WIDTHS_PX = (1.5, 40.0)  # at half height, of what may be a line
_DARK_ROWS_MAX = 32  # that are searched for dark lines where nothing bright is found
_PIXELS_A_ROW = 160  # that tell of the ground
_ODD = Reason(
    "upside-down",
    "the stripes found are wider than the gaps between them: they are darker than their surroundings "
    "(then invert the image), or too near to each other",
)
_DARK = Reason(
    "upside-down",
    "no bright stripe was found, but dark lines: invert the image if these are the stripes",
)


def doubts(
    image: NDArray[Any], white: int, row: NDArray[Any], x_px: Floats, width_px: Floats
) -> tuple[Reason, ...]:
    """Say what speaks against the peaks of an image being its stripes.

    Stripes leave most of a row dark: of 8 standard deviations from one to the next, the full width at half
    height is 0.29. Between dark lines the bright ground is the wider part. Where there are less than two
    peaks a row, some rows of the complement are searched.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels.
    white
        Grey level from which on a pixel is saturated.
    row, x_px, width_px
        (peak,) image row, place and full width at half height, px, sorted by row, then place.
    """
    step = max(1, row.shape[0] // _LOOKED_AT)
    one, other = slice(0, max(row.shape[0] - 1, 0), step), slice(1, None, step)
    pairs = row[one] == row[other]
    looked_at = np.count_nonzero(pairs)
    if looked_at >= _FEWEST:
        filled = width_px[one] + width_px[other] > 2.0 * _FILLED * (x_px[other] - x_px[one])
        # Half of them is more than half: without a median, which would take longer than all else.
        if 2 * np.count_nonzero(filled & pairs) > looked_at:
            return (_ODD,)
    if row.shape[0] >= 2 * image.shape[0] or not _has_darker_pixels(image, white):
        return ()
    return (_DARK,) if _has_dark_lines(image, white, row.shape[0] / image.shape[0]) else ()


def _has_darker_pixels(image: NDArray[Any], white: int) -> bool:
    """Say whether rows usually hold a pixel darker than the ground by what a line needs: asked first.

    On dark ground none is, so that what searches for lines need not even be loaded.
    """
    some = image[:: max(1, -(-image.shape[0] // _DARK_ROWS_MAX))]
    part = some[:, :: max(1, some.shape[1] // _PIXELS_A_ROW)].reshape(-1)
    half = max(some.shape[0] // 2 - 1, 0)
    darkest = np.partition(some.min(axis=1), half)[half]
    ground = np.partition(part, part.size // 2)[part.size // 2]
    return float(ground) - float(darkest) >= RISE_MIN * white / 255.0


def _has_dark_lines(image: NDArray[Any], white: int, bright_a_row: float) -> bool:
    """Say whether most rows have more dark lines than bright stripes."""
    from scipy.signal import find_peaks  # few images get here

    some = image[:: max(1, -(-image.shape[0] // _DARK_ROWS_MAX))]
    ground = np.median(some, axis=1)
    if np.median(some.max(axis=1) - ground) > np.median(ground - some.min(axis=1)):
        return False  # what is brightest stands out more than what is darkest: a line in a lit room
    dark = plain_layout((white - np.minimum(some, white)).astype(some.dtype.newbyteorder("=")))
    rise = automatic_rise(dark, white, 0, some.shape[0], 0, some.shape[1])
    lines = [find_peaks(line, prominence=rise, width=_WIDTHS_PX)[1]["prominences"] for line in dark]
    highest = max((float(one.max()) for one in lines if one.size), default=0.0)
    count = np.array([np.count_nonzero(one >= SHARE_MIN * highest) for one in lines])
    rows = np.count_nonzero(count)
    return bool(rows >= max(_FEWEST, some.shape[0] // 2) and count.sum() > bright_a_row * some.shape[0])


@kernel
def nth_smallest(values: NDArray[Any], n: int) -> Any:
    """Give the number that would stand at `n` if the values were sorted (Hoare's selection).

    Parameters
    ----------
    values
        (k,) in any order, none of them NaN; they are left as they are.
    n
        From 0 to k − 1.
    """
    return _with_in_place(values, n)[n]


@kernel
def median_of(values: NDArray[Any]) -> float:
    """Give the median of one value or more, none of them NaN; of an even number the middle two's mean."""
    lower = (values.shape[0] - 1) // 2
    some = _with_in_place(values, lower)
    if values.shape[0] % 2:
        return float(some[lower])
    above = some[lower + 1]
    for k in range(lower + 2, some.shape[0]):
        above = min(above, some[k])
    return 0.5 * (some[lower] + above)


@kernel
def quantile_of(values: NDArray[Any], share: float) -> float:
    """Give the value that a share of one value or more, none of them NaN, lies below; linear in between."""
    at = share * (values.shape[0] - 1)
    lower = int(at)
    some = _with_in_place(values, lower)
    if lower + 1 >= values.shape[0]:
        return float(some[lower])
    above = some[lower + 1]
    for k in range(lower + 2, some.shape[0]):
        above = min(above, some[k])
    return float(some[lower] + (at - lower) * (above - some[lower]))


@kernel
def _with_in_place(values: NDArray[Any], n: int) -> NDArray[Any]:
    """Give the values with the n-th smallest at `n`, none before it larger and none behind it smaller."""
    some = values.copy()
    low, high = 0, some.shape[0] - 1
    while low < high:
        middle = some[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while some[i] < middle:
                i += 1
            while middle < some[j]:
                j -= 1
            if i <= j:
                some[i], some[j] = some[j], some[i]
                i += 1
                j -= 1
        if n <= j:
            high = j
        elif n >= i:
            low = i
        else:
            break
    return some
