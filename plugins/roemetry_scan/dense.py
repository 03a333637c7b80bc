"""Volume of dense slices: areas times the pitch perpendicular to the plane of light, and what they may miss.

Model. Slices lie in planes n·X = d. The area under slice i, with its width measured across the belt, times
half the way to both neighbours where the planes cut the belt, fills the column under it: V = Σ Aᵢ wᵢ,
Aᵢ = ∫ z dy. How far the body goes on beyond its first and last slice, the areas there tell. Planes that all
lean alike shear the body, which changes no volume; so it is the pitch perpendicular to the light, t·n, that
counts.

What neither camera nor light sees of a flank the assembler has followed (`roemetry_scan.flanks`); it counts
as interpolated.

Uncertainty, each part a standard deviation: `motion` V·u(t·n)/(t·n); `belt off its zero` what it does if that
is because camera or laser have moved; `encoder quantum` half a count's way, uniform, of each slice's place;
`belt jitter` the belt's scatter from line to line on slices; `slip` by the disagreement of several
lines; `between slices` by what every other slice would give; `flanks` a part of what is not seen of them,
and by how much conics miss this body's flank where it is seen (`Profiles.flank_rel_std`);
`rim` by how much the rim's height changes with the points that tell it;
`not seen beside` what may lie between a slice's ends and what is seen next to them; `length of the line` V
times twice its change since calibration; `damaged lines` three lines for each that was left out; `gaps` a
tenth of what straight lines fill.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Profiles, Reason, Shares, Surface, Volume
from roemetry.records.arrays import Flags, Floats, Integers, Labels
from roemetry.stages import Capabilities, StageOptions, VolumeEstimator
from roemetry_kernels.compiling import float_kernel
from roemetry_scan.flanks import POINTS, conic

_UNIFORM = 1.0 / math.sqrt(12.0)  # standard deviation of a uniform distribution over its width
_UP_TO = 1.0 / math.sqrt(2.0)
"""Of the volume that may be missing beside slices: the more, the likelier. Where noise took a potato's flanks
it was 97 % of it."""
FAULTS_UNSEEN = 3.0
"""Lines that faults of transport have spoiled unnoticed, for each one that was noticed. Of three scans that
`benchmarks faults` disturbed, one of nine, one of nine and four of ten such frames were noticed; those before
and behind the product do no harm."""
_OVER_GAP = 0.1
"""Of what a straight line fills: a dome rises over it by some tenth."""
_FLANK_SHARE = 0.06
"""Of what was followed of the flanks, at least. Chosen on foods (seeds 9500 and 9700), where 0.1 made
intervals three times too wide; on seed 9900, used for nothing else, 19 of 20 intervals hold. With 0.04, and
without what much that was followed adds, 34 of 40 held (seeds 204000 to 204507)."""
_FLANKS_MUCH = 0.15
"""Of the volume: where so much was followed, the doubt is twice what the seen side tells, or twice that share
where it tells nothing. What a conic misses grows with the third power of how far it is followed, and the
area with the first: of a lumpy body a quarter of which was followed it was 31 % (`mitsuba-belt`, seed
109400), of foods with 5 to 10 % at most 8. A ball, of which a fifth is followed, is a conic, and its seen
side says so."""
_EDGE_SHIFT = 0.4
"""Points by which all edges may lie farther out or in together: rays miss the last of a flank (seed 7000);
flanks of fillets, which end thin, are followed too far under lines 1 mm apart, by 0.54 % of their volumes.
With 0.3, 4 of 8 intervals of these held (seeds 204400 to 204407)."""
_EDGE_POINTS = 0.5
"""Points by which each edge of a slice may lie otherwise, uniform."""
_BEYOND_STEPS = 2.0
"""Where no rim is known, an outermost point beyond which more is missing would have been followed by the
assembler."""
TO_RIM = 2.0 / 3.0
"""Of the last point's height over the rim, on the mean from there to it: a parabola's."""
_SURFACE_SLICES, _SURFACE_POINTS = 160, 64
"""Of a drawn surface, at most."""
_COVERAGE_FACTOR = 1.959964  # of a normal distribution's 95 %


class Sections(NamedTuple):
    """The slices of one product, sorted along the belt."""

    at_mm: Floats
    """(slice,) where the slice's plane cuts the belt, mm along X."""
    area_mm2: Floats
    filled_mm2: Floats
    bridged_mm2: Floats
    """area_mm2, filled_mm2, bridged_mm2: (slice,) area under it; what of that straight lines fill, and what
    lies under points that were not seen."""
    width_mm: Floats
    edge_mm: Floats
    """width_mm, edge_mm: (slice,) width, and the root of the sum of squares of both edges' heights."""
    point_mm: float
    """Usual distance of points along a slice, mm."""
    held_mm: Floats
    own_mm: Floats
    """held_mm, own_mm: (slice,) half the way to both neighbours, and at both ends what lies beyond; and of
    that what lost lines leave to it."""
    place: Integers
    row: Integers
    """place, row: (slice,) place along the scan, and row of the profiles."""

    @property
    def volume_mm3(self) -> float:
        """The sum of areas times what each slice holds."""
        return float(self.area_mm2 @ self.held_mm)


class DenseSlices(VolumeEstimator[StageOptions]):
    """Sums slices that lie so close that little is to be guessed between them."""

    capabilities = Capabilities(relative_tolerance=0.12)

    @property
    def states_model_error(self) -> bool:
        """True: the parts of the budget are all that the sum may miss."""
        return True

    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the visible volume; StageError where fewer than three slices show the product."""
        found = sections_of(product.profiles, product.number)
        value, budget = found.volume_mm3, budget_of(found, product.profiles, product.number)
        if not value > 0.0:
            raise StageError(f"the slices sum up to {value:.4g} mm³: the points lie on or below the belt")
        if rng is not None:
            value += float(sum(part * rng.standard_normal() for part in budget.values()))
        return Volume(
            visible_mm3=estimate_of(value, budget),
            true_mm3=None,
            shares=shares_of(found),
            slice_stripe=found.place,
            slice_area_mm2=found.area_mm2,
            slice_spacing_mm=found.held_mm,
            reasons=reasons_of(found),
        )

    def surface(self, product: Product) -> Surface:
        """Give the slices at even places across, thinned out."""
        found = sections_of(product.profiles, product.number)
        step = max(1, math.ceil(found.row.size / _SURFACE_SLICES))
        return _drawn(product.profiles, found.row[::step], product.number)


def sections_of(profiles: Profiles, number: int) -> Sections:
    """Measure the slices of a product; StageError where fewer than three show it, or planes run along X."""
    height = profiles.xyz_mm[..., 2]
    mine = (profiles.product == number) & np.isfinite(height)
    index = np.flatnonzero(np.count_nonzero(mine, axis=1) >= 2)
    if index.size < 3:
        raise StageError(f"{index.size} slices show the product, 3 are the least")
    plane = profiles.plane[index]
    if np.abs(plane[:, 0]).min() < 1e-3:
        raise StageError("a slice's plane runs along X: slices lie across the way the belt runs")
    middle = float(np.median(profiles.xyz_mm[..., 1][mine]))
    at = (plane[:, 3] - plane[:, 1] * middle) / plane[:, 0]
    order = np.argsort(at, kind="stable")
    index, at = index[order], at[order]
    gap = np.diff(at)
    if not gap.min() > 0.0:
        raise StageError("two slices lie at one place")
    xyz, on = profiles.xyz_mm[index], mine[index]
    rim = float(profiles.rim_mm[number]) if number < profiles.rim_mm.size else math.nan
    table = _areas(xyz, on, profiles.seen[index], profiles.product[index], rim)
    place = profiles.stripe[index]
    steps = np.maximum(np.abs(np.diff(place)), 1)
    held, own = np.zeros(index.size), np.zeros(index.size)
    for half, of in ((0.5 * gap, held), (0.5 * gap / steps, own)):
        of[:-1] += half
        of[1:] += half
    for end, inner, step in ((0, 1, gap[0]), (-1, -2, gap[-1])):
        area, width = float(table[inner, 0]), float(table[inner, 2])
        wall = min(rim * width / area, 1.0) if math.isfinite(rim) and area > 0.0 else 1.0
        outer_held, inner_held = end_held(float(table[end, 0]), area, wall)
        for of in (held, own):
            of[end] += outer_held * step
            of[inner] += inner_held * step
    return Sections(
        at, table[:, 0], table[:, 1], table[:, 5], table[:, 2], table[:, 3], float(np.median(table[:, 4])),
        held, own, place, index,
    )  # fmt: skip


def end_held(outer_mm2: float, inner_mm2: float, wall_share: float = 1.0) -> tuple[float, float]:
    """Give how far the two slices at an end hold besides half the way between them, in spacings.

    Outlines are round at their ends: with the distance δ from the end, widths grow as √δ, and so do the areas
    of a wall up to the rim; what bulges over the rim grows in width and height, as δ. With the share p of the
    wall in the inner slice, `wall_share`,

        A(δ) = A₁·(p·√s + (1 − p)·s),  s = δ / (δ₀ + 1),

    the ratio of both areas tells δ₀, the outer slice's distance from the end; up to the inner one there are
    (½ + p/6)·A₁·(δ₀ + 1). Farther in areas are concave, and trapezoids miss 1/12 of their slope at the inner
    slice, in squares of the spacing (Euler and Maclaurin): (2 − p)·(1 − s₀)/24 of A₁, 0.04 to 0.08 with a
    slice at the very end.

    An end more than a spacing away (s₀ > ½) would show in one slice more, so areas that differ less are those
    of a blunt end, whose place is not known: half a spacing on the mean where both areas are alike. Between
    the two, from what s₀ = ½ gives, in proportion to s₀.
    """
    if not inner_mm2 > 0.0:
        return 0.5, 0.0
    ratio, wall = min(max(outer_mm2 / inner_mm2, 0.0), 1.0), wall_share
    root = 2.0 * ratio / (wall + math.sqrt(wall * wall + 4.0 * (1.0 - wall) * ratio)) if ratio > 0.0 else 0.0
    square = root * root
    bent = (2.0 - wall) * (1.0 - square) / 24.0
    mean = 0.5 + wall / 6.0
    if square > 0.5:
        whole = wall * math.sqrt(0.5) + (1.0 - wall) * 0.5  # the ratio of areas at s₀ = ½
        farthest = (2.0 * mean - 0.5 * (1.0 + whole)) / whole
        return 0.5 + (farthest - 0.5) * 2.0 * (1.0 - square), bent
    outer = mean * square / (ratio * (1.0 - square)) if ratio > 0.0 else 0.0
    return outer - 0.5, mean - 0.5 + bent


def budget_of(found: Sections, profiles: Profiles, number: int) -> dict[str, float]:
    """Give the standard deviation of each part of what the sum may miss, mm³."""
    area, at, value = found.area_mm2, found.at_mm, found.volume_mm3
    uneven = 0.1 * abs(value)
    if area.size > 6:
        whole = [slice(0, area.size - 1 + area.size % 2), slice(1, area.size - area.size % 2)]
        coarse = [_trapezoid(area[k][::2], at[k][::2]) - _trapezoid(area[k], at[k]) for k in whole]
        uneven = max(map(abs, coarse)) / 3.0  # a trapezoid's error falls with the square of the pitch
    followed = float(found.bridged_mm2 @ found.held_mm)
    edge = found.edge_mm * found.held_mm * found.point_mm * _EDGE_POINTS * 2.0 * _UNIFORM
    together = _EDGE_SHIFT * found.point_mm * float(found.edge_mm @ found.held_mm) * math.sqrt(2.0)
    budget = {
        "between slices": uneven,
        "slice edges": math.hypot(float(np.sqrt(edge @ edge)), together),
        "flanks": flanks_std_mm3(followed, value, told_of(profiles, number)),
        "gaps": _OVER_GAP * float(found.filled_mm2 @ found.held_mm)
        + _OVER_GAP * float(area @ (found.held_mm - found.own_mm)),
    }
    if number < profiles.rim_mm3.size:
        budget["rim"] = float(profiles.rim_mm3[number])
    if number < profiles.unseen_margin_mm3.size:
        budget["not seen beside"] = _UP_TO * float(profiles.unseen_margin_mm3[number])
    scan = profiles.scan
    if scan is not None:
        rise = np.diff(area, prepend=0.0, append=0.0)
        per_slice = found.width_mm * found.held_mm
        budget["motion"] = abs(value) * scan.pitch_rel_std
        budget["damaged lines"] = abs(value) * FAULTS_UNSEEN * scan.damaged / scan.lines
        budget["belt off its zero"] = abs(value) * scan.belt_off_rel_std
        if math.isfinite(scan.line_length_rel_std):
            budget["length of the line"] = abs(value) * scan.line_length_rel_std
        budget["encoder quantum"] = scan.quantum_mm * _UNIFORM * float(np.sqrt(rise @ rise))
        budget["belt jitter"] = scan.jitter_mm * float(np.sqrt(per_slice @ per_slice))
        if math.isfinite(scan.slip_rel):
            budget["slip"] = abs(value) * scan.slip_rel
    return budget


def flanks_std_mm3(followed_mm3: float, volume_mm3: float, told: float) -> float:
    """Give the standard deviation of what was followed of flanks; `told` as in `Profiles.flank_rel_std`."""
    much = 1.0 + (followed_mm3 / (_FLANKS_MUCH * volume_mm3)) ** 2 if volume_mm3 else 1.0
    if math.isnan(told):
        return followed_mm3 * _FLANK_SHARE * much
    return followed_mm3 * math.hypot(_FLANK_SHARE, told * much)


def told_of(profiles: Profiles, number: int) -> float:
    """Give a product's `Profiles.flank_rel_std`; NaN where the slices say nothing of it."""
    known = number < profiles.flank_rel_std.size
    return float(profiles.flank_rel_std[number]) if known else math.nan


def _trapezoid(area: Floats, at: Floats) -> float:
    """Sum as `scipy.integrate.trapezoid` does, whose import takes 15 MB; numpy has it from 2.0 on only."""
    return float((np.diff(at) * (area[1:] + area[:-1]) / 2.0).sum())


def shares_of(found: Sections) -> Shares:
    """Give the shares: seen points; straight lines and flanks; lost lines."""
    seen = float((found.area_mm2 - found.filled_mm2 - found.bridged_mm2) @ found.own_mm)
    joined = float((found.filled_mm2 + found.bridged_mm2) @ found.own_mm)
    assumed = max(found.volume_mm3 - seen - joined, 0.0)
    total = seen + joined + assumed
    return Shares(seen / total, joined / total, assumed / total)


def reasons_of(found: Sections) -> tuple[Reason, ...]:
    """Say what lost lines left out of the product."""
    whole = float(found.area_mm2 @ found.held_mm)
    share = 1.0 - float(found.area_mm2 @ found.own_mm) / whole if whole > 0.0 else 0.0
    lost = int(np.maximum(np.abs(np.diff(found.place)) - 1, 0).sum())
    if not lost:
        return ()
    return (
        Reason(
            "gap-in-scan",
            f"{lost} lines over the product were not taken; {share:.1%} of its volume is bridged between "
            "their neighbours",
        ),
    )


def estimate_of(value: float, budget: dict[str, float]) -> Estimate:
    """Give an estimate whose uncertainty is the root of the sum of squares of its parts."""
    std = math.hypot(*budget.values())
    reach = _COVERAGE_FACTOR * std
    return Estimate(value, std, budget, (value - reach, value + reach))


@float_kernel
def _areas(xyz: Floats, mine: Flags, seen: Flags, label: Labels, rim: float) -> Floats:
    """Give (slice, 6): area, what of it is filled, width, √(Σ edge heights²), usual step, what is bridged."""
    slices, points = mine.shape
    table = np.zeros((slices, 6))
    for i in range(slices):
        last, first = -1, -1
        area, filled, bridged, steps, count = 0.0, 0.0, 0.0, 0.0, 0
        for k in range(points):
            if not mine[i, k]:
                continue
            if last >= 0:
                step = abs(xyz[i, k, 1] - xyz[i, last, 1])
                part = 0.5 * (xyz[i, k, 2] + xyz[i, last, 2]) * step
                area += part
                if k - last > 1:
                    filled += abs(part)
                else:
                    steps += step
                    count += 1
                    if not (seen[i, k] and seen[i, last]):
                        bridged += abs(part)
            else:
                first = k
            last = k
        each = steps / count if count > 0 else 0.0
        left = _beyond(xyz[i], mine[i], seen[i], label[i], first, 1, each, rim)
        right = _beyond(xyz[i], mine[i], seen[i], label[i], last, -1, each, rim)
        area += left[0] * left[1] + right[0] * right[1]
        table[i, 0], table[i, 1], table[i, 5] = area, filled, bridged
        table[i, 2] = abs(xyz[i, last, 1] - xyz[i, first, 1]) + left[0] + right[0]
        table[i, 3] = math.sqrt(xyz[i, first, 2] ** 2 + xyz[i, last, 2] ** 2)
        table[i, 4] = each
    return table


@float_kernel
def _beyond(
    xyz: Floats, mine: Flags, seen: Flags, label: Labels, edge: int, inwards: int, step: float, rim: float
) -> tuple[float, float]:
    """Give how far a slice goes on beyond its outermost point, mm, and the mean height there, mm.

    A wall or a slope ends half a step farther out on the mean. A flank that bulges goes on as
    the conic of its last points, to the rim: a camera over the belt's middle looks past the rim of what it
    sees to the side, and light that grazes loses the last of it. Where the rim is known, points that were
    followed from other slices are as good as seen ones: they lie no nearer to it, and up to the first belt
    beside them all may be product.
    """
    beside = edge - inwards
    half = 0.5 * step
    only_seen = math.isnan(rim)
    if only_seen and not seen[edge]:
        return half, xyz[edge, 2]
    most = _BEYOND_STEPS * step
    while not only_seen and 0 <= beside < label.size and label[beside] < 0:
        beside -= inwards
    if 0 <= beside < label.size and label[beside] == 0:
        most = abs(xyz[beside, 1] - xyz[edge, 1])
    d, z = np.empty(POINTS), np.empty(POINTS)
    count, k = 0, edge
    while 0 <= k < mine.size and count < POINTS and mine[k] and (seen[k] or not only_seen):
        d[count], z[count] = abs(xyz[k, 1] - xyz[edge, 1]), xyz[k, 2]
        count += 1
        k += inwards
    r, _, _, c, length = conic(d, z, count, most, rim)
    if length <= 0.0 or c >= 0.0:
        return half, xyz[edge, 2]
    return length, r + TO_RIM * (xyz[edge, 2] - r)


def _drawn(profiles: Profiles, index: Integers, number: int) -> Surface:
    """Resample slices at even places between their own edges."""
    stations = np.full((index.size, _SURFACE_POINTS, 3), np.nan)
    for k, row in enumerate(index.tolist()):
        on = (profiles.product[row] == number) & np.isfinite(profiles.xyz_mm[row, :, 2])
        points = profiles.xyz_mm[row][on]
        points = points[np.argsort(points[:, 1])]
        y = np.linspace(points[0, 1], points[-1, 1], _SURFACE_POINTS)
        stations[k] = np.column_stack([np.interp(y, points[:, 1], points[:, m]) for m in range(3)])
    return Surface(stations, np.zeros(stations.shape[:2], np.bool_))
