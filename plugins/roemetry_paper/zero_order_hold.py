"""Volume as the paper sums it: each slice's area held until the next stripe (section 3.6).

Model. V = Σ xᵢ·Aᵢ over the slices, i = 1 … N − 1 (Lee et al. 2000).

Aᵢ, mm², is the area between belt and product in slice i, along Y: each point's height times the length it
stands for, half the way to each of its two neighbours. At the end of a curve a point stands for as much
outwards as inwards, as a pixel of an image row does; so on rows of equal scale Aᵢ is the paper's sum of
heights times the scale. Bridged points count like seen ones, rows with neither count nothing.

xᵢ, mm, is the distance along X from the rest position of stripe i to that of the next live stripe: where
their planes cut the belt (Z = 0), at the product's middle Y. The slices may come in any order.

Decided where the paper is silent:

- A stripe without any point between two that lie on the product is dead: the slice before it is held over it,
  and that part counts as assumed. Stripes beyond the product are live and have the area 0.
- Points below the belt are kept with their sign; they are noise around the belt, and dropping them would add
  volume. Shares are reckoned with the heights' sizes.
- No error is modelled, so the uncertainty is not stated. The true volume cannot be known from above.

What to know before trusting it: nothing is added for what lies before the first stripe on the product, and
the last slice is held although the product ends somewhere before the next stripe. Where both ends of the
product lie between lit stripes the two errors nearly cancel; where it reaches beyond the outer stripes that
part is missing, and the last stripe's slice is never counted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Profiles, Reason, Shares, Volume
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Capabilities, StageOptions, VolumeEstimator
from roemetry_kernels.compiling import kernel
from roemetry_kernels.slices import BodyCurves, body_curves

_UNSEARCHED_ROWS = 1  # at the image's top and bottom: the paper's extractors leave them out


class ZeroOrderHold(VolumeEstimator[StageOptions]):
    """Sums area times spacing over the slices: the volume as Lee et al. (2000, section 3.6) have it."""

    capabilities = Capabilities(relative_tolerance=0.01)

    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the visible volume; `rng` is not used, since the estimator's own error is not modelled.

        Raises
        ------
        StageError
            No stripe lies on the product, or a plane runs along X, or the sum is not positive.
        """
        curves = body_curves(product.profiles, product.number)
        if not curves.slice.size:
            raise StageError("no stripe on the product", hint="there is nothing to sum; look at the coding")
        slices = _slices(product.profiles, curves)
        volume_mm3 = float((slices.area_mm2 * slices.spacing_mm).sum())
        if not volume_mm3 > 0.0:
            raise StageError(_no_volume(slices, volume_mm3), hint="look at the coding and the belt's zero")
        lit = slices.lit
        return Volume(
            visible_mm3=Estimate(volume_mm3),
            true_mm3=None,
            shares=_shares(slices),
            slice_stripe=slices.stripe[lit],
            slice_area_mm2=slices.area_mm2[lit],
            slice_spacing_mm=slices.spacing_mm[lit],
            reasons=_reasons(product, curves, slices),
        )


class _Slices(NamedTuple):
    """The slices in the order of their rest positions.

    `seen_mm2` and `bridged_mm2` are sums of the heights' sizes; `own_mm` is the part of the spacing that
    reaches to the next stripe, dead or live; `missing` is the number of dead stripes in the spacing.
    """

    stripe: Integers
    lit: Flags
    area_mm2: Floats
    seen_mm2: Floats
    bridged_mm2: Floats
    spacing_mm: Floats
    own_mm: Floats
    missing: Integers


def _slices(profiles: Profiles, curves: BodyCurves) -> _Slices:
    count = profiles.slice_count
    alone = bool((curves.size == 1).any())
    # only a curve of one point needs the scale along Y, for it has no neighbour to tell
    row_mm = _mm_per_row(profiles, curves) if alone else np.nan
    sums, y_mm = slice_sums(curves, profiles.xyz_mm, profiles.seen, row_mm)
    # planes lean against Y: spacings are taken where the product is
    rest_mm = _rest_mm(profiles, 0.5 * float(y_mm[0] + y_mm[1]))
    # along X; stable, so that slices at one place keep their order
    order = np.argsort(rest_mm, kind="stable")
    rest_mm, stripe, frame = rest_mm[order], profiles.stripe[order], profiles.frame[order]
    # sums of the heights, seen part, bridged part, each (slice,)
    area_mm2, seen_mm2, bridged_mm2 = np.ascontiguousarray(sums[order].T)
    lit = np.zeros(count, np.bool_)
    lit[curves.slice[curves.first]] = True
    lit = lit[order]
    dead = ~lit
    # dead is only said between the first and the last stripe on the product
    dead[: int(lit.argmax())] = dead[count - int(lit[::-1].argmax()) :] = False
    for place in dead.nonzero()[0]:  # amid the product: without any point, or live and of the area 0
        dead[place] = np.isnan(profiles.xyz_mm[order[place], :, 2]).all()

    spacing, own, missing = held_over(rest_mm, stripe, frame, dead)
    return _Slices(
        stripe=stripe,
        lit=lit,
        area_mm2=area_mm2,
        seen_mm2=seen_mm2,
        bridged_mm2=bridged_mm2,
        spacing_mm=spacing,
        own_mm=own,
        missing=missing,
    )


def _mm_per_row(profiles: Profiles, curves: BodyCurves) -> float:
    """Length along Y of a row: the median over neighbours; else from the outermost points."""
    y_mm = profiles.xyz_mm[curves.slice, curves.point, 1]
    row_px = profiles.row_px[curves.slice, curves.point]
    joined = np.ones(y_mm.size, np.bool_)
    joined[curves.first] = False
    if joined.any():
        step_mm, step_px = np.abs(np.diff(y_mm, prepend=np.nan)), np.diff(row_px, prepend=np.nan)
        # median: one torn pair of neighbours does not matter
        return float(np.median(step_mm[joined] / step_px[joined]))
    rows = float(np.ptp(row_px))
    if rows == 0.0:
        raise StageError("the product is a single row of points; its extent along the stripes is not known")
    return float(np.ptp(y_mm)) / rows


def _rest_mm(profiles: Profiles, y_mm: float) -> Floats:
    # plane n·X = d at Z = 0: x = (d − n_y y) / n_x
    """X at which each slice's plane cuts the belt at a given Y, mm."""
    nx, ny, _, d = profiles.plane.T
    if (np.abs(nx) < 1e-9).any():
        stripe = int(profiles.stripe[np.argmin(np.abs(nx))])
        raise StageError(f"the plane of stripe {stripe + 1} runs along X: slices have no spacing there")
    rest: Floats = (d - ny * y_mm) / nx
    return rest


def _shares(slices: _Slices) -> Shares:
    # by the heights' sizes, or points below the belt could make a share negative
    sizes = slices.seen_mm2 + slices.bridged_mm2
    total = float(sizes @ slices.spacing_mm)
    return Shares(
        # up to the next stripe, dead or live, a slice is measured; beyond it is held, hence assumed
        seen=float(slices.seen_mm2 @ slices.own_mm) / total,
        interpolated=float(slices.bridged_mm2 @ slices.own_mm) / total,
        assumed=float(sizes @ (slices.spacing_mm - slices.own_mm)) / total,
    )


def _no_volume(slices: _Slices, volume_mm3: float) -> str:
    # some slice but the last is lit: then its heights are to blame
    if slices.lit[:-1].any():
        return f"the slices sum up to {volume_mm3:.4g} mm³: the points lie on or below the belt"
    return "only the last stripe lies on the product, and the paper's sum does not count it"


def _reasons(product: Product, curves: BodyCurves, slices: _Slices) -> tuple[Reason, ...]:
    profiles, calibration = product.profiles, product.calibration
    reasons = []
    # a slice that is held over dead stripes
    held = slices.lit & (slices.missing > 0)
    if held.any():
        after = ", ".join(str(stripe + 1) for stripe in slices.stripe[held])
        many = int(slices.missing[held].sum())
        reasons.append(
            Reason(
                "dead-stripe",
                f"{many} {'stripe shows' if many == 1 else 'stripes show'} nothing (after stripe {after}); "
                "the slice before is held over the gap",
            )
        )
    # only matters if there was something to count
    if slices.lit[-1] and slices.area_mm2[-1] != 0.0:
        reasons.append(
            Reason("last-slice-not-counted", "the last lit stripe's slice is not counted (the paper's sum)"),
        )
    lowest, highest, unseen = rows_reached(profiles.row_px, curves)
    if unseen:
        reasons.append(
            Reason(
                "gap-in-slice",
                f"{unseen} {'row' if unseen == 1 else 'rows'} within the slices neither seen nor bridged; "
                "nothing is counted there",
            )
        )
    # the rows beyond are not searched by the paper's extractors, so reaching them is as good as leaving the
    # image
    if lowest <= _UNSEARCHED_ROWS or highest >= calibration.image_size[0] - 1 - _UNSEARCHED_ROWS:
        reasons.append(
            Reason("cut-by-edge", "the product reaches the image's first or last row; it may go on beyond"),
        )
    outermost = (0, calibration.stripe_count - 1)
    # by place, not by number: stripes may come in either order
    if any(slices.lit[end] and slices.stripe[end] in outermost for end in (0, -1)):
        reasons.append(
            Reason(
                "beyond-outer-stripes",
                "the product reaches beyond the outer stripes; what lies beyond is not in the number",
            )
        )
    return tuple(reasons)


@kernel
def slice_sums(curves: BodyCurves, xyz_mm: Floats, seen: Flags, row_mm: float) -> tuple[Floats, Floats]:
    """Area (mm²) of each slice between belt and product, and of the heights' sizes its seen and bridged part.

    Each point's height counts times the length it stands for along Y: half the way to each neighbour in its
    curve, at an end as much outwards as inwards, and `row_mm` where a curve is one point.

    Returns
    -------
    sums
        (slice, 3) area, its seen part and its bridged part, of the heights' sizes, mm².
    y_mm
        (2,) smallest and largest Y of the points.
    """
    slice_of, point_of, first, size = curves
    sums = np.zeros((xyz_mm.shape[0], 3))
    y_mm = np.array([math.inf, -math.inf])
    for c in range(first.size):
        last = first[c] + size[c] - 1
        for k in range(first[c], last + 1):
            s, p = slice_of[k], point_of[k]
            y, z = xyz_mm[s, p, 1], xyz_mm[s, p, 2]
            y_mm[0], y_mm[1] = min(y_mm[0], y), max(y_mm[1], y)
            # neighbours within one curve only
            before = abs(y - xyz_mm[slice_of[k - 1], point_of[k - 1], 1]) if k > first[c] else math.nan
            after = abs(xyz_mm[slice_of[k + 1], point_of[k + 1], 1] - y) if k < last else math.nan
            # at its ends a point reaches outwards as far as inwards
            if k == first[c]:
                before = after
            if k == last:
                after = before
            # a curve of one point has neither neighbour
            length = row_mm if math.isnan(before) else 0.5 * (before + after)
            part = z * length
            sums[s, 0] += part
            # sizes for the shares, the sign for the area
            sums[s, 1 if seen[s, p] else 2] += abs(part)
    return sums, y_mm


@kernel
def held_over(
    rest_mm: Floats, stripe: Integers, frame: Integers, dead: Flags
) -> tuple[Floats, Floats, Integers]:
    """Over what each live slice is held, slices in the order of their rest positions.

    Stripe numbers tell of stripes without a slice, within a frame: a scan's frames overlap as they like.

    Returns
    -------
    spacing
        (slice,) mm to the next live slice; 0 of dead ones and of the last.
    own
        (slice,) the part of it that reaches to the next stripe, dead or live, mm.
    missing
        (slice,) number of dead stripes in it.
    """
    count = rest_mm.size
    spacing, own, missing = np.zeros(count), np.zeros(count), np.zeros(count, np.int64)
    live = -1
    for k in range(count):
        if not dead[k]:
            if live >= 0:
                # closed when the next live slice comes
                spacing[live] = rest_mm[k] - rest_mm[live]
                # the step to this live slice was counted, too
                missing[live] -= 1
                # two slices at one place: the first is held over nothing
                if spacing[live] <= 0.0:
                    own[live] = 0.0
            live = k
        if k < count - 1:
            # stripes without a slice between the two, by number
            step = max(abs(stripe[k + 1] - stripe[k]), 1) if frame[k + 1] == frame[k] else 1
            if live >= 0:
                missing[live] += step
            if live == k:
                own[k] = (rest_mm[k + 1] - rest_mm[k]) / step
    # behind the last live slice there is nothing to hold it over
    if live >= 0:
        own[live], missing[live] = 0.0, 0
    return spacing, own, missing


@kernel
def rows_reached(row_px: Floats, curves: BodyCurves) -> tuple[float, float, int]:
    """Lowest and highest row of points in line, and the rows between two curves of one slice, summed."""
    slice_of, point_of, first, _ = curves
    lowest, highest, between = math.inf, -math.inf, 0
    for k in range(slice_of.size):
        row = row_px[slice_of[k], point_of[k]]
        lowest, highest = min(lowest, row), max(highest, row)
    for c in range(1, first.size):
        k = first[c]
        # two curves of one slice: between them neither seen nor bridged
        if slice_of[k] == slice_of[k - 1]:
            step = row_px[slice_of[k], point_of[k]] - row_px[slice_of[k - 1], point_of[k - 1]]
            between += int(np.rint(step)) - 1
    return lowest, highest, between
