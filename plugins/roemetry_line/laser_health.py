"""Whether the laser shines as it did when the run began, by the light of the stripes that are found."""

from __future__ import annotations

import math

import numpy as np

from roemetry.records import Trace

_FIRST = 20
"""Frames of a run whose mean light is what later frames are compared with."""
_DARK = 0.5
"""Less of that light than this is told: a dirty window or an ageing diode, before stripes are lost."""
_IN_A_ROW = 3
"""Frames: a hand before the camera is not told."""


class LaserHealth:
    """Follows the light of the stripes over the frames of a run."""

    def __init__(self) -> None:
        self.percent = math.nan
        """Median height of the last frame's peaks, % of white; 0 where none was found."""
        self._sum, self._count, self._dark = 0.0, 0, 0

    def look(self, trace: Trace | None) -> str | None:
        """Take a frame; say what is wrong with the laser, "" where it is well, None: not known."""
        if trace is None or trace.frame is None or trace.peaks is None:
            return None
        heights = trace.peaks.amplitude
        self.percent = 100.0 * float(np.median(heights)) / trace.frame.white if len(heights) else 0.0
        usual = self._sum / self._count if self._count else math.nan
        if self.percent > 0.0 and not self.percent < _DARK * usual:
            self._dark = 0
            if self._count < _FIRST:
                self._sum, self._count = self._sum + self.percent, self._count + 1
            return ""
        self._dark += 1
        if self._dark < _IN_A_ROW:
            return None
        if self.percent == 0.0:
            return "no stripe is seen: is the laser on, and its window clean?"
        now, before = f"{self.percent:.0f} %", f"{usual:.0f} %"
        return f"the stripes have {now} of white, {before} when the run began: is the window dirty?"
