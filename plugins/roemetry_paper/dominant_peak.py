"""The dominant peak of section 3.2: one peak a stripe, however rough its profile."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.image_levels import grey, plain_layout, scaled_level

if TYPE_CHECKING:
    from roemetry_paper.peak_scans import Scan


class DominantPeakOptions(StageOptions):
    """Options of `DominantPeak`."""

    threshold: Annotated[float, Field(ge=0.0, le=255.0)] | Literal["auto"] = Field(
        default=100.0,
        description="grey levels (of 0…255, scaled for deeper images) by which a peak must exceed the "
        "valleys before and after it; one that exceeds them by just as much does not count. auto (not the "
        "paper's): from the image's own noise, and from how high its stripes are",
    )
    start: Literal["fixed", "lowest"] = Field(
        default="fixed",
        description="what counts as the valley before a peak. fixed: where the last peak ended (at first the "
        "row's first pixel), as the paper has it. lowest: the lowest valley since then",
    )


class DominantPeak(Extractor[DominantPeakOptions]):
    """Finds peaks that exceed the valleys on both sides by a threshold (Lee et al. 2000, section 3.2).

    Along a row, a maximum is a pixel not lower than the one before and higher than the one after; a minimum
    is one lower than the one before and not higher than the one after. The search goes left to right: its
    start is at first the row's first pixel, its end the minimum after the first maximum. The highest
    maximum between them is dominant if it exceeds both by more than the threshold; then the end becomes the
    next start. Else the end moves on to the next minimum. Of several equal maxima the leftmost counts.

    Decided where the paper is silent: behind the last minimum the row's last pixel is an end. Criterion 1 is
    printed as a difference between the two minima; it is read as between the peak and each of them.

    What to know before trusting it:

    - Positions are whole pixels, `x_std_px` is not stated.
    - The last pixel of a plateau counts, so a saturated stripe is reported 1 to 4 px to the right of its
      middle. That is millimetres of height, unless belt and product saturate alike.
    - With ``start: fixed`` the start keeps its grey level however dark the row gets after it. A stripe to
      the right of a bright image border, or of a step halfway down another stripe's slope, is lost
      unless it exceeds that level too. ``start: lowest`` mends this; it is a peak search with hysteresis.
    - The threshold is fixed: stripes dimmer than it are lost. ``threshold: auto`` mends this.
    """

    Options: ClassVar[type[StageOptions]] = DominantPeakOptions
    capabilities = Capabilities(tolerance_px=0.55, saturated_tolerance_px=3.0)
    expected_failures: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "check_brightness_does_not_matter": "the threshold is a fixed number of grey levels: a stripe "
            "that rises less above its valleys is lost, and comes back in a brighter image",
        }
    )

    def extract(self, frame: Frame) -> Peaks:
        """Find the dominant peaks of all rows but the first and the last."""
        # numba: loaded only when something runs
        from roemetry_paper.peak_scans import dominant_peaks

        stated, pixels = self.options.threshold, grey(frame)
        threshold = rise_of(frame) if stated == "auto" else math.floor(scaled_level(stated, frame))
        lowest = self.options.start == "lowest"
        scan = dominant_peaks(pixels, threshold, lowest=lowest, white=frame.white)
        return as_peaks(frame, without_faint(scan) if stated == "auto" else scan)


def rise_of(frame: Frame) -> int:
    """Choose by how much a peak must rise, from the image's noise, grey levels."""
    from roemetry_kernels.image_levels import automatic_rise

    rows, columns = frame.size
    return automatic_rise(plain_layout(grey(frame)), frame.white, 0, rows, 0, columns)


def without_faint(scan: Scan) -> Scan:
    """Leave out what is low beside the image's other peaks."""
    from roemetry_kernels.image_levels import SHARE_MIN, faint

    kept = ~faint(scan.row, scan.x_px, scan.amplitude, SHARE_MIN)
    return scan if kept.all() else type(scan)._make(values[kept] for values in scan)


def as_peaks(frame: Frame, scan: Scan) -> Peaks:
    """Make the record of what a scan found in the frame; the scans do not model an uncertainty of x."""
    from roemetry_kernels.image_levels import doubts

    reasons = doubts(frame.pixels, frame.white, scan.row, scan.x_px, scan.width_px)
    unsaid = np.full(scan.row.shape[0], np.nan)
    return Peaks(image_size=frame.size, x_std_px=unsaid, reasons=reasons, **scan._asdict())
