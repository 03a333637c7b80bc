"""From a scene file to its plan, as a page that opens anywhere and as JSON with units beside every number."""

from __future__ import annotations

from dataclasses import asdict
from datetime import datetime
from importlib.metadata import version
from typing import Any

from roemetry.config.scene import Scene
from roemetry.errors import PluginError
from roemetry.html.page import environment_of
from roemetry.html.plots import plain
from roemetry.io.files import json_values
from roemetry.io.yaml_source import dump
from roemetry.records import Plan, PlanFigure
from roemetry.stages.registry import Registry, discover
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


def plan_of(scene: Scene, *, simulate: bool, registry: Registry | None = None) -> Plan:
    """Plan the rig of a scene by the planner that comes with its simulator, under the same name.

    With `simulate`, short simulations stand beside the prediction. Raises PluginError where the simulator's
    plugin has no planner, or one that reads another kind of scene, and StageError, with the reason, where
    the rig cannot measure a height.
    """
    registry = registry or discover()
    chosen = scene.simulator
    name = f"{chosen.registered.provider.name}/{chosen.registered.entry.name}"
    found = registry.find("planner", name)
    stage = registry.load(found)
    if not isinstance(chosen.options, stage.Options):
        raise PluginError(f"the planner `{name}` does not read the scenes of the simulator of this name")
    plan: Plan = stage(chosen.options).plan(simulate=simulate)
    return plan


def as_plain(plan: Plan) -> dict[str, Any]:
    """Give a plan as dictionaries, lists and numbers, its parts by name; NaN becomes None."""
    told: dict[str, Any] = {
        part: {one.name: asdict(one) for one in getattr(plan, part)}
        for part in ("figures", "tables", "curves", "maps")
    }
    told["answer"] = None if plan.answer is None else {**asdict(plan.answer), "text": plan.answer.text}
    told["reasons"] = [reason._asdict() for reason in plan.reasons]
    plain: dict[str, Any] = json_values(told)
    return plain
