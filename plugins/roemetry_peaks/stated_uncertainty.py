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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Flags, Floats, Integers
from roemetry.records import EDGE, SATURATED, Reason
from roemetry_kernels.compiling import kernel
from roemetry_kernels.extraction.stripe_background import neighbours

_LAG = 10
"""Rows between the centres of a difference: speckle of length ℓ has the correlation exp(−100/(4 ℓ²)) there, 2
% at 2.5 px. At 6 rows a length of 2.5 px was seen by three quarters only; more rows need longer stripes."""
_WINDOW = 24
"""Differences that are averaged: enough that chance moves the quantile little, few enough that one window
lies on one surface."""
_QUANTILE = 0.5
"""Of the windows, the one that counts. At 0.3, flat tops that follow the pixel grid in some rows
only are scaled by half of what they need; where there is no texture it makes no difference."""
_USUAL = 0.94
"""That quantile where all errors are as stated: by drawing 16,000 windows of independent normal errors, ±
0.005."""
_WINDOWS_MIN = 20
"""Windows below which nothing is said: the quantile's own scatter is then about 10 %."""
_TRUSTED = 1.25
"""Factor between stated and observed up to which nothing is changed: intervals of 95 % then hold 88 to 98.6
%, and chance, texture and a few per cent in the speckle's contrast explain it."""
_SAMPLE = 1024
"""Peaks whose profiles are averaged, at most: the mean's own error is then 3 % of one peak's."""
_TILES = 16
"""Parts of the sample with a mean profile each; the median of them counts, so that one body does not
decide."""
_PEAKS_MIN = 8
"""Profiles below which a part says nothing."""
_BINS = 41
"""Bins of the mean profile, a quarter of a standard deviation wide: to ±5."""
_PER_SIGMA = 4
_LEVELS = (0.25, 0.5, 0.75)
"""Of the profile's height, where its chords are looked at: below, background decides; above, noise."""
_SHARE_MIN = 0.03
"""Standard deviations of the stripe that the chords' middles may lie apart on a symmetric profile: what bins
of a quarter standard deviation and pixels of up to half a stripe's width leave."""
_MATTERS = 0.5
"""Of the stated uncertainty, from which on lopsidedness is added to it: half as much widens it by 12 %."""
_FWHM = 2.3548200450309493


class Checked(NamedTuple):
    """What the image says of the stated uncertainties.

    Attributes
    ----------
    factor
        k: observed over stated scatter; 1 where it is trusted or not known.
    centre_px
        c, median over the peaks, px; 0 where the profile is symmetric.
    reasons
        What was found, in words.
    """

    factor: float
    centre_px: float
    reasons: tuple[Reason, ...]


def corrected(
    image: NDArray[Any],
    white: int,
    row: Integers,
    x_px: Floats,
    x_std_px: Floats,
    amplitude: Floats,
    background: Floats,
    width_px: Floats,
    flags: NDArray[np.uint8],
    asked: Flags | None = None,
) -> tuple[Floats, tuple[Reason, ...]]:
    """Give (peak,) the standard uncertainty that the image bears out, px, and what is to be said of it.

    Parameters
    ----------
    image
        (row, column) grey levels that the peaks were found in.
    white
        Grey level from which on a pixel is saturated.
    row, x_px, x_std_px, amplitude, background, width_px, flags
        (peak,) as in `roemetry.records.Peaks`; rows and columns are the image's.
    asked
        (peak,) those that may tell; none: all. Saturated peaks and those at the border never do.
    """
    whole = (flags & (SATURATED | EDGE)) == 0
    whole &= np.isfinite(x_std_px) & (x_std_px > 0.0)
    use = whole if asked is None else whole & asked
    factor = _factor(row, x_px, x_std_px, use) if use.any() else 1.0
    std: Floats = x_std_px if factor == 1.0 else factor * x_std_px
    reasons = () if factor == 1.0 else (_scatter(factor),)
    sigma = width_px / _FWHM
    for group in (use,) if asked is None else (use, whole & ~asked):
        if not group.any():
            continue
        share = _lopsided(image, white, row, x_px, amplitude, background, sigma, group)
        if share * np.median(sigma[group]) > _MATTERS * float(np.median(std[group])):
            std = np.where(group, np.hypot(std, share * sigma), std)
            reasons = (*reasons, _SKEWED)
    return std, tuple(dict.fromkeys(reasons))


_SKEWED = Reason(
    "profile-lopsided",
    "the stripes' profiles are lopsided, alike in all rows: where the centre lies is a matter of definition; "
    "the stated uncertainty was widened by as much. Check the focus and alignment of laser and camera",
)


def _scatter(factor: float) -> Reason:
    """Say that centres scatter by another amount than stated; rounded, so that frames say the same."""
    how = "more" if factor > 1.0 else "less"
    return Reason(
        "noise-contradicted",
        f"centres scatter {how} along the stripes than the noise that is told or assumed explains; stated "
        "uncertainties were scaled to what is observed. Check the sensor's gain and read noise and the "
        "speckle's length, or measure them by python -m roemetry_peaks.measure_noise",
    )


def _factor(row: Integers, x_px: Floats, x_std_px: Floats, use: Flags) -> float:
    """k, 1 where it is near to 1 or not known."""
    _, down = neighbours(row, x_px)
    ratios = _windows(x_px, x_std_px, use, down)
    if ratios.size < _WINDOWS_MIN:
        return 1.0
    factor = math.sqrt(float(np.quantile(ratios, _QUANTILE)) / _USUAL)
    return 1.0 if 1.0 / _TRUSTED <= factor <= _TRUSTED else max(factor, 1e-3)


@kernel
def _windows(x_px: Floats, x_std_px: Floats, use: Flags, down: Integers) -> Floats:
    """Observed over stated squares of third differences, one number a window of rows of one stripe."""
    peaks = x_px.shape[0]
    led = np.zeros(peaks, np.bool_)
    for p in range(peaks):
        if down[p] >= 0:
            led[down[p]] = True
    ratios = np.empty(peaks // _WINDOW + 1)
    chain = np.empty(peaks, np.int64)
    count = 0
    for head in range(peaks):
        if led[head]:
            continue
        n, p = 0, head
        while p >= 0:
            chain[n] = p
            n += 1
            p = down[p]
        total, terms = 0.0, 0
        for i in range(n - 3 * _LAG):
            a, b, c, d = chain[i], chain[i + _LAG], chain[i + 2 * _LAG], chain[i + 3 * _LAG]
            if not (use[a] and use[b] and use[c] and use[d]):
                continue
            difference = x_px[a] - x_px[d] + 3.0 * (x_px[c] - x_px[b])
            stated = x_std_px[a] ** 2 + x_std_px[d] ** 2 + 9.0 * (x_std_px[b] ** 2 + x_std_px[c] ** 2)
            total += difference * difference / stated
            terms += 1
            if terms == _WINDOW:
                ratios[count] = total / _WINDOW
                count += 1
                total, terms = 0.0, 0
    return ratios[:count]


def _lopsided(
    image: NDArray[Any],
    white: int,
    row: Integers,
    x_px: Floats,
    amplitude: Floats,
    background: Floats,
    sigma_px: Floats,
    use: Flags,
) -> float:
    """Distance of the chords' middles from the extractor's centre, standard deviations of the stripe."""
    pick = np.flatnonzero(use)
    pick = pick[:: max(1, pick.size // _SAMPLE)]
    rows, columns = image.shape
    tile = row[pick] * 4 // rows * 4 + np.clip(x_px[pick] * 4 // columns, 0, 3).astype(np.int64)
    profile, count = _mean_profiles(
        image, white, row[pick], x_px[pick], amplitude[pick], background[pick], sigma_px[pick], tile
    )
    middles = [_middles(profile[k]) for k in np.flatnonzero(count >= _PEAKS_MIN)]
    middles = [one for one in middles if np.isfinite(one).all()]
    if not middles:
        return 0.0
    usual = np.median(middles, axis=0)
    if usual.max() - usual.min() < _SHARE_MIN:
        return 0.0
    return float(np.abs(usual).max())


@kernel
def _mean_profiles(
    image: NDArray[Any],
    white: float,
    row: Integers,
    x_px: Floats,
    amplitude: Floats,
    background: Floats,
    sigma_px: Floats,
    tile: Integers,
) -> tuple[Floats, Integers]:
    """(tile, bin) mean light above the background over the height; (tile,) number of profiles in it."""
    total = np.zeros((_TILES, _BINS))
    weight = np.zeros((_TILES, _BINS))
    count = np.zeros(_TILES, np.int64)
    middle = _BINS // 2
    for p in range(row.shape[0]):
        reach = (middle - 1) / _PER_SIGMA * sigma_px[p]
        first = max(math.ceil(x_px[p] - reach), 0)
        last = min(math.floor(x_px[p] + reach), image.shape[1] - 1)
        count[tile[p]] += 1
        for x in range(first, last + 1):
            # Each pixel counts for the two bins around it.
            at = (x - x_px[p]) / sigma_px[p] * _PER_SIGMA + middle
            k = math.floor(at)
            light = (image[row[p], x] - background[p]) / amplitude[p]
            for bin_, share in ((k, 1.0 - (at - k)), (k + 1, at - k)):
                total[tile[p], bin_] += share * light
                weight[tile[p], bin_] += share
    for t in range(_TILES):
        for k in range(_BINS):
            total[t, k] = total[t, k] / weight[t, k] if weight[t, k] > 0.0 else np.nan
    return total, count


def _middles(profile: Floats) -> Floats:
    """Middles of the chords at `_LEVELS` of a profile's height, standard deviations; NaN for none."""
    out = np.full(len(_LEVELS), np.nan)
    middle = profile.size // 2
    near = profile[middle - 4 : middle + 5]
    if not np.isfinite(near).all():
        return out
    top = middle - 4 + int(np.argmax(near))
    for i, level in enumerate(_LEVELS):
        wanted = level * profile[top]
        sides = []
        for step in (-1, 1):
            k = top
            while 0 < k < profile.size - 1 and profile[k + step] >= wanted:
                k += step
            if not 0 < k < profile.size - 1 or not np.isfinite(profile[k + step]):
                return out
            sides.append(k + step * (profile[k] - wanted) / (profile[k] - profile[k + step]))
        out[i] = (0.5 * (sides[0] + sides[1]) - middle) / _PER_SIGMA
    return out
