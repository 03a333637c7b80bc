"""Circles, traced as curves, where they cross image rows.

Model. A circle's left and right halves cross rows as stripes do, and are measured in each row by
`gaussian`. A curve that leans by s pixels a row is √(1 + s²) times as wide along the row as across
itself, and so is the uncertainty of its place: a place along the row says of the curve what one along its
normal would. Peaks are joined from row to row; where a curve's slope over nine rows is steeper than 60°
from upright, near the top and the bottom of a circle, it runs as the rows do: those peaks are left out,
and so are pieces of few rows.

Along a row the light of a curve that bends falls more steeply on its outside. With the distance from the
curve d = u cos θ + u² sin² θ / 2R, u along the row, the Gaussian exp(−d² / 2σ²) has a cubic term that
shifts the fitted place inwards by κ sin² θ σ² x″, for x″ = 1 / (R cos³ θ) the bend of x over rows. Where
the fit weighs pixels by their light κ is 1.5, by its square 0.75: `gaussian` is near the first where it knows
the sensor, near the second where not. It is taken off, and counts as uncertain by as much.

It fails where circles stand nearer together than three of their widths. Source: our own.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Floats, Integers
from roemetry.records.view import STEEP_MAX
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.tracing import trace_fragments
from roemetry_peaks.gaussian import Gaussian, GaussianOptions
from roemetry_peaks.peak_window import FWHM_OF_SIGMA

_STEP_PX = 3.0
"""From row to row, by which a curve that is not too steep moves, and one that noise moves a pixel more."""
_HALF_ROWS = 4
"""To both sides, over which a slope is taken: noise of 0.2 px makes it wrong by 0.03."""
_INWARDS_UNKNOWN, _INWARDS_KNOWN = 0.8, 1.5
"""κ, see above, where the sensor is not known and where it is: of 386 places of drawn circles and 1,148
places on the belt of rendered ones, whose speckle lets bright pixels weigh no more."""
_BENT_MAX_PX = 0.15
"""sin² θ σ² x″, px, beyond which the shift's first order no longer holds."""
_INWARDS_STD = 1.0
"""Of what is taken off, that it may be wrong by: on bodies whose light falls off across the curve κ is
2.5 to 4."""
_LEAST_ROWS = 5
"""Shorter pieces are glints, or the ends of a circle."""


class CircleCurvesOptions(StageOptions):
    """What counts as a circle."""

    threshold: Annotated[float, Field(ge=1.0, le=255.0)] | Literal["auto"] = Field(
        default="auto",
        description="grey levels (of 0…255, scaled for deeper images) by which a circle must rise above the "
        "light beside it; auto: from the image's own noise, and from how high its curves are",
    )
    width_max_px: float = Field(
        default=16.0, gt=2.0, le=100.0, description="largest full width at half height along a row, px"
    )


class CircleCurves(Extractor[CircleCurvesOptions]):
    """Traces the halves of circles across rows, as far as rows tell where they are."""

    capabilities = Capabilities(tolerance_px=0.1, saturated_tolerance_px=0.3, pattern="circles")

    def extract(self, frame: Frame) -> Peaks:
        """Find where circles cross the rows of a frame."""
        given = self.options
        peaks = Gaussian(GaussianOptions(threshold=given.threshold, width_max_px=given.width_max_px)).extract(
            frame
        )
        piece, _ = trace_fragments(peaks.row_start, peaks.x_px, _STEP_PX)
        slope, bend, rows = _slopes(piece, peaks.x_px)
        sigma_px = peaks.width_px / FWHM_OF_SIGMA
        inwards = _INWARDS_UNKNOWN if frame.sensor is None else _INWARDS_KNOWN
        with np.errstate(invalid="ignore"):
            # σ across the curve is cos θ times that along the row, and sin² θ cos² θ = s² / (1 + s²)²
            bent_px = (slope * sigma_px / (1.0 + slope**2)) ** 2 * bend
            good = (np.abs(slope) <= STEEP_MAX) & (np.abs(bent_px) <= _BENT_MAX_PX)
        inwards_px = inwards * bent_px
        kept = np.flatnonzero(good & (rows >= _LEAST_ROWS))
        x_px = np.clip(peaks.x_px - inwards_px, -0.5, frame.size[1] - 0.5)[kept]
        order = np.lexsort((x_px, peaks.row[kept]))
        kept, x_px = kept[order], x_px[order]
        x_std_px = np.hypot(peaks.x_std_px[kept], _INWARDS_STD * inwards_px[kept])
        return peaks.some(kept, x_px=x_px, x_std_px=x_std_px)


def _slopes(piece: Integers, x_px: Floats) -> tuple[Floats, Floats, Integers]:
    """Give (peak,) slope, px a row, bend, px a row², and number of rows of the piece each peak is on."""
    count = np.bincount(piece, minlength=1)
    order = np.argsort(piece, kind="stable")  # peaks come by row, so within a piece they stay in order
    first = (np.cumsum(count) - count)[piece[order]]
    last = first + count[piece[order]] - 1
    here = np.arange(piece.size)
    before, after = np.maximum(here - _HALF_ROWS, first), np.minimum(here + _HALF_ROWS, last)
    x = x_px[order]
    slope, bend = np.full(piece.size, np.inf), np.zeros(piece.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope[order] = (x[after] - x[before]) / (after - before)
    # of a piece's ends the bend is that of the nearest place with rows on both sides
    middle = np.clip(here, np.minimum(first + _HALF_ROWS, last), np.maximum(last - _HALF_ROWS, first))
    reach = np.minimum(_HALF_ROWS, np.minimum(middle - first, last - middle))
    # second differences over up to four rows
    curved = x[middle + reach] - 2.0 * x[middle] + x[middle - reach]
    bend[order] = curved / np.maximum(reach, 1) ** 2
    return np.nan_to_num(slope, nan=np.inf), bend, count[piece]
