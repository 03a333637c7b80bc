"""The page of a plan: one file that opens anywhere."""

from __future__ import annotations

from datetime import datetime
from importlib.metadata import version

from roemetry.config.scene import Scene
from roemetry.html.page import environment_of
from roemetry.html.plots import plain
from roemetry.io.yaml_source import dump
from roemetry.records import Plan, PlanFigure
from roemetry_tools.plan.plots import COLOURS, curves_plot, map_plot, side_view

_DIGITS = {"mm/px": 3, "mm": 1, "µm": 0, "degrees": 1, "1": 0}  # places behind the point, by unit


def page(plan: Plan, scene: Scene, *, command: str, made: datetime) -> str:
    """Write the whole page as one text: the plan, its scene, the command that made it, and when."""
    environment = environment_of("roemetry_tools.plan")
    environment.filters |= {"written": written}
    planes = [one for one in plan.sketch if one.kind == "plane"]
    tables = {one.name: one for one in plan.tables}
    return environment.get_template("plan.html.j2").render(
        plan=plan,
        scene=scene,
        command=command,
        made=f"{made:%Y-%m-%d %H:%M} UTC",
        version=version("roemetry"),
        side=side_view(plan.sketch),
        maps=[(one, map_plot(one, planes)) for one in plan.maps],
        curves={one.name: (one, curves_plot(one)) for one in plan.curves},
        tables=tables,
        colours=COLOURS,
        options=dump(scene.kept()[0]),
    )


def written(figure: PlanFigure) -> str:
    """Write a figure's value with the places its unit deserves, without the unit."""
    digits = _DIGITS.get(figure.unit, 2)
    if 0.0 < abs(figure.value) < 10.0 and digits < 2 and figure.unit != "1":
        digits += 1
    return plain(figure.value, digits)
