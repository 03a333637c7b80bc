"""What every simulator and planner keeps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from roemetry.stages import Planner, Simulator
from roemetry.testing.verdict import difference, require


def check_numbers_and_seeds_make_others(simulator: Simulator[Any]) -> None:
    """Another number and another seed make another image."""
    one, number, seed = (simulator.simulate(*which) for which in ((0, 1), (1, 1), (0, 2)))
    require(difference(one.frames, number.frames) is not None, "numbers 0 and 1 are the same image")
    require(difference(one.frames, seed.frames) is not None, "seeds 1 and 2 make the same image")


def check_truth_fits_the_image(simulator: Simulator[Any]) -> None:
    """True stripe centres have a row for each row of the laser frame and lie within it."""
    made = simulator.simulate(0, 1)
    frame = next((frame for frame in made.frames if frame.role == "laser"), None)
    require(frame is not None, "there is no laser frame")
    if frame is None or made.truth.stripes is None:
        return
    x_px = made.truth.stripes.x_px
    require(x_px.shape[1] == frame.size[0], f"truth of {x_px.shape[1]} rows for {frame.size[0]} rows")
    known = x_px[np.isfinite(x_px)]
    require(bool(((known >= -0.5) & (known <= frame.size[1] - 0.5)).all()), "true centres lie outside")


def check_every_figure_has_unit_and_basis(planner: Planner[Any]) -> None:
    """Every figure, table, map and curve says its unit, and the formula or source it comes from."""
    plan = planner.plan(simulate=False)
    require(bool(plan.figures), "the plan has no figures")
    columns = [column for table in plan.tables for column in table.columns]
    columns += [line for curves in plan.curves for line in (curves.over, *curves.lines)]
    with_unit = [(figure.name, figure.unit) for figure in plan.figures]
    with_unit += [(one.name, one.unit) for one in plan.maps]
    with_unit += [(column.name, column.unit) for column in columns]
    for name, unit in with_unit:
        require(bool(unit), f"`{name}` has no unit")
    told = [(figure.name, figure.basis) for figure in plan.figures]
    told += [(one.name, one.basis) for one in plan.maps]
    told += [(table.name, table.basis) for table in plan.tables]
    told += [(curves.name, curves.basis) for curves in plan.curves]
    for name, basis in told:
        require(bool(basis), f"`{name}` does not say where it comes from")


def check_what_is_missing_has_a_reason(planner: Planner[Any]) -> None:
    """A plan with a figure that cannot be said (NaN) has reasons in words."""
    plan = planner.plan(simulate=False)
    missing = [one.name for one in plan.figures if math.isnan(one.value)]
    require(not missing or bool(plan.reasons), f"{', '.join(missing)}: no reason is given")
