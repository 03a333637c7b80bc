"""What every weigher keeps."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import RoemetryError
from roemetry.records import Estimate
from roemetry.stages import Weigher
from roemetry.testing.checks.volume import stated_or_nan
from roemetry.testing.runs import volume_of
from roemetry.testing.scenes import SEED
from roemetry.testing.solids import HALF_ELLIPSOID, product_of
from roemetry.testing.verdict import difference, require

_TOLERANCE = 1e-9  # relative: rounding


def check_mass_is_proportional_to_volume(weigher: Weigher[Any]) -> None:
    """Two and three times the volume weigh two and three times as much."""
    one = _mass_g(weigher, 9000.0)
    require(one > 0.0, f"9 cm³ weigh {one:.4g} g")
    for factor in (2.0, 3.0):
        off = _mass_g(weigher, factor * 9000.0) / (factor * one) - 1.0
        require(
            abs(off) <= _TOLERANCE,
            f"{factor:g} times the volume is off by {off:+.2%} from as many times the mass",
        )


def check_the_mass_is_one_of_this_world(weigher: Weigher[Any]) -> None:
    """A cubic centimetre weighs between 0.01 and 30 g: units are not mistaken."""
    density = _mass_g(weigher, 10_000.0) / 10.0
    require(0.01 <= density <= 30.0, f"a cubic centimetre weighs {density:.4g} g")


def check_uncertainty_is_positive_or_not_stated(weigher: Weigher[Any]) -> None:
    """The standard uncertainty is positive, or NaN where it is not modelled."""
    volume = volume_of(9000.0)
    stated_or_nan(weigher.weigh(product_of(HALF_ELLIPSOID), volume).mass_g)
    sure = replace(volume, visible_mm3=Estimate(9000.0, 90.0, {"scale": 90.0}))
    stated_or_nan(weigher.weigh(product_of(HALF_ELLIPSOID), sure).mass_g)


def check_an_unknown_volume_has_no_mass(weigher: Weigher[Any]) -> None:
    """A volume of NaN gives a mass of NaN, or is refused."""
    try:
        mass = _mass_g(weigher, math.nan)
    except RoemetryError:
        return
    require(math.isnan(mass), f"an unknown volume weighs {mass:.4g} g")


def check_one_seed_gives_one_draw(weigher: Weigher[Any]) -> None:
    """Given generators of the same seed, two masses are the same."""
    product, volume = product_of(HALF_ELLIPSOID), volume_of(9000.0)
    one, other = (weigher.weigh(product, volume, rng=np.random.default_rng(SEED)) for _ in range(2))
    found = difference(one, other)
    require(found is None, f"with the same seed {found}")


def _mass_g(weigher: Weigher[Any], volume_mm3: float) -> float:
    return weigher.weigh(product_of(HALF_ELLIPSOID), volume_of(volume_mm3)).mass_g.value
