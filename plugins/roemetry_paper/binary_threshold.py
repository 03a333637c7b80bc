"""A fixed binary threshold: what the paper compares its dominant peaks against."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.image_levels import grey, scaled_level
from roemetry_paper.dominant_peak import as_peaks, rise_of


class BinaryThresholdOptions(StageOptions):
    """Options of `BinaryThreshold`."""

    threshold: Annotated[float, Field(ge=0.0, le=255.0)] | Literal["auto"] = Field(
        default=128.0,
        description="grey level (of 0…255, scaled for deeper images) above which a pixel belongs to a "
        "stripe. auto (not the paper's): a quarter of the way from the dark to what the image's stripes "
        "reach, and above the noise",
    )


class BinaryThreshold(Extractor[BinaryThresholdOptions]):
    """Takes the middle of each run of pixels brighter than one fixed grey level (Figures 7 and 9).

    The paper shows it with a high and a low level, to say why it is not enough: a high one loses dim
    stripes, a low one joins neighbours and takes stray light for stripes. Its place is the comparison.

    Ours: the middle of the run stands for the stripe (the paper shows binary images only), so positions are
    whole or half pixels, `x_std_px` not stated. Pixels on the image border are not searched. A run that the
    border cuts off is flagged as being at the edge, since its middle is not known; one that fills the whole
    row shows no stripe and is left out.
    """

    Options: ClassVar[type[StageOptions]] = BinaryThresholdOptions
    capabilities = Capabilities(tolerance_px=0.5)
    expected_failures: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "check_brightness_does_not_matter": "the threshold is a fixed grey level: a stripe is found only "
            "while it is brighter, and the run above the level grows with its brightness",
        }
    )

    def extract(self, frame: Frame) -> Peaks:
        """Find the runs of all rows but the first and the last."""
        # numba: loaded only when something runs
        from roemetry_paper.peak_scans import runs_above

        stated = self.options.threshold
        threshold = level_of(frame) if stated == "auto" else math.floor(scaled_level(stated, frame))
        return as_peaks(frame, runs_above(grey(frame), threshold, white=frame.white))


def level_of(frame: Frame) -> int:
    """Choose a grey level between the dark and the stripes."""
    from roemetry_kernels.image_levels import level_between

    return level_between(grey(frame), rise_of(frame))
