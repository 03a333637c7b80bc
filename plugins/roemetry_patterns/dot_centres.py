"""Maximum likelihood of each dot's centre, height and shape under the camera's noise and the laser's speckle.

Model. Around a dot the light is b + a·exp(−½ rᵀ S⁻¹ r), r from the centre, S any positive definite shape: a
round beam on a slope is an ellipse. A pixel's variance is v = s² + g·m + C²·m², with m the dot's own light,
s what pixels beside dots scatter by, g the camera's gain and C the contrast of the speckle. Fisher scoring
finds the seven numbers; its inverse information is their covariance, and the Cramér–Rao bound where there
is no speckle. Speckle is alike in neighbouring pixels, which says less than independent pixels would: the
covariance becomes N⁻¹(JᵀWΣWJ)N⁻¹, with Σ of pixels that correlate by ρ at distance 1.

s comes from the dark of the image, g from the camera (if it is not known, C counts it), C and ρ from the
residuals of some dots. A clipped pixel says nothing and is left out. What is no dot (two that have merged,
one that an edge has cut) fits worse than noise allows; its covariance grows by as much, and beyond a limit
it is flagged `WIDE`.

It fails where dots are nearer than three of their widths: they are flagged, or found as one.
Source: Fisher scoring as in Rao (1973), Linear Statistical Inference, 5g; the use of speckle is ours.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from pydantic import Field

from roemetry.records import EDGE, SATURATED, WIDE, Dots, Frame, Peaks
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.compiling import float_kernel, inlined, kernel
from roemetry_kernels.image_levels import clipped_beyond, grey, median_of
from roemetry_kernels.robust_fit import solve

_NOISES = 8.0
"""Of the smoothed image's noise, that a dot's top rises above its surroundings."""
_LEVELS = 4.0 / 255.0
"""Of white, that it rises at least."""
_FINE_PX, _COARSE_PX = 1.0, 4.0
"""The image smoothed by the first, less that smoothed by the second, is where dots are looked for, px."""
_NOISE_ROWS = 3
"""The noise is told by every so many rows."""
_REACH = 3.5
"""Standard deviations of a dot within which pixels count: beyond them is 0.2 % of its light."""
_RADIUS_PX = (3, 12)
"""Least and largest radius of the pixels that count, px."""
_APART = 0.6
"""Of the distance to the next dot, that the radius is at most."""
_ROUNDS = 12
"""Steps of Fisher scoring at most: from a start within a pixel six settle."""
_SETTLED_PX = 4e-3
"""What is left after a step is a tenth of it and less: a twentieth of the surest dot's uncertainty."""
_FIRST_RADIUS_PX = 5
"""Of the pixels that count, before it is known how large dots are."""
_SIZE_SAMPLE = 72
"""Dots that are asked for their size."""
_SAMPLE = 24
"""Of these, that tell of the speckle: each has some ten grains."""
_CORRELATIONS = np.array([0.0, 0.3, 0.5, 0.65, 0.75])
"""Of neighbouring pixels' speckle, that are tried."""
_ALIKE = 3
"""Pixels over which speckle is alike."""
_WIDTHS = (0.5, 2.0)
"""Of the dots' usual size, that one can be: a sphere's flank at 75° draws its dot out to the double."""
_HEIGHT_MAX, _DARK_MAX = 3.0, 0.1
"""Of white: a dot that is not clipped and higher, or whose background is darker than black by more, was drawn
far beyond its pixels."""
_MISFIT_MAX = 3.0
"""Times the noise that residuals can be: merged dots reach ten and more."""
_FWHM = 2.3548200450309493  # full width at half height of a Gaussian, standard deviations


class DotCentresOptions(StageOptions):
    """What counts as a dot."""

    amplitude_min: float | None = Field(
        default=None, gt=0.0, le=65535.0, description="least height of a dot, grey levels; default: by noise"
    )
    width_max_px: float = Field(
        default=12.0, ge=2.0, le=24.0, description="largest full width at half height of a dot, px"
    )


class DotCentres(Extractor[DotCentresOptions]):
    """Fits an elliptical Gaussian to each dot, weighted by each pixel's noise."""

    capabilities = Capabilities(tolerance_px=0.02, saturated_tolerance_px=0.3, pattern="dots")

    def extract(self, frame: Frame) -> Peaks:
        """Find the dots of a frame; DataError where it has colours, or pixels above its bit depth."""
        image = np.ascontiguousarray(grey(frame), np.float64)
        starts, noise = found_dots(image, frame.highest, self.options.amplitude_min)
        gain = math.nan if frame.sensor is None else frame.sensor.gain_grey_per_electron
        fit = fitted_dots(image, float(frame.highest), starts, noise, gain)
        return _peaks(fit, frame, self.options.width_max_px)


class Fit(NamedTuple):
    """Dots as fitted."""

    values: Floats
    """(dot, 7) x, y, height, background, then S: xx, xy, yy."""
    covariance: Floats
    """(dot, 2, 2) of x and y, px²."""
    misfit: Floats
    """(dot,) root mean square of the residuals over their noise; NaN where the fit has failed."""
    clipped: Flags
    """(dot,) True where pixels near the middle are white."""


def found_dots(image: Floats, white: int, amplitude_min: float | None = None) -> tuple[Floats, float]:
    """Find tops of the image, (n, 3) x, y and height over the surroundings, and the noise of a dark pixel."""
    import cv2

    if min(image.shape) < 2 * _RADIUS_PX[0] + 1:
        return np.empty((0, 3)), 1.0
    # of rounded grey levels that hardly scatter, the rounding is what remains
    usual = median_of(np.abs(np.diff(image[::_NOISE_ROWS], axis=1)).ravel())
    # a difference has twice the variance; 1.4826 makes a median a standard deviation
    noise = max(1.4826 * usual / math.sqrt(2.0), 0.3)
    smooth = (cv2.GaussianBlur(image.astype(np.float32), (0, 0), s) for s in (_FINE_PX, _COARSE_PX))
    raised = next(smooth) - next(smooth)
    # smoothing leaves 1/(2√π σ) of white noise
    least = max(_NOISES * noise / (2.0 * math.sqrt(math.pi) * _FINE_PX), _LEVELS * white)
    if amplitude_min is not None:
        # of a dot's top smoothing leaves half and more
        least = 0.5 * amplitude_min
    # the highest of 5 × 5 pixels
    row, column = np.nonzero((raised > least) & (raised == cv2.dilate(raised, np.ones((5, 5), np.uint8))))
    top = raised[row, column]
    x, y = column.astype(np.float64), row.astype(np.float64)
    for place, at, size, down, right in ((x, column, image.shape[1], 0, 1), (y, row, image.shape[0], 1, 0)):
        inner = np.flatnonzero((at > 0) & (at < size - 1))
        before, after = (raised[row[inner] + sign * down, column[inner] + sign * right] for sign in (-1, 1))
        # vertex of the parabola through three pixels
        bend = 2.0 * top[inner] - before - after
        place[inner] += 0.5 * (after - before) / np.maximum(bend, 1e-6)
    return np.column_stack([x, y, top]), noise


def fitted_dots(image: Floats, white: float, starts: Floats, noise: float, gain: float) -> Fit:
    """Fit all dots, after some have told of their size and of the speckle, which holds a gain that is NaN."""
    count = len(starts)
    values = np.column_stack(
        [starts, np.zeros(count), np.full(count, 2.0), np.zeros(count), np.full(count, 2.0)]
    )
    if not count:
        return Fit(values, np.empty((0, 2, 2)), np.empty(0), np.empty(0, np.bool_))
    given = np.array([noise**2, 0.0 if math.isnan(gain) else gain, 0.0, 0.0])
    _start(image, values, np.full(count, _FIRST_RADIUS_PX))
    # some dots tell of all how large they are, and then of the speckle
    some = np.unique(np.linspace(0, count - 1, _SIZE_SAMPLE).astype(np.int64))
    told, *_ = _fit(image, white, values[some], np.full(some.size, _FIRST_RADIUS_PX), given, _ROUNDS)
    # variance of a round dot, from both axes
    size = np.sqrt(np.nanmedian(told[:, 4] + told[:, 6]) / 2.0)
    radius = _radii(values[:, :2], float(size) if math.isfinite(size) else 1.5)
    told, _, misfit, clipped = _fit(image, white, told, radius[some], given, _ROUNDS)
    kept = np.flatnonzero(np.isfinite(misfit) & ~clipped)
    if kept.size:
        kept = kept[np.unique(np.linspace(0, kept.size - 1, _SAMPLE).astype(np.int64))]
        given[2:] = _speckle(image, told[kept], radius[some][kept], given)
        # most are of this shape: two or three steps are left
        values[:, 4:] = np.median(told[kept, 4:], axis=0)
    return Fit(*_fit(image, white, values, radius, given, _ROUNDS))


def _radii(xy: Floats, size_px: float) -> Integers:
    from scipy.spatial import cKDTree

    radius = np.full(len(xy), _REACH * size_px)
    known = np.isfinite(xy).all(axis=1)
    if known.sum() > 1:
        near = cKDTree(xy[known]).query(xy[known], 2)[0][:, 1]
        radius[known] = np.minimum(radius[known], _APART * near)
    return np.clip(np.rint(radius), *_RADIUS_PX).astype(np.int64)


def _speckle(image: Floats, values: Floats, radius: Integers, given: Floats) -> tuple[float, float]:
    """Give squared contrast of the speckle and its correlation from one pixel to the next.

    With A = 1 − J N⁻¹ JᵀW the residuals' covariance is AΣAᵀ: the fit takes away more of speckle that is alike
    in neighbours than of white noise. So squares and products of neighbours' residuals are compared with what
    is expected of noise alone, and of speckle of each correlation.
    """
    seen, dark, alike = _speckle_sums(image, values, radius, given, _CORRELATIONS)
    over = seen - dark
    if over[0] <= 0.0:
        return 0.0, 0.0
    # the correlation that explains the products of neighbours best
    best = int(np.abs(over[1] / over[0] - alike[:, 1] / alike[:, 0]).argmin())
    return float(over[0] / alike[best, 0]), float(_CORRELATIONS[best])


@float_kernel
def _speckle_sums(
    image: Floats, values: Floats, radius: Integers, given: Floats, correlations: Floats
) -> tuple[Floats, Floats, Floats]:
    """Give three sums, of squares and of products of neighbours each.

    Of residuals (2,), of what noise makes of them (2,), and of what speckle of contrast 1 does,
    (correlation, 2). Both kinds are residuals times a matrix B, diagonal or of neighbours. With A = 1 − J H,
    H = N⁻¹JᵀW, a pair of pixels counts (AᵀBA)ᵢⱼ = Bᵢⱼ − Pᵢ·Hⱼ − Hᵢ·Pⱼ + Hᵢ·K Hⱼ, where P = BJ and K = JᵀBJ:
    nothing of the size of A is multiplied.
    """
    seen, dark, alike = np.zeros(2), np.zeros(2), np.zeros((correlations.size, 2))
    rows, columns = image.shape
    for i in range(values.shape[0]):
        p, r = values[i], radius[i]
        middle_x, middle_y = int(np.rint(p[0])), int(np.rint(p[1]))
        y0, y1 = max(middle_y - r, 0), min(middle_y + r + 1, rows)
        x0, x1 = max(middle_x - r, 0), min(middle_x + r + 1, columns)
        most = (y1 - y0) * (x1 - x0)
        number = np.full((y1 - y0, x1 - x0), -1)
        place = np.empty((most, 2), np.int64)
        slope, own = np.empty((most, 7)), np.empty((most, 4))  # own: residual, light, m, variance
        determinant = p[4] * p[6] - p[5] * p[5]
        # the inverse of S
        ia, ib, ic = p[6] / determinant, -p[5] / determinant, p[4] / determinant
        normal, many = np.zeros((7, 7)), 0
        for y in range(y0, y1):
            for x in range(x0, x1):
                if (x - middle_x) ** 2 + (y - middle_y) ** 2 > r * r:
                    continue
                u, v = x - p[0], y - p[1]
                tu, tv = ia * u + ib * v, ib * u + ic * v
                light = math.exp(-0.5 * (u * tu + v * tv))
                m = p[2] * light
                s = slope[many]
                s[0], s[1], s[2], s[3] = m * tu, m * tv, light, 1.0
                s[4], s[5], s[6] = 0.5 * m * tu * tu, m * tu * tv, 0.5 * m * tv * tv
                own[many, 0], own[many, 1], own[many, 2] = image[y, x] - p[3] - m, light, m
                own[many, 3] = given[0] + given[1] * m
                for a in range(7):
                    for b in range(7):
                        normal[a, b] += s[a] * s[b] / own[many, 3]
                place[many, 0], place[many, 1] = y, x
                number[y - y0, x - x0] = many
                many += 1
        if np.linalg.matrix_rank(normal) < 7:
            continue  # what is no dot, but an edge or a line, leaves numbers of the fit open
        inverse = np.linalg.inv(normal)
        # number by number, pixels in a row: pairs of pixels are then taken several at a time
        pull, times, across = np.zeros((2, 7, many)), np.zeros((7, many)), np.zeros((2, 7, 7))
        for k in range(many):
            for a in range(7):
                for b in range(7):
                    times[a, k] += inverse[a, b] * slope[k, b] / own[k, 3]
            light = own[k, 1]
            seen[0] += (light * own[k, 0]) ** 2
            pull[0, :, k] = light**2 * slope[k]
            for step_y, step_x in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                y, x = place[k, 0] + step_y - y0, place[k, 1] + step_x - x0
                if 0 <= y < y1 - y0 and 0 <= x < x1 - x0 and number[y, x] >= 0:
                    other = number[y, x]
                    weight = light * own[other, 1]
                    seen[1] += weight * own[k, 0] * own[other, 0]
                    pull[1, :, k] += weight * slope[other]
            for which in range(2):
                for a in range(7):
                    for b in range(7):
                        across[which, a, b] += slope[k, a] * pull[which, b, k]
        for which in range(2):
            half, pairs = -pull[which], np.empty(many)
            for a in range(7):
                for b in range(7):
                    for k in range(many):
                        half[a, k] += across[which, a, b] * times[b, k]
            of_distance = np.zeros(8 * r * r + 1)
            for k in range(many):
                pairs[:] = 0.0
                for a in range(7):
                    one, other_way, mine, ours = times[a], pull[which, a], half[a, k], times[a, k]
                    for n in range(k + 1):
                        pairs[n] += mine * one[n] - ours * other_way[n]
                for n in range(k + 1):
                    weight = pairs[n]
                    apart = (place[k, 0] - place[n, 0]) ** 2 + (place[k, 1] - place[n, 1]) ** 2
                    if apart == which:
                        weight += own[k, 1] * own[n, 1]
                    if n == k:
                        dark[which] += weight * own[k, 3]
                        of_distance[0] += weight * own[k, 2] ** 2
                    else:
                        of_distance[apart] += 2.0 * weight * own[k, 2] * own[n, 2]
            for c in range(correlations.size):
                alike[c, which] += of_distance[0]
                for apart in range(1, of_distance.size):
                    if of_distance[apart] != 0.0:
                        alike[c, which] += of_distance[apart] * correlations[c] ** apart
    return seen, dark, alike


def _peaks(fit: Fit, frame: Frame, width_max_px: float) -> Peaks:
    rows, columns = frame.size
    x, y, amplitude, background = (fit.values[:, k] for k in range(4))
    across, along = fit.values[:, 4], fit.values[:, 6]
    with np.errstate(invalid="ignore"):
        inside = (x >= 0.0) & (x <= columns - 1.0) & (y >= 0.0) & (y <= rows - 1.0)
        width = _FWHM * np.sqrt(np.maximum(across, along))
        known = fit.clipped | (amplitude <= _HEIGHT_MAX * frame.highest)
        known &= (background >= -_DARK_MAX * frame.highest) & (background <= frame.highest)
        sound = inside & known & (amplitude > 0.0) & np.isfinite(fit.misfit) & (width <= width_max_px)
        kept = np.flatnonzero(sound)
    kept = _once(fit.values, kept)
    row = np.rint(y[kept]).astype(np.int64)
    kept = kept[np.lexsort((x[kept], row))]
    row, size = np.rint(y[kept]).astype(np.int64), 0.5 * (across + along)[kept]
    usual = float(np.median(size)) if size.size else 1.0
    odd = (fit.misfit[kept] > _MISFIT_MAX) | (size < _WIDTHS[0] * usual) | (size > _WIDTHS[1] * usual)
    reach = _REACH * np.sqrt(np.maximum(across, along)[kept])
    edge = (np.minimum(x[kept], columns - 1.0 - x[kept]) < reach) | (
        np.minimum(y[kept], rows - 1.0 - y[kept]) < reach
    )
    # what fits worse than noise allows is that much less sure
    covariance = fit.covariance[kept] * np.maximum(fit.misfit[kept], 1.0)[:, None, None] ** 2
    return Peaks(
        image_size=(rows, columns),
        row=row,
        x_px=x[kept],
        x_std_px=np.sqrt(covariance[:, 0, 0]),
        amplitude=amplitude[kept],
        background=background[kept],
        width_px=_FWHM * np.sqrt(across[kept]),
        flags=(SATURATED * fit.clipped[kept] + EDGE * edge + WIDE * odd).astype(np.uint8)
        | clipped_beyond(frame, row, x[kept]),
        dots=Dots(y[kept], covariance, np.full(kept.size, -1, np.int16)),
    )


def _once(values: Floats, kept: Integers) -> Integers:
    """Leave out fits that have come to the same place as a brighter one."""
    from scipy.spatial import cKDTree

    if kept.size < 2:
        return kept
    pairs = cKDTree(values[kept, :2]).query_pairs(1.0, output_type="ndarray")
    weaker = np.where(values[kept[pairs[:, 0]], 2] < values[kept[pairs[:, 1]], 2], pairs[:, 0], pairs[:, 1])
    return np.delete(kept, np.unique(weaker))


@kernel
def _start(image: Floats, values: Floats, radius: Integers) -> None:
    """Write first heights and backgrounds: the top's pixel over the least one around."""
    rows, columns = image.shape
    for i in range(values.shape[0]):
        column, row, r = int(values[i, 0]), int(values[i, 1]), radius[i]
        low = image[row, column]
        for y in range(max(row - r, 0), min(row + r + 1, rows)):
            for x in range(max(column - r, 0), min(column + r + 1, columns)):
                low = min(low, image[y, x])
        values[i, 3] = low
        values[i, 2] = max(image[row, column] - low, 1.0)


@float_kernel
def _fit(
    image: Floats, white: float, values: Floats, radius: Integers, given: Floats, rounds: int
) -> tuple[Floats, Floats, Floats, Flags]:
    """Fisher scoring of each dot; `given` are s², g, C² and the speckle's correlation at distance 1."""
    count = values.shape[0]
    found = values.copy()
    covariance = np.full((count, 2, 2), np.nan)
    misfit = np.full(count, np.nan)
    clipped = np.zeros(count, np.bool_)
    rows, columns = image.shape
    for i in range(count):
        p = values[i].copy()
        if not np.isfinite(p[0]):
            continue
        r = radius[i]
        # the pixels are those about the place where the search began, so that the sum does not jump
        middle_x, middle_y = int(np.rint(p[0])), int(np.rint(p[1]))
        x0, x1 = max(middle_x - r, 0), min(middle_x + r + 1, columns)
        y0, y1 = max(middle_y - r, 0), min(middle_y + r + 1, rows)
        many = (x1 - x0) * (y1 - y0)
        # too few for seven numbers and their scatter
        if many < 20:
            continue
        # number by number, pixels in a row: sums over pixels are then taken several at a time
        slope, weighted = np.zeros((7, many)), np.empty(many)
        light, weight, off = np.zeros(many), np.zeros(many), np.zeros(many)
        normal, factor = np.zeros((7, 7)), np.zeros((7, 7))
        sound, settled = True, False
        for step in range(rounds + 1):
            change = np.zeros(7)
            determinant = p[4] * p[6] - p[5] * p[5]
            if not (determinant > 0.01 and p[4] > 0.05 and p[6] > 0.05 and p[4] + p[6] < 300.0):
                sound = False
                break
            ia, ib, ic = p[6] / determinant, -p[5] / determinant, p[4] / determinant
            used = 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    k = (y - y0) * (x1 - x0) + x - x0
                    weight[k] = 0.0
                    if (x - middle_x) ** 2 + (y - middle_y) ** 2 > (r + 0.5) ** 2:
                        continue
                    # what is white says nothing; near the middle it clips the dot
                    if image[y, x] >= white:
                        if (x - p[0]) ** 2 + (y - p[1]) ** 2 < 2.0 * (p[4] + p[6]):
                            clipped[i] = True
                        continue
                    u, v = x - p[0], y - p[1]
                    tu, tv = ia * u + ib * v, ib * u + ic * v
                    shape = math.exp(-0.5 * (u * tu + v * tv))
                    m = p[2] * shape
                    light[k] = m
                    # read noise, shot noise, speckle
                    variance = given[0] + given[1] * max(m, 0.0) + given[2] * m * m
                    weight[k] = 1.0 / variance
                    off[k] = image[y, x] - p[3] - m
                    slope[0, k], slope[1, k], slope[2, k], slope[3, k] = m * tu, m * tv, shape, 1.0
                    slope[4, k], slope[5, k], slope[6, k] = 0.5 * m * tu * tu, m * tu * tv, 0.5 * m * tv * tv
                    used += 1
            if used < 12:
                sound = False
                break
            for a in range(7):
                one = slope[a]
                for k in range(many):
                    weighted[k] = weight[k] * one[k]
                change[a] = _product(weighted, off)
                for b in range(a + 1):
                    normal[a, b] = _product(weighted, slope[b])
                # a touch of damping
                normal[a, a] *= 1.0 + 1e-9
            for k in range(many):
                weighted[k] = weight[k] * off[k]
            # seven numbers were fitted
            misfit[i] = math.sqrt(_product(weighted, off) / (used - 7))
            if settled or step == rounds:
                break
            factor[:] = normal
            solve(factor, change)
            settled = max(abs(change[0]), abs(change[1])) < _SETTLED_PX
            # a start may be far off: no step goes farther than a pixel or changes a size by more than half
            share = min(1.0, 1.0 / max(abs(change[0]), abs(change[1]), 1e-9))
            share = min(share, 0.5 * p[4] / max(abs(change[4]), 1e-9), 0.5 * p[6] / max(abs(change[6]), 1e-9))
            for a in range(7):
                p[a] += share * change[a]
            if abs(p[0] - middle_x) > r or abs(p[1] - middle_y) > r:
                sound = False
                break
        if not sound:
            misfit[i] = np.nan
            continue
        # of the inverse two rows are asked for
        inverse = np.zeros((2, 7))
        for a in range(2):
            inverse[a, a] = 1.0
            factor[:] = normal
            solve(factor, inverse[a])
        found[i], covariance[i] = p, inverse[:, :2]
        if given[2] > 0.0 and given[3] > 0.0:
            covariance[i] += _shared(light, weight, slope, inverse, x1 - x0, given)
    return found, covariance, misfit, clipped


@float_kernel
def _shared(
    light: Floats, weight: Floats, slope: Floats, inverse: Floats, across: int, given: Floats
) -> Floats:
    """What speckle that neighbouring pixels share, ρ^(Δ²), adds to the covariance of x and y."""
    added, down = np.zeros((2, 2)), light.size // across
    pull = np.zeros((2, down, across))  # how a pixel moves the centre, times its light
    for a in range(2):
        line = pull[a].ravel()
        for b in range(7):
            one, share = slope[b], inverse[a, b]
            for k in range(light.size):
                line[k] += share * one[k]
        for k in range(light.size):
            line[k] *= weight[k] * light[k]
    # ρ^(u² + v²) is a product: first along rows, then down columns; a power takes longer than all else
    along, around = np.zeros((2, down, across)), -pull  # what it shares with itself is counted as noise
    for step in range(-_ALIKE, _ALIKE + 1):
        share = given[3] ** (step * step)
        for a in range(2):
            for y in range(down):
                to, of = along[a, y], pull[a, y]
                for x in range(max(-step, 0), min(across - step, across)):
                    to[x] += share * of[x + step]
    for step in range(-_ALIKE, _ALIKE + 1):
        share = given[3] ** (step * step)
        for a in range(2):
            for y in range(max(-step, 0), min(down - step, down)):
                to, of = around[a, y], along[a, y + step]
                for x in range(across):
                    to[x] += share * of[x]
    for a in range(2):
        for b in range(2):
            added[b, a] = given[2] * _product(pull[b].ravel(), around[a].ravel())
    return added


@inlined
def _product(one: Floats, other: Floats) -> float:
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total
