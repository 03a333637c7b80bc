"""How a belt carries a product through the light, and when frames are taken: `scan` of a scene file."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from roemetry.config.scene_parts import Part

Floats = NDArray[np.float64]

_JITTER, _PHASE = 83, 84
"""Streams of random numbers beside a scan's seed, which no other part of a scene draws from."""


class ScanPart(Part):
    """How the belt runs, and when frames are taken."""

    mm_per_count: tuple[float, float] = Field(
        default=(0.02, 0.0), description="way of the product for each encoder count along X and Y, mm"
    )
    counts_per_line: int = Field(default=25, ge=1, description="encoder counts from frame to frame")
    lead_mm: float = Field(default=6.0, ge=0, description="bare belt before and behind the product, mm")
    first_count: int = Field(default=0, ge=-(2**31), lt=2**32, description="count of the first frame")
    wrap_bits: int = Field(default=0, ge=0, le=32, description="bits of the counter; 0: it never overflows")
    jitter_mm: float = Field(
        default=0.0, ge=0, description="the belt's height scatters by, from frame to frame, mm"
    )
    slip_share: float = Field(
        default=0.0, gt=-1, lt=1, description="in the middle third the product goes so much further"
    )
    below_mm: float | None = Field(
        default=None, gt=0, le=1000,
        description="the head looks up through a gap in the belt: its own frame, Z down, begins so far above "
        "the belt, mm; default: it looks down",
    )  # fmt: skip
    line_sigma_px: float = Field(
        default=1.6, gt=0,
        description="width of the line (standard deviation), px, where a simulator does not light it by the "
        "laser's own width",
    )  # fmt: skip

    line_y_mm: tuple[float, float] | None = Field(
        default=None, description="Y at which the light ends on the belt, mm; default: beyond the image"
    )

    @field_validator("mm_per_count")
    @classmethod
    def _runs_along_x(cls, way: tuple[float, float]) -> tuple[float, float]:
        if way[0] == 0.0:
            raise ValueError("the belt has to run along X: the first number is 0")
        return way

    def run(
        self, along_mm: tuple[float, float], lines_x_mm: Floats, seed: int
    ) -> tuple[NDArray[np.int64], Floats]:
        """Give (line,) counts, and (line, 3) by how much the product has moved since it lay at X = 0, mm.

        `along_mm` is where the product begins and ends along X, `lines_x_mm` where planes of light meet the
        belt. Its near end comes to the first plane, and its far end passes the last. Between two lines the
        product's end may lie anywhere, as the seed draws.
        """
        low, high = along_mm[0] - self.lead_mm, along_mm[1] + self.lead_mm
        begin, end = lines_x_mm.min() - high, lines_x_mm.max() - low
        if self.mm_per_count[0] < 0.0:
            begin, end = end, begin
        step_mm = self.counts_per_line * self.mm_per_count[0]
        begin -= np.random.default_rng([seed, _PHASE]).random() * step_mm
        lines = math.ceil((end - begin) / step_mm) + 1
        counts = self.counts_per_line * np.arange(lines)
        share = np.full(lines, 1.0)
        share[lines // 3 : 2 * lines // 3] += self.slip_share
        gone = np.concatenate([[0.0], np.cumsum(share[1:])]) * self.counts_per_line
        moved = np.column_stack(
            [begin + gone * self.mm_per_count[0], gone * self.mm_per_count[1], np.zeros(lines)]
        )
        if self.jitter_mm:
            moved[:, 2] = np.random.default_rng([seed, _JITTER]).normal(0.0, self.jitter_mm, lines)
        return counts, moved

    def runs(self, projector_mm: Floats, axis: Floats, lines_x_mm: Floats) -> Floats:
        """Give the cosines (2,) of a beam's angle with the lines' common axis between which there is light.

        `lines_x_mm` is where planes of light meet the belt at Y = 0.
        """
        if self.line_y_mm is None:
            return np.array([-1.0, 1.0])
        ends = np.array([[float(lines_x_mm.mean()), y, 0.0] for y in self.line_y_mm]) - projector_mm
        return np.sort(ends @ axis / np.linalg.norm(ends, axis=1))

    def shown(self, counts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Give what a counter of so many bits shows."""
        shifted = counts + self.first_count
        return shifted % (1 << self.wrap_bits) if self.wrap_bits else shifted

    def told_motion(self) -> list[float]:
        """Give the motion in the frame of the head, mm per count."""
        along, across = self.mm_per_count
        return [along, across if self.below_mm is None else -across, 0.0]
