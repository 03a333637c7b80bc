"""Potatoes: lumpy blunt ellipsoids that lie on a rounded underside.

All uniform: length 55–105 mm; width 40–70 mm, at most 0.9 of the length; thickness 30–55 mm, kept within
0.6–0.95 of the width; widest line at 0.40–0.50 of the thickness; bluntness of the outline 2.0–2.6; four
waves around the outline, each up to 0.02 of the radius; one end thicker by up to 0.15; underside's power
1.0–1.4; relief 0.1–0.3 mm over 4 mm. Kinds: healthy (0.7), and dented (0.3) by a hollow 2–6 mm deep and 8–25
mm long and wide. Turned ±15°, off centre by up to 5 and 6 mm. Density 1.08 g/cm³.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry_simulate.products.family import Drawn, ProductFamily, draw_pose, pick, random_of
from roemetry_simulate.products.food import Floats, FoodOptions, Form, Range, dent, drawn


class PotatoOptions(FoodOptions):
    """Options of `potato`."""

    known_kinds: ClassVar[tuple[str, ...]] = ("healthy", "dented")

    density_g_per_cm3: float = Field(default=1.08, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = Field(
        default_factory=lambda: {"healthy": 0.7, "dented": 0.3},
        description="kinds that are drawn, each with its share",
    )
    length_range_mm: Range = Field(default=(55.0, 105.0), description="smallest and largest length, mm")
    width_range_mm: Range = Field(
        default=(40.0, 70.0), description="smallest and largest width, mm; at most 0.9 of the length"
    )
    thickness_range_mm: Range = Field(
        default=(30.0, 55.0), description="smallest and largest height, mm; kept within 0.6–0.95 of the width"
    )


def _make(seed: int, options: PotatoOptions) -> Drawn:
    rng = random_of(seed, "potato")
    kind = pick(rng, options.kinds)
    pose = draw_pose(rng, options)
    length = rng.uniform(*options.length_range_mm)
    width = min(rng.uniform(*options.width_range_mm), 0.9 * length)
    thickness = np.clip(rng.uniform(*options.thickness_range_mm), 0.6 * width, 0.95 * width)
    rim = rng.uniform(0.40, 0.50) * thickness
    blunt, thick_end = rng.uniform(2.0, 2.6), rng.uniform(-0.15, 0.15)
    waves, phases = rng.uniform(0.0, 0.02, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    a, b = 0.5 * length, 0.5 * width

    def radius(u: Floats, v: Floats) -> Floats:
        angle = np.arctan2(v / b, u / a)
        lumps = [size * np.cos((k + 2) * angle + phases[k]) for k, size in enumerate(waves)]
        return np.asarray(1.0 + np.sum(lumps, axis=0), dtype=np.float64)

    def q(u: Floats, v: Floats) -> Floats:
        across = v / (b * (1.0 + thick_end * np.clip(u / a, -1.0, 1.0)) / (1.0 + abs(thick_end)))
        inner: Floats = 1.0 - (np.abs(u / a) ** blunt + np.abs(across) ** blunt) / radius(u, v) ** blunt
        return inner

    def dome(u: Floats, v: Floats) -> Floats:
        slim: Floats = (thickness - rim) * (1.0 + thick_end * np.clip(u / a, -1.0, 1.0))
        return slim

    form = Form(
        1.08 * a,
        1.08 * b,
        q,
        dome,
        rim,
        power=rng.uniform(1.0, 1.4),
        relief_mm=rng.uniform(0.1, 0.3),
        relief_period_mm=4.0,
    )
    change = dent(rng, (a, b), (2.0, 6.0), (8.0, 25.0)) if kind == "dented" else None
    return drawn(form, change, "none" if change is None else kind, pose, options, seed)


POTATO = ProductFamily("potato", "potatoes, healthy and dented", PotatoOptions, _make)
"""The family."""
