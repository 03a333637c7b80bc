"""Fish fillets: flat below, thick at the head end, thin towards the tail.

All uniform: length 75–110 mm; width 30–60 mm, at most 0.7 of the length; nominal thickness, at the very
head, 8–22 mm, at most 0.5 of the width; the head end at own right or left; height falls by 0.5–0.75 and
width by 0.25–0.45 of their means from the middle to the tail; bluntness of the ends 2.2–3.5; widest line at
0.06–0.15 of the thickness; underside's power 2–3; fullness 0.3–0.9; relief 0.05–0.15 mm over 3 mm. Kinds:
healthy (0.7), and gaping (0.3): the flakes part in a furrow across it, 2–6 mm deep, 3–8 mm wide, 60–120° to
its length. Turned ±15°, off centre by up to 5 and 6 mm. Density 1.05 g/cm³.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry_simulate.products.family import Drawn, ProductFamily, draw_pose, pick, random_of
from roemetry_simulate.products.food import Floats, FoodOptions, Form, Range, drawn, furrow


class FilletOptions(FoodOptions):
    """Options of `fillet`."""

    known_kinds: ClassVar[tuple[str, ...]] = ("healthy", "gaping")

    density_g_per_cm3: float = Field(default=1.05, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = Field(
        default_factory=lambda: {"healthy": 0.7, "gaping": 0.3},
        description="kinds that are drawn, each with its share",
    )
    length_range_mm: Range = Field(default=(75.0, 110.0), description="smallest and largest length, mm")
    width_range_mm: Range = Field(
        default=(30.0, 60.0), description="smallest and largest width, mm; at most 0.7 of the length"
    )
    thickness_range_mm: Range = Field(
        default=(8.0, 22.0), description="smallest and largest height, mm; at most 0.5 of the width"
    )


def _make(seed: int, options: FilletOptions) -> Drawn:
    rng = random_of(seed, "fillet")
    kind = pick(rng, options.kinds)
    pose = draw_pose(rng, options)
    length = rng.uniform(*options.length_range_mm)
    width = min(rng.uniform(*options.width_range_mm), 0.7 * length)
    thickness = min(rng.uniform(*options.thickness_range_mm), 0.5 * width)
    head = float(rng.choice([-1.0, 1.0]))
    thin, narrow, blunt = rng.uniform(0.5, 0.75), rng.uniform(0.25, 0.45), rng.uniform(2.2, 3.5)
    rim = rng.uniform(0.06, 0.15) * thickness
    a, b = 0.5 * length, 0.5 * width

    def place(u: Floats) -> Floats:
        return np.clip(head * u / a, -1.0, 1.0)

    def q(u: Floats, v: Floats) -> Floats:
        half = b * (1.0 + narrow * place(u)) / (1.0 + narrow)
        inner: Floats = 1.0 - np.abs(u / a) ** blunt - (v / half) ** 2
        return inner

    def dome(u: Floats, v: Floats) -> Floats:
        height: Floats = (thickness - rim) * (1.0 + thin * place(u)) / (1.0 + thin)
        return height

    form = Form(
        a, b, q, dome, rim, power=rng.uniform(2.0, 3.0), fullness=rng.uniform(0.3, 0.9),
        relief_mm=rng.uniform(0.05, 0.15),
    )  # fmt: skip
    change = furrow(rng, a, (2.0, 6.0), (3.0, 8.0), (60.0, 120.0)) if kind == "gaping" else None
    return drawn(form, change, "none" if change is None else kind, pose, options, seed)


FILLET = ProductFamily("fillet", "fish fillets, healthy and gaping", FilletOptions, _make)
"""The family."""
