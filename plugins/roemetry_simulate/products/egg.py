"""Eggs: bodies of revolution that lie on their side, one end blunter.

With s from -1 to 1 along the egg, its radius is r(s)² = R² (1 - s²) (1 + k s). All uniform: length 50–64 mm;
width 38–47 mm, at most 0.85 of the length; k 0.1–0.35 of either sign. Smooth. Kinds: healthy (0.8), and
dented (0.2): a broken place of the shell, 1–3 mm deep, 6–15 mm long and wide. Turned ±15°, off centre by up
to 5 and 6 mm. Density 1.03 g/cm³. The true volume of a healthy one is 2/3 π R² length.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry_simulate.products.family import Drawn, ProductFamily, draw_pose, pick, random_of
from roemetry_simulate.products.food import Floats, FoodOptions, Form, Range, dent, drawn


class EggOptions(FoodOptions):
    """Options of `egg`."""

    known_kinds: ClassVar[tuple[str, ...]] = ("healthy", "dented")

    density_g_per_cm3: float = Field(default=1.03, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = Field(
        default_factory=lambda: {"healthy": 0.8, "dented": 0.2},
        description="kinds that are drawn, each with its share",
    )
    length_range_mm: Range = Field(default=(50.0, 64.0), description="smallest and largest length, mm")
    width_range_mm: Range = Field(
        default=(38.0, 47.0), description="smallest and largest width, mm; at most 0.85 of the length"
    )


def _make(seed: int, options: EggOptions) -> Drawn:
    rng = random_of(seed, "egg")
    kind = pick(rng, options.kinds)
    pose = draw_pose(rng, options)
    length = rng.uniform(*options.length_range_mm)
    width = min(rng.uniform(*options.width_range_mm), 0.85 * length)
    k = float(rng.uniform(0.1, 0.35) * rng.choice([-1.0, 1.0]))
    # the widest place, where the derivative of (1 - s²) (1 + k s) is 0
    s = (math.sqrt(1.0 + 3.0 * k * k) - 1.0) / (3.0 * k)
    most = (1.0 - s * s) * (1.0 + k * s)
    a, b = 0.5 * length, 0.5 * width

    def q(u: Floats, v: Floats) -> Floats:
        at = u / a
        inner: Floats = (1.0 - at**2) * np.maximum(1.0 + k * at, 0.1) / most - (v / b) ** 2
        return inner

    def dome(u: Floats, v: Floats) -> Floats:
        return np.full_like(u, b)

    change = dent(rng, (a, b), (1.0, 3.0), (6.0, 15.0)) if kind == "dented" else None
    figures = {"shape_radius_mm": b / math.sqrt(most), "nominal_length_mm": length}
    defect = "none" if change is None else kind
    return drawn(Form(a, b, q, dome, b), change, defect, pose, options, seed, figures)


EGG = ProductFamily("egg", "eggs on their side, healthy and dented", EggOptions, _make)
"""The family."""
