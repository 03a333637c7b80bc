"""How a camera has moved over the belt, from circles on it: as `belt-lines` from lines.

Circles tell more of a motion than lines, for they bend: a shift along their halves is seen, too. All halves
come from one point round one axis, so none moves against the others, and none is corrected alone: where
halves lie beside the best motion, columns of the image are lost, or camera and light are not as calibrated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Peaks
from roemetry.records.arrays import Floats
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
_HALVES_PX = 0.045
"""Median of the halves' distances from where the motion takes them: at most 0.016 of twelve potatoes, sound,
noisy, dim, out of focus, JPEG or moved by 1 px, and 0.032 moved by 3 px; 0.054 to 0.113 where one column is
lost, which shifts all halves, and volumes are up to 4 % off. A mean would be that of one half, of which a
product leaves little."""
_HALVES_MIN = 4
"""Halves on the belt that tell it: as many as a motion has numbers."""


class BeltCircles(Aligner[AlignerOptions]):
    """Fits a small motion of the camera to the belt's circles."""

    capabilities = Capabilities(pattern="circles")

    def align(
        self, peaks: Peaks, calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
    ) -> Alignment:
        """Compare a frame's belt with the calibration.

        Raises
        ------
        StageError
            The circles have moved too far, or their halves fit no motion.
        """
        model = model_of(calibration, moved)
        fit = fitted(peaks, model)
        # refused before "not compared": light that fits nowhere is worse than too little of it
        if fit.outer_peaks >= PEAKS_MIN:
            refuse_far(fit.outer_peaks, fit.outer_fit, _LIGHT)
        if fit.used < PEAKS_MIN:
            return not_compared()
        # halves cannot move alone: they share an apex and an axis
        _refuse_halves_apart(fit.stripe_px)
        motion = FittedMotion(fit.motion, fit.covariance, model.edges, model.scale)
        return alignment_of(motion, self.options, focal_px_of(calibration), _LIGHT, 2)


def _refuse_halves_apart(half_px: Floats) -> None:
    """Refuse a frame by the mean distances (half,) from where the motion takes halves, px; NaN: not known."""
    known_px = half_px[np.isfinite(half_px)]
    apart_px = float(np.median(np.abs(known_px))) if known_px.size >= _HALVES_MIN else 0.0
    if apart_px > _HALVES_PX:
        raise StageError(
            f"halves of circles on the belt lie {apart_px:.2f} px (median) beside the calibrated ones, which "
            "no motion of the camera explains: columns of the image are lost, or it is another rig",
            hint="look at the image; take it again, or calibrate again",
        )
