"""Weights of a line against those of a scale: whether they still agree, and since when they do not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from roemetry.errors import DataError
from roemetry.records.arrays import Floats

Verdict = Literal["holds", "too few", "refit"]

LEAST = 5
"""With fewer pairs nothing can be said."""

_SLACK, _LIMIT = 0.5, 6.0
"""Of the cumulative sums, in standard deviations: half of a shift of 1 beyond the tolerance; rarely a false
alarm in 20 pairs."""

_WIDER_SURE = 0.999  # level of the χ² test: scatter beyond it is not chance


class WeighedPair(NamedTuple):
    """One product, grams: by the line and by the scale, with standard uncertainties (NaN: not stated)."""

    id: str
    line_g: float
    line_std_g: float
    scale_g: float
    scale_std_g: float = math.nan


class WeightCheck(NamedTuple):
    """What a comparison found."""

    verdict: Verdict
    """``holds``; ``refit``; ``too few`` pairs to tell."""
    pairs: int
    """How many."""
    bias_share: float
    bias_low_share: float
    bias_high_share: float
    """bias_share, bias_low_share, bias_high_share: mean of line over scale less 1, and its 95 % interval."""
    scatter_share: float
    """Standard deviation of line over scale."""
    scatter_over_stated: float
    """Root mean square of the differences over the uncertainties stated; NaN where none are."""
    within_share: float
    """Share of differences within 1.96 uncertainties; NaN where none are stated."""
    since: str
    """Id of the first product from which on the line drifts to one side; "" where it does not."""
    words: tuple[str, ...]
    """What that means, and what to do, in sentences."""


def check_weights(pairs: Sequence[WeighedPair], tolerance_share: float = 0.01) -> WeightCheck:
    """Compare weights of a line with a scale's.

    Parameters
    ----------
    pairs
        In the order in which the products ran.
    tolerance_share
        A bias up to this share of the weight is accepted.

    Notes
    -----
    Refit where the bias is surely not 0 and above the tolerance, where it drifts (cumulative sums of the
    differences, each less the tolerance, in standard deviations, Page 1954), or where the differences are
    surely wider than stated (χ², one-sided 99.9 %). A scale whose uncertainty is not stated counts as exact.

    Raises
    ------
    DataError
        No product was weighed by both, or the two are not in the same unit.
    """
    if not pairs:
        raise DataError(
            "no product was weighed by line and scale both", hint="do the ids of run and table agree?"
        )
    off = np.array([pair.line_g / pair.scale_g - 1.0 for pair in pairs])
    usual = 1.0 + float(np.median(off))
    if not 0.2 < usual < 5.0:
        raise DataError(
            f"the line's weights are {usual:.3g} times the scale's (median): these are not the same unit",
            hint="`mass_g` is in grams",
        )
    std = np.array(
        [math.hypot(pair.line_std_g, np.nan_to_num(pair.scale_std_g)) / pair.scale_g for pair in pairs]
    )
    count, bias = len(pairs), float(off.mean())
    scatter = float(off.std(ddof=1)) if count > 1 else math.nan
    if count < LEAST:
        said = (f"{count} pairs: at least {LEAST} are needed to tell anything",)
        return WeightCheck("too few", count, bias, math.nan, math.nan, scatter, math.nan, math.nan, "", said)
    from scipy.stats import chi2, t

    half = float(t.ppf(0.975, count - 1)) * scatter / math.sqrt(count)
    stated = bool(np.isfinite(std).all() and (std > 0.0).all())
    unit = std if stated else np.full(count, scatter if scatter > 0.0 else math.inf)
    z = off / unit
    begin = _drift_begins(z, _SLACK + tolerance_share / unit)
    words = []
    if abs(bias) > max(tolerance_share, half):
        words.append(
            f"the line weighs {bias:+.1%} against the scale (95 %: {bias - half:+.1%} to {bias + half:+.1%})"
        )
    if begin is not None:
        words.append(f"from {pairs[begin].id} on, the line drifts to one side")
    if stated and float((z**2).sum()) > chi2.ppf(_WIDER_SURE, count):
        words.append(f"differences are {math.sqrt(float((z**2).mean())):.2f} times as wide as stated")
    verdict: Verdict = "refit" if words else "holds"
    words.append(
        "weigh some 20 products of today and fit again with `roemetry fit-weight`; look at the season, the "
        "product, and the calibration's chart first"
        if words
        else "no sign that the weights have changed"
    )
    return WeightCheck(
        verdict=verdict,
        pairs=count,
        bias_share=bias,
        bias_low_share=bias - half,
        bias_high_share=bias + half,
        scatter_share=scatter,
        scatter_over_stated=math.sqrt(float((z**2).mean())) if stated else math.nan,
        within_share=float((np.abs(z) <= 1.96).mean()) if stated else math.nan,
        since="" if begin is None else pairs[begin].id,
        words=tuple(words),
    )


def _drift_begins(z: Floats, slack: Floats) -> int | None:
    """Index of the product with which a cumulative sum began to rise to its limit; None where none does."""
    for sign in (1.0, -1.0):
        total, begin = 0.0, 0
        for at, value in enumerate(sign * z - slack):
            if total == 0.0:
                begin = at
            total = max(0.0, total + float(value))
            if total > _LIMIT:
                return begin
    return None
