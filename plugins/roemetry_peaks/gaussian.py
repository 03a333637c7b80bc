"""The Gaussian sub-pixel peak of each stripe."""

from __future__ import annotations

from typing import ClassVar

from roemetry.records import Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_peaks.options import PeakOptions

_BEYOND_LINEAR = 7.0  # see `roemetry_peaks.finding.found`; found by drawing


class GaussianOptions(PeakOptions):
    """Options of `Gaussian`."""


class Gaussian(Extractor[GaussianOptions]):
    """Fits a Gaussian by weighted least squares on the logarithms of the grey levels."""

    Options: ClassVar[type[StageOptions]] = GaussianOptions
    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        # numba: when something runs
        from roemetry_kernels.extraction.gaussian_fit import gaussian_centres
        from roemetry_peaks.finding import found

        return found(frame, self.options, gaussian_centres, weighs_speckle=True, beyond_linear=_BEYOND_LINEAR)
