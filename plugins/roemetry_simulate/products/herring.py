"""Herring roe skeins: their parameters drawn from a seed, their defects, their surface, the family.

70–105 mm long, 20–34 mm wide, 10–20 mm thick; healthy (0.32), dented (0.13), bent (0.12), s-bent (0.08),
twisted (0.11), folded (0.11), broken (0.06), or with several dents (0.07); a dent is 2–6 mm deep, at most
half of the dome, and 5–20 mm long and wide; air gaps 0–3 mm under bent, s-bent and twisted ones; all of it
uniform, see `SkeinRecord`. The underside takes 5–25 % of the visible volume away: an underside outside of
that is made rounder or flatter until it is inside. Turned ±15°, off centre by up to 5 and 6 mm. A family
knows no rig: how far the ends lie beyond the outer stripes is the scene's. Density 1.10 g/cm³.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry_simulate.products.family import (
    Drawn,
    PopulationOptions,
    ProductFamily,
    changed,
    describe,
    kind_shares,
    pick,
    random_of,
)
from roemetry_simulate.solid import GriddedSolid
from roemetry_simulate.surface import smooth_noise

Floats = NDArray[np.float64]

KINDS = ("healthy", "dented", "bent", "twisted", "folded", "broken")
KIND_SHARES = (0.35, 0.18, 0.15, 0.13, 0.12, 0.07)  # what a seed alone draws; kept, so that seeds stay

FURTHER_KINDS = ("s-bent", "several-dents")
"""Kinds that are made when asked for, and never drawn without: what a seed alone gives stays as it is."""


@dataclass(frozen=True)
class SkeinRecord:
    """All that makes a skein. Drawn from uniform distributions over the ranges given here.

    - `seed`: What everything was drawn from.
    - `kind`: One of `KINDS` or `FURTHER_KINDS`.
    - `length_mm`: Along the mid-line, 70–105 (broken: of the whole skein, 90–105).
    - `width_mm`: 20–34 in the middle of its length.
    - `thickness_mm`: Nominal height over the belt in the middle, 10–20, at most 0.68 of the width (folded: at
      most 16, before the flap).
    - `rim_height_mm`: Height of the widest line over its lowest point, 0.25–0.42 of the thickness.
    - `underside_power`: Roundness of the underside, 1 (half an ellipse) to 2.2 (flatter); at least 1.5 over a
      gap.
    - `air_gap_mm`: Largest air gap under the middle, which arches: 0, but 0–3 and at most 0.13 of the
      thickness for bent, s-bent and twisted ones.
    - `thick_end`: Growth of width and height from the middle to the thick end, 0.06–0.2 of either sign;
      positive is thick at the right.
    - `taper`: Share of the dome's height lost towards both ends, 0.25–0.55.
    - `bluntness`: Exponent of the outline's ends, 2.0–3.2.
    - `fullness`: 0 is an elliptic cross-section, up to 0.5 is fuller.
    - `relief_mm`: Standard deviation of the fine relief, 0.04–0.10, over about 3 mm.
    - `bend_deg`: Turn of the mid-line from end to end, within ±12; bent ones 30–60 of either sign; for s-bent
      ones the turn of the right half, 25–45 of either sign, and the left half turns back by as much.
    - `yaw_deg`: Turn from belt X, within ±15.
    - `centre_x_mm`, `centre_y_mm`: Where the middle lies, within ±5 and ±6; a scene may move it along X to
      where the stripes are.
    - `defect_along`, `defect_across`: Where the defect is: a (−0.55…0.55), and v as a share of the half width
      (−0.35…0.35). Of several dents (2–4) this is the first; the others are drawn from the seed, over the
      same ranges.
    - `defect_depth_mm`: 2–6, at most half of the dome; 0 for healthy ones.
    - `defect_length_mm`, `defect_width_mm`: Its full extent along and across the mid-line, 5–20.
    - `defect_angle_deg`: Phase of a twist (0–360), or slant of a fold's, crease's or break's line (−50…50).
    """

    seed: int
    kind: str
    length_mm: float
    width_mm: float
    thickness_mm: float
    rim_height_mm: float
    underside_power: float
    air_gap_mm: float
    thick_end: float
    taper: float
    bluntness: float
    fullness: float
    relief_mm: float
    bend_deg: float
    yaw_deg: float
    centre_x_mm: float
    centre_y_mm: float
    defect_along: float
    defect_across: float
    defect_depth_mm: float
    defect_length_mm: float
    defect_width_mm: float
    defect_angle_deg: float


GRID_STEP_MM = 0.125  # the relief, over 3 mm, is then sampled 24 times


@dataclass(frozen=True, eq=False)
class Skein:
    """A skein on the belt: its parameters, its solid, and the same skein without its defect.

    The reference of a bent or s-bent one is bent, but without the creases.
    """

    record: SkeinRecord
    solid: GriddedSolid
    reference: GriddedSolid


def build(record: SkeinRecord, step_mm: float = GRID_STEP_MM) -> Skein:
    """Shape a skein on a grid in the belt frame; nothing is random but the relief, by the record's seed."""
    x, y = _grid(record, step_mm)
    a, v = mid_line_coordinates(record, x, y)
    inner = np.clip(a, -1.0, 1.0)
    half_width = 0.5 * record.width_mm * (1.0 + record.thick_end * inner)
    # 1 on the mid-line's middle, 0 on the outline, negative beyond
    q = 1.0 - np.abs(a) ** record.bluntness - (v / half_width) ** 2
    # far outside nothing depends on it, and squares stay small
    q = np.maximum(q, -1.0)

    slim = (1.0 + record.thick_end * inner) * (1.0 - record.taper * inner**2)
    rim = record.rim_height_mm * (1.0 - 0.3 * inner**2)
    gap = record.air_gap_mm * (1.0 - inner**2)
    # at least 2 mm of dome over the rim, however thin the skein
    dome = np.maximum(record.thickness_mm - record.rim_height_mm - record.air_gap_mm, 2.0) * slim
    mid = rim + gap

    inside = np.clip(q, 0.0, 1.0)
    # a seed of its own for each random part: more draws in one change no other
    rng = np.random.default_rng([record.seed, 7])
    relief = record.relief_mm * smooth_noise(rng, (x.shape[0], x.shape[1]), 3.0 / step_mm)
    height = dome * np.sqrt(inside * (1.0 + record.fullness * (1.0 - inside)))
    # relief dies out towards the rim, and never makes a hole
    height = np.maximum(height + relief * inside, 0.3 * height)
    # continues the square through the rim with the same slope, so that the outline is smooth
    outside = dome**2 * q * (1.0 + record.fullness)

    low = record.underside_power
    u_bottom = np.where(q > 0.0, rim**2 * (1.0 - (1.0 - inside) ** low), low * rim**2 * q)

    def solid(top: Floats, limit: Floats) -> GriddedSolid:
        # a wall (of a broken skein) cuts both squares
        u_top = np.where(q > 0.0, top**2, outside)
        layers = np.stack([mid, np.minimum(u_top, limit), np.minimum(u_bottom, limit)], axis=-1)
        return GriddedSolid(float(x[0, 0]), float(y[0, 0]), step_mm, layers)

    no_limit = np.full_like(q, np.inf)
    changed, wall = deform(record, height, inside, a, v)
    return Skein(record, solid(changed, no_limit if wall is None else wall), solid(height, no_limit))


def mid_line_coordinates(record: SkeinRecord, x_mm: Floats, y_mm: Floats) -> tuple[Floats, Floats]:
    """Place of belt positions (mm) along and across the mid-line.

    Returns a, −1…1 from the skein's own left end to its right end, and v, mm to its left-hand side.
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
    # the bow's height; its middle is moved so that the bent skein stays centred
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
    # a first, coarse look at where the skein lies, before the fine grid is made
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


def deform(
    record: SkeinRecord, height_mm: Floats, inside: Floats, a: Floats, v_mm: Floats
) -> tuple[Floats, Floats | None]:
    """Apply a skein's defect to its dome without it (mm over the rim).

    `inside` is q clipped to 0…1: 1 on the ridge, 0 at the rim and beyond; a and v are mid-line coordinates.
    Returns the dome with the defect and, for a broken skein, the square (mm²) that ends it, positive on the
    side that is left.
    """
    changes = {
        "dented": _dent,
        "several-dents": _dents,
        "bent": _crease,
        "s-bent": _creases,
        "twisted": _twist,
        "folded": _fold,
    }
    if record.kind in changes:
        return changed(height_mm, inside, changes[record.kind](record, height_mm, a, v_mm)), None
    if record.kind == "broken":
        return height_mm, _break(record, a, v_mm)
    return height_mm, None


def _place(record: SkeinRecord, a: Floats, v_mm: Floats) -> tuple[Floats, Floats]:
    """Distances (mm) along and across the mid-line from the defect's middle."""
    along = 0.5 * record.length_mm * (a - record.defect_along)
    return along, v_mm - 0.5 * record.width_mm * record.defect_across


def _dent(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return a smooth hollow of limited extent."""
    along, across = _place(record, a, v_mm)
    r2 = (2.0 * along / record.defect_length_mm) ** 2 + (2.0 * across / record.defect_width_mm) ** 2
    # bell of finite extent, smooth at its edge
    hollow: Floats = -record.defect_depth_mm * np.clip(1.0 - r2, 0.0, 1.0) ** 2
    return hollow


def dents(record: SkeinRecord) -> list[SkeinRecord]:
    """Return a record for each of several dents: the skein's own, then 1–3 more, drawn from its seed."""
    rng = np.random.default_rng([record.seed, 17])
    found = [record]
    for _ in range(int(rng.integers(1, 4))):
        along, across, depth = rng.uniform(-0.55, 0.55), rng.uniform(-0.35, 0.35), rng.uniform(2.0, 6.0)
        length, width = rng.uniform(5.0, 20.0, 2)
        deepest = max(0.5 * (record.thickness_mm - record.rim_height_mm), 2.0)
        names = ("along", "across", "depth_mm", "length_mm", "width_mm")
        values = map(float, (along, across, min(depth, deepest), length, width))
        own = {f"defect_{name}": value for name, value in zip(names, values, strict=True)}
        found.append(replace(record, **own))  # type: ignore[arg-type]
    return found


def _dents(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return the hollows of several dents; where they meet, the deepest counts."""
    return np.minimum.reduce([_dent(one, height_mm, a, v_mm) for one in dents(record)])


def _creases(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return two wrinkles, one on the inner side of each half of an S."""
    place = max(abs(record.defect_along), 0.25)
    right = replace(record, defect_along=place)
    left = replace(record, defect_along=-place, bend_deg=-record.bend_deg)
    return np.minimum(_crease(right, height_mm, a, v_mm), _crease(left, height_mm, a, v_mm))


def _crease(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return the wrinkle on the inner side of a bend, deepest at the edge, gone on the outer side."""
    along, _ = _place(record, a, v_mm)
    slant = np.tan(np.deg2rad(0.5 * record.defect_angle_deg))
    inner = np.sign(record.bend_deg) * v_mm / (0.5 * record.width_mm)
    # the inner side of the bend has too much skin: there it wrinkles
    share = 0.5 + 0.5 * np.tanh(2.0 * inner)
    sigma = 0.2 * record.defect_length_mm + 0.6
    wrinkle: Floats = -record.defect_depth_mm * share * np.exp(-0.5 * ((along - slant * v_mm) / sigma) ** 2)
    return wrinkle


def _twist(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return a lean of the ridge to one side, then the other, with a furrow that winds along."""
    # winds along: 2.2 rad from the middle to an end
    phase = np.deg2rad(record.defect_angle_deg) + 2.2 * a
    half = 0.5 * record.width_mm
    furrow = v_mm - 0.45 * half * np.sin(phase)
    sigma = 0.12 * record.defect_width_mm + 1.2
    side = np.clip(v_mm / half, -1.0, 1.0)
    # odd across, nothing at ridge and rims: a lean
    lean = -0.9 * record.defect_depth_mm * np.sin(phase) * side * (1.0 - side**2)
    wound: Floats = lean - 0.8 * record.defect_depth_mm * np.exp(-0.5 * (furrow / sigma) ** 2)
    return wound


def _fold(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return a flap that lies over the rest with a rounded steep edge and a groove before it."""
    along, across = _place(record, a, v_mm)
    side = 1.0 if record.defect_along >= 0.0 else -1.0
    angle = np.deg2rad(40.0 + 0.6 * record.defect_angle_deg)
    d = side * along * np.cos(angle) + across * np.sin(angle)
    # a step over some millimetres, which falls off behind it
    lip = 0.5 * record.defect_depth_mm * (1.0 + np.tanh(d / 1.2))
    back = np.exp(-np.maximum(d, 0.0) / 14.0)
    groove = 0.7 * record.defect_depth_mm * np.exp(-0.5 * ((d + 2.4) / 1.8) ** 2)
    # a flap lies over at most 0.6 of the dome
    flap: Floats = np.minimum(lip * back, 0.6 * height_mm) - groove
    return flap


def _break(record: SkeinRecord, a: Floats, v_mm: Floats) -> Floats:
    """Square (mm²) of a ragged steep end across the skein, beyond which nothing is left."""
    side = 1.0 if record.defect_along >= 0.0 else -1.0
    rng = np.random.default_rng([record.seed, 13])
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    sizes = np.array([1.0, 0.7, 0.4, 0.2]) * rng.uniform(0.5, 1.2, 4)
    ragged = sum(
        size * np.sin(2.0 * np.pi * v_mm / period + phase)
        for size, phase, period in zip(sizes, phases, (23.0, 13.0, 7.5, 4.5), strict=True)
    )
    at_mm = 0.5 * record.length_mm * (0.35 + 0.8 * abs(record.defect_along))
    slant = 0.4 * np.tan(np.deg2rad(record.defect_angle_deg))
    left_mm = at_mm - side * 0.5 * record.length_mm * a + slant * v_mm + ragged
    wall: Floats = np.maximum(18.0 * left_mm, -40.0)
    return wall


def draw(seed: int, kind: str | None = None) -> SkeinRecord:
    """Draw a skein's parameters; without a kind, one of `KINDS`, too, in the shares `KIND_SHARES`."""
    if kind is not None and kind not in KINDS + FURTHER_KINDS:
        known = ", ".join(KINDS + FURTHER_KINDS)
        raise ValueError(f"no kind of skein is called {kind!r}; there are {known}")
    rng = np.random.default_rng([seed, 3])
    # drawn even where the kind is given, so that a seed's other numbers do not depend on it
    drawn = str(rng.choice(KINDS, p=KIND_SHARES))
    kind = drawn if kind is None else kind
    between = rng.uniform
    length = between(90, 105) if kind == "broken" else between(70, 105)
    width = between(20, 34)
    thickness = between(10, min(20, 0.68 * width))
    record = SkeinRecord(
        seed=seed,
        kind=kind,
        length_mm=float(length),
        width_mm=float(width),
        thickness_mm=float(thickness),
        rim_height_mm=float(between(0.25, 0.42) * thickness),
        underside_power=float(between(1.0, 2.2)),
        air_gap_mm=0.0,
        thick_end=float(between(0.06, 0.20) * rng.choice([-1.0, 1.0])),
        taper=float(between(0.25, 0.55)),
        bluntness=float(between(2.0, 3.2)),
        fullness=float(between(0.0, 0.5)),
        relief_mm=float(between(0.04, 0.10)),
        bend_deg=float(between(-12, 12)),
        yaw_deg=float(between(-15, 15)),
        centre_x_mm=float(between(-5, 5)),
        centre_y_mm=float(between(-6, 6)),
        defect_along=float(between(-0.55, 0.55)),
        defect_across=float(between(-0.35, 0.35)),
        defect_depth_mm=0.0,
        defect_length_mm=float(between(5, 20)),
        defect_width_mm=float(between(5, 20)),
        defect_angle_deg=float(between(-50, 50)),
    )
    if kind == "healthy":
        return record
    deepest = 0.5 * (record.thickness_mm - record.rim_height_mm)
    record = replace(record, defect_depth_mm=float(min(between(2, 6), max(deepest, 2.0))))
    if kind in ("bent", "s-bent", "twisted"):
        gap = between(0, 3)
        record = replace(
            record,
            air_gap_mm=float(min(gap, 0.13 * record.thickness_mm)),
            underside_power=max(record.underside_power, 1.5),
        )
    if kind == "bent":
        record = replace(record, bend_deg=float(between(30, 60) * rng.choice([-1.0, 1.0])))
    if kind == "s-bent":
        record = replace(record, bend_deg=float(between(25, 45) * rng.choice([-1.0, 1.0])))
    if kind == "folded":
        # a fold doubles what is there, and comes of the thinner ones
        share = min(1.0, 16.0 / record.thickness_mm)
        record = replace(
            record, thickness_mm=share * record.thickness_mm, rim_height_mm=share * record.rim_height_mm
        )
    if kind == "twisted":
        record = replace(record, defect_angle_deg=float(between(0, 360)))
    return record


_LEAST_LOST, _MOST_LOST = 0.05, 0.25
"""Share of the visible volume that an underside may take away."""
_COARSE_MM = 0.5
"""Pitch of the grid on which that share is found, for speed; a margin of 0.001 covers the difference."""
# default shares of the family, the two further kinds among them
_SHARES = {
    "healthy": 0.32, "dented": 0.13, "bent": 0.12, "s-bent": 0.08, "twisted": 0.11, "folded": 0.11,
    "broken": 0.06, "several-dents": 0.07,
}  # fmt: skip
_DRAWN_TURN_DEG, _DRAWN_X_MM, _DRAWN_Y_MM = 15.0, 5.0, 6.0
"""Ranges that `draw` draws poses from, either way; the options scale them."""


class HerringRoeOptions(PopulationOptions):
    """Options of `herring-roe`."""

    density_g_per_cm3: float = Field(default=1.10, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = kind_shares(_SHARES)
    grid_step_mm: float = Field(default=0.125, ge=0.02, le=1, description="pitch of the body's grid, mm")


def _make(seed: int, options: HerringRoeOptions) -> Drawn:
    record = draw(seed, pick(random_of(seed, "herring-roe"), options.kinds))
    record = replace(
        # `draw` has its own ranges; the options scale them
        record,
        yaw_deg=record.yaw_deg * (options.turn_range_deg / _DRAWN_TURN_DEG),
        centre_x_mm=record.centre_x_mm * (options.offset_range_x_mm / _DRAWN_X_MM),
        centre_y_mm=record.centre_y_mm * (options.offset_range_y_mm / _DRAWN_Y_MM),
    )
    skein = build(_underside_in_range(record), options.grid_step_mm)
    lost = 1.0 - skein.solid.true_volume_mm3 / skein.solid.visible_volume_mm3
    numbers = {name: value for name, value in asdict(skein.record).items() if name not in ("seed", "kind")}
    figures = {**numbers, "underside_share": lost}
    if record.kind == "several-dents":
        figures["dent_count"] = len(dents(record))
    defect = "none" if record.kind == "healthy" else record.kind
    return Drawn(skein.solid, describe(skein.solid, options, defect, figures), skein.reference)


def _underside_in_range(record: SkeinRecord) -> SkeinRecord:
    """Make the underside rounder or flatter until it takes the share of the visible volume that it may."""
    for _ in range(20):
        solid = build(record, _COARSE_MM).solid
        lost = 1.0 - solid.true_volume_mm3 / solid.visible_volume_mm3
        # a rounder underside takes less away, a flatter one more
        if lost < _LEAST_LOST + 0.001:
            record = replace(record, underside_power=0.93 * record.underside_power)
        elif lost > _MOST_LOST - 0.001:
            record = replace(record, underside_power=1.07 * record.underside_power)
        else:
            break
    return record


HERRING_ROE = ProductFamily(
    "herring-roe", "herring roe skeins, healthy and deformed", HerringRoeOptions, _make
)
"""The family."""
