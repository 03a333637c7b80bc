"""What every volume estimator keeps: known bodies have their volume."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from roemetry.errors import RoemetryError
from roemetry.records import Estimate, Shares, Volume
from roemetry.stages import VolumeEstimator
from roemetry.testing.scenes import SEED
from roemetry.testing.solids import (
    BOX,
    DENSE,
    HALF_CYLINDER,
    HALF_ELLIPSOID,
    SPHERICAL_CAP,
    Solid,
    product_from,
    product_of,
    reordered,
)
from roemetry.testing.verdict import CheckFailedError, difference, refused, require

_ORDER_TOLERANCE = 1e-9  # relative: sums in another order round otherwise
_MIRROR_TOLERANCE = 1e-3  # relative: rows fall elsewhere on the mirrored body


def check_a_box(estimator: VolumeEstimator[Any]) -> None:
    """A box of 60 × 30 × 10 mm has its volume within the declared `relative_tolerance`."""
    _known(estimator, BOX)


def check_a_half_cylinder(estimator: VolumeEstimator[Any]) -> None:
    """A half cylinder of radius 15 mm, 60 mm long, has its volume within the `relative_tolerance`."""
    _known(estimator, HALF_CYLINDER)


def check_a_spherical_cap(estimator: VolumeEstimator[Any]) -> None:
    """A spherical cap 50 mm across and 10 mm high has its volume within the `relative_tolerance`."""
    _known(estimator, SPHERICAL_CAP)


def check_a_half_ellipsoid(estimator: VolumeEstimator[Any]) -> None:
    """A skewed half ellipsoid of 60 × 30 × 12 mm has its volume within the `relative_tolerance`."""
    _known(estimator, HALF_ELLIPSOID)


def check_volume_grows_with_the_cube(estimator: VolumeEstimator[Any]) -> None:
    """The scene scaled by 2 and by 1/2 has 8 and 1/8 of the volume, within the `relative_tolerance`."""
    one = _visible_mm3(estimator.estimate(product_of(HALF_ELLIPSOID)))
    for factor in (2.0, 0.5):
        other = _visible_mm3(
            estimator.estimate(product_of(HALF_ELLIPSOID.scaled(factor), DENSE.scaled(factor)))
        )
        off = other / (factor**3 * one) - 1.0
        limit = estimator.capabilities.relative_tolerance
        require(
            abs(off) <= limit,
            f"{factor:g} times as large it has {other / one:.4g} times the volume ({off:+.2%})",
        )


def check_order_of_slices_does_not_matter(estimator: VolumeEstimator[Any]) -> None:
    """Slices in another order give the same volume."""
    product = product_of(HALF_ELLIPSOID)
    one, other = (_visible_mm3(estimator.estimate(each)) for each in (product, reordered(product)))
    off = other / one - 1.0
    require(abs(off) <= _ORDER_TOLERANCE, f"in another order the volume differs by {off:+.2%}")


def check_a_mirrored_scene_has_the_same_volume(estimator: VolumeEstimator[Any]) -> None:
    """A mirrored body under a mirrored rig gives the same volume, within a thousandth."""
    one = _visible_mm3(estimator.estimate(product_of(HALF_ELLIPSOID)))
    mirrored = product_of(HALF_ELLIPSOID.mirrored(), DENSE.mirrored())
    off = _visible_mm3(estimator.estimate(mirrored)) / one - 1.0
    require(abs(off) <= _MIRROR_TOLERANCE, f"mirrored, the volume differs by {off:+.2%}")


def check_shares_add_up(estimator: VolumeEstimator[Any]) -> None:
    """The shares seen, interpolated and assumed lie between 0 and 1 and add up to 1."""
    shares = estimator.estimate(product_of(HALF_ELLIPSOID)).shares
    values = [getattr(shares, name) for name in Shares.__slots__]
    require(
        all(-1e-9 <= value <= 1.0 + 1e-9 for value in values) and abs(sum(values) - 1.0) <= 1e-9,
        f"seen, interpolated and assumed are {', '.join(f'{value:.4g}' for value in values)}",
    )


def check_a_dead_stripe_does_not_make_a_hole(estimator: VolumeEstimator[Any]) -> None:
    """A middle stripe without points changes the volume by less than one slice, or is refused."""
    product = product_of(HALF_ELLIPSOID)
    heights = product.profiles.xyz_mm[..., 2].copy()
    heights[DENSE.stripes // 2] = np.nan
    whole = _visible_mm3(estimator.estimate(product))
    try:
        holed = estimator.estimate(product_from(heights))
    except RoemetryError:
        return
    slice_share = 1.5 / 60.0
    off = _visible_mm3(holed) / whole - 1.0
    require(abs(off) <= slice_share / 2.0, f"without one of 40 slices the volume differs by {off:+.2%}")


def check_uncertainty_is_positive_or_not_stated(estimator: VolumeEstimator[Any]) -> None:
    """Standard uncertainties are positive, or NaN where they are not modelled."""
    volume = estimator.estimate(product_of(HALF_ELLIPSOID))
    for estimate in (volume.visible_mm3, volume.true_mm3):
        if estimate is not None:
            stated_or_nan(estimate)


def check_one_seed_gives_one_draw(estimator: VolumeEstimator[Any]) -> None:
    """Given generators of the same seed, two estimates are the same."""
    product = product_of(HALF_ELLIPSOID)
    one, other = (estimator.estimate(product, rng=np.random.default_rng(SEED)) for _ in range(2))
    found = difference(one, other)
    require(found is None, f"with the same seed {found}")


def check_no_point_is_no_number(estimator: VolumeEstimator[Any]) -> None:
    """A product without points is refused by a `RoemetryError` and gets no number."""
    with refused("a product without points"):
        estimator.estimate(product_from(np.full((DENSE.stripes, DENSE.rows), np.nan)))


def stated_or_nan(estimate: Estimate) -> None:
    """Require that a standard uncertainty and its budget are positive, or NaN."""
    for cause, std in {"all": estimate.std, **estimate.budget}.items():
        require(math.isnan(std) or std >= 0.0, f"the standard uncertainty ({cause}) is {std:.4g}")
    if estimate.std == 0.0:
        raise CheckFailedError("the standard uncertainty is 0; what is not modelled is NaN")


def _known(estimator: VolumeEstimator[Any], solid: Solid) -> None:
    found = _visible_mm3(estimator.estimate(product_of(solid)))
    off = found / solid.volume_mm3 - 1.0
    limit = estimator.capabilities.relative_tolerance
    require(
        abs(off) <= limit,
        f"{found:.5g} mm³, expected {solid.volume_mm3:.5g} mm³ ({off:+.2%}; {limit:.2%} are declared)",
    )


def _visible_mm3(volume: Volume) -> float:
    return volume.visible_mm3.value
