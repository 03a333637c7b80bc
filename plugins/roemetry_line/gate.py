"""Where a product is on the belt, and at which encoder count it is at the gate.

A product whose middle lies at the belt coordinate y (mm) while the encoder shows c has, at the count

    c + k · (g − s · y)

moved so far that its middle is at the gate: k counts for each millimetre, g the way from the belt frame's
origin to the gate along the motion, s = +1 where the belt moves towards +y and −1 where towards −y.
Assumed: the product does not slip on the belt between camera and gate, and the belt moves along y. Counts
are whole and may wrap: they are given modulo the encoder's range.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from pydantic import Field

from roemetry.config.recipe_file import Section
from roemetry.records import Product


class ShiftRegister:
    """The products between camera and gate, in the order in which they reach it.

    Counts wrap: of two, the one ahead is the one that is reached within half of the counter's range.
    """

    def __init__(self, encoder_bits: int) -> None:
        self._range = 1 << encoder_bits
        self._now: int | None = None
        self._waiting: list[tuple[int, Any]] = []
        self.missed = 0
        """Products that were told after they had passed the gate."""

    def move(self, encoder_count: float) -> None:
        """Take note of where the belt is; products that have passed the gate go."""
        self._now = int(encoder_count) % self._range
        self._waiting = [one for one in self._waiting if self._ahead(one[0]) < self._range // 2]

    def put(self, gate_count: int, told: Any) -> None:
        """Add a product that is at the gate at a count."""
        if self._ahead(gate_count) >= self._range // 2:
            self.missed += 1
            return
        self._waiting.append((gate_count, told))
        self._waiting.sort(key=lambda one: self._ahead(one[0]))

    @property
    def waiting(self) -> tuple[tuple[int, Any], ...]:
        """Give count at the gate and what was told of each product, the next one first."""
        return tuple(self._waiting)

    def _ahead(self, count: int) -> int:
        return (count - (self._now or 0)) % self._range


class GateSection(Section):
    """Where products are sorted."""

    counts_per_mm: float = Field(gt=0, description="encoder counts for each millimetre of belt")
    distance_mm: float = Field(
        gt=0, description="from the belt frame's origin to the gate, along the motion, mm"
    )
    moves: Literal["+y", "-y"] = Field(default="+y", description="which way the belt moves in the belt frame")
    encoder_bits: int = Field(
        default=32,
        ge=8,
        le=53,
        description="bits of the encoder's counter: it wraps to 0 after its largest count",
    )


def position_of(product: Product) -> tuple[float, float]:
    """Give x and y of the middle between the ends of what was seen of a product, belt frame, mm; else NaN."""
    xyz_mm = product.profiles.xyz_mm
    seen = np.isfinite(xyz_mm).all(axis=2)
    if not seen.any():
        return math.nan, math.nan
    xy_mm = xyz_mm[seen][:, :2]
    x_mm, y_mm = (xy_mm.min(axis=0) + xy_mm.max(axis=0)) / 2.0
    return float(x_mm), float(y_mm)


def count_at_gate(gate: GateSection, encoder_count: float, y_mm: float) -> int | None:
    """Give the encoder count at which the product is at the gate; None where count or place is not known."""
    if not (math.isfinite(encoder_count) and math.isfinite(y_mm)):
        return None
    way_mm = gate.distance_mm - (y_mm if gate.moves == "+y" else -y_mm)
    return round(encoder_count + gate.counts_per_mm * way_mm) % (1 << gate.encoder_bits)
