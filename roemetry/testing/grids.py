"""A grid on a linear rig: lines of both families over one surface, every place and height known exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.records import Peaks, StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.testing.scenes import LinearRig

_ROUNDS = 60
"""Of following a line to where it lies on the surface: each leaves a fifth of the error."""


@dataclass(frozen=True, slots=True)
class GridRig(LinearRig):
    """The linear rig with `lines` across its stripes, which heights move down the image by as much.

    Heights are (stripe, row) of the stripes, or of the lines across in the image turned by 90°
    counter-clockwise: `across` is the linear rig that sees them there.
    """

    rows: int = 240
    first_px: float = 40.0
    lines: int = 5

    @property
    def across(self) -> LinearRig:
        """The rig of the lines across, in the turned image."""
        return LinearRig(
            rows=self.columns,
            columns=self.rows,
            stripes=self.lines,
            first_px=0.5 * (self.rows - 1) - 14.0 * (self.lines - 1),
            spacing_px=28.0,
            px_per_mm=self.px_per_mm,
            mm_per_px=self.mm_per_px,
            sigma_px=self.sigma_px,
            background=self.background,
        )

    def hill(self, height_mm: float = 6.0) -> tuple[Floats, Floats]:
        """Give heights, mm, of a dome in the image's middle, of the stripes and of the lines across."""
        found = []
        for rig, turned in ((self, False), (self.across, True)):
            row = np.broadcast_to(np.arange(rig.rows, dtype=np.float64), (rig.stripes, rig.rows))
            height = np.zeros(row.shape)
            for _ in range(_ROUNDS):
                x = rig.x_px(height)
                place = (self.columns - 1.0 - row, x) if turned else (x, row)
                height = height_mm * _bump(place[0] / self.columns) * _bump(place[1] / self.rows)
            found.append(height)
        return found[0], found[1]

    def grid_light(self, heights: tuple[Floats, Floats], amplitude: float = 100.0) -> Floats:
        """Give (row, column) grey levels of a grid over these heights: the light of both families adds."""
        down, across = (
            rig.light(rig.x_px(height), amplitude)
            for rig, height in zip((self, self.across), heights, strict=True)
        )
        return np.asarray(down + np.rot90(across, -1) - self.background)

    def grid_peaks(self, heights: tuple[Floats, Floats], scatter_px: float = 0.05) -> Peaks:
        """Give the peaks of a perfect extractor, with noise of std `scatter_px`; NaN heights give none."""
        down, across = (
            rig.peaks(rig.x_px(height), scatter_px).peaks
            for rig, height in zip((self, self.across), heights, strict=True)
        )
        return replace(down, across=across)

    def grid_map(self, heights: tuple[Floats, Floats]) -> StripeMap:
        """Give the true map of heights, mm; NaN is not seen, 0 is belt, else product 1."""
        return replace(self.stripe_map(heights[0]), across=self.across.stripe_map(heights[1]))

    def grid_calibration(self) -> Calibration:
        """Give the true calibration of both families."""
        return replace(LinearRig.calibration(self), across=self.across.calibration())


def _bump(share: Floats) -> Floats:
    """Rise from 0 at a fifth of the image to 1 in its middle, and back."""
    return np.asarray(np.sin(np.pi * np.clip((share - 0.2) / 0.6, 0.0, 1.0)) ** 2)
