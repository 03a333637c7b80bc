"""The planner of `moving-belt`: what its rig will give, and which line spacing and belt speed are enough.

A frame every Δ of the belt's way is a slice every Δ. The sum of slices then errs by what `sampling_pct` finds
on the scene's own products; that of an ellipsoid falls with the square of the number of slices. A camera
exposes one frame at a time, so the belt runs by at most one spacing an exposure: faster, lines are missing,
and a frame shows more than its own spacing.

The expected uncertainty is the root of the sum of squares of sampling, of what dense slices were measured to
miss of flanks that neither camera nor light sees, and of the calibration's common error of heights.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from roemetry.errors import RoemetryError
from roemetry.records import Plan, PlanAnswer, PlanColumn, PlanFigure, PlanTable
from roemetry.stages import Planner
from roemetry_simulate.moving_belt import MovingBelt, MovingBeltOptions
from roemetry_simulate.optics import view_mm
from roemetry_simulate.plan_model import plane_points, scale_at
from roemetry_simulate.plan_tables import Bodies, Space
from roemetry_simulate.planner import CALIBRATION_PX, UNDERSIDE_PCT, RigPlanner, bodies_from, space_of

_DRAWN = 6
"""Products of the scene whose sections tell what a spacing costs."""
_ENOUGH_PCT = 0.1
"""Sampling error that no longer counts beside what flanks cost."""
_FLANKS_PCT = 0.2
"""Of a volume, RMS: what is not seen of flanks (docs/measurements/scans.md)."""
_SPACINGS_MM = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)  # of lines, that are tried
_STILL_TABLES = ("products", "numbers")
_STILL_CURVES = ("volume-error", "price", "spacing-height")
"""Of the plan of a rig under which nothing moves: there the stripes' spacing is that of slices."""


class BeltPlanner(Planner[MovingBeltOptions]):
    """Plans a rig over a moving belt."""

    def plan(self, *, simulate: bool) -> Plan:
        """Plan the rig; raise StageError where heights do not show in its image."""
        still = RigPlanner(self.options).plan(simulate=simulate)
        scan = self.options.scan
        now = scan.counts_per_line * math.hypot(*scan.mm_per_count)
        exposure_s = 1e-3 * self.options.camera.exposure_ms
        figures = [
            PlanFigure("line-spacing", "Line spacing", now, "mm", "Counts from frame to frame times the "
                       "belt's way for each.", True),
            PlanFigure("belt-speed", "Fastest belt", now / exposure_s, "mm/s", "One line spacing in one "
                       "exposure: faster, lines would be missing.", True),
        ]  # fmt: skip
        bodies, answer, tables = self._bodies(), None, list(still.tables)
        if bodies is not None:
            enough = enough_mm(bodies)
            figures += [
                PlanFigure("spacing-enough", "Line spacing that is enough", enough, "mm",
                           f"The sum of slices errs by at most {_ENOUGH_PCT:g} % (RMS over products and "
                           "places): less than what is not seen of flanks costs.", True),
                PlanFigure("speed-enough", "Fastest belt with it", enough / exposure_s, "mm/s",
                           "That spacing in one exposure.", True),
            ]  # fmt: skip
            tables.insert(0, _spacings(bodies, exposure_s))
            answer = _answer(space_of(self.options), bodies, now, enough, exposure_s)
        return replace(
            still,
            figures=(*figures, *still.figures),
            tables=tuple(one for one in tables if one.name not in _STILL_TABLES),
            curves=tuple(one for one in still.curves if one.name not in _STILL_CURVES),
            answer=answer,
        )

    def _bodies(self) -> Bodies | None:
        """Draw a few products; None for an empty belt."""
        simulator = MovingBelt(self.options)
        try:
            drawn = [simulator.drawn(k, 0) for k in range(_DRAWN)]
        except RoemetryError:
            return None
        solids = [one.solid for one in drawn if one is not None]
        return bodies_from(solids) if solids else None


def enough_mm(bodies: Bodies) -> float:
    """Give the line spacing up to which sampling does not count, mm, rounded down to two digits."""
    # errors rise and fall with how many whole spacings a length has: it is the first that counts
    found = 0.01 * float(bodies.lengths_mm.min())
    # in steps of a percent from far too fine; stops at the first that errs too much
    while found < 0.5 * bodies.length_mm and bodies.sampling_pct(1.01 * found) <= _ENOUGH_PCT:
        found *= 1.01
    # rounded down, so that what is said is still enough
    digits = 1 - math.floor(math.log10(found))
    return math.floor(found * 10**digits) / 10**digits


def _spacings(bodies: Bodies, exposure_s: float) -> PlanTable:
    shortest = float(bodies.lengths_mm.min())
    spacing = np.array([one for one in _SPACINGS_MM if 3.0 * one < shortest])
    return PlanTable(
        "line-spacing",
        "Line spacing and belt speed",
        (
            PlanColumn("spacing", "line spacing", "mm", spacing, 2),
            PlanColumn("slices", "slices on the shortest product", "1", shortest / spacing, 0),
            PlanColumn("error", "volume error of the sum of slices", "% RMS",
                       np.array([bodies.sampling_pct(float(one)) for one in spacing]), 3),
            PlanColumn("speed", "fastest belt", "mm/s", spacing / exposure_s, 0),
        ),
        "The error of sampling alone, over the scene's own products and where lines meet them. The fastest "
        "belt runs one line spacing in one exposure.",
    )  # fmt: skip


def _answer(space: Space, bodies: Bodies, now_mm: float, enough: float, exposure_s: float) -> PlanAnswer:
    """Say whether the rig measures the products, how well, and which spacing and speed are enough."""
    # at half the highest product's height
    middle = plane_points(space.rig.laser, space.y_mm, np.array([0.5 * bodies.height_mm]))[0]
    scale = scale_at(space.rig.camera, space.rig.laser, middle[[space.rig.laser.count // 2]])
    per_px = float(1.0 / np.abs(scale.height_px_per_mm[0]))
    causes = {
        f"lines {now_mm:.2g} mm apart": bodies.sampling_pct(now_mm),
        "flanks that are not seen": _FLANKS_PCT,
        f"{per_px:.2f} mm of height for a pixel": 100.0 * CALIBRATION_PX * per_px / bodies.mean_height_mm,
    }
    total = math.hypot(*causes.values())
    faults = list(_faults(space, bodies, now_mm))
    speed = f"belt up to {enough / exposure_s:.0f} mm/s at this exposure"
    change = f"a line every {enough:g} mm is enough, {speed}"
    return PlanAnswer(
        not faults, total, math.hypot(total, UNDERSIDE_PCT),
        faults[0] if faults else max(causes, key=causes.__getitem__), (change,),
    )  # fmt: skip


def _faults(space: Space, bodies: Bodies, now_mm: float) -> Iterator[str]:
    """Say why the rig cannot measure the products."""
    if bodies.lengths_mm.min() < 3.0 * now_mm:
        yield f"fewer than three lines on a product {bodies.lengths_mm.min():.0f} mm long"
    _, _, low, high = view_mm(space.rig.camera, bodies.height_mm)
    if bodies.width_mm > high - low:
        yield f"{bodies.height_mm:.0f} mm above the belt the camera sees a width of {high - low:.0f} mm"
    top = space.highest_mm
    if bodies.height_mm > top:
        yield f"products are {bodies.height_mm:.0f} mm high, the line leaves the view at {top:.0f}"
