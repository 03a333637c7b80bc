"""Whether a rig measures the scene's product, how well, what limits it, and what to change.

The expected standard uncertainty of the volume is the root of the sum of three squares:

- sampling: spacing × sum of slice areas against the whole, RMS over where the product lies, of the scene's
  own products as they are drawn, times what an estimator was measured to make of it;
- noise: that of single rows by a centre of gravity at half the product's height, over all rows and stripes;
- calibration: an error that all heights share, of a place in the image that boards leave.

The weight adds the underside, which no camera above sees. Changes are found by working the same out for other
numbers of stripes, each with the projector as far aside as leaves the product below one spacing's height.
Assumed: level light, an albedo as the scene's, no contact between products.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import RoemetryError
from roemetry.records import PlanAnswer
from roemetry_simulate.optics import view_mm
from roemetry_simulate.plan_model import peak_std, plane_points, scale_at, stripes_at
from roemetry_simulate.plan_tables import Bodies, Space, mean_spacing_mm
from roemetry_simulate.population import draw_item
from roemetry_simulate.render import Rig
from roemetry_simulate.scene import RayCasterOptions
from roemetry_simulate.solid import Solid

Floats = NDArray[np.float64]

_DRAWN = 4
"""Products that are drawn: enough to know the highest of a population to a tenth."""
_SLICES, _OUTLINE = 2.0, 0.4
"""Error of a volume over that of exact slices' sampling, from slices alone and with an outline: skeins, whose
sampling errs by 0.8 %, came out 1.2 to 1.9 and 0.2 to 0.4 % off (docs/measurements/outside.md)."""
_CALIBRATION_PX = 0.03
"""Error in the image that a calibration by boards leaves common to all heights: 5 to 13 µm on rigs with 0.2
to 0.5 mm of height for a pixel."""
_UNDERSIDE_PCT = 100.0 * 0.2 / math.sqrt(12.0) / 0.9
"""Of the weight before it is fitted: true over visible volume lies anywhere between 0.8 (a ball) and 1."""
_SPACINGS = 2.5
"""Heights beyond so many spacings' displacement are told apart by no coder."""
_SHARE = 0.85
"""Of one spacing's height that a proposed rig uses for the highest product."""
_SMALL_DEG, _STEEP = 12.0, 0.5
"""Triangulation angle below which the plan says so; tangent up to which a projector is proposed."""
_SPACING_LEAST_PX = 14.0
"""About three widths of a stripe in focus: nearer ones are not told apart."""
_WORTH = 0.75
"""A change that leaves more than this of the uncertainty is not proposed."""


def bodies_of(scene: RayCasterOptions, rig: Rig) -> Bodies | None:
    """Draw a few of the scene's products; None where there is none, or none that fits into the view."""
    try:
        drawn = [one.solid for k in range(_DRAWN) for one in draw_item(scene.product, rig, k, 0).products]
    except RoemetryError:
        return None
    if not drawn:
        return None
    sizes, areas = zip(*(_sections(solid) for solid in drawn), strict=True)
    lengths, widths, heights, means = np.array(sizes).T
    return Bodies(lengths.max(), widths.max(), heights.max(), means.mean(), lengths, np.array(areas))


def _sections(solid: Solid, count: int = 200) -> tuple[tuple[float, float, float, float], Floats]:
    """Length, width, height and mean height, mm, and section areas at places along X, mm²."""
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    x = x_min + (np.arange(count) + 0.5) / count * (x_max - x_min)
    y = y_min + (np.arange(count) + 0.5) / count * (y_max - y_min)
    heights = np.nan_to_num(solid.heights_mm(*np.meshgrid(x, y))[0])
    areas = heights.mean(axis=0) * (y_max - y_min)
    mean = float(heights[heights > 0.0].mean())
    return (x_max - x_min, y_max - y_min, float(heights.max()), mean), areas


def answer_of(
    scene: RayCasterOptions, space: Space, bodies: Bodies, space_of: Callable[[RayCasterOptions], Space]
) -> PlanAnswer:
    """Say whether the rig measures the products, how well, what limits it, and what would be better."""
    faults = list(_faults(space, bodies))
    has_outline = "plain" in scene.light.images
    causes = _causes(space, bodies, has_outline)
    total = math.hypot(*causes.values())
    weight = math.hypot(total, _UNDERSIDE_PCT)
    limiting = faults[0] if faults else max(causes, key=causes.__getitem__)
    rigs = _other_rigs(scene, space, bodies, space_of)
    now = angle_deg(space)
    good = min((one for one in rigs if one.angle_deg >= min(now - 0.5, _SMALL_DEG)), default=None)
    changes = []
    if good is not None and (faults or good.volume_pct < _WORTH * total):
        changes.append(good.said(now))
    with_one = math.hypot(*_causes(space, bodies, True).values())
    if not (faults or with_one > _WORTH * total):
        changes.append(f"a second image in plain light, for an outline: volume ± {with_one:.1f} %")
    steeper = [one for one in rigs if one.stripes < space.rig.laser.count and one.angle_deg > now + 2.0]
    if now < _SMALL_DEG and steeper:
        changes.append(f"for finer heights {max(steeper, key=lambda one: one.stripes).said(now)}")
    changes.append("weigh twenty products and fit the weight, which takes the underside out")
    return PlanAnswer(not faults, total, weight, limiting, tuple(changes))


def _faults(space: Space, bodies: Bodies) -> Iterator[str]:
    """Say why the rig cannot measure the products."""
    spacing, count = mean_spacing_mm(space), space.rig.laser.count
    high = bodies.height_mm
    if bodies.length_mm / spacing < 3.0:
        yield f"fewer than three stripes on a product {bodies.length_mm:.0f} mm long"
    if bodies.length_mm > spacing * (count + 1.0):
        yield f"the stripes span {spacing * (count - 1.0):.0f} mm, the product {bodies.length_mm:.0f} mm"
    x_low, x_high, y_low, y_high = view_mm(space.rig.camera, high)
    if bodies.length_mm > x_high - x_low or bodies.width_mm > y_high - y_low:
        yield f"{high:.0f} mm above the belt the camera sees {x_high - x_low:.0f} × {y_high - y_low:.0f} mm"
    feet = space.feet_mm[:, 0]
    under = np.abs(feet - feet.mean()) < 0.5 * bodies.length_mm
    if (space.in_view_mm[under] < high).any():
        yield f"stripes on a product {high:.0f} mm high leave the image above {space.highest_mm:.0f} mm"
    if high > _SPACINGS * space.spacing_height_mm:
        yield (
            f"a product {high:.0f} mm high displaces a stripe by more than {_SPACINGS:g} spacings "
            f"({space.spacing_height_mm:.1f} mm of height each)"
        )


def _causes(space: Space, bodies: Bodies, has_outline: bool) -> dict[str, float]:
    """Standard uncertainties of the volume by cause, %; in words that end `limited by`."""
    rig, spacing = space.rig, mean_spacing_mm(space)
    middle = plane_points(rig.laser, space.y_mm, np.array([0.5 * bodies.height_mm]))[0]
    index = rig.laser.count // 2
    scale = scale_at(rig.camera, rig.laser, middle[[index]])
    per_px = float(1.0 / np.abs(scale.height_px_per_mm[0]))
    stripe = stripes_at(rig, middle[[index]], space.albedo, rig.laser.peak_grey[[index]])[0]
    rows = bodies.width_mm / float(scale.y_mm_per_px[0]) * bodies.length_mm / spacing
    noise = peak_std(stripe, rig.sensor).centre_of_gravity_px / math.sqrt(max(rows, 1.0))
    sampling = bodies.sampling_pct(spacing) * (_OUTLINE if has_outline else _SLICES)
    return {
        f"only {bodies.length_mm / spacing:.0f} stripes on a product": sampling,
        "noise of the stripes": 100.0 * noise * per_px / bodies.mean_height_mm,
        f"{per_px:.2f} mm of height for a pixel": 100.0 * _CALIBRATION_PX * per_px / bodies.mean_height_mm,
    }


class _Proposal(NamedTuple):
    """Another rig: what volume to expect, and its light."""

    volume_pct: float
    angle_deg: float
    stripes: int
    spacing_mm: float
    beside_mm: float

    def said(self, now_deg: float) -> str:
        """Put it into words, beside the angle that there is now."""
        angle = self.angle_deg
        turned = f" (triangulation {angle:.0f}°, now {now_deg:.0f}°)" if abs(angle - now_deg) >= 1.0 else ""
        return (
            f"{self.stripes} stripes {self.spacing_mm:.1f} mm apart, projector {self.beside_mm:.0f} mm "
            f"beside the camera{turned}: volume ± {self.volume_pct:.1f} %"
        )


def _other_rigs(
    scene: RayCasterOptions, space: Space, bodies: Bodies, space_of: Callable[[RayCasterOptions], Space]
) -> list[_Proposal]:
    """Try other numbers of stripes, with the projector where the product stays below one spacing's height."""
    laser, camera = scene.laser, space.rig.camera
    across = max(mean_spacing_mm(space) * (space.rig.laser.count - 1), 1.1 * bodies.length_mm)
    distance = float(camera.centre_mm[2])
    middle = space.feet_mm[[space.rig.laser.count // 2]]
    least_mm = _SPACING_LEAST_PX * float(scale_at(camera, space.rig.laser, middle).x_mm_per_px[0])
    way = math.copysign(1.0, float(space.rig.laser.projector_mm[0] - camera.centre_mm[0]))
    found = []
    for count in range(5, 30, 2):
        spacing = across / (count - 1)
        beside = min(spacing * (_SHARE * distance / bodies.height_mm - 1.0), _STEEP * distance)
        if spacing < least_mm or beside <= 0.0:
            continue
        place = (float(camera.centre_mm[0] + way * beside), laser.projector_mm[1], laser.projector_mm[2])
        fan = {"planes": count, "spacing_mm": spacing, "projector_mm": place}
        changed = laser.model_copy(update={**fan, "belt_x_mm": None, "power": None})
        try:
            other = space_of(scene.model_copy(update={"laser": changed}))
            if next(_faults(other, bodies), None) is not None:
                continue
        except RoemetryError:
            continue
        pct = math.hypot(*_causes(other, bodies, "plain" in scene.light.images).values())
        found.append(_Proposal(pct, angle_deg(other), count, spacing, beside))
    return found


def angle_deg(space: Space) -> float:
    """Angle between the directions to camera and projector from the middle stripe on the belt, degrees."""
    foot = space.feet_mm[space.rig.laser.count // 2]
    ways: Sequence[Floats] = (space.rig.camera.centre_mm - foot, space.rig.laser.projector_mm - foot)
    cosine = float(ways[0] @ ways[1] / np.linalg.norm(ways[0]) / np.linalg.norm(ways[1]))
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
