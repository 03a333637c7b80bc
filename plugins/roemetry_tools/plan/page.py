"""From a scene file to its plan, as a page that opens anywhere and as JSON with units beside every number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from markupsafe import Markup

from roemetry.config.scene import Scene
from roemetry.errors import PluginError
from roemetry.html.page import environment_of
from roemetry.html.plots import Axis, box, dot, line, number, picture, plain, shape, text
from roemetry.io.files import json_values
from roemetry.io.yaml_source import dump
from roemetry.records import Plan, PlanCurves, PlanFigure, PlanMap, PlanShape
from roemetry.records.arrays import Floats
from roemetry.stages.registry import Registry, discover

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

    With `simulate`, short simulations stand beside the prediction.

    Raises
    ------
    PluginError
        The simulator's plugin has no planner, or one that reads another kind of scene.
    StageError
        The rig cannot measure a height; with the reason.
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


COLOURS = ("#0d689c", "#d98a12", "#2c8a5f", "#8a6fd1")

_RAMP = ("#fdf6d8", "#f9d48b", "#f2a65e", "#dd7360", "#b04a70", "#73346f", "#3a1f55")
_NAME_HEIGHT = 15.0  # of a line of text
_SIDE_WIDTH = 900.0  # of the side view, in units of the drawing
_LOOKING_DOWN = ((-13, -16), (13, -16), (13, 0), (5, 0), (0, 6), (-5, 0), (-13, 0))  # a camera's outline


def side_view(sketch: Sequence[PlanShape]) -> Markup:
    """Draw the rig to scale, X to the right, Z up, the same millimetres both ways."""
    points = np.vstack([one.points_mm for one in sketch])
    (x_low, z_low), (x_high, z_high) = points.min(axis=0), points.max(axis=0)
    left, top, right, bottom = 52.0, 26.0, 176.0, 44.0
    per_mm = (_SIDE_WIDTH - left - right) / (x_high - x_low)
    height = top + bottom + per_mm * (z_high - z_low)
    x_axis = Axis(x_low, x_high, left, _SIDE_WIDTH - right)
    z_axis = Axis(z_low, z_high, height - bottom, top)
    body = []
    for value, words in x_axis.ticks(10):
        body += [line(x_axis(value), height - bottom, x_axis(value), height - bottom + 5, "zero")]
        body += [text(x_axis(value), height - bottom + 18, words)]
    for value, words in z_axis.ticks(6):
        body += [line(left - 5, z_axis(value), _SIDE_WIDTH - right, z_axis(value), "grid")]
        body += [text(left - 9, z_axis(value) + 4, words, "end")]
    body += [
        text(0.5 * (left + _SIDE_WIDTH - right), height - 6, "X, mm"),
        text(left - 9, 14, "Z, mm", "end"),
    ]
    named: list[float] = []
    for one in sketch:
        body += _part(one, x_axis, z_axis, named)
    return picture(body, height, "The rig from the side, to scale", _SIDE_WIDTH)


def map_plot(one: PlanMap, planes: Sequence[PlanShape] = ()) -> Markup:
    """Draw a map, with the light planes over it and the scale of its colours below."""
    left, right, top, tall = 46.0, 430.0, 18.0, 170.0
    bottom = top + tall
    x_axis = Axis(*_edges(one.x_mm), left, right)
    z_axis = Axis(*_edges(one.z_mm), bottom, top)
    known = one.values[np.isfinite(one.values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if high - low < 1e-9:
        high = low + 1e-9
    dx, dz = _step(one.x_mm), _step(one.z_mm)
    body = [box(left, top, right - left, tall, "unknown")]
    for k, z in enumerate(one.z_mm):
        for i, x in enumerate(one.x_mm):
            value = float(one.values[k, i])
            if not math.isfinite(value):
                continue
            words = f"X {plain(x)} mm, Z {plain(z)} mm: {plain(value, one.digits)} {one.unit}"
            x0, x1 = x_axis(x - 0.5 * dx), x_axis(x + 0.5 * dx)
            y0, y1 = z_axis(z + 0.5 * dz), z_axis(z - 0.5 * dz)
            body.append(
                box(x0, y0, x1 - x0 + 0.3, y1 - y0 + 0.3, "", words, _colour((value - low) / (high - low)))
            )
    ends = _edges(one.z_mm)
    for plane in planes:
        cut = [_at_height(plane.points_mm, z) for z in ends]
        if one.x_mm[0] <= min(cut) and max(cut) <= one.x_mm[-1]:
            body.append(line(x_axis(cut[0]), z_axis(ends[0]), x_axis(cut[1]), z_axis(ends[1]), "lit"))
    body += [text(x_axis(v), bottom + 15, words) for v, words in x_axis.ticks(7)]
    body += [text(left - 6, z_axis(v) + 4, words, "end") for v, words in z_axis.ticks(6)]
    body += [text(right, bottom + 30, "X, mm", "end"), text(left - 6, top - 6, "Z, mm", "end")]
    return picture([*body, *_scale(low, high, one, left, bottom + 42)], bottom + 76, one.title)


def curves_plot(one: PlanCurves) -> Markup:
    """Draw curves over their quantity; where the rig stands is a dot on each."""
    left, right, top, bottom = 52.0, 426.0, 24.0, 216.0
    values = np.concatenate([line_.values for line_ in one.lines])
    values = values[np.isfinite(values)]
    if one.logarithmic:
        low, high = np.log10(values.min()), np.log10(values.max())
        y_axis = Axis.over(math.floor(low), math.ceil(high), bottom, top)
        ticks = [(float(p), f"{10.0**p:g}") for p in range(math.floor(low), math.ceil(high) + 1)]
    else:
        y_axis = Axis.over(min(0.0, float(values.min())), 1.05 * float(values.max()), bottom, top)
        ticks = y_axis.ticks(5)
    x_axis = Axis.over(float(one.over.values.min()), float(one.over.values.max()), left, right)
    body = []
    for v, words in ticks:
        body += [line(left, y_axis(v), right, y_axis(v), "grid"), text(left - 6, y_axis(v) + 4, words, "end")]
    body += [text(x_axis(v), bottom + 16, words) for v, words in x_axis.ticks(8)]
    body += [text(right, bottom + 34, f"{one.over.title}{_unit(one.over.unit)}", "end")]
    upwards = (one.lines[0].title if len(one.lines) == 1 else "") + _unit(one.lines[0].unit)
    body += [text(0, 12, upwards.lstrip(", "), "start")]
    for curve, colour in zip(one.lines, COLOURS, strict=False):
        there = np.isfinite(curve.values)
        x, y = one.over.values[there], curve.values[there]
        shown = np.log10(y) if one.logarithmic else y
        points = "L".join(f"{number(x_axis(a))} {number(y_axis(b))}" for a, b in zip(x, shown, strict=True))
        body.append(Markup('<path class="curve" stroke="{}" d="M{}"/>').format(colour, points))
        if x.size and x[0] <= one.marked <= x[-1]:
            value = float(np.interp(one.marked, x, shown))
            true = 10.0**value if one.logarithmic else value
            words = f"{plain(one.marked, one.over.digits)}: {plain(true, curve.digits)} {curve.unit}"
            body.append(dot(x_axis(one.marked), y_axis(value), "point", words, colour, 4.5))
            if curve is one.lines[-1]:
                body.append(text(x_axis(one.marked) + 8, y_axis(value) - 8, "this rig", "start"))
    return picture(body, bottom + 42, one.title)


def _part(one: PlanShape, x_axis: Axis, z_axis: Axis, named: list[float]) -> list[Markup]:
    """Draw a part; `named` are the places of the names of heights, of which none covers another."""

    def beside(y: float) -> float:
        named.append(
            max([y + 4, *(other + _NAME_HEIGHT for other in named if abs(other - y - 4) < _NAME_HEIGHT)])
        )
        return named[-1]

    at = [(x_axis(float(x)), z_axis(float(z))) for x, z in one.points_mm]
    words = one.label
    if one.kind in ("view", "range"):
        body = [shape(at, one.kind)]
        return [*body, text(at[1][0] + 34, beside(at[2][1]), words, "start name")] if words else body
    if one.kind in ("camera", "projector"):
        ((x, y),) = at
        down = [(x + right, y + below) for right, below in _LOOKING_DOWN]
        return [shape(down, one.kind), text(x + 19, y - 3, words, "start name")]
    body = [line(*at[0], *at[1], one.kind)]
    if words:
        if one.kind == "belt":
            body.append(text(at[1][0] + 6, at[1][1] + 4, words, "start name"))
        else:
            body.append(text(at[1][0] + 34, beside(at[1][1]), words, "start"))
    return body


def _scale(low: float, high: float, one: PlanMap, left: float, top: float) -> list[Markup]:
    axis = Axis(low, high, left, left + 240.0)
    steps = 48
    body = [
        box(left + 240.0 * k / steps, top, 240.0 / steps + 0.3, 10, "", "", _colour((k + 0.5) / steps))
        for k in range(steps)
    ]
    body += [text(axis(v), top + 24, words) for v, words in axis.ticks(4)]
    return [*body, text(left + 252, top + 9, one.unit, "start")]


def _colour(share: float) -> str:
    """Colour of a share of the scale, light to dark."""
    at = min(max(share, 0.0), 1.0) * (len(_RAMP) - 1)
    k = min(int(at), len(_RAMP) - 2)
    ends = [[int(ramp[i : i + 2], 16) for i in (1, 3, 5)] for ramp in _RAMP[k : k + 2]]
    mixed = [round(a + (at - k) * (b - a)) for a, b in zip(*ends, strict=True)]
    return "#" + "".join(f"{value:02x}" for value in mixed)


def _at_height(points_mm: Floats, z_mm: float) -> float:
    """X of a straight line of two points at a height."""
    (x0, z0), (x1, z1) = points_mm
    return float(x0 + (z_mm - z0) / (z1 - z0) * (x1 - x0))


def _step(values: Floats) -> float:
    return float(values[1] - values[0])


def _edges(values: Floats) -> tuple[float, float]:
    half = 0.5 * _step(values)
    return float(values[0] - half), float(values[-1] + half)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f", {unit}"
