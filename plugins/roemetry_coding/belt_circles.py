"""How a camera has moved over the belt, from circles on it: as `belt-lines` from lines.

Circles tell more of a motion than lines, for they bend: a shift along their halves is seen, too. All halves
come from one point round one axis, so none moves against the others, and none is corrected alone.
"""

from __future__ import annotations

from collections.abc import Callable

from roemetry.records import Peaks
from roemetry.records.calibration import Alignment, Calibration
from roemetry.stages import Aligner, Capabilities
from roemetry_coding.alignment import (
    AlignerOptions,
    FittedMotion,
    Light,
    alignment_of,
    focal_px_of,
    not_compared,
    refuse_far,
)
from roemetry_coding.belt_lines import PEAKS_MIN, fitted, model_of

_LIGHT = Light("circles", "the calibrated ones", "image's top and bottom")


class BeltCircles(Aligner[AlignerOptions]):
    """Fits a small motion of the camera to the belt's circles."""

    Options = AlignerOptions
    capabilities = Capabilities(pattern="circles")

    def align(
        self, peaks: Peaks, calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
    ) -> Alignment:
        """Compare a frame's belt with the calibration; StageError where the circles have moved too far."""
        model = model_of(calibration, moved)
        fit = fitted(peaks, model)
        if fit.outer_peaks >= PEAKS_MIN:
            refuse_far(fit.outer_peaks, fit.outer_fit, _LIGHT)
        if fit.used < PEAKS_MIN:
            return not_compared()
        motion = FittedMotion(fit.motion, fit.covariance, model.edges, model.scale)
        return alignment_of(motion, self.options, focal_px_of(calibration), _LIGHT, 2)
