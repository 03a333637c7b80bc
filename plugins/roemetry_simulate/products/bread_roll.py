"""Bread rolls: a full dome over a nearly flat underside.

All uniform: length 60–95 mm; width 50–75 mm, at most the length; thickness 30–50 mm, at most 0.75 of the
width; bluntness of the outline 2.0–2.8; widest line at 0.20–0.35 of the thickness; underside's power 3–5;
fullness 0.2–0.6; relief 0.1–0.3 mm over 4 mm. Kinds: healthy (0.6); sunken (0.2): a hollow 4–12 mm deep and
20–40 mm long and wide; split (0.2): a furrow 3–8 mm deep and 5–12 mm wide within 25° of its length. Turned
±15°, off centre by up to 5 and 6 mm. Density 0.25 g/cm³.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry_simulate.products.family import Drawn, ProductFamily, draw_pose, pick, random_of
from roemetry_simulate.products.food import Floats, FoodOptions, Form, Range, dent, drawn, furrow


class BreadRollOptions(FoodOptions):
    """Options of `bread-roll`."""

    known_kinds: ClassVar[tuple[str, ...]] = ("healthy", "sunken", "split")

    density_g_per_cm3: float = Field(default=0.25, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = Field(
        default_factory=lambda: {"healthy": 0.6, "sunken": 0.2, "split": 0.2},
        description="kinds that are drawn, each with its share",
    )
    length_range_mm: Range = Field(default=(60.0, 95.0), description="smallest and largest length, mm")
    width_range_mm: Range = Field(
        default=(50.0, 75.0), description="smallest and largest width, mm; at most the length"
    )
    thickness_range_mm: Range = Field(
        default=(30.0, 50.0), description="smallest and largest height, mm; at most 0.75 of the width"
    )


def _make(seed: int, options: BreadRollOptions) -> Drawn:
    rng = random_of(seed, "bread-roll")
    kind = pick(rng, options.kinds)
    pose = draw_pose(rng, options)
    length = rng.uniform(*options.length_range_mm)
    width = min(rng.uniform(*options.width_range_mm), length)
    thickness = min(rng.uniform(*options.thickness_range_mm), 0.75 * width)
    blunt = rng.uniform(2.0, 2.8)
    rim = rng.uniform(0.20, 0.35) * thickness
    a, b = 0.5 * length, 0.5 * width

    def q(u: Floats, v: Floats) -> Floats:
        inner: Floats = 1.0 - np.abs(u / a) ** blunt - np.abs(v / b) ** blunt
        return inner

    def dome(u: Floats, v: Floats) -> Floats:
        return np.full_like(u, thickness - rim)

    form = Form(
        a, b, q, dome, rim, power=rng.uniform(3.0, 5.0), fullness=rng.uniform(0.2, 0.6),
        relief_mm=rng.uniform(0.1, 0.3), relief_period_mm=4.0,
    )  # fmt: skip
    change = None
    if kind == "sunken":
        change = dent(rng, (a, b), (4.0, 12.0), (20.0, 40.0))
    if kind == "split":
        change = furrow(rng, a, (3.0, 8.0), (5.0, 12.0), (-25.0, 25.0))
    return drawn(form, change, "none" if change is None else kind, pose, options, seed)


BREAD_ROLL = ProductFamily("bread-roll", "bread rolls, healthy, sunken and split", BreadRollOptions, _make)
"""The family."""
