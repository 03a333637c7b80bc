"""Alignment by a grid's lines on the belt: one motion of the camera from both families.

Model. Each family is compared with its own rest lines as `belt-lines` does, the lines across in the image
turned by 90°. Lines that cross rows tell best of a shift along x, those across of a shift along y, and both
of roll and zoom. Their motions θ₁ and θ₂, with covariances C₁ and C₂, are joined by their weights:
C⁻¹ = C₁⁻¹ + C₂⁻¹, θ = C (C₁⁻¹ θ₁ + C₂⁻¹ θ₂).

Assumes what `belt-lines` assumes, and that both families have moved alike: one projector throws both; where
they have not, the frame is refused. It fails where too little belt is seen of either family, and does not
look for torn frames: where lines cross, stripes bend as they do at a tear.
"""

from __future__ import annotations

import math
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
    Light,
    alignment_of,
    focal_px_of,
    not_compared,
    refuse_far,
)
from roemetry_coding.belt_lines import (
    LIGHT,
    PEAKS_MIN,
    Fit,
    Model,
    fitted,
    model_of,
    with_planes,
)

_LIGHT_ACROSS = Light("lines across", "the calibrated rest lines", "image's left and right")
_LINES_MIN = 3
"""Lines of a family that tell a zoom from a shift: of a cross hair each family has one."""
_KNOWN_PX = 0.01
"""No better than that a family's motion is known: noise of few lines may agree by chance."""
_APART, _APART_PX = 5.0, 0.5
"""Standard deviations, and px, by which both families' motions may differ from the joined one."""


class BeltGrid(Aligner[AlignerOptions]):
    """Fits a small motion of the camera to both families of a grid's lines on the belt."""

    capabilities = Capabilities(pattern="grid")

    def align(
        self, peaks: Peaks, calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
    ) -> Alignment:
        """Compare a frame's belt with the calibration.

        Raises
        ------
        StageError
            As by `belt-lines`, but for torn frames; both families have moved differently; or peaks or
            calibration are not of a grid.
        """
        if peaks.across is None or calibration.across is None:
            what = "peaks are" if peaks.across is None else "calibration is"
            raise StageError(
                f"the {what} of one family of lines, not of a grid",
                hint="set `extractor: grid-lines` and calibrate with pinhole-grid",
            )
        upright, across = _models_of(calibration, moved)
        one, other = fitted(peaks, upright), fitted(peaks.across, across)
        families = ((one, upright, LIGHT), (other, across, _LIGHT_ACROSS))
        for fit, _, light in families:
            if fit.outer_peaks >= PEAKS_MIN:
                refuse_far(fit.outer_peaks, fit.outer_fit, light)
        # fewer lines of one family leave zoom and shift apart by nothing
        fewest = min(model.lines.shape[1] for _, model, _ in families)
        if min(one.used, other.used) < PEAKS_MIN or fewest < _LINES_MIN:
            return not_compared()
        joined, moved_px = _joined((one, upright), (other, across))
        found = alignment_of(joined, self.options, focal_px_of(calibration), LIGHT, 2)
        planes = (
            # single planes are told against the joined motion: what its own fit put elsewhere is added back
            (fit.stripe_px + off_px, fit.sigma_px, light)
            for (fit, _, light), off_px in zip(families, moved_px, strict=True)
        )
        return with_planes(found, *planes)


def _joined(*families: tuple[Fit, Model]) -> tuple[FittedMotion, list[Floats]]:
    """Join the motions of all families, in units in which each part moves some place of some by a pixel.

    Beside it stands, of each family, (line,) px that its own motion takes its lines on the mean farther than
    the joined one does. StageError where the families' motions differ.
    """
    scales = np.array([model.scale for _, model in families])
    # the finer of both units: no part moves any place by more than a pixel
    scale = np.where(scales > 0.0, scales, np.inf).min(axis=0)
    information, pull, parts = np.zeros((4, 4)), np.zeros(4), []
    for fit, model in families:
        # a part that moves no line is told by others
        per_unit = np.where(model.scale > 0.0, scale / np.maximum(model.scale, 1e-300), 0.0)
        # of few lines the scatter about what was fitted to them is too small: as of n numbers by n − 4
        lines = model.lines.shape[1]
        stated = fit.covariance * lines / max(lines - 4, 1) + _KNOWN_PX**2 * np.eye(4)
        weight = np.linalg.inv(stated) * per_unit[:, None]
        pull += weight @ fit.motion
        information += weight * per_unit
        parts.append((per_unit, stated))
    # information adds; the covariance of the joined motion is its inverse
    covariance: Floats = np.asarray(np.linalg.inv(information), np.float64)
    motion = covariance @ pull
    edges, moved_px = [], []
    for (fit, model), (per_unit, stated) in zip(families, parts, strict=True):
        # how far each family is from the joined motion, by its own uncertainty and in px
        apart = np.where(per_unit > 0.0, fit.motion - per_unit * motion, 0.0)
        off = math.sqrt(max(float(apart @ np.linalg.solve(stated, apart)), 0.0))
        most_px = float(np.abs(model.edges @ apart).max())
        if off > _APART and most_px > _APART_PX:
            raise StageError(
                f"the two families of a grid's lines have moved differently, by up to {most_px:.1f} px",
                hint="were both calibrated with this projector, and is it fastened? Calibrate again",
            )
        edges.append(model.edges * per_unit)
        moved_px.append(np.nanmean(model.answer, axis=0) @ apart)
    return FittedMotion(motion, covariance, np.vstack(edges), scale), moved_px


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
