"""Herring roe skeins: bodies around a mid-line, healthy or deformed in one of several ways.

A skein is described by a place (a, v): a runs from -1 at one end to 1 at the other along the mid-line, which
is an arc; v is the distance across it in millimetres. The footprint is q > 0 with

    q = 1 - |a|^bluntness - (v / half_width(a))²

and the top stands over the rim by h(a) · sqrt(q (1 + fullness (1 - q))), so that it is a dome which is
vertical at its widest line. The underside is rounded alike and rests on the belt, or hangs over it by a gap.
Each defect changes the dome; the dome without it is kept as the reference for the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.defects import deform
from roemetry_simulate.parameters import SkeinRecord
from roemetry_simulate.solid import GriddedSolid
from roemetry_simulate.surface import smooth_noise

Floats = NDArray[np.float64]

GRID_STEP_MM = 0.125


@dataclass(frozen=True, eq=False)
class Skein:
    """One skein on the belt.

    Attributes
    ----------
    record : SkeinRecord
        The parameters it was made from.
    solid : GriddedSolid
        The skein.
    reference : GriddedSolid
        The same skein without its defect (for a bent or s-bent one: bent, but without the creases).
    """

    record: SkeinRecord
    solid: GriddedSolid
    reference: GriddedSolid


def build(record: SkeinRecord, step_mm: float = GRID_STEP_MM) -> Skein:
    """Shape a skein from its parameters.

    Parameters
    ----------
    record : SkeinRecord
        All its parameters; nothing else is random but the fine relief, which has the record's seed.
    step_mm : float
        Grid pitch.

    Returns
    -------
    Skein
        In the belt frame.
    """
    x, y = _grid(record, step_mm)
    a, v = mid_line_coordinates(record, x, y)
    inner = np.clip(a, -1.0, 1.0)
    half_width = 0.5 * record.width_mm * (1.0 + record.thick_end * inner)
    q = 1.0 - np.abs(a) ** record.bluntness - (v / half_width) ** 2
    q = np.maximum(q, -1.0)

    slim = (1.0 + record.thick_end * inner) * (1.0 - record.taper * inner**2)
    rim = record.rim_height_mm * (1.0 - 0.3 * inner**2)
    gap = record.air_gap_mm * (1.0 - inner**2)
    dome = np.maximum(record.thickness_mm - record.rim_height_mm - record.air_gap_mm, 2.0) * slim
    mid = rim + gap

    inside = np.clip(q, 0.0, 1.0)
    rng = np.random.default_rng([record.seed, 7])
    relief = record.relief_mm * smooth_noise(rng, (x.shape[0], x.shape[1]), 3.0 / step_mm)
    height = dome * np.sqrt(inside * (1.0 + record.fullness * (1.0 - inside)))
    height = np.maximum(height + relief * inside, 0.3 * height)
    outside = dome**2 * q * (1.0 + record.fullness)

    low = record.underside_power
    u_bottom = np.where(q > 0.0, rim**2 * (1.0 - (1.0 - inside) ** low), low * rim**2 * q)

    def solid(top: Floats, limit: Floats) -> GriddedSolid:
        u_top = np.where(q > 0.0, top**2, outside)
        layers = np.stack([mid, np.minimum(u_top, limit), np.minimum(u_bottom, limit)], axis=-1)
        return GriddedSolid(float(x[0, 0]), float(y[0, 0]), step_mm, layers)

    no_limit = np.full_like(q, np.inf)
    changed, wall = deform(record, height, inside, a, v)
    return Skein(record, solid(changed, no_limit if wall is None else wall), solid(height, no_limit))


def mid_line_coordinates(record: SkeinRecord, x_mm: Floats, y_mm: Floats) -> tuple[Floats, Floats]:
    """Place of belt positions along and across the mid-line.

    Parameters
    ----------
    record : SkeinRecord
        Position, yaw, length and bend.
    x_mm, y_mm : ndarray
        Belt frame, millimetres, one shape.

    Returns
    -------
    a, v_mm : ndarray
        -1…1 from the skein's own left end to its right end; millimetres to its left-hand side.
    """
    c, s = np.cos(np.deg2rad(record.yaw_deg)), np.sin(np.deg2rad(record.yaw_deg))
    along = c * (x_mm - record.centre_x_mm) + s * (y_mm - record.centre_y_mm)
    across = c * (y_mm - record.centre_y_mm) - s * (x_mm - record.centre_x_mm)
    if record.bend_deg == 0.0:
        return 2.0 * along / record.length_mm, across
    if record.kind == "s-bent":
        return _along_s(record, along, across)
    # an arc of the given length that turns by bend_deg, its middle shifted so that it stays centred
    radius = record.length_mm / np.deg2rad(record.bend_deg)
    sagitta = radius * (1.0 - np.cos(np.deg2rad(record.bend_deg) / 2.0))
    down = radius - (across + 0.6 * sagitta)
    distance = np.hypot(along, down)
    sign = np.sign(radius)
    angle = np.arctan2(along, sign * down)
    return 2.0 * angle * abs(radius) / record.length_mm, sign * (abs(radius) - distance)


def _along_s(record: SkeinRecord, along: Floats, across: Floats) -> tuple[Floats, Floats]:
    """Place along and across two arcs that meet smoothly in the middle; their far ends lie on own x."""
    turn = np.deg2rad(record.bend_deg)
    radius = 0.5 * record.length_mm / turn
    # the tangent in the middle lies half the turn off the line from end to end
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    x, y = c * along - s * across, s * along + c * across
    half = np.where(x < 0.0, -1.0, 1.0)
    x, y = half * x, half * y
    sign = np.sign(radius)
    down = radius - y
    a = 2.0 * np.arctan2(x, sign * down) * abs(radius) / record.length_mm
    return half * a, half * sign * (abs(radius) - np.hypot(x, down))


def _grid(record: SkeinRecord, step_mm: float) -> tuple[Floats, Floats]:
    """Grid nodes that cover the footprint with a margin, aligned to multiples of the step."""
    reach = 0.5 * record.length_mm + 3.0
    coarse = np.arange(-reach, reach + 1.0, 1.0)
    x, y = np.meshgrid(coarse + record.centre_x_mm, coarse + record.centre_y_mm)
    a, v = mid_line_coordinates(record, x, y)
    half_width = 0.5 * record.width_mm * (1.0 + record.thick_end * np.clip(a, -1.0, 1.0))
    near = (np.abs(a) < 1.0 + 4.0 / record.length_mm) & (np.abs(v) < half_width + 2.0)

    def nodes(values: Floats) -> Floats:
        first, last = np.floor((values.min() - 2.0) / step_mm), np.ceil((values.max() + 2.0) / step_mm)
        positions: Floats = step_mm * np.arange(first, last + 1)
        return positions

    xx, yy = np.meshgrid(nodes(x[near]), nodes(y[near]))
    return xx, yy


def moved(record: SkeinRecord, centre_x_mm: float, centre_y_mm: float) -> SkeinRecord:
    """Return the same skein elsewhere on the belt."""
    return replace(record, centre_x_mm=centre_x_mm, centre_y_mm=centre_y_mm)
