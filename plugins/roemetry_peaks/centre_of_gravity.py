"""The centre of gravity of each stripe's profile, background removed."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_peaks.options import PeakOptions

_BEYOND_LINEAR = 3.5  # see `roemetry_peaks.finding.found`; found by drawing


class CentreOfGravityOptions(PeakOptions):
    """Options of `CentreOfGravity`."""

    reach_sigmas: float = Field(
        default=2.5,
        ge=1.5,
        le=4.0,
        description="what is summed over, to both sides of the centre: standard deviations of the stripe",
    )


class CentreOfGravity(Extractor[CentreOfGravityOptions]):
    """Takes the centre of gravity of the grey levels above the background, in a window around it."""

    Options: ClassVar[type[StageOptions]] = CentreOfGravityOptions
    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        # numba: when something runs
        from roemetry_kernels.extraction.centre_of_gravity import centres_of_gravity
        from roemetry_peaks.finding import found

        return found(
            frame, self.options, centres_of_gravity, self.options.reach_sigmas, beyond_linear=_BEYOND_LINEAR
        )
