"""Check stated uncertainties of peaks against the image, and correct them where they do not hold.

An extractor states the standard uncertainty s of each centre from what it was told or has estimated: the
sensor's gain and read noise, the speckle and its length, a profile of a certain shape. Any of these may be
wrong. Two observations on the peaks themselves tell, without any of these numbers:

1. *Scatter along a stripe.* Third differences of one stripe's centres L rows apart,

       D = x[i] − 3 x[i+L] + 3 x[i+2L] − x[i+3L],

   are free of place, slant and bend, and their variance is s²[i] + 9 s²[i+L] + 9 s²[i+2L] + s²[i+3L] if rows
   so far apart err independently. The ratio of observed to stated squares is averaged over windows of rows.
   Texture and edges of a product only add to D: so a quantile of the windows is taken, divided by that of
   windows where all is as stated. Its root k tells how much larger the errors are than stated. A sensor that
   is told wrongly, longer or shorter speckle, and flat-topped stripes that follow the pixel grid all show
   here.

2. *Lopsidedness of the mean profile.* What is skewed in the same way in all rows does not scatter. The
middles
   of the chords at 1/4, 1/2 and 3/4 of the mean profile's height, and the extractor's centre, are one place
   if the profile is symmetric. If not, the place of the centre is a matter of definition, and their largest
   distance c from the extractor's centre is an uncertainty that all rows share.

Then s becomes √(k² s² + c²), and a reason says which of the two was found and what can be done.

Assumed: half of the windows lie on smooth surfaces, and most of the image's stripes on a material that
does not scatter light inside; where the extractor knows which peaks do not, only those are asked. Fails where
no stripe is followed for `3 L` rows: nothing is then said. A symmetric error that all rows share is not seen.

Source: differences as estimators of noise, von Neumann, Kent, Bellinson, Hart (1941), Ann. Math. Stat.
12:153; the rest is ours.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import EDGE, SATURATED, Reason
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_peaks.peak_window import FWHM_OF_SIGMA
from roemetry_peaks.smoothed_peaks import background_noise, neighbours

_LAG = 10
"""Rows between the centres of a difference: speckle of length ℓ has the correlation exp(−100/(4 ℓ²)) there, 2
% at 2.5 px. At 6 rows a length of 2.5 px was seen by three quarters only; more rows need longer stripes."""
_WINDOW = 24
"""Differences that are averaged: enough that chance moves the quantile little, few enough that one window
lies on one surface."""
_USUAL = 0.94
"""The median of the windows where all errors are as stated: by drawing 16,000 windows of independent normal
errors, ± 0.005."""
_BAND = 104
"""Rows at the image's top and at its bottom that are asked first: three windows of each stripe, so that seven
stripes suffice. Asking all rows takes as long as a tenth of the quickest extraction."""
_WINDOWS_MIN = 20
"""Windows below which nothing is said: the quantile's own scatter is then about 10 %."""
_TRUSTED = 1.25
"""Factor between stated and observed up to which nothing is changed: intervals of 95 % then hold 88 to 98.6
%, and chance, texture and a few per cent in the speckle's contrast explain it."""
_SAMPLE = 512
"""Peaks whose profiles are averaged, at most: the mean's own error is then 4 % of one peak's."""
_TILES = 16
"""Parts of the sample with a mean profile each; the median of them counts, so that one body does not
decide."""
_TILES_MIN = 8
"""Parts of the image below which nothing is said of the mean profile: one stripe that keeps its place in
the pixel grid has a lopsided mean, too."""
_CHANCE = 4.0
"""Standard errors of the parts' mean that count as chance: speckle makes each mean profile lopsided."""
_PEAKS_MIN = 8
"""Profiles below which a part says nothing."""
_BINS = 41
"""Bins of the mean profile, a quarter of a standard deviation wide: to ±5."""
_PER_SIGMA = 4  # bins a standard deviation
_LEVELS = (0.25, 0.5, 0.75)
"""Of the profile's height, where its chords are looked at: below, background decides; above, noise."""
_SHARE_MIN = 0.03
"""Standard deviations of the stripe that the chords' middles may lie apart on a symmetric profile: what bins
of a quarter standard deviation and pixels of up to half a stripe's width leave."""
_MATTERS = 0.5
"""Of the stated uncertainty, from which on lopsidedness is added to it: half as much widens it by 12 %."""
_MORE = 2.0
"""Uncertainty by the pixels' own residuals over the stated one, and variance of the background over the told
one, that count as evidence: weighted fits and speckle make the former 0.4 to 1.6 where all is right."""
_LONG = 0.08
"""Third differences of the logarithm of the height, of neighbours over those far apart: 1 for white noise,
0.11 for speckle of 0.8 px, 0.04 for 1 px, less for longer."""
_CORE = 2.0
"""Standard deviations on both sides of the centre where residuals are taken: farther out is background."""


def corrected(
    image: NDArray[Any],
    row: Integers,
    x_px: Floats,
    x_std_px: Floats,
    amplitude: Floats,
    background: Floats,
    width_px: Floats,
    flags: NDArray[np.uint8],
    *,
    sensor: tuple[float, float],
    asked: Flags | None = None,
) -> tuple[Floats, tuple[Reason, ...]]:
    """Give (peak,) the standard uncertainty that the image bears out, px, and what is to be said of it.

    Parameters
    ----------
    image
        (row, column) grey levels that the peaks were found in.
    row, x_px, x_std_px, amplitude, background, width_px, flags
        (peak,) as in `roemetry.records.Peaks`; rows and columns are the image's.
    sensor
        Variance of a dark pixel, grey levels², and its growth with the grey level, as told or estimated.
    asked
        (peak,) those that may tell; none: all. Saturated peaks and those at the border never do.
    """
    # where nothing is stated nothing is asked
    if not x_std_px.size or np.isnan(x_std_px[0]):
        return x_std_px, ()
    use = np.empty(x_std_px.size, np.bool_)
    _usable(x_std_px, flags, use)
    told = use if asked is None else use & asked
    factor = _factor(row, x_px, x_std_px, told)
    if factor > 1.0 and not _is_noise(
        image, row, x_px, x_std_px, amplitude, background, width_px, told, sensor
    ):
        factor = 1.0
    std: Floats = x_std_px if factor == 1.0 else factor * x_std_px
    reasons = () if factor == 1.0 else (_scatter(factor),)
    for group in (told,) if asked is None else (told, use & ~asked):
        pick = np.flatnonzero(group)
        pick = pick[:: max(1, pick.size // _SAMPLE)]
        if not pick.size:
            continue
        sigma = width_px[pick] / FWHM_OF_SIGMA
        share = _lopsided(image, row[pick], x_px[pick], amplitude[pick], background[pick], sigma)
        if share * _median(sigma) > _MATTERS * _median(std[pick]):
            std = np.where(group, np.hypot(std, share / FWHM_OF_SIGMA * width_px), std)
            reasons = (*reasons, _SKEWED)
    return std, tuple(dict.fromkeys(reasons))


_SKEWED = Reason(
    "profile-lopsided",
    "the stripes' profiles are asymmetric in all rows alike, so the position of the centre depends on its "
    "definition; the stated uncertainty includes that. Check the focus and alignment of laser and camera",
)


def _scatter(factor: float) -> Reason:
    """Say that centres scatter by another amount than stated; rounded, so that frames say the same."""
    how = "more" if factor > 1.0 else "less"
    return Reason(
        "noise-contradicted",
        f"centres scatter {how} along the stripes than the stated or assumed noise explains; stated "
        "uncertainties were scaled to the observed scatter. Check the sensor's gain and read noise and the "
        "speckle's length, or measure them by python -m roemetry_peaks.measure_noise",
    )


@kernel
def _usable(x_std_px: Floats, flags: NDArray[np.uint8], use: Flags) -> None:
    """Say which peaks are seen whole and have an uncertainty."""
    for p in range(use.shape[0]):
        use[p] = x_std_px[p] > 0.0 and (flags[p] & (SATURATED | EDGE)) == 0


def _factor(row: Integers, x_px: Floats, x_std_px: Floats, use: Flags) -> float:
    """k, 1 where it is near to 1 or not known."""
    ratios = np.empty(0)
    if row[-1] - row[0] > 3 * _BAND:
        # Near the top and the bottom of the image, where belt is seen most likely.
        to, begin = np.searchsorted(row, [row[0] + _BAND, row[-1] - _BAND])
        bands = slice(0, to), slice(begin, None)
        if to + row.size - begin >= 2 * _WINDOWS_MIN * _WINDOW:  # otherwise all rows are needed
            ratios = np.concatenate(
                [_windows(row[one], x_px[one], x_px[one], x_std_px[one], use[one], _LAG) for one in bands]
            )
    if ratios.size < 2 * _WINDOWS_MIN:
        ratios = _windows(row, x_px, x_px, x_std_px, use, _LAG)
    if ratios.size < _WINDOWS_MIN:
        return 1.0
    # ratios are of squares
    factor = math.sqrt(_median(ratios) / _USUAL)
    return 1.0 if 1.0 / _TRUSTED <= factor <= _TRUSTED else max(factor, 1e-3)


def _is_noise(
    image: NDArray[Any],
    row: Integers,
    x_px: Floats,
    x_std_px: Floats,
    amplitude: Floats,
    background: Floats,
    width_px: Floats,
    use: Flags,
    sensor: tuple[float, float],
) -> bool:
    """Say whether there is evidence in the light, too, for errors larger than stated.

    Without it, what scatters is the surface. The evidence is any of these: residuals of pixels that imply a
    larger uncertainty; heights that are so alike from row to row as only long grains of speckle make them;
    a background that is noisier than the sensor is told to be.
    """
    pick = np.flatnonzero(use)
    pick = pick[:: max(1, pick.size // _SAMPLE)]
    of_peak = row[pick], x_px[pick], amplitude[pick], background[pick], width_px[pick] / FWHM_OF_SIGMA
    if _median(_residual_std(image, *of_peak) / x_std_px[pick]) > _MORE:
        return True
    # speckle multiplies heights: logarithms make it the same for all
    height, one = np.log(np.maximum(amplitude, 1e-3)), np.ones(amplitude.size)
    near, far = (_windows(row, x_px, height, one, use, lag) for lag in (1, _LAG))
    if near.size and far.size and _median(near) < _LONG * _median(far):
        return True
    seen, (variance, gain) = background_noise(image) ** 2, sensor
    return seen > _MORE * (variance + gain * max(_median(background[pick]), 0.0))


@kernel
def _windows(row: Integers, x_px: Floats, values: Floats, std: Floats, use: Flags, lag: int) -> Floats:
    """Observed over stated squares of third differences, one number a window of rows of one stripe."""
    peaks = x_px.shape[0]
    up, down = neighbours(row, x_px)
    ratios = np.empty(peaks // _WINDOW + 1)
    chain = np.empty(peaks, np.int64)
    count = 0
    for head in range(peaks):
        if up[head] >= 0:
            continue
        n, p = 0, head
        while p >= 0:
            chain[n] = p
            n += 1
            p = down[p]
        total, terms = 0.0, 0
        for i in range(n - 3 * lag):
            a, b, c, d = chain[i], chain[i + lag], chain[i + 2 * lag], chain[i + 3 * lag]
            if not (use[a] and use[b] and use[c] and use[d]):
                continue
            # third differences, which neither lean nor even bend enters
            difference = values[a] - values[d] + 3.0 * (values[c] - values[b])
            stated = std[a] ** 2 + std[d] ** 2 + 9.0 * (std[b] ** 2 + std[c] ** 2)
            total += difference * difference / stated
            terms += 1
            if terms == _WINDOW:
                ratios[count] = total / _WINDOW
                count += 1
                total, terms = 0.0, 0
    return ratios[:count]


def _median(values: Floats) -> float:
    """The upper of the two middle values: for few numbers much quicker than numpy's."""
    return float(np.sort(values)[values.size // 2])


def _lopsided(
    image: NDArray[Any], row: Integers, x_px: Floats, amplitude: Floats, background: Floats, sigma_px: Floats
) -> float:
    """Distance of the chords' middles from the extractor's centre, standard deviations of the stripe."""
    middles = _chords(*_mean_profiles(image, row, x_px, amplitude, background, sigma_px))
    if not middles.size:
        return 0.0
    usual = np.sort(middles, axis=0)[middles.shape[0] // 2]
    lean = middles[:, -1] - middles[:, 0]
    chance = _CHANCE * float(lean.std()) / math.sqrt(lean.size)
    if lean.size < _TILES_MIN or abs(usual[-1] - usual[0]) < max(_SHARE_MIN, chance):
        return 0.0
    return float(np.abs(usual).max())


@kernel
def _residual_std(
    image: NDArray[Any], row: Integers, x_px: Floats, amplitude: Floats, background: Floats, sigma_px: Floats
) -> Floats:
    """(peak,) standard uncertainty of each centre that its own pixels' residuals imply, px."""
    std = np.empty(row.shape[0])
    for p in range(row.shape[0]):
        first = max(math.ceil(x_px[p] - _CORE * sigma_px[p]), 0)
        last = min(math.floor(x_px[p] + _CORE * sigma_px[p]), image.shape[1] - 1)
        squares = 0.0
        for x in range(first, last + 1):
            u = (x - x_px[p]) / sigma_px[p]
            squares += (image[row[p], x] - background[p] - amplitude[p] * math.exp(-0.5 * u * u)) ** 2
        freedom = max(last - first + 1 - 3, 1)
        # least squares on a Gaussian: noise × √(2 σ/√π) over its height
        std[p] = math.sqrt(squares / freedom * 2.0 * sigma_px[p] / math.sqrt(math.pi)) / amplitude[p]
    return std


@kernel
def _mean_profiles(
    image: NDArray[Any], row: Integers, x_px: Floats, amplitude: Floats, background: Floats, sigma_px: Floats
) -> tuple[Floats, Integers]:
    """(tile, bin) mean light above the background over the height; (tile,) number of profiles in it."""
    total = np.zeros((_TILES, _BINS))
    weight = np.zeros((_TILES, _BINS))
    count = np.zeros(_TILES, np.int64)
    middle = _BINS // 2
    for p in range(row.shape[0]):
        reach = (middle - 1) / _PER_SIGMA * sigma_px[p]
        first, last = math.ceil(x_px[p] - reach), math.floor(x_px[p] + reach)
        if first < 0 or last >= image.shape[1]:
            continue  # the border cuts off what the background is known from
        tile = 4 * (4 * row[p] // image.shape[0]) + min(max(int(4 * x_px[p]) // image.shape[1], 0), 3)
        count[tile] += 1
        for x in range(first, last + 1):
            # Each pixel counts for the two bins around it.
            at = (x - x_px[p]) / sigma_px[p] * _PER_SIGMA + middle
            k = math.floor(at)
            light = (image[row[p], x] - background[p]) / amplitude[p]
            for bin_, share in ((k, 1.0 - (at - k)), (k + 1, at - k)):
                total[tile, bin_] += share * light
                weight[tile, bin_] += share
    for t in range(_TILES):
        for k in range(_BINS):
            total[t, k] = total[t, k] / weight[t, k] if weight[t, k] > 0.0 else np.nan
    return total, count


@kernel
def _chords(profiles: Floats, count: Integers) -> Floats:
    """(tile, level) middles of the chords at `_LEVELS` of each profile's height, standard deviations."""
    out = np.empty((profiles.shape[0], len(_LEVELS)))
    found, middle = 0, profiles.shape[1] // 2
    for t in range(profiles.shape[0]):
        if count[t] < _PEAKS_MIN:
            continue
        profile = profiles[t]
        top = middle
        for k in range(middle - _PER_SIGMA, middle + _PER_SIGMA + 1):
            top = k if profile[k] > profile[top] else top
        whole = True
        for i in range(len(_LEVELS)):
            wanted, total = _LEVELS[i] * profile[top], 0.0
            for step in (-1, 1):
                k = top
                while 0 < k < profile.size - 1 and profile[k + step] >= wanted:
                    k += step
                whole &= 0 < k < profile.size - 1
                if whole:
                    total += k + step * (profile[k] - wanted) / (profile[k] - profile[k + step])
            out[found, i] = (0.5 * total - middle) / _PER_SIGMA
            whole &= not math.isnan(total)
        found += whole
    return out[:found]
