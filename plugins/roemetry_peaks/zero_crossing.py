"""The zero crossing of each stripe's filtered derivative."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_peaks.options import PeakOptions

_BEYOND_LINEAR = 1.0  # see `roemetry_peaks.finding.found`; found by drawing


class ZeroCrossingOptions(PeakOptions):
    """Options of `ZeroCrossing`."""

    half_length: Annotated[int, Field(ge=1, le=64)] | Literal["auto"] = Field(
        default="auto",
        description="pixels to each side that the filter sums over; auto: 1.6 standard deviations of "
        "the stripe",
    )


class ZeroCrossing(Extractor[ZeroCrossingOptions]):
    """Finds where the sum of the pixels to the right equals that of those to the left."""

    Options: ClassVar[type[StageOptions]] = ZeroCrossingOptions
    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        # numba: when something runs
        from roemetry_kernels.extraction.zero_crossing import zero_crossings
        from roemetry_peaks.finding import found

        half_length = 0 if self.options.half_length == "auto" else self.options.half_length
        return found(frame, self.options, zero_crossings, half_length, beyond_linear=_BEYOND_LINEAR)
