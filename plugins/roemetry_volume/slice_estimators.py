"""Visible volume from slices alone: areas in tilted planes, a rule between them, caps at both ends."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Shares, Volume
from roemetry.records.arrays import Floats
from roemetry.stages import Capabilities, VolumeEstimator
from roemetry_volume.slice_doubts import reasons_of
from roemetry_volume.slice_ends import Cap, cap_of
from roemetry_volume.slice_kernels import slice_kernels
from roemetry_volume.slice_options import SliceOptions, SliceSumOptions
from roemetry_volume.slice_table import Slices, slices_of
from roemetry_volume.underside import estimate_of, true_volume

# chosen so that 95 % intervals hold the truth as often as they say: docs/reference/plugins/slice-pchip.md
_BETWEEN = 0.38  # of what leaving a slice out changes: with it, the gap is half as wide
_RULES_APART = 1.3  # a rectangle's half width over its standard deviation would be 1.73
_AREAS_STD = 0.003  # of the volume: walls and ends of the slices themselves, however many there are
_LOOSE = 1.0 / math.sqrt(3.0)  # of what is bridged beyond a slice's seen points: none of it, or twice as much
_OVER_GAP = 0.1  # of what a straight line fills: a dome rises over it by some tenth
_Known = tuple[tuple[float, float], tuple[float, float]]
_IN_HOLE = 1.0 / math.sqrt(3.0)  # of what a straight line over a hole would hold: it may not be empty


class _SliceEstimator(VolumeEstimator[SliceOptions]):
    """V = rule(Aᵢ over tᵢ) + caps.

    tᵢ is where plane i cuts the belt, Aᵢ the area below the slice weighed so that Aᵢ·dt is a volume however
    the planes lean and fan out. What the rule is, the classes below say.
    """

    Options = SliceOptions
    capabilities = Capabilities(relative_tolerance=0.026)
    rule: ClassVar[int]

    @property
    def states_model_error(self) -> bool:
        """Whether all of the model's error is drawn: not where what lies beyond the slices is left out."""
        return self.options.ends != "none"

    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the visible volume; with `rng` the error between slices and at the ends is drawn, too.

        Raises
        ------
        StageError
            Fewer than three stripes lie on the product, or a plane runs along X, or the sum is not positive.
        """
        rules = slice_kernels().rules
        slices = slices_of(product)
        nan = math.nan
        caps = [cap_of(product, slices, end, self.options.ends) for end in (0, 1)]
        slope = np.array([one.slope_mm if one.kind == rules.TAPERED else nan for one in caps])
        # where an outer slice runs over the edge of an upright end, as if it were whole
        area = slices.area_mm2.copy()
        area[0], area[-1] = caps[0].area_mm2, caps[1].area_mm2
        known = (caps[0].bulge_mm3, caps[1].bulge_mm3), (caps[0].trust, caps[1].trust)
        between = rules.between_slices(slices.t_mm, area, slope, self.rule, *known)
        volume = between + sum(one.volume_mm3 + one.shadow_mm3 for one in caps)
        if not volume > 0.0:
            raise StageError(
                f"the slices sum up to {volume:.4g} mm³: the points lie on or below the belt",
                hint="look at the coding and the belt's zero",
            )
        uneven = _between_std(slices.t_mm, area, slope, between, known)
        budget = {
            "between slices": math.hypot(uneven, _AREAS_STD * volume),
            "slice ends": _LOOSE * float(slices.loose_mm2 @ slices.held_mm),
            "gaps": gaps_std(slices),
            "ends": math.hypot(caps[0].std_mm3, caps[1].std_mm3),
        }
        if rng is not None:
            volume += sum(std * rng.standard_normal() for std in budget.values())
        visible = estimate_of(volume, budget)
        return Volume(
            visible_mm3=visible,
            true_mm3=self._true(visible, slices, caps, rng),
            shares=_shares(slices, caps),
            slice_stripe=slices.stripe,
            slice_area_mm2=slices.area_mm2,
            slice_spacing_mm=slices.held_mm,
            reasons=reasons_of(product, slices, [one.kind for one in caps]),
        )

    def _true(
        self,
        visible: Estimate,
        slices: Slices,
        caps: list[Cap],
        rng: np.random.Generator | None,
    ) -> Estimate | None:
        if self.options.underside == "unknown":
            return None
        # two thirds of the rectangle: the width falls at an end as a parabola does
        at_ends = sum(2.0 / 3.0 * one.length_mm * slices.width_mm[-end] for end, one in enumerate(caps))
        footprint = float((slices.width_mm * slices.held_mm).sum()) + float(at_ends)
        return true_volume(self.options, visible, footprint, rng)


class SliceSum(_SliceEstimator):
    """V = Σ Aᵢ·wᵢ: each area held half the way to both neighbours, outwards half a spacing.

    The zero-order hold with central widths. The plainest rule, and blind to what happens between slices.
    """

    Options = SliceSumOptions
    rule = 0


class SliceTrapezoid(_SliceEstimator):
    """Straight lines between the areas; short of convex bodies by what lies above the lines."""

    rule = 1


class SliceSimpson(_SliceEstimator):
    """Parabolas over pairs of intervals of any lengths; exact where the areas are a parabola."""

    rule = 2


class SlicePchip(_SliceEstimator):
    """Cubics with slopes after Fritsch and Butland (1984): they never overshoot the areas."""

    rule = 3


class SliceSpline(_SliceEstimator):
    """A cubic spline; its slopes at the ends are the caps' where there are any, else not-a-knot."""

    rule = 4


def _between_std(t_mm: Floats, area_mm2: Floats, slope: Floats, between: float, known: _Known) -> float:
    """Say how far the areas between slices may be off: by what leaving single slices out changes.

    Part of the rule's distance from the spline, which smooth bodies follow more closely, is added.
    """
    rules = slice_kernels().rules
    smooth: float = rules.between_slices(t_mm, area_mm2, slope, rules.SPLINE, *known)
    return math.hypot(_BETWEEN * rules.unevenness(t_mm, area_mm2), (smooth - between) / _RULES_APART)


def gaps_std(slices: Slices) -> float:
    """Say how far what straight lines fill, and holes that count as empty, may be off, mm³."""
    if slices.most_filled_mm2 == 0.0 and slices.most_hole_mm == 0.0:
        return 0.0
    return float((_OVER_GAP * slices.filled_mm2 + _IN_HOLE * slices.open_mm2) @ slices.held_mm)


def _shares(slices: Slices, caps: list[Cap]) -> Shares:
    beyond = sum(abs(one.volume_mm3) for one in caps)
    seen, joined, assumed = slices.seen_mm3, slices.joined_mm3, slices.assumed_mm3 + beyond
    total = seen + joined + assumed
    return Shares(seen / total, joined / total, assumed / total)
