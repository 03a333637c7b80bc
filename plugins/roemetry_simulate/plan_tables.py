"""The plan's tables: a row a stripe, a row a product length, a row a number of stripes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import PlanColumn, PlanCurves, PlanTable
from roemetry_simulate.plan_geometry import meeting_height_mm, plane_points, scale_at, steepest_slopes_deg
from roemetry_simulate.plan_slices import ellipsoid, skein, slice_error_pct
from roemetry_simulate.plan_uncertainty import PeakStd, defocus_px, peak_std, stripes_at
from roemetry_simulate.plan_volume import Space

Floats = NDArray[np.float64]

NUMBERS = np.arange(3, 42, 2)
_LENGTH_SHARES = (0.4, 0.6, 0.8, 1.0, 1.2)
_FWHM = 2.3548200450309493


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
            PlanColumn("spacing-height", "height of one spacing", "mm", space.spacing_heights_mm, 2),
            PlanColumn("highest-in-view", "in view up to", "mm", space.in_view_mm, 1),
        ),
        "At the plan's Y. Height of one spacing: where the stripe appears at its neighbour's place on the "
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
    points = plane_points(space.rig.laser, space.y_mm, np.zeros(1))[0]
    slopes = steepest_slopes_deg(space.rig.camera, space.rig.laser, points)
    sides = (("+x", "rising to +X"), ("-x", "rising to −X"), ("+y", "rising to +Y"), ("-y", "rising to −Y"))
    return PlanTable(
        "slopes",
        "Steepest slope that is lit and seen",
        (
            _numbers(len(points)),
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
    covered = np.where(number < count + 0.5, number, np.nan)
    return PlanTable(
        "products",
        "Products across the stripes",
        (
            PlanColumn("length", "length across the stripes", "mm", lengths, 1),
            PlanColumn("at-least", "stripes, at least", "1", np.minimum(np.floor(number + 1e-9), count), 0),
            PlanColumn("at-most", "stripes, at most", "1", np.minimum(np.ceil(number - 1e-9), count), 0),
            PlanColumn("ellipsoid", "volume error, ellipsoid", "% RMS", _errors(ellipsoid, covered), 2),
            PlanColumn("skein", "volume error, skein", "% RMS", _errors(skein, covered), 2),
        ),
        f"Stripes {spacing:.2f} mm apart on the mean; a length over the spacing, rounded down and up. The "
        "errors are those of the sum of exact slices, RMS over the product's place; a product longer than "
        f"the fan ({spacing * count:.1f} mm) has ends that no stripe meets: what they hold is missing.",
    )


def numbers(space: Space) -> tuple[PlanTable, PlanCurves, PlanCurves]:
    """Return what more stripes over the same length would gain and cost."""
    rig = space.rig
    length = mean_spacing_mm(space) * rig.laser.count
    spacing = length / NUMBERS
    middle = np.full(NUMBERS.size, float(rig.laser.x_mm(space.y_mm, 0.0).mean()))
    either = [
        meeting_height_mm(rig.camera, rig.laser, middle, middle + way * spacing, space.y_mm)
        for way in (1.0, -1.0)
    ]
    height = np.fmin(*either)
    over = PlanColumn("number", "stripes over the length", "1", NUMBERS.astype(np.float64), 0)
    gap = PlanColumn("spacing", "spacing", "mm", spacing, 2)
    price = PlanColumn("spacing-height", "height of one spacing", "mm", height, 2)
    first = PlanColumn("ellipsoid", "ellipsoid", "% RMS", _errors(ellipsoid, NUMBERS), 3)
    second = PlanColumn("skein", "skein", "% RMS", _errors(skein, NUMBERS), 3)
    basis = (
        f"A body as long as the fan ({length:.1f} mm) under N stripes, its place even over one spacing, "
        "slices exact: the error of sampling alone, RMS. A length of just N spacings is the worst case: both "
        "ends err alike. Ellipsoid: 1 / (√5 N²). Skein: blunt ends, a thick "
        "end, a rim."
    )
    costs = (
        "The height at which a stripe in the middle of the fan appears at its neighbour's place on the belt: "
        "higher products need a coder that looks at more than one row's order."
    )
    table = PlanTable(
        "numbers", "More or fewer stripes", (over, gap, first, second, price), f"{basis} {costs}"
    )
    count = float(rig.laser.count)
    return (
        table,
        PlanCurves(
            "volume-error", "Volume error of the sum of slices", over, (first, second), basis, count, True
        ),
        PlanCurves("price", "Height of one spacing", over, (price,), costs, count),
    )


def over_x(space: Space) -> PlanCurves:
    """Return the height of one spacing over X."""
    rig, spacing = space.rig, mean_spacing_mm(space)
    feet = rig.laser.x_mm(space.y_mm, 0.0)
    x = np.linspace(float(feet.min()), float(feet.max()), 41)
    ways = [meeting_height_mm(rig.camera, rig.laser, x, x + way * spacing, space.y_mm) for way in (1.0, -1.0)]
    return PlanCurves(
        "spacing-height",
        "Height of one spacing over X",
        PlanColumn("x", "X on the belt", "mm", x),
        (PlanColumn("height", "height", "mm", np.fmin(*ways), 2),),
        f"For stripes {spacing:.2f} mm apart everywhere; the table has each stripe's own.",
    )


def focus_over_height(space: Space) -> PlanCurves | None:
    """Return the lens's blur over height; None where the scene gives no aperture."""
    if space.rig.focus is None:
        return None
    z = np.linspace(0.0, space.top_mm, 41)
    middle = plane_points(space.rig.laser, space.y_mm, z)[:, space.rig.laser.count // 2]
    return PlanCurves(
        "defocus",
        "Blur of the lens over height",
        PlanColumn("z", "height", "mm", z),
        (PlanColumn("sigma", "standard deviation", "px", defocus_px(space.rig, middle), 3),),
        "A quarter of the thin lens's circle of confusion, at the middle stripe.",
    )


def mean_spacing_mm(space: Space) -> float:
    """Return the mean distance of neighbouring stripes on the belt; NaN for one plane."""
    feet = space.rig.laser.x_mm(space.y_mm, 0.0)
    return float(np.diff(feet).mean()) if feet.size > 1 else np.nan


def _numbers(count: int) -> PlanColumn:
    return PlanColumn("stripe", "stripe", "1", np.arange(count, dtype=np.float64), 0)


def _errors(area: Callable[[Floats], Floats], stripes: NDArray[Any]) -> Floats:
    return np.array([slice_error_pct(area, float(n)) if np.isfinite(n) else np.nan for n in stripes])
