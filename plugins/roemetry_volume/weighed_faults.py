"""What is wrong with weighed samples: another unit, rows mixed up, a weight that is another product's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roemetry.errors import DataError
from roemetry.records.arrays import Floats

DENSITY_RANGE = (0.05, 25.0)
"""Mass over visible volume, g/cm³, of anything that is weighed: from puffed food to tungsten."""

UNITS_G = {"kilograms": 1000.0, "pounds": 453.592, "ounces": 28.3495, "milligrams": 0.001}
"""Grams in each."""

_LIKELY = (0.2, 3.0)
_SAME_UNIT = 0.2
_FAR_STDS = 4.0
_FAR_SHARE = 0.1
_NAMED = 5
_FOR_TREND = 8
_BY_CHANCE = 0.05
"""Ranks that agree no better than this share of shuffled tables do show no trend."""


def check_masses(ids: Sequence[str], masses_g: Floats, visible_cm3: Floats) -> None:
    """Raise DataError where masses cannot be grams of these products.

    Parameters
    ----------
    ids, masses_g, visible_cm3
        (sample,) names, masses as they were given, and visible volumes, all above 0.
    """
    if not len(ids):
        raise DataError(
            "no weighed product has a measured volume", hint="look at the run: was anything measured?"
        )
    density = masses_g / visible_cm3
    usual = float(np.median(density))
    if not DENSITY_RANGE[0] <= usual <= DENSITY_RANGE[1]:
        units = [name for name, grams in UNITS_G.items() if _LIKELY[0] <= usual * grams <= _LIKELY[1]]
        maybe = f"are they {' or '.join(units)}? " if units else ""
        raise DataError(
            f"the masses are {usual:.3g} times the visible volumes in cm³ (median): these are not grams",
            hint=f"{maybe}`mass_g` is in grams; also look at the calibration's scale",
        )
    odd = np.abs(np.log(density / usual))
    for name, grams in UNITS_G.items():
        like = (odd > np.log(3.0)) & (np.abs(np.log(density * grams / usual)) < _SAME_UNIT)
        if like.any():
            named = ", ".join(ids[k] for k in np.flatnonzero(like)[:_NAMED])
            raise DataError(
                f"{int(like.sum())} of {len(ids)} masses are off by the factor of {name} ({named})",
                hint="one unit for all of them: grams",
            )
    _check_trend(masses_g, visible_cm3)


def _check_trend(masses_g: Floats, visible_cm3: Floats) -> None:
    """Refuse masses that no volume says anything of, where volumes differ enough to tell."""
    if len(masses_g) < _FOR_TREND or np.log(visible_cm3).std() < 0.1:
        return
    from scipy.stats import spearmanr

    # One odd sample does not unmake a trend: medians, and ranks.
    scatter, alone = _scatter(np.log(masses_g / visible_cm3)), _scatter(np.log(masses_g))
    ranks = spearmanr(masses_g, visible_cm3, alternative="greater")
    if scatter > alone or not ranks.pvalue <= _BY_CHANCE:
        raise DataError(
            f"the masses do not follow the volumes: mass over volume scatters by {scatter:.0%}, masses alone "
            f"by {alone:.0%}; their ranks agree by {ranks.statistic:+.2f} of 1",
            hint="were rows mixed up, or ids of one table given to the other's products?",
        )


def _scatter(values: Floats) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def far_off(ids: Sequence[str], masses_g: Floats, fitted_g: Floats) -> list[str]:
    """Name samples far from what was fitted: perhaps another product's weight."""
    off = masses_g / fitted_g - 1.0
    usual = _scatter(off)
    far = np.flatnonzero(np.abs(off) > max(_FAR_STDS * usual, _FAR_SHARE))
    far = far[np.argsort(-np.abs(off[far]))]
    return [
        f"look at {ids[k]}: {masses_g[k]:.4g} g, fitted {fitted_g[k]:.4g} g ({off[k]:+.0%}); "
        "is that its own weight?"
        for k in far[:_NAMED]
    ]
