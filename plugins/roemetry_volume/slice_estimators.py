"""Visible volume from slices alone: areas in tilted planes, a cubic between them, caps at both ends.

Model. Of each slice the area is weighed so that its integral over where planes cut the belt is a volume
(`roemetry_volume.slice_table`); between slices runs a cubic, beyond the outer ones a cap
(`roemetry_volume.slice_rules`).

Assumed: between slices and beyond them the product goes on as it came. It fails at steps between two slices,
which the interval allows for as far as others show such, and where a side of the product is in the shadow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Profiles, Reason, Shares, Surface, Volume
from roemetry.records.arrays import Flags, Floats, Labels
from roemetry.stages import Capabilities, VolumeEstimator
from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import median_of
from roemetry_volume import slice_rules as rules
from roemetry_volume.slice_rules import Cap, cap_of
from roemetry_volume.slice_table import COUNT, FILLED, HOLE, LOW, WALL, Slices, slices_of
from roemetry_volume.underside import UndersideOptions, estimate_of, true_volume, underside_reasons

# chosen so that 95 % intervals hold the truth as often as they say: docs/reference/plugins/slice-pchip.md
_BETWEEN = 0.38  # of what leaving a slice out changes: with it, the gap is half as wide
_CUBICS_APART = 1.3  # a rectangle's half width over its standard deviation would be 1.73
_AREAS_STD = 0.003  # of the volume: walls and ends of the slices themselves, however many there are
_LOOSE = 1.0 / math.sqrt(3.0)  # of what is bridged beyond a slice's seen points: none of it, or twice as much
_EDGE_ROWS = 0.3
"""As in scans: a blurred stripe loses rows at all of its ends alike (a fillet out of focus by 2 px: 0.8)."""
_OVER_GAP = 0.1  # of what a straight line fills: a dome rises over it by some tenth
_IN_HOLE = 1.0 / math.sqrt(3.0)  # of what a straight line over a hole would hold: it may not be empty

_SHARED = 0.5
"""Of the variance that does not scatter from row to row. On 23 skeins on five rigs of two renderers with
tissue the mean height was off by 0.0 to 1.5 of its root, 0.8 root mean square; with 0.5 all their intervals
hold (plain-light outline), with 1 they are up to a quarter wider."""
_EVERY = 3
"""Points of which one is looked at: medians of some hundreds are within 5 %, and take a few microseconds."""
_POINTS_MIN = 30
"""Fewer second differences than that say nothing of noise (their median is uncertain by a quarter)."""


class SlicePchip(VolumeEstimator[UndersideOptions]):
    """V = the integral of a monotone cubic through Aᵢ over tᵢ, + caps.

    tᵢ is where plane i cuts the belt, Aᵢ the area below the slice weighed so that Aᵢ·dt is a volume however
    the planes lean and fan out. The cubic's slopes are those of Fritsch and Butland (1984): it never
    overshoots the areas.
    """

    capabilities = Capabilities(relative_tolerance=0.026)

    @property
    def states_model_error(self) -> bool:
        """Whether all of the model's error is drawn."""
        return True

    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the visible volume; with `rng` the error between slices and at the ends is drawn, too.

        Raises
        ------
        StageError
            Fewer than three stripes lie on the product, or a plane runs along X, or the sum is not positive.
        """
        slices = slices_of(product)
        caps = [cap_of(product, slices, end) for end in (0, 1)]
        slope = np.array([one.slope_mm for one in caps])
        between = self._between(slices.t_mm, slices.area_mm2)
        volume = between + sum(one.volume_mm3 + one.shadow_mm3 for one in caps)
        if not volume > 0.0:
            raise StageError(
                f"the slices sum up to {volume:.4g} mm³: the points lie on or below the belt",
                hint="look at the coding and the belt's zero",
            )
        uneven = _between_std(slices.t_mm, slices.area_mm2, slope, between)
        budget = {
            "between slices": math.hypot(uneven, _AREAS_STD * volume),
            "slice ends": _LOOSE * float(slices.loose_mm2 @ slices.held_mm),
            "slice edges": _edges_std(slices),
            "gaps": gaps_std(slices),
            "ends": math.hypot(caps[0].std_mm3, caps[1].std_mm3),
            "common height": common_height_std_mm(product) * self._footprint_mm2(slices, caps),
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
            reasons=reasons_of(product, slices, [one.kind for one in caps]) + underside_reasons(self.options),
        )

    @staticmethod
    def _between(t_mm: Floats, area_mm2: Floats) -> float:
        """Give the volume from the first to the last slice, mm³."""
        return float(rules.between_slices(t_mm, area_mm2))

    def surface(self, product: Product) -> Surface:
        """Give the slices, joined straight, and the caps that stand for what lies beyond them."""
        slices = slices_of(product)
        caps = [cap_of(product, slices, end) for end in (0, 1)]
        return _drawn(product, slices, caps)

    def _true(
        self,
        visible: Estimate,
        slices: Slices,
        caps: list[Cap],
        rng: np.random.Generator | None,
    ) -> Estimate | None:
        if self.options.underside == "unknown":
            return None
        return true_volume(self.options, visible, self._footprint_mm2(slices, caps), rng)

    @staticmethod
    def _footprint_mm2(slices: Slices, caps: list[Cap]) -> float:
        # two thirds of the rectangle: the width falls at an end as a parabola does
        at_ends = sum(2.0 / 3.0 * one.length_mm * slices.width_mm[-end] for end, one in enumerate(caps))
        return float((slices.width_mm * slices.held_mm).sum()) + float(at_ends)


class SliceTrapezoid(SlicePchip):
    """Straight lines between the areas; short of convex bodies by what lies above the lines."""

    @staticmethod
    def _between(t_mm: Floats, area_mm2: Floats) -> float:
        from scipy.integrate import trapezoid  # numpy has it from 2.0 on only

        return float(trapezoid(area_mm2, t_mm))


def _edges_std(slices: Slices) -> float:
    """Say what all slices may be too long or too short together, by `_EDGE_ROWS` at each end, mm³."""
    # way from row to row along each slice
    row_mm = slices.width_mm / slices.table[:, COUNT]
    # both ends together, at the root of their mean squared heights
    ends_mm = 2.0 * np.sqrt(slices.table[:, WALL])
    return _EDGE_ROWS * float((ends_mm * row_mm) @ slices.held_mm)


def _between_std(t_mm: Floats, area_mm2: Floats, slope: Floats, between: float) -> float:
    """Say how far the areas between slices may be off: by what leaving single slices out changes.

    Part of the cubic's distance from the spline, which smooth bodies follow more closely, is added.
    """
    smooth: float = rules.by_spline(t_mm, area_mm2, slope)
    return math.hypot(_BETWEEN * rules.unevenness(t_mm, area_mm2), (smooth - between) / _CUBICS_APART)


def gaps_std(slices: Slices) -> float:
    """Say how far what straight lines fill, and holes that count as empty, may be off, mm³."""
    if slices.most_filled_mm2 == 0.0 and slices.most_hole_mm == 0.0:
        return 0.0
    return float((_OVER_GAP * slices.filled_mm2 + _IN_HOLE * slices.open_mm2) @ slices.held_mm)


_ACROSS, _BEYOND = 27, 9
"""Of a drawn surface: points along each slice, and stations in a cap."""


def _drawn(product: Product, slices: Slices, caps: list[Cap]) -> Surface:
    """Resample each slice evenly along itself, and close both ends by caps of their volume and length.

    A cap's cross-sections are the outer slice's, scaled so that its area A falls to A (1 − u)ᵖ at the share u
    of its length L: V = A L / (p + 1).
    """
    profiles = slices.profiles
    lit = [_evenly(profiles, int(place), product.number) for place in slices.place]
    stations, assumed = [lit[0]], [False]
    for k in range(1, len(lit)):
        dark = abs(int(slices.stripe[k] - slices.stripe[k - 1])) - 1
        for j in range(1, dark + 1):
            # straight between the slices beside
            stations.append(lit[k - 1] + j / (dark + 1) * (lit[k] - lit[k - 1]))
            assumed.append(True)
        stations.append(lit[k])
        assumed.append(False)
    for end, cap in enumerate(caps):
        if not (cap.length_mm > 0.0 and cap.volume_mm3 > 0.0):
            continue
        outer, at = lit[-end], float(slices.t_mm[-end])
        # V = A L / (p + 1), solved for p
        power = max(float(slices.area_mm2[-end]) * cap.length_mm / cap.volume_mm3 - 1.0, 0.0)
        middle = np.array([at, 0.5 * (outer[0, 1] + outer[-1, 1]), 0.0])
        beyond = []
        for u in np.sin(np.linspace(0.0, 0.5 * math.pi, _BEYOND + 1)[1:]).tolist():
            # areas go with the square of lengths
            moved = middle + (outer - middle) * (1.0 - u) ** (0.5 * power)
            moved[:, 0] += (1.0 if end else -1.0) * u * cap.length_mm
            beyond.append(moved)
        stations = stations + beyond if end else beyond[::-1] + stations
        assumed = assumed + [True] * _BEYOND if end else [True] * _BEYOND + assumed
    return Surface(np.array(stations), np.repeat(np.array(assumed)[:, None], _ACROSS, axis=1))


def _evenly(profiles: Profiles, place: int, number: int) -> Floats:
    """Give points (27, 3) at even distances along a slice."""
    xyz = profiles.xyz_mm[place]
    on = np.flatnonzero((profiles.product[place] == number) & np.isfinite(xyz).all(axis=1))
    on = on[np.argsort(profiles.row_px[place, on])]
    steps = np.hypot(*np.diff(xyz[on, 1:], axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, along[-1], _ACROSS)
    return np.column_stack([np.interp(at, along, xyz[on, k]) for k in range(3)])


def _shares(slices: Slices, caps: list[Cap]) -> Shares:
    beyond = sum(abs(one.volume_mm3) for one in caps)
    seen, joined, assumed = slices.seen_mm3, slices.joined_mm3, slices.assumed_mm3 + beyond
    total = seen + joined + assumed
    return Shares(seen / total, joined / total, assumed / total)


_UNSEARCHED_ROWS = 1  # at the image's top and bottom: extractors may leave them out
_BELOW_MM = 1.0  # a slice of a smaller depth below the belt is noise, or a worn belt


def reasons_of(product: Product, slices: Slices, caps: Sequence[float] = ()) -> tuple[Reason, ...]:
    """Give the doubts that the slices raise, and what was done about each.

    Parameters
    ----------
    product, slices
        The product and its slices.
    caps
        Kinds of the caps at both ends, for estimators that have such.
    """
    table, calibration = slices.table, product.calibration
    reasons = []
    if slices.missing:
        many = slices.missing
        reasons.append(
            Reason(
                "dead-stripe",
                f"{many} {'stripe' if many == 1 else 'stripes'} between others on the product "
                f"{'shows' if many == 1 else 'show'} nothing; the slices beside were joined over the gap",
            )
        )
    if slices.most_filled_mm2 > 0.0:
        where = _named(slices.stripe[table[:, FILLED] > 0.0])
        reasons.append(
            Reason(
                "gap-in-slice",
                f"rows neither seen nor bridged (stripe {where}); joined by a straight line, as interpolated",
            )
        )
    if slices.most_hole_mm > 0.0:
        hole = table[:, HOLE]
        reasons.append(
            Reason(
                "hole",
                f"the surface falls away and rises again over up to {hole.max():.1f} mm (stripe "
                f"{_named(slices.stripe[hole > 0.0])}): a hole, or two products; nothing is counted there",
            )
        )
    if slices.lowest_mm < -_BELOW_MM:
        low = table[:, LOW]
        reasons.append(
            Reason(
                "below-belt",
                f"points lie up to {-low.min():.1f} mm below the belt (stripe "
                f"{_named(slices.stripe[low < -_BELOW_MM])}); they are counted with their sign",
            )
        )
    if (waist := rules.waist(slices.area_mm2)) >= 0:
        reasons.append(
            Reason(
                "waist",
                f"the slice of stripe {slices.stripe[waist] + 1} has under {rules.WAIST:.0%} of the area on "
                "both sides of it: perhaps two products that touch, measured as one",
            )
        )
    first, last = slices.rows_px
    if first <= _UNSEARCHED_ROWS or last >= calibration.image_size[0] - 1 - _UNSEARCHED_ROWS:
        reasons.append(
            Reason("cut-by-edge", "the product reaches the image's first or last row; it may go on beyond"),
        )
    if any(kind == rules.BLUNT for kind in caps):
        reasons.append(
            Reason(
                "blunt-end",
                "the outer slices do not taper: the end lies anywhere up to the next stripe, "
                "and half of that way is counted",
            )
        )
    if not all(slices.limited) and caps:
        by_taper = not any(kind == rules.NO_CAP for kind in caps)
        reasons.append(
            Reason(
                "beyond-outer-stripes",
                "the product reaches beyond the outer stripes; what lies beyond "
                + ("follows the slices' taper" if by_taper else "is not in the number"),
            )
        )
    return tuple(reasons)


def _named(stripes: np.ndarray) -> str:
    return ", ".join(str(int(stripe) + 1) for stripe in stripes)


def common_height_std_mm(product: Product) -> float:
    """Give the standard uncertainty that all of a product's heights share, mm; 0 where none is stated.

    Each point's stated uncertainty s holds two things: noise, which differs from row to row, and what the
    model of the stripe's profile may be wrong by, which does not: light that enters tissue comes out beside
    the stripe by nearly the same in all rows (Farrell, Patterson, Wilson 1992, Medical Physics 19:879–888).
    Noise averages out over thousands of points, and so does what a run draws point by point; the rest does
    not. Noise shows: the second differences of heights along a stripe scatter by √6 n, n its standard
    deviation, on any surface that is smooth over three rows. So

        common² = ½ (median(s)² − median|z₋₁ − 2 z₀ + z₊₁|² · (1.4826² / 6)), not less than 0.

    Half of the variance, since tissue differs over some millimetres, which averages out over a product and
    not over three rows. Assumed: noise of neighbouring rows is independent (else the interval is too wide),
    and the stated uncertainty is right. It fails towards 0 where the surface is rough from row to row.
    """
    profiles = product.profiles
    common: float = _common_std_mm(
        profiles.xyz_mm,
        profiles.height_std_mm,
        profiles.row_px,
        profiles.product,
        profiles.seen,
        product.number,
    )
    return common


@kernel
def _common_std_mm(
    xyz_mm: Floats, height_std_mm: Floats, row_px: Floats, on: Labels, seen: Flags, number: int
) -> float:
    slices, points = on.shape
    stated, second = np.empty(slices * points // _EVERY + 1), np.empty(slices * points // _EVERY + 1)
    count, m = 0, 0
    for i in range(slices):
        for k in range(1, points - 1):
            if on[i, k] != number or on[i, k - 1] != number or on[i, k + 1] != number:
                continue
            if not (seen[i, k] and seen[i, k - 1] and seen[i, k + 1] and height_std_mm[i, k] > 0.0):
                continue
            # rows are missing between them
            if abs(row_px[i, k + 1] - row_px[i, k - 1]) > 2.5:
                continue
            m += 1
            if m % _EVERY == 0:
                stated[count] = height_std_mm[i, k]
                second[count] = abs(xyz_mm[i, k - 1, 2] - 2.0 * xyz_mm[i, k, 2] + xyz_mm[i, k + 1, 2])
                count += 1
    if count < _POINTS_MIN:
        return 0.0
    # second differences of white noise scatter by √6
    noise, usual = 1.4826 * median_of(second[:count]), median_of(stated[:count])
    return math.sqrt(_SHARED * max(usual * usual - noise * noise / 6.0, 0.0))
