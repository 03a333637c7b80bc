"""Every local maximum: the simple peak search that the paper sets out from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.image_levels import grey, scaled_level
from roemetry_paper.binary_threshold import level_of
from roemetry_paper.dominant_peak import as_peaks


class LocalMaximumOptions(StageOptions):
    """Options of `LocalMaximum`."""

    floor: Annotated[float, Field(ge=0.0, le=255.0)] | Literal["auto"] = Field(
        default=0.0,
        description="grey level (of 0…255, scaled for deeper images) which a maximum must reach to count. "
        "auto (not the paper's): a quarter of the way from the dark to what the image's stripes reach, and "
        "above the noise",
    )


class LocalMaximum(Extractor[LocalMaximumOptions]):
    """Takes every maximum of a row (Lee et al. 2000, section 3.2, step 1).

    A maximum is a pixel not lower than the one before it and higher than the one after it. One stripe gives
    several, and so does the dark between stripes: noise alone makes about one pixel in three a maximum.
    That is what the paper shows it for; as an extractor its place is the comparison. Positions are whole
    pixels, `x_std_px` is not stated. A step halfway down a slope is a maximum too, with amplitude 0.
    """

    Options: ClassVar[type[StageOptions]] = LocalMaximumOptions
    capabilities = Capabilities(tolerance_px=0.55, saturated_tolerance_px=3.0)
    expected_failures: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "check_dark_rows_give_nothing": "every maximum counts, those of the noise in the dark too: about "
            "one pixel in three is one",
        }
    )

    def extract(self, frame: Frame) -> Peaks:
        """Find the maxima of all rows but the first and the last."""
        # numba: loaded only when something runs
        from roemetry_paper.peak_scans import local_maxima

        stated = self.options.floor
        floor = level_of(frame) if stated == "auto" else math.ceil(scaled_level(stated, frame))
        return as_peaks(frame, local_maxima(grey(frame), floor, white=frame.white))
