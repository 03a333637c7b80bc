"""Ridges of the smoothed image in any direction, where they cross rows.

Model. The image is smoothed by a Gaussian of σ in all directions; g are its first, H its second
derivatives. Where the stronger eigenvalue λ of H is negative enough, its eigenvector n points across a
ridge, and the ridge passes the pixel at

    t n,   t = −(g · n) / λ,

kept if it lies within the pixel. From there the ridge is followed along its direction to the row's own
height; pixels next to each other tell of one crossing, and their mean is taken.

A ridge must rise above the valleys on both sides by the threshold, be bright in its own row, and go on over
rows for two standard deviations of the smoothing. In the first and the last rows, where smoothing would
bend it, it is led on by its lean and found in the row alone.

Assumed: a ridge as wide as the smoothing, symmetric, straight over 2 σ. It averages along the stripe: half
the bound's error on clean images, paid for in resolution. Fails at junctions, and on stripes much wider
than σ. No uncertainty is stated.

Source: Steger (1998), An unbiased detector of curvilinear structures, IEEE PAMI 20:113–125; what is asked
of a ridge, and the first and last rows, are ours.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Floats, Integers
from roemetry.records.stripes import EDGE, SATURATED
from roemetry.stages import Capabilities, Extractor
from roemetry_kernels.compiling import inlined, kernel
from roemetry_kernels.image_levels import (
    SHARE_MIN,
    clipped_beyond,
    doubts,
    faint,
    grey,
    plain_layout,
    scaled_level,
)
from roemetry_peaks.peak_window import FWHM_OF_SIGMA
from roemetry_peaks.searching import SearchOptions, searched
from roemetry_peaks.smoothed_peaks import background_noise, rounding_variance

_NOISES = 8.0  # of the smoothed image, that a ridge rises above both valleys
_LEVELS_MIN = 5.0  # grey levels of 0…255 that it rises at least
_BEND_NOISES = 3.0  # of the second derivative, that a ridge is curved at least
_REACH = 4.0  # standard deviations that the filters reach


class StegerOptions(SearchOptions):
    """Options of `Steger`; widths are those across the stripe."""

    sigma_px: float = Field(
        default=2.0,
        ge=0.7,
        le=10.0,
        description="standard deviation of the smoothing in all directions, px: about a stripe's own",
    )


class Steger(Extractor[StegerOptions]):
    """Finds ridges by the Hessian of the smoothed image and follows each to the row's own height."""

    capabilities = Capabilities(tolerance_px=0.12, saturated_tolerance_px=0.2)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        import cv2

        options = self.options
        area = searched(frame, options.region)
        image = plain_layout(grey(frame)[area.top : area.bottom, area.left : area.right])
        sigma = options.sigma_px
        plain, first, second = _filters(sigma)

        def filtered(across: np.ndarray, along: np.ndarray) -> Any:
            return cv2.sepFilter2D(image, cv2.CV_64F, across, along, borderType=cv2.BORDER_REPLICATE)

        noise = math.sqrt(max(background_noise(image) ** 2, rounding_variance(image)))
        if options.threshold == "auto":
            rise = max(_NOISES * noise * _noise_left(plain, image.shape[0]), scaled_level(_LEVELS_MIN, frame))
        else:
            rise = scaled_level(options.threshold, frame)
        # √(3/(16π))/σ³ is what the second derivative's filter leaves of white noise
        found = crossings(
            image,
            filtered(plain, plain),
            (filtered(first, plain), filtered(plain, first)),
            (filtered(second, plain), filtered(first, first), filtered(plain, second)),
            sigma_px=sigma,
            bend_min=_BEND_NOISES * noise * math.sqrt(3.0 / (16.0 * math.pi)) / sigma**3,
            rise=rise,
            noise=noise,
            widths_px=(options.width_min_px, options.width_max_px),
            white=frame.highest,
        )
        order = np.lexsort((found.x_px, found.row))
        row, x_px = found.row[order], found.x_px[order]
        # a crossing may lie beyond the border, or out of order
        inside = np.abs(x_px - 0.5 * (image.shape[1] - 1)) <= 0.5 * image.shape[1]
        inside[1:] &= (np.diff(row) > 0) | (np.diff(x_px) > 0.0)
        order = order[inside]
        if options.threshold == "auto":
            order = order[~faint(found.row[order], found.x_px[order], found.amplitude[order], SHARE_MIN)]
        row, x_px = found.row[order] + area.top, found.x_px[order] + area.left
        return Peaks(
            image_size=frame.size,
            row=row,
            x_px=x_px,
            x_std_px=np.full(order.size, np.nan),
            amplitude=found.amplitude[order],
            background=found.background[order],
            width_px=found.width_px[order],
            flags=found.flags[order] | clipped_beyond(frame, row, x_px),
            correlation_rows=sigma,
            reasons=doubts(image, frame.white, found.row[order], found.x_px[order], found.width_px[order]),
        )


def _noise_left(plain: np.ndarray, rows: int) -> float:
    """Give what the smoothing leaves of white noise, halfway down an image; borders are repeated.

    Along the rows the image is taken as long: where there are few rows, each of them counts several times.
    """
    reach = plain.size // 2
    # rows beyond the border repeat the last one, whose weights add up
    of_row = np.bincount(np.clip(rows // 2 + np.arange(-reach, reach + 1), 0, rows - 1), plain)
    return float(np.linalg.norm(plain) * np.linalg.norm(of_row))


def _filters(sigma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gaussian and its first and second derivative, for correlation; exact on parabolas."""
    reach = math.ceil(_REACH * sigma)
    u = np.arange(-reach, reach + 1, dtype=np.float64)
    plain = np.exp(-0.5 * (u / sigma) ** 2)
    plain /= plain.sum()
    # scaled to be exact on u and on u²
    first = u * plain
    first /= first @ u
    second = (u**2 - (u**2 @ plain)) * plain
    second /= 0.5 * (second @ u**2)
    return plain, first, second


_STEEPEST = 10.0  # px a row: a stripe that leans more hardly crosses rows
_LONG = 0.7  # a ridge's curvature along itself over that across: blobs have 1, beads of speckle or JPEG 0.6
_WITHIN_PX = 0.6  # Steger's half pixel and some more, or noise lets a ridge fall between two pixels
_APART_PX = 1.0  # ridge points of a row that are nearer are of one ridge
_STRONGER = 3.0  # times: next to a ridge so much stronger another one is its shadow
_SEPARATE = 0.4  # of a ridge's height above the lower valley, that it must have above the higher one
_SHADOW = 4.0  # standard deviations of the smoothing within which that is asked
_LIT = 0.4  # of a ridge's height in the smoothed image, that its own row must have
_LIT_NOISES = 4.0  # standard deviations of three pixels' mean, that it must have at least
_STEP_PX = 0.5  # along the normal, where the height is halved
_REACH_PX = 60.0  # and how far that is looked for
_LENGTH = 2.0  # of the smoothing's standard deviation, in rows, that a ridge is long at least
_GONE_PX = 1.0  # from where the ridge was leading, that its crossing of the next row may lie
_MISSING = 1  # rows without a crossing, that a ridge is followed over
_BENT = 0.5  # of what it leans, that it may lie farther away
_ROOM = 48  # crossings a row, made at first

Smooth = NDArray[np.float64]


class Crossings(NamedTuple):
    """Where ridges cross rows, one element a crossing, sorted by row, then x; fields as in `Peaks`."""

    row: Integers
    x_px: Floats
    amplitude: Floats
    background: Floats
    width_px: Floats
    flags: NDArray[np.uint8]


def crossings(
    image: NDArray[Any],
    smooth: Smooth,
    slopes: tuple[Smooth, Smooth],
    bends: tuple[Smooth, Smooth, Smooth],
    *,
    sigma_px: float,
    bend_min: float,
    rise: float,
    noise: float,
    widths_px: tuple[float, float],
    white: int,
) -> Crossings:
    """Find where ridges cross rows.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels.
    smooth : ndarray of float64, shape (rows, columns)
        The image smoothed by a Gaussian.
    slopes, bends
        Its derivatives, grey levels per px and px²: by x, y; by xx, xy, yy.
    sigma_px
        Standard deviation of that Gaussian, px.
    bend_min
        Smallest curvature across a ridge, grey levels per px².
    rise
        By how much a ridge must rise above the valleys on both sides of the smoothed image, grey levels.
    noise
        Standard deviation of a pixel beside the stripes, grey levels.
    widths_px
        Smallest and largest full width at half height across a stripe, px.
    white
        Grey level from which on a pixel is saturated.
    """
    room = _ROOM * image.shape[0]
    while True:
        row, flags = np.empty(room, np.int64), np.zeros(room, np.uint8)
        values = np.empty((5, room))
        limits = np.array([sigma_px, bend_min, rise, *widths_px, white, noise], np.float64)
        count = _crossings(image, smooth, *slopes, *bends, limits, row, values, flags)
        if count <= room:
            break
        room = count
    x_px, amplitude, background, width_px = values[:4, :count].copy()
    return Crossings(row[:count].copy(), x_px, amplitude, background, width_px, flags[:count].copy())


@kernel
def _crossings(
    image: NDArray[Any],
    smooth: Smooth,
    gx: Smooth,
    gy: Smooth,
    gxx: Smooth,
    gxy: Smooth,
    gyy: Smooth,
    limits: Floats,
    row: Integers,
    values: Floats,
    flags: NDArray[np.uint8],
) -> int:
    rows, columns = image.shape
    count = 0
    measured = np.empty(4)
    for y in range(rows):
        begin, kept_x, kept = count, -np.inf, 0.0
        # Pixels next to each other tell of one crossing: their mean, weighted by how near the ridge is.
        weight, x_sum, nx_sum, ny_sum, x_last, strongest = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for x in range(columns + 1):
            near, at, nx, ny, strength = 0.0, 0.0, 1.0, 0.0, 0.0
            if x < columns:
                near, at, nx, ny, strength = _ridge(gx, gy, gxx, gxy, gyy, y, x, limits[0], limits[1])
            if weight > 0.0 and (x == columns or (near > 0.0 and at - x_last > _APART_PX)):
                crossing = x_sum / weight
                size = math.hypot(nx_sum, ny_sum)
                good = _measure(smooth, crossing, y, nx_sum / size, ny_sum / size, limits, measured)
                good = good and _lit(image, crossing, y, measured, limits[6])
                good = good and not _bent_by_border(nx_sum, ny_sum, y, rows, limits[0])
                if good and count > begin and crossing - kept_x < _SHADOW * limits[0]:
                    # Of two that are so near the much weaker one is a wrinkle on the other's slope.
                    if _STRONGER * strongest < kept:
                        good = False
                    elif strongest > _STRONGER * kept:
                        count -= 1
                if good and count < row.shape[0]:
                    row[count] = y
                    values[0, count] = crossing
                    values[1, count], values[2, count] = measured[0], measured[1]
                    values[3, count] = measured[2] * size / nx_sum
                    values[4, count] = -ny_sum / nx_sum
                    flags[count] = _flags(image, crossing, y, limits[0], limits[5])
                if good:
                    kept_x, kept = crossing, strongest
                    count += 1
                weight, x_sum, nx_sum, ny_sum, strongest = 0.0, 0.0, 0.0, 0.0, 0.0
            # what is so much stronger replaces what was gathered
            if weight > 0.0 and strength > _STRONGER * strongest:
                weight, x_sum, nx_sum, ny_sum = 0.0, 0.0, 0.0, 0.0
            if near > 0.0 and _STRONGER * strength >= strongest:
                strongest = max(strongest, strength)
                weight += near
                x_sum += near * at
                nx_sum += near * nx
                ny_sum += near * ny
                x_last = at
    if count > row.shape[0]:
        return count
    found = _long(min(math.ceil(_LENGTH * limits[0]), rows), count, row, values, flags)
    count = carried_on(image, limits[0], _LIT_NOISES * limits[6], found, row, values)
    for p in range(found, min(count, row.shape[0])):
        flags[p] = _flags(image, values[0, p], row[p], limits[0], limits[5])
    return count


@inlined
def _long(rows_min: int, count: int, row: Integers, values: Floats, flags: NDArray[np.uint8]) -> int:
    """Leave out what no ridge of so many rows runs through, in place; gives how many crossings are left.

    A ridge goes on where it was leading. A hot pixel, a ripple of a JPEG, a bump of noise is bright in a row
    or two; smoothing makes it round, and noise beside it long.
    """
    rows = np.ones((2, count), np.int64)
    for way in range(2):
        begin, upto = 0, 0
        for i in range(count):
            p = i if way == 0 else count - 1 - i
            down = 1 if way == 0 else -1
            # Crossings of the rows before, as far as they have been walked past.
            while (
                begin < i and down * (row[p] - row[begin if way == 0 else count - 1 - begin]) > _MISSING + 1
            ):
                begin += 1
            upto = begin
            while upto < i:
                q = upto if way == 0 else count - 1 - upto
                if row[q] == row[p]:
                    break
                lean = values[4, q] * (row[p] - row[q])
                # within what its lean explains
                if abs(values[0, p] - values[0, q] - lean) <= _GONE_PX + _BENT * abs(lean):
                    rows[way, p] = max(rows[way, p], rows[way, q] + 1)
                upto += 1
    kept = 0
    for p in range(count):
        # both ways have counted the row itself
        if rows[0, p] + rows[1, p] - 1 < rows_min:
            continue
        row[kept], flags[kept] = row[p], flags[p]
        for field in range(values.shape[0]):
            values[field, kept] = values[field, p]
        kept += 1
    return kept


@kernel
def _bent_by_border(nx: float, ny: float, y: int, rows: int, sigma: float) -> bool:
    """Whether a leaning ridge is so near the first or last row that what lies beyond would be asked."""
    return abs(ny) > LEANS * abs(nx) and min(y, rows - 1 - y) < BORDER * sigma


@kernel
def _lit(image: NDArray[Any], x: float, y: int, measured: Floats, noise: float) -> bool:
    """Whether the row itself has light there: smoothing carries a stripe beyond its end."""
    light, pixels = 0.0, 0
    for column in range(max(int(x + 0.5) - 1, 0), min(int(x + 0.5) + 2, image.shape[1])):
        light += image[y, column]
        pixels += 1
    least = max(_LIT * measured[3], _LIT_NOISES * noise / math.sqrt(max(pixels, 1)))
    return pixels > 0 and light / pixels - measured[1] > least


@kernel
def _ridge(
    gx: Smooth,
    gy: Smooth,
    gxx: Smooth,
    gxy: Smooth,
    gyy: Smooth,
    y: int,
    x: int,
    sigma: float,
    bend_min: float,
) -> tuple[float, float, float, float, float]:
    """How near a ridge runs to a pixel's middle (0: not through it); the crossing; its normal; strength."""
    a, b, c = np.float64(gxx[y, x]), np.float64(gxy[y, x]), np.float64(gyy[y, x])
    # neither curvature is negative enough: known without a root
    if a > -bend_min and c > -bend_min and a * c - b * b >= 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0
    # eigenvalues of the Hessian
    half = 0.5 * (a - c)
    root = math.sqrt(half * half + b * b)
    across = 0.5 * (a + c) - root
    along = 0.5 * (a + c) + root
    if across > -bend_min or along < _LONG * across:
        return 0.0, 0.0, 1.0, 0.0, 0.0
    # The eigenvector of the stronger curvature, by the numerically better of two forms.
    nx, ny = (b, across - a) if abs(across - a) > abs(across - c) else (across - c, b)
    size = math.hypot(nx, ny)
    if size == 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0
    nx, ny = nx / size, ny / size
    # Newton's step to where the slope across vanishes
    t = -(gx[y, x] * nx + gy[y, x] * ny) / across
    if abs(t) > 1.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0
    # One step of Newton's from the pixel goes too far, on a Gaussian as wide as the smoothing by this much.
    t -= t * t * t / (2.0 * sigma * sigma)
    dx, dy = t * nx, t * ny
    # The ridge's point nearest to the pixel lies in it, up to a half on either side and some overlap, to the
    # ends of which its weight falls to nothing.
    if abs(dx) >= _WITHIN_PX or abs(dy) >= _WITHIN_PX or abs(ny) > _STEEPEST * abs(nx):
        return 0.0, 0.0, 1.0, 0.0, 0.0
    if nx < 0.0:
        nx, ny = -nx, -ny
    # From that point along the ridge, whose direction is (−ny, nx), back to the row.
    return (_WITHIN_PX - abs(dx)) * (_WITHIN_PX - abs(dy)), x + dx + dy * ny / nx, nx, ny, -across


@kernel
def _measure(smooth: Smooth, x: float, y: int, nx: float, ny: float, limits: Floats, out: Floats) -> bool:
    """Height, background and width of a stripe from the smoothed image along its normal."""
    sigma, rise, narrow, wide = limits[0], limits[2], limits[3], limits[4]
    top = _level(smooth, x, np.float64(y))
    valleys, halves = np.zeros(2), np.zeros(2)
    for side in range(2):
        way = 1.0 if side else -1.0
        lowest, distance = top, 0.0
        # down to the valley, which ends where it rises by half the threshold
        while distance < min(_REACH_PX, 3.0 * wide):
            distance += _STEP_PX
            level = _level(smooth, x + way * distance * nx, y + way * distance * ny)
            if not level > -np.inf or level > lowest + 0.5 * rise:
                break
            lowest = min(lowest, level)
        valleys[side] = lowest
    if top - max(valleys[0], valleys[1]) <= max(rise, _SEPARATE * (top - min(valleys[0], valleys[1]))):
        return False
    for side in range(2):
        way = 1.0 if side else -1.0
        half = 0.5 * (top + valleys[side])
        before, distance = top, 0.0
        while True:
            distance += _STEP_PX
            level = _level(smooth, x + way * distance * nx, y + way * distance * ny)
            if not level > half:
                break
            before = level
        if not level > -np.inf:
            return False
        halves[side] = distance - _STEP_PX * (half - level) / (before - level)
    # widths add as squares: the smoothing's is taken off
    variance = ((halves[0] + halves[1]) / FWHM_OF_SIGMA) ** 2 - sigma * sigma
    if variance <= 0.0 or not narrow <= FWHM_OF_SIGMA * math.sqrt(variance) <= wide:
        return False
    background = 0.5 * (valleys[0] + valleys[1])
    # smoothing lowered the height, too
    out[0] = (top - background) * math.sqrt((variance + sigma * sigma) / variance)
    out[1] = background
    out[3] = top - background
    out[2] = FWHM_OF_SIGMA * math.sqrt(variance)
    return True


@kernel
def _level(smooth: Smooth, x: float, y: float) -> float:
    """The smoothed image between pixels; −∞ left and right of it; the first and last row go on for ever."""
    rows, columns = smooth.shape
    if not 0.0 <= x <= columns - 1:
        return -np.inf
    y = min(max(y, 0.0), rows - 1.0)
    i, j = min(int(y), max(rows - 2, 0)), min(int(x), max(columns - 2, 0))
    v, u = y - i, x - j
    below, right = min(i + 1, rows - 1), min(j + 1, columns - 1)
    upper = (1.0 - u) * smooth[i, j] + u * smooth[i, right]
    lower = (1.0 - u) * smooth[below, j] + u * smooth[below, right]
    return (1.0 - v) * upper + v * lower


@kernel
def _flags(image: NDArray[Any], x: float, y: int, sigma: float, white: float) -> int:
    columns = image.shape[1]
    flag = 0
    if x < 2.0 * sigma or x > columns - 1 - 2.0 * sigma:
        flag |= EDGE
    for column in range(max(int(x) - 1, 0), min(int(x) + 3, columns)):
        if image[y, column] >= white:
            flag |= SATURATED
    return flag


LEANS = 0.1
"""Px a row: a ridge that leans more is bent by rows that are repeated beyond the border."""
BORDER = 2.0
"""Standard deviations of the smoothing: so near the first or the last row it is."""
_AWAY = 0.75  # standard deviations of the smoothing from where the ridge leads, that its crossing may lie
_END_LIT = 0.25  # of the height, that all three pixels in the middle have
_STEPS = 6  # of Newton's method at most
_RESTS_PX = 1e-4  # a step so short is the last
_END_REACH = 4.0  # standard deviations of the smoothing


@kernel
def carried_on(
    image: NDArray[Any],
    sigma: float,
    dark: float,
    count: int,
    row: Integers,
    values: Floats,
) -> int:
    """Carry ridges on to the first and the last row; gives how many crossings there are then.

    From the nearest row that smoothing does not bend, each ridge leads to the next one by its lean. There the
    row alone is smoothed, across the ridge, and the top nearest to that place is the crossing, if it has
    light. What else is known of it is as in the row where it was carried on from.

    Parameters
    ----------
    image
        (row, column) grey levels.
    sigma
        Standard deviation of the smoothing, px.
    dark
        Grey levels above the background that a pixel may have by chance.
    count
        Crossings so far.
    row, values
        (room,) image row, not falling as far as `count`; (5, room) place, px, height, background, width, lean
        of the crossings; those that are new are added, as far as there is room.
    """
    rows = image.shape[0]
    near = min(math.ceil(BORDER * sigma), rows)
    known = count
    for p in range(known):
        lean = values[4, p]
        for way in (-1, 1):
            last = 0 if way < 0 else rows - 1
            if abs(row[p] - last) != near:
                continue
            lead = values[0, p]
            for step in range(1, near + 1):
                y = row[p] + way * step
                lead += way * lean
                x = _top_near(image, y, lead, sigma)
                if not _is_lit(image, y, x, values[2, p], max(dark, _END_LIT * values[1, p])):
                    continue
                lead = x
                if _is_there(row, values, known, p, way, y, x, BORDER * sigma):
                    continue
                if count < row.shape[0]:
                    row[count], values[0, count] = y, x
                    for field in range(1, values.shape[0]):
                        values[field, count] = values[field, p]
                count += 1
    return count


@kernel
def _is_there(
    row: Integers, values: Floats, known: int, p: int, way: int, y: int, x: float, near_px: float
) -> bool:
    """Whether a row has a crossing near a place already; it is looked for from crossing p on."""
    q = p
    while 0 <= q < known and way * (y - row[q]) >= 0:
        if row[q] == y and abs(values[0, q] - x) < near_px:
            return True
        q += way
    return False


@kernel
def _top_near(image: NDArray[Any], y: int, at: float, sigma: float) -> float:
    """Where the row, smoothed by a Gaussian, has its top next to a place; NaN where it has none there."""
    columns = image.shape[1]
    reach = math.ceil(_END_REACH * sigma)
    x = at
    for _ in range(_STEPS):
        # slope and bend of the smoothed row at x, but for their factors
        slope, bend = 0.0, 0.0
        for column in range(math.floor(x) - reach, math.floor(x) + reach + 1):
            u = (column - x) / sigma
            light = np.exp(-0.5 * u * u) * image[y, min(max(column, 0), columns - 1)]
            slope += u * light
            bend += (u * u - 1.0) * light
        if not bend < 0.0:
            return np.nan
        # half a pixel at a time at most, so that it does not jump to another top
        step = -sigma * slope / bend
        x += min(max(step, -0.5), 0.5)
        if not abs(x - at) <= _AWAY * sigma + LEANS:
            return np.nan
        if abs(step) < _RESTS_PX:
            break
    return x


@kernel
def _is_lit(image: NDArray[Any], y: int, x: float, background: float, least: float) -> bool:
    """Whether all three pixels around a place have light: a speck beyond a stripe's end is no more of it."""
    columns = image.shape[1]
    if not 0.0 <= x <= columns - 1:
        return False
    middle = int(x + 0.5)
    darkest = np.inf
    for column in range(middle - 1, middle + 2):
        darkest = min(darkest, np.float64(image[y, min(max(column, 0), columns - 1)]))
    return darkest - background > least
