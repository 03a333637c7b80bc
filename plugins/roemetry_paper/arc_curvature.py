"""Shape by the curvature of the stripes (section 3.5): a dent turns the bow of a stripe around.

Model. Circles are put through points `delta_samples` apart along each stripe's curve on the product, and κ is
the vector from the middle one of three points to the circle's centre. A healthy product is convex: all its
centres lie on one side. The product is henkei if any centre lies on the other side at a distance above
`radius_min_px` and below `radius_max_px` (both exclusive). Long |κ| is flat, short is sharp.

The side: a stripe's peak moves by ``displacement_px_per_mm`` times the height. If that is negative, as on the
paper's rig, a convex product pushes the middle of the stripe to the left and its centres of arc lie to the
right, κx > 0. If it is positive (the laser on the other side) all is mirrored. So κx times
−sign(displacement) is positive for convex arcs on either rig. In the cross-section (Y, Z) a convex arc has
its centre below, κz < 0, whatever the rig.

A curve is a run of rows without a gap, bridged points included. N points of it give floor((N − 1) / delta) −
1 circles. Three points on a line are infinitely flat.

Limits in mm, where none are given: with s mm per px along the stripe and h mm of height per px of
displacement, row = −Y/s and x = ∓Z/h. At small slopes 1/R is the second derivative's size, so 1/R_px = s²/(h
R_mm) and R_mm = R_px s²/h, stripe by stripe. Where slopes are not small the two spaces do not agree: circles
in the image are ellipses in the cross-section.

Lengths in pixels belong to a scale. Given the scale they were chosen at, all of them, and the samples between
points, are multiplied by how much finer the rig is, so that a rescaled rig grades the same.

What to know before trusting it: the rule is sharp. At 14 samples, a radius below 80 px is a bow of 1.2 px, so
with whole-pixel peaks noise alone turns a flat healthy product into henkei. Take sub-pixel peaks, or
`smoothing_rows`, or ask for more than one arc. With samples one row apart no circle is smaller than
`delta_samples`, so the paper's lower limit of 4 px never acts. ``unknown`` is the answer where no curve is
long enough for one circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from roemetry.records import Grade, ImageArrows, Product, Reason
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Classifier, StageOptions
from roemetry_kernels.compiling import kernel
from roemetry_kernels.slices import BodyCurves, body_curves, smoothed

GOOD, HENKEI, UNKNOWN = "good", "henkei", "unknown"

_STEPS = 200  # looked at for the scale along the stripes


class ArcCurvatureOptions(StageOptions):
    """Options of `ArcCurvature`."""

    delta_samples: int = Field(
        default=14, ge=1, le=1000, description="samples (rows) between the points a circle is put through"
    )
    radius_min_px: float = Field(
        default=4.0, ge=0.0, description="px; a concave arc counts if its radius is larger than this"
    )
    radius_max_px: float = Field(
        default=80.0, gt=0.0, description="px; a concave arc counts if its radius is smaller than this"
    )
    space: Literal["px", "mm"] = Field(
        default="px",
        description="px: circles in the image, as in the paper. mm: circles in the true cross-section, the "
        "same for every rig",
    )
    radius_min_mm: float | None = Field(
        default=None, ge=0.0, description="mm, for space mm; not given: radius_min_px converted for the rig"
    )
    radius_max_mm: float | None = Field(
        default=None, gt=0.0, description="mm, for space mm; not given: radius_max_px converted for the rig"
    )
    tuned_at_mm_per_px: float | None = Field(
        default=None,
        gt=0.0,
        le=100.0,
        description="mm per px along stripes on the product, at which lengths in px and rows were chosen: "
        "they are converted to the rig's own scale; none: taken as they are",
    )
    smoothing_rows: int = Field(
        default=0,
        ge=0,
        le=201,
        description="rows (odd) over which a local quadratic smooths a curve first; 0: none, as in the paper",
    )
    henkei_arcs_min: int = Field(
        default=1, ge=1, description="number of concave, sharp arcs that makes a product henkei; 1: the paper"
    )

    @model_validator(mode="after")
    def _consistent(self) -> ArcCurvatureOptions:
        if self.smoothing_rows and (self.smoothing_rows < 3 or self.smoothing_rows % 2 == 0):
            raise ValueError(
                f"smoothing_rows is {self.smoothing_rows}, expected 0 or an odd number from 3 on"
            )
        if self.radius_min_px >= self.radius_max_px:
            raise ValueError(
                f"radius_min_px ({self.radius_min_px:g}) is not below radius_max_px ({self.radius_max_px:g})"
            )
        low, high = self.radius_min_mm, self.radius_max_mm
        if low is not None and high is not None and low >= high:
            raise ValueError(f"radius_min_mm ({low:g}) is not below radius_max_mm ({high:g})")
        return self


class ArcCurvature(Classifier[ArcCurvatureOptions]):
    """Calls a product henkei if an arc along a stripe is concave and sharp (Lee et al. 2000, section 3.5)."""

    def classify(self, product: Product, *, rng: np.random.Generator | None = None) -> Grade:
        """Grade one product; `rng` is not used, since no error of the rule itself is modelled."""
        curves = body_curves(product.profiles, product.number)
        asked = self.options.space == "mm" or self.options.tuned_at_mm_per_px is not None
        mm_per_px = _mm_per_px(product, curves) if asked else math.nan
        options = _rescaled(self.options, mm_per_px)
        # three points each, the middle ones delta samples apart: neighbouring circles share two points
        middle = arc_middles(curves.first, curves.size, options.delta_samples)
        if not middle.size:
            return _unknown(curves, options.delta_samples)
        arcs = _arcs(product, curves, middle, options, mm_per_px)
        count, flagged = arcs.flagged.size, int(arcs.flagged.sum())
        label = HENKEI if flagged >= options.henkei_arcs_min else GOOD
        smallest = float(np.min(arcs.radius, where=arcs.concave, initial=np.inf))
        # infinity where no arc is concave
        unit = options.space
        return Grade(
            label=label,
            features={
                "arcs": float(count),
                "arcs_straight": float(np.isinf(arcs.radius).sum()),
                "arcs_concave": float(arcs.concave.sum()),
                "arcs_flagged": float(flagged),
                f"smallest_concave_radius_{unit}": smallest if math.isfinite(smallest) else math.nan,
            },
            reasons=(_reason(arcs, options),),
            arrows=_arrows(arcs, unit),
        )


@dataclass(frozen=True, eq=False, slots=True)
class _Arcs:
    """All circles of a product, one element each; `radius` in the space's unit, inf where flat."""

    stripe: Integers
    middle_px: Floats
    centre_px: Floats
    radius: Floats
    bow: Floats
    concave: Flags
    flagged: Flags
    radius_min: Floats
    radius_max: Floats


def _arcs(
    product: Product, curves: BodyCurves, middle: Integers, options: ArcCurvatureOptions, mm_per_px: float
) -> _Arcs:
    profiles, delta = product.profiles, options.delta_samples
    x_row = pairs_in_line(profiles.x_px, profiles.row_px, curves.slice, curves.point)
    # together: the same rows are smoothed in the image and in the section
    in_section = options.space == "mm"
    along_above = profiles.xyz_mm[curves.slice, curves.point, 1:] if in_section else x_row[:, :0]
    if options.smoothing_rows:
        both = smoothed(curves, np.concatenate([x_row, along_above], axis=1), options.smoothing_rows)
        x_row, along_above = np.ascontiguousarray(both[:, :2]), np.ascontiguousarray(both[:, 2:])
    stripe = profiles.stripe[curves.slice[middle]]
    displacement = product.calibration.displacement_px_per_mm[stripe]
    to_centre_px, radius, bow = circles(x_row, middle, delta)
    if not in_section:
        # a convex body pushes the middle of a stripe to the side it is displaced to, so its centres lie on
        # the other
        convexity = np.where(displacement > 0.0, -to_centre_px[:, 0], to_centre_px[:, 0])
        radius_min: Floats = np.full(middle.size, options.radius_min_px)
        radius_max: Floats = np.full(middle.size, options.radius_max_px)
    else:
        # R_mm = R_px s²/h, with 1/h = |displacement| in px per mm
        to_mm = mm_per_px**2 * np.abs(displacement)
        to_centre, radius, bow = circles(along_above, middle, delta)
        # columns are Y and Z: a convex arc has its centre below
        convexity = -to_centre[:, 1]
        low, high = options.radius_min_mm, options.radius_max_mm
        radius_min = options.radius_min_px * to_mm if low is None else np.full(middle.size, low)
        radius_max = options.radius_max_px * to_mm if high is None else np.full(middle.size, high)
    # a straight line has no centre, on neither side
    concave = np.isfinite(radius) & (convexity < 0.0)
    middle_px = x_row[middle]
    return _Arcs(
        stripe=stripe,
        middle_px=middle_px,
        centre_px=middle_px + to_centre_px,
        radius=radius,
        bow=bow,
        concave=concave,
        flagged=concave & (radius > radius_min) & (radius < radius_max),
        radius_min=radius_min,
        radius_max=radius_max,
    )


def _mm_per_px(product: Product, curves: BodyCurves) -> float:
    """Scale along the stripes: the s of the class's derivation, one for the product; NaN without any step.

    The median of some hundred steps from a point to the next, spread over all.
    """
    profiles, points = product.profiles, curves.slice.size
    same_curve = np.ones(points, np.bool_)
    # steps within a curve only: from one curve to the next is a gap or another stripe
    same_curve[curves.first] = False
    here = np.arange(points)[:: max(points // _STEPS, 1)]
    here = here[same_curve[here]]
    # all of the evenly spread ones began a curve
    if not here.size:
        here = np.flatnonzero(same_curve)
    this, before = ((curves.slice[at], curves.point[at]) for at in (here, here - 1))
    step_mm = profiles.xyz_mm[*this, 1] - profiles.xyz_mm[*before, 1]
    steps = np.abs(step_mm / (profiles.row_px[this] - profiles.row_px[before]))
    if not steps.size:
        return math.nan
    # numpy's own median takes longer than all of the above
    in_order = np.sort(steps)
    return 0.5 * float(in_order[(steps.size - 1) // 2] + in_order[steps.size // 2])


def _rescaled(options: ArcCurvatureOptions, mm_per_px: float) -> ArcCurvatureOptions:
    """Convert lengths in pixels, and numbers of rows, from the scale they were chosen at to the rig's."""
    if options.tuned_at_mm_per_px is None or math.isnan(mm_per_px):
        return options
    # more pixels on a finer rig show the same length
    finer = options.tuned_at_mm_per_px / mm_per_px
    # odd, and at least three rows, which a local quadratic needs
    half = max(round(0.5 * (finer * options.smoothing_rows - 1.0)), 1)
    return options.model_copy(
        update={
            "delta_samples": max(round(finer * options.delta_samples), 1),
            "radius_min_px": finer * options.radius_min_px,
            "radius_max_px": finer * options.radius_max_px,
            "smoothing_rows": 2 * half + 1 if options.smoothing_rows else 0,
        }
    )


def _unknown(curves: BodyCurves, delta: int) -> Grade:
    longest = int(curves.size.max(initial=0))
    return Grade(
        label=UNKNOWN,
        features={"arcs": 0.0, "arcs_straight": 0.0, "arcs_concave": 0.0, "arcs_flagged": 0.0},
        reasons=(
            Reason(
                "too-few-points",
                f"no stripe has {2 * delta + 1} points in a row on the product, which one arc needs; "
                f"the longest has {longest}",
            ),
        ),
    )


def _reason(arcs: _Arcs, options: ArcCurvatureOptions) -> Reason:
    count, concave, flagged = arcs.flagged.size, int(arcs.concave.sum()), int(arcs.flagged.sum())
    unit = options.space
    if not concave:
        return Reason("no-concave-arc", f"none of {count} arcs is concave")
    # named is the sharpest of the flagged ones; without any, the sharpest of the concave ones
    sharpest = int(np.argmin(np.where(arcs.flagged if flagged else arcs.concave, arcs.radius, np.inf)))
    limits = f"between {arcs.radius_min[sharpest]:.4g} and {arcs.radius_max[sharpest]:.4g} {unit}"
    x_px, row_px = arcs.middle_px[sharpest]
    where = (
        f"the sharpest of them, of radius {arcs.radius[sharpest]:.4g} {unit} (a bow of "
        f"{arcs.bow[sharpest]:.2g} {unit}), is on stripe {arcs.stripe[sharpest] + 1} "
        f"at x {x_px:.0f} px, row {row_px:.0f}"
    )
    if flagged >= options.henkei_arcs_min:
        return Reason(
            "concave-arcs",
            f"{flagged} of {count} arcs {_are(flagged)} concave with a radius {limits}; {where}",
        )
    if flagged:
        return Reason(
            "few-concave-arcs",
            f"{flagged} of {count} arcs {_are(flagged)} concave with a radius {limits}, fewer than the "
            f"{options.henkei_arcs_min} that make henkei; {where}",
        )
    return Reason(
        "no-sharp-concave-arc",
        f"{concave} of {count} arcs {_are(concave)} concave, none with a radius {limits}; {where}",
    )


def _are(count: int) -> str:
    return "is" if count == 1 else "are"


def _arrows(arcs: _Arcs, unit: str) -> ImageArrows:
    # a centre at infinity cannot be drawn
    known = np.isfinite(arcs.radius) & np.isfinite(arcs.centre_px).all(axis=1)
    drawn = slice(None) if known.all() else known
    return ImageArrows(
        kind="centre of arc",
        unit=unit,
        stripe=arcs.stripe[drawn],
        from_px=arcs.middle_px[drawn],
        to_px=arcs.centre_px[drawn],
        # the sign tells the side: concave radii are negative
        value=np.where(arcs.concave, -arcs.radius, arcs.radius)[drawn],
        flagged=arcs.flagged[drawn],
    )


@kernel
def arc_middles(first: Integers, size: Integers, delta: int) -> Integers:
    """Index of the middle point of each three that are `delta` samples apart, from each curve's first on.

    N points give floor((N − 1) / delta) − 1 of them.
    """
    middle = np.empty(size.sum() // delta, np.int64)
    n = 0
    for c in range(first.size):
        for m in range(first[c] + delta, first[c] + size[c] - delta, delta):
            middle[n] = m
            n += 1
    return middle[:n].copy()


@kernel
def pairs_in_line(one: Floats, other: Floats, slice_of: Integers, point_of: Integers) -> Floats:
    """Collect two (slice, point) quantities of points in line: (n, 2)."""
    pairs = np.empty((slice_of.size, 2))
    for k in range(slice_of.size):
        pairs[k, 0], pairs[k, 1] = one[slice_of[k], point_of[k]], other[slice_of[k], point_of[k]]
    return pairs


_STRAIGHT = 1e-9  # sine of the bend below which three points lie on one line as far as float64 can tell


@kernel
def circles(xy: Floats, middle: Integers, delta: int) -> tuple[Floats, Floats, Floats]:
    """Circles through points `delta` before, at and `delta` after each middle one, of (point, 2) places.

    Returns
    -------
    to_centre
        (middle, 2) vector from the middle point to the circle's centre; infinite where the three lie on one
        line.
    radius
        (middle,) its length.
    bow
        (middle,) distance of the middle point from the chord.
    """
    count = middle.size
    to_centre, radius, bow = np.full((count, 2), np.inf), np.empty(count), np.empty(count)
    for k in range(count):
        m = middle[k]
        # from the middle point, so that large coordinates do not cancel
        ax, ay = xy[m - delta, 0] - xy[m, 0], xy[m - delta, 1] - xy[m, 1]
        bx, by = xy[m + delta, 0] - xy[m, 0], xy[m + delta, 1] - xy[m, 1]
        aa, bb = ax * ax + ay * ay, bx * bx + by * by
        # twice the area of the triangle; 0 where the three lie on one line
        cross = ax * by - ay * bx
        if abs(cross) > _STRAIGHT * math.sqrt(aa * bb):
            # centre of the circle through 0, a and b: equally far from all three
            to_centre[k, 0] = (by * aa - ay * bb) / (2.0 * cross)
            to_centre[k, 1] = (ax * bb - bx * aa) / (2.0 * cross)
        radius[k] = math.hypot(to_centre[k, 0], to_centre[k, 1])
        chord = math.hypot(bx - ax, by - ay)
        # height of the triangle over the side between the outer points
        bow[k] = abs(cross) / chord if chord > 0.0 else math.nan
    return to_centre, radius, bow
