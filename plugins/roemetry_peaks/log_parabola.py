"""The parabola through the logarithms at each stripe's top."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_peaks.options import PeakOptions

_BEYOND_LINEAR = 3.0  # see `roemetry_peaks.finding.found`; found by drawing


class LogParabolaOptions(PeakOptions):
    """Options of `LogParabola`."""

    points: Literal["three", "five"] = Field(default="five", description="pixels the parabola goes through")


class LogParabola(Extractor[LogParabolaOptions]):
    """Takes the top of the parabola through the logarithms of three or five pixels."""

    Options: ClassVar[type[StageOptions]] = LogParabolaOptions
    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        # numba: when something runs
        from roemetry_kernels.extraction.log_parabola import log_parabola_centres
        from roemetry_peaks.finding import found

        points = 3 if self.options.points == "three" else 5
        return found(frame, self.options, log_parabola_centres, points, beyond_linear=_BEYOND_LINEAR)
