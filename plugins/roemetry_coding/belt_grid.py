"""Alignment by a grid's lines on the belt: one motion of the camera from both families.

Model. Each family is compared with its own rest lines as `belt-lines` does, the lines across in the image
turned by 90°. Lines that cross rows tell best of a shift along x, those across of a shift along y, and both
of roll and zoom. Their motions θ₁ and θ₂, with covariances C₁ and C₂, are joined by their weights:
C⁻¹ = C₁⁻¹ + C₂⁻¹, θ = C (C₁⁻¹ θ₁ + C₂⁻¹ θ₂).

Assumes what `belt-lines` assumes, and that both families have moved alike: one projector throws both. It
fails where too little belt is seen of either family.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Peaks
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.stages import Aligner, Capabilities
from roemetry_coding.alignment import (
    AlignerOptions,
    FittedMotion,
    alignment_of,
    focal_px_of,
    not_compared,
    refuse_far,
)
from roemetry_coding.belt_lines import (
    BLOCKS,
    LIGHT,
    PEAKS_MIN,
    Fit,
    Model,
    fitted,
    model_of,
    with_planes,
)


class BeltGrid(Aligner[AlignerOptions]):
    """Fits a small motion of the camera to both families of a grid's lines on the belt."""

    Options = AlignerOptions
    capabilities = Capabilities(pattern="grid")

    def align(
        self, peaks: Peaks, calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
    ) -> Alignment:
        """Compare a frame's belt with the calibration.

        Raises
        ------
        StageError
            As by `belt-lines`; or peaks or calibration are not of a grid.
        """
        if peaks.across is None or calibration.across is None:
            what = "peaks are" if peaks.across is None else "calibration is"
            raise StageError(
                f"the {what} of one family of lines, not of a grid",
                hint="set `extractor: grid-lines` and calibrate with pinhole-grid",
            )
        upright, across = _models_of(calibration, moved)
        one, other = fitted(peaks, upright), fitted(peaks.across, across)
        if min(max(fit.used, fit.outer_peaks) for fit in (one, other)) < PEAKS_MIN:
            return not_compared()
        for fit in (one, other):
            refuse_far(fit.outer_peaks, fit.outer_fit, LIGHT)
        joined = _joined((one, upright), (other, across))
        found = alignment_of(joined, self.options, focal_px_of(calibration), LIGHT, 2)
        stripe_px = np.concatenate([one.stripe_px, other.stripe_px])
        return with_planes(found, stripe_px, max(one.sigma_px, other.sigma_px))


def _joined(*families: tuple[Fit, Model]) -> FittedMotion:
    """Join the motions of all families, in units in which each part moves some place of some by a pixel."""
    scales = np.array([model.scale for _, model in families])
    scale = np.where(scales > 0.0, scales, np.inf).min(axis=0)
    information, pull, edges = np.zeros((4, 4)), np.zeros(4), []
    for fit, model in families:
        shown = np.flatnonzero(model.scale > 0.0)  # a part that moves no line is told by others
        per_unit = np.zeros(4)
        per_unit[shown] = scale[shown] / model.scale[shown]
        weight = np.zeros((4, 4))
        # of few lines the scatter about what was fitted to them is too small: as of n numbers by n − 4
        groups = model.lines.shape[1] + BLOCKS
        few = groups / max(groups - 4, 1)
        weight[np.ix_(shown, shown)] = np.linalg.inv(few * fit.covariance[np.ix_(shown, shown)])
        weight *= per_unit[:, None]
        pull += weight @ fit.motion
        information += weight * per_unit
        edges.append(model.edges * per_unit)
    covariance: Floats = np.asarray(np.linalg.inv(information), np.float64)
    return FittedMotion(covariance @ pull, covariance, np.vstack(edges), scale)


@lru_cache(maxsize=8)
def _models_of(
    calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
) -> tuple[Model, Model]:
    """Move the calibration to and fro, and keep what either family's lines do."""

    def across(made: Calibration, by: Alignment) -> Calibration:
        """Give the lines across of the moved calibration; `made` are those of the one that is moved."""
        found = moved(calibration, by).across
        assert found is not None
        return found

    assert calibration.across is not None
    return model_of(calibration, moved), model_of(calibration.across, across)
