"""What every smoother keeps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.stages import Smoother
from roemetry.testing.scenes import SEED, LinearRig
from roemetry.testing.verdict import require

_SCATTER_PX = 0.2
_STRAIGHT_TOLERANCE_PX = 1e-6
_STEP_ROWS = 2


def check_straight_stripes_stay(smoother: Smoother[Any]) -> None:
    """Stripes without noise that run straight stay where they are, to 1e-6 px."""
    rig = LinearRig()
    given = rig.stripe_map(rig.belt())
    found = smoother.smooth(given)
    off = float(np.abs(found.x_px - given.x_px).max())
    require(off <= _STRAIGHT_TOLERANCE_PX, f"a straight stripe moves by {off:.2g} px")


def check_scatter_becomes_less(smoother: Smoother[Any]) -> None:
    """On straight stripes the scatter becomes less, and the stated uncertainty with it."""
    rig = LinearRig()
    true = rig.stripe_map(rig.belt())
    noise = np.random.default_rng(SEED).normal(0.0, _SCATTER_PX, true.x_px.shape)
    given = replace(true, x_px=true.x_px + noise, x_std_px=np.full(noise.shape, _SCATTER_PX))
    found = smoother.smooth(given)
    scatter = float(np.std(found.x_px - true.x_px))
    require(scatter < 0.8 * _SCATTER_PX, f"a scatter of {_SCATTER_PX} px becomes {scatter:.3f} px")
    stated = float(np.median(found.x_std_px))
    require(0.8 < stated / scatter < 1.25, f"the scatter is {scatter:.3f} px, {stated:.3f} px are stated")
    require(
        found.correlation_rows > given.correlation_rows, "errors of neighbours are still called independent"
    )


def check_labels_and_gaps_stay(smoother: Smoother[Any]) -> None:
    """Nothing is coded anew: labels, gaps, what was seen and what was refused stay as they are."""
    rig = LinearRig()
    given = rig.stripe_map(rig.dome())
    x_px = given.x_px.copy()
    x_px[2, 90:110] = np.nan
    gap = np.isnan(x_px)
    given = replace(
        given,
        x_px=x_px,
        seen=~gap,
        product=np.where(gap, -1, given.product),
        x_std_px=np.where(gap, np.nan, 0.1),
    )
    found = smoother.smooth(given)
    for field in ("product", "seen", "ambiguous", "peak_stripe", "rest_px"):
        same = np.array_equal(getattr(found, field), getattr(given, field), equal_nan=field == "rest_px")
        require(same, f"{field} is changed")
    require(bool((np.isnan(found.x_px) == gap).all()), "a gap is filled, or a point is lost")


def check_a_step_stays_a_step(smoother: Smoother[Any]) -> None:
    """A step of many scatters along a stripe stays within two rows of its place."""
    rig = LinearRig()
    heights = rig.belt()
    heights[3, 100:] = 5.0
    given = rig.stripe_map(heights)
    found = smoother.smooth(given)
    off = np.abs(found.x_px - given.x_px)[3]
    far = np.abs(np.arange(rig.rows) - 99.5) > _STEP_ROWS
    require(float(off[far].max()) < 0.1, f"a step of 10 px is smeared: {off[far].max():.2f} px beside it")


CHECKS = (
    check_straight_stripes_stay,
    check_scatter_becomes_less,
    check_labels_and_gaps_stay,
    check_a_step_stays_a_step,
)
