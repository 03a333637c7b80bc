"""Herring roe skeins: the population of `roemetry_simulate.skein`, and two further kinds.

70–105 mm long, 20–34 mm wide, 10–20 mm thick; healthy (0.32), dented (0.13), bent (0.12), s-bent (0.08),
twisted (0.11), folded (0.11), broken (0.06), or with several dents (0.07); a dent is 2–6 mm deep, at most
half of the dome, and 5–20 mm long and wide; air gaps 0–3 mm under bent, s-bent and twisted ones; all of it
uniform, see `SkeinRecord`. The underside takes 5–25 % of the visible volume away: an underside outside of
that is made rounder or flatter until it is inside. Turned ±15°, off centre by up to 5 and 6 mm. A family
knows no rig: how far the ends lie beyond the outer stripes is the scene's. Density 1.10 g/cm³.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Self

from pydantic import Field, model_validator

from roemetry_simulate.products.family import (
    Drawn,
    ProductFamily,
    ProductOptions,
    check_shares,
    describe,
    pick,
    random_of,
)
from roemetry_simulate.skein import FURTHER_KINDS, KINDS, SkeinRecord, build, dents, draw

_LEAST_LOST, _MOST_LOST = 0.05, 0.25
_COARSE_MM = 0.5
_SHARES = {
    "healthy": 0.32,
    "dented": 0.13,
    "bent": 0.12,
    "s-bent": 0.08,
    "twisted": 0.11,
    "folded": 0.11,
    "broken": 0.06,
    "several-dents": 0.07,
}
_DRAWN_TURN_DEG, _DRAWN_X_MM, _DRAWN_Y_MM = 15.0, 5.0, 6.0


class HerringRoeOptions(ProductOptions):
    """Options of `herring-roe`."""

    density_g_per_cm3: float = Field(default=1.10, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = Field(
        default_factory=lambda: dict(_SHARES),
        description="kinds that are drawn, each with its share; need not sum to 1",
    )
    turn_range_deg: float = Field(default=15.0, ge=0, le=180, description="turned by up to this, degrees")
    offset_range_x_mm: float = Field(
        default=5.0, ge=0, le=5000, description="off centre along X by up to, mm"
    )
    offset_range_y_mm: float = Field(
        default=6.0, ge=0, le=5000, description="off centre along Y by up to, mm"
    )
    grid_step_mm: float = Field(default=0.125, ge=0.02, le=1, description="pitch of the body's grid, mm")

    @model_validator(mode="after")
    def _kinds_are_known(self) -> Self:
        check_shares(self.kinds, KINDS + FURTHER_KINDS)
        return self


def _make(seed: int, options: HerringRoeOptions) -> Drawn:
    record = draw(seed, pick(random_of(seed, "herring-roe"), options.kinds))
    record = replace(
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
