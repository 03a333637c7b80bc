"""The space a plan is made over, its maps over X and Z, and its tables of stripes, products, numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from roemetry.records import PlanColumn, PlanCurves, PlanMap, PlanTable
from roemetry_simulate.optics import view_mm
from roemetry_simulate.plan_model import (
    PeakStd,
    defocus_px,
    highest_in_view_mm,
    in_view,
    meeting_height_mm,
    middle_y_mm,
    peak_std,
    plane_points,
    scale_at,
    spacing_heights_mm,
    steepest_slopes_deg,
    stripes_at,
)
from roemetry_simulate.render import Rig

Floats = NDArray[np.float64]

_COLUMNS, _ROWS = 57, 17
"""Cells of a map over X and Z."""
_SPACINGS = 2.5
"""Without a product, heights are planned up to so many spacings' displacement: no coder tells stripes apart
much beyond."""
_TO_BORDER = 0.9
"""How far towards the image's upper and lower border the maps look; beyond, a stripe's window is cut."""


@dataclass(frozen=True, eq=False)
class Space:
    """A rig, and over which Y and heights it is planned.

    - `rig`: The rig.
    - `albedo`: Of the product, in the laser's light.
    - `speckle_limit_px`: Below which speckle lets no stripe's place be known; NaN where the scene gives no
      aperture.
    - `product_mm`: Height of the scene's highest product; NaN where there is none.
    """

    rig: Rig
    albedo: float
    speckle_limit_px: float = math.nan
    product_mm: float = math.nan

    @cached_property
    def y_mm(self) -> float:
        """Belt Y of the plan: where the image's middle sees the belt."""
        return middle_y_mm(self.rig.camera)

    @cached_property
    def in_view_mm(self) -> Floats:
        """Height up to which each stripe stays in the image, shape (N,); NaN for one that never is."""
        return highest_in_view_mm(self.rig.camera, self.rig.laser, self.y_mm)

    @cached_property
    def spacing_heights_mm(self) -> Floats:
        """Unambiguous height of each stripe, mm, shape (N,)."""
        return spacing_heights_mm(self.rig.camera, self.rig.laser, self.y_mm)

    @property
    def highest_mm(self) -> float:
        """Height up to which every stripe that is seen on the belt stays in the image."""
        return float(np.nanmin(self.in_view_mm))

    @property
    def spacing_height_mm(self) -> float:
        """Height below which no stripe can be taken for its neighbour; NaN for one plane."""
        known = self.spacing_heights_mm[np.isfinite(self.spacing_heights_mm)]
        return float(known.min()) if known.size else np.nan

    @cached_property
    def top_mm(self) -> float:
        """Height up to which the plan is made: the highest product's, or 2½ unambiguous heights; in view."""
        wanted = _SPACINGS * self.spacing_height_mm if math.isnan(self.product_mm) else self.product_mm
        # nobody needs a plan beyond the highest product, nor beyond what is seen
        return float(np.fmin(np.nanmax(self.in_view_mm), wanted))

    @cached_property
    def belt_points_mm(self) -> Floats:
        """Where the stripes lie on the belt, shape (N, 3)."""
        return plane_points(self.rig.laser, self.y_mm, np.zeros(1))[0]

    def best_px(self, std: PeakStd) -> float:
        """Return the least standard uncertainty of a stripe's place: the bound, or the speckle limit."""
        return float(np.fmax(std.bound_px, self.speckle_limit_px))

    @cached_property
    def ys_mm(self) -> tuple[float, float, float]:
        """Belt Y of the maps: the plan's own, and nine tenths of the way to the upper and lower border."""
        _, _, low, high = view_mm(self.rig.camera)
        y = self.y_mm
        return y + _TO_BORDER * (low - y), y, y + _TO_BORDER * (high - y)

    def _over_x_and_z(self, x: Floats, z: Floats, y_mm: float) -> Floats:
        """Height per pixel (mm), bound and centre of gravity (µm), shape (3, z, x); NaN out of view."""
        rig = self.rig
        points = np.stack(np.broadcast_arrays(x[None, :], y_mm, z[:, None]), axis=-1)
        seen = in_view(rig.camera, points)
        scale = scale_at(rig.camera, rig.laser, points)
        found = np.full((3, *seen.shape), np.nan)
        found[0] = np.where(seen, 1.0 / np.abs(scale.height_px_per_mm), np.nan)
        # dead planes do not lower the mean
        lit = rig.laser.peak_grey[rig.laser.peak_grey > 0.0]
        peak = np.full(int(seen.sum()), float(lit.mean()))
        stds = [peak_std(s, rig.sensor) for s in stripes_at(rig, points[seen], self.albedo, peak)]
        found[1][seen] = [1e3 * self.best_px(one) for one in stds]
        found[2][seen] = [1e3 * one.centre_of_gravity_px for one in stds]
        found[1:] *= found[0]
        return found

    def maps(self) -> tuple[PlanMap, ...]:
        """Return millimetres of height per pixel and standard uncertainties of a height over X and Z."""
        rig = self.rig
        views = [view_mm(rig.camera, z) for z in (0.0, self.top_mm)]
        x = np.linspace(min(v[0] for v in views), max(v[1] for v in views), _COLUMNS)
        z = np.linspace(0.0, self.top_mm, _ROWS)
        # the worst of three places along Y; NaN only where none sees it
        per_px, bound, gravity = np.fmax.reduce([self._over_x_and_z(x, z, y) for y in self.ys_mm])
        ys = ", ".join(f"{y:.1f}" for y in self.ys_mm)
        worst = f"The worst of Y = {ys} mm, where the place is in view."
        flat = (
            "On a level, matt surface of the product's albedo; for a plane of mean power through each place. "
            f"{worst}"
        )
        inverse = (
            "Inverse of the displacement of a stripe along its row for a height: central differences of the "
            f"camera's full model within the light plane. {worst}"
        )
        best = (
            "Cramér-Rao bound of the stripe's place in one row (shot noise, read noise, rounding, speckle), "
            "at least the speckle limit of the lens where the aperture is known, times height per pixel. "
            f"{flat}"
        )
        centre = (
            "The same noise through a centre of gravity over ± 3 standard deviations of the stripe, in whole "
            f"pixels: hence the steps. {flat}"
        )
        std = "Standard uncertainty"
        title = "Height for one pixel of displacement"
        return (
            PlanMap("height-per-px", title, "mm/px", x, z, per_px, inverse, 3),
            PlanMap("height-std-bound", f"{std}, best possible", "µm", x, z, bound, best, 0),
            PlanMap("height-std-gravity", f"{std}, centre of gravity", "µm", x, z, gravity, centre, 0),
        )


NUMBERS = np.arange(3, 42, 2)
"""Numbers of stripes that are compared."""
_LENGTH_SHARES = (0.4, 0.6, 0.8, 1.0, 1.2)
"""Lengths of products over that of the fan."""
_FWHM = 2.3548200450309493
"""Width at half height over the standard deviation of a Gaussian, 2 √(2 ln 2)."""


_PHASES = 64
"""Places under the stripes over which the sampling's RMS is taken, even over one spacing."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """The scene's products: highest and longest of a few, and their section areas along X.

    `areas` are (n, m) mm² at `step_mm` along each product's own length, the same number of places for each.
    """

    length_mm: float
    width_mm: float
    height_mm: float
    mean_height_mm: float
    lengths_mm: Floats
    areas_mm2: Floats

    def sampling_pct(self, spacing_mm: float) -> float:
        """RMS error of spacing × sum of slice areas, % of the volume, over products and places."""
        found = []
        share = (np.arange(_PHASES) + 0.5) / _PHASES
        # places under the stripes, evenly over one spacing: where a product lies is chance
        for length, areas in zip(self.lengths_mm, self.areas_mm2, strict=True):
            along = (np.arange(areas.size) + 0.5) / areas.size * length
            # stripes before, on and behind the product, for every place
            at = spacing_mm * (np.arange(math.ceil(length / spacing_mm) + 1)[:, None] - 1 + share)
            sums = np.interp(at, along, areas, left=0.0, right=0.0).sum(axis=0) * spacing_mm
            # relative to the exact volume
            found.append(sums / (areas.mean() * length) - 1.0)
        return 100.0 * float(np.sqrt(np.mean(np.square(found))))


def ellipsoid(length_mm: float) -> Bodies:
    """Return an ellipsoid, whose section area is a parabola along it: it errs by 1 / (√5 N²) for whole N."""
    t = (np.arange(2000) + 0.5) / 1000.0 - 1.0
    areas = np.asarray(1.0 - t[None] ** 2, np.float64)
    return Bodies(length_mm, math.nan, math.nan, math.nan, np.array([length_mm]), areas)


def tables_and_curves(space: Space, bodies: Bodies | None) -> tuple[list[PlanTable], list[PlanCurves]]:
    """Return all of a plan's, but the simulated ones."""
    tables, curves = [stripe_geometry(space), stripe_light(space), stripe_slopes(space)], []
    if space.rig.laser.count > 1:
        more, error, price = numbers(space, bodies)
        tables += [products(space), more]
        curves += [error, price, over_x(space)]
    return tables, curves + focus_over_height(space)


def stripe_geometry(space: Space) -> PlanTable:
    """Return where each stripe is, what a height does to it, and how far it can be followed."""
    rig = space.rig
    points = plane_points(rig.laser, space.y_mm, np.array([0.0, space.top_mm]))
    scale = scale_at(rig.camera, rig.laser, points)
    per_px = 1.0 / np.abs(scale.height_px_per_mm)
    pixels = rig.camera.project(points[0])
    return PlanTable(
        "stripes",
        "The stripes",
        (
            _numbers(rig.laser.count),
            PlanColumn("x", "X on the belt", "mm", points[0, :, 0], 2),
            PlanColumn("x-px", "in the image", "px", pixels[:, 0], 1),
            PlanColumn("height-per-px-belt", "height per px, belt", "mm", per_px[0], 3),
            PlanColumn("height-per-px-top", "height per px, top", "mm", per_px[1], 3),
            PlanColumn("spacing-height", "unambiguous height range", "mm", space.spacing_heights_mm, 2),
            PlanColumn("highest-in-view", "in view up to", "mm", space.in_view_mm, 1),
        ),
        "At the plan's Y. Unambiguous height range: where the stripe appears at its neighbour's place on the "
        "belt; the last stripe on that side has no neighbour.",
    )


def stripe_light(space: Space) -> PlanTable:
    """Return how wide and bright each stripe is at belt, middle and top, and what that makes of a height."""
    rig = space.rig
    heights = np.array([0.0, 0.5 * space.top_mm, space.top_mm])
    points = plane_points(rig.laser, space.y_mm, heights)
    per_px = 1.0 / np.abs(scale_at(rig.camera, rig.laser, points).height_px_per_mm)
    columns = [_numbers(rig.laser.count)]
    words = ("belt", "middle", "top")
    stripes = [stripes_at(rig, level, space.albedo, rig.laser.peak_grey) for level in points]
    stds: list[list[PeakStd]] = [[peak_std(s, rig.sensor) for s in level] for level in stripes]
    for word, level in zip(words, stripes, strict=True):
        wide = np.array([_FWHM * s.width_px(rig.sensor) for s in level])
        columns.append(PlanColumn(f"fwhm-{word}", f"width (FWHM), {word}", "px", wide, 2))
    columns.append(
        PlanColumn("peak-grey", "grey level, middle", "1", np.array([one.peak_grey for one in stds[1]]), 0)
    )
    for name, title in (("bound", "best"), ("gravity", "c. of g.")):
        for k, word in enumerate(words):
            px = [space.best_px(one) if name == "bound" else one.centre_of_gravity_px for one in stds[k]]
            std_um = 1e3 * np.array(px) * per_px[k]
            columns.append(PlanColumn(f"{name}-{word}", f"{title}, {word}", "µm", std_um, 0))
    return PlanTable(
        "light",
        "Width, brightness and standard uncertainty of a height",
        tuple(columns),
        f"Level, matt surface of albedo {space.albedo:g}; belt, middle and top are 0, {heights[1]:.1f} and "
        f"{heights[2]:.1f} mm. Best: Cramér-Rao bound, at least the speckle limit; c. of g.: centre of "
        "gravity; both of one image row, speckle counted.",
    )


def stripe_slopes(space: Space) -> PlanTable:
    """Return the steepest slopes that are lit and seen at each stripe's place on the belt."""
    slopes = steepest_slopes_deg(space.rig.camera, space.rig.laser, space.belt_points_mm)
    sides = (("+x", "rising to +X"), ("-x", "rising to −X"), ("+y", "rising to +Y"), ("-y", "rising to −Y"))
    return PlanTable(
        "slopes",
        "Steepest slope that is lit and seen",
        (
            _numbers(len(slopes)),
            *(PlanColumn(n, title, "degrees", slopes[:, k], 1) for k, (n, title) in enumerate(sides)),
        ),
        "A slope faces a place while tan α < height over it / distance from it in the direction of the rise; "
        "both projector and camera must be faced. 90: a wall is lit and seen. At belt height; of the slope "
        "alone, without shadows of what stands beside it.",
    )


def products(space: Space) -> PlanTable:
    """Return how many stripes cross products of several lengths, and what the sum of their slices misses."""
    spacing = mean_spacing_mm(space)
    lengths = np.array(_LENGTH_SHARES) * spacing * space.rig.laser.count
    count = space.rig.laser.count
    number = lengths / spacing
    body = ellipsoid(1.0)
    # longer products than the fan have ends without stripes: their error is no sampling error
    errors = np.array([body.sampling_pct(1.0 / n) if n < count + 0.5 else np.nan for n in number])
    return PlanTable(
        "products",
        "Products across the stripes",
        (
            PlanColumn("length", "length across the stripes", "mm", lengths, 1),
            # a length of whole spacings meets that many stripes, whatever rounding says
            PlanColumn("at-least", "stripes, at least", "1", np.minimum(np.floor(number + 1e-9), count), 0),
            PlanColumn("at-most", "stripes, at most", "1", np.minimum(np.ceil(number - 1e-9), count), 0),
            PlanColumn("ellipsoid", "volume error, ellipsoid", "% RMS", errors, 2),
        ),
        f"Stripes {spacing:.2f} mm apart on the mean; a length over the spacing, rounded down and up. The "
        "errors are those of the sum of exact slices, RMS over the product's place; a product longer than "
        f"the fan ({spacing * count:.1f} mm) has ends that no stripe meets: what they hold is missing.",
    )


def numbers(space: Space, bodies: Bodies | None) -> tuple[PlanTable, PlanCurves, PlanCurves]:
    """Return what more stripes over the same length would gain and cost."""
    rig = space.rig
    length = mean_spacing_mm(space) * rig.laser.count
    spacing = length / NUMBERS
    middle = np.full(NUMBERS.size, float(rig.laser.x_mm(space.y_mm, 0.0).mean()))
    # in the middle of the fan, where it is typical
    height = _neighbour_height_mm(space, middle, spacing)
    over = PlanColumn("number", "stripes over the length", "1", NUMBERS.astype(np.float64), 0)
    gap = PlanColumn("spacing", "spacing", "mm", spacing, 2)
    price = PlanColumn("spacing-height", "unambiguous height range", "mm", height, 2)
    shown = [("ellipsoid", "ellipsoid of the fan's length", ellipsoid(length))]
    shown += [] if bodies is None else [("product", "your product", bodies)]
    errors = tuple(
        PlanColumn(name, title, "% RMS", np.array([body.sampling_pct(s) for s in spacing]), 3)
        for name, title, body in shown
    )
    basis = (
        f"Under N stripes over {length:.1f} mm, the body's place even over one spacing, slices exact: the "
        "error of sampling alone, RMS. A length of just N spacings is the worst case: both ends err alike. "
        "Ellipsoid: 1 / (√5 N²)."
    )
    costs = (
        "The height at which a stripe in the middle of the fan appears at its neighbour's place on the belt: "
        "higher products need a coder that looks at more than one row's order."
    )
    table = PlanTable("numbers", "More or fewer stripes", (over, gap, *errors, price), f"{basis} {costs}")
    count = float(rig.laser.count)
    return (
        table,
        PlanCurves("volume-error", "Volume error of the sum of slices", over, errors, basis, count, True),
        PlanCurves("price", "Unambiguous height range", over, (price,), costs, count),
    )


def over_x(space: Space) -> PlanCurves:
    """Return the unambiguous height range over X."""
    spacing, lines_x = mean_spacing_mm(space), space.belt_points_mm[:, 0]
    x = np.linspace(float(lines_x.min()), float(lines_x.max()), 41)
    height = PlanColumn("height", "height", "mm", _neighbour_height_mm(space, x, spacing), 2)
    basis = f"For stripes {spacing:.2f} mm apart everywhere; the table has each stripe's own."
    over = PlanColumn("x", "X on the belt", "mm", x)
    return PlanCurves("spacing-height", "Unambiguous height range over X", over, (height,), basis)


def _neighbour_height_mm(space: Space, x_mm: Floats, spacing_mm: Floats | float) -> Floats:
    """Height at which a stripe at X appears at its nearer neighbour's place on the belt, on either side."""
    camera, fan = space.rig.camera, space.rig.laser
    # the neighbour on the side to which heights displace; the other way gives NaN
    ways = [meeting_height_mm(camera, fan, x_mm, x_mm + way * spacing_mm, space.y_mm) for way in (1.0, -1.0)]
    return np.asarray(np.fmin(*ways))


def focus_over_height(space: Space) -> list[PlanCurves]:
    """Return the lens's blur over height; nothing where the scene gives no aperture."""
    if space.rig.focus is None:
        return []
    z = np.linspace(0.0, space.top_mm, 41)
    middle = plane_points(space.rig.laser, space.y_mm, z)[:, space.rig.laser.count // 2]
    sigma = PlanColumn("sigma", "standard deviation", "px", defocus_px(space.rig, middle), 3)
    basis = "A quarter of the thin lens's circle of confusion, at the middle stripe."
    over = PlanColumn("z", "height", "mm", z)
    return [PlanCurves("defocus", "Blur of the lens over height", over, (sigma,), basis)]


def mean_spacing_mm(space: Space) -> float:
    """Return the mean distance of neighbouring stripes on the belt; NaN for one plane."""
    lines_x = space.rig.laser.x_mm(space.y_mm, 0.0)
    return float(np.diff(lines_x).mean()) if lines_x.size > 1 else np.nan


def _numbers(count: int) -> PlanColumn:
    return PlanColumn("stripe", "stripe", "1", np.arange(1.0, count + 1.0), 0)  # as reports number them
