"""Options of every calibration from boards, whatever the light's pattern."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from roemetry.stages import StageOptions


class BoardOptions(StageOptions):
    """What is looked for, and what of a board's print is used."""

    lens: Literal["none", "radial", "brown", "rational"] = Field(
        default="brown",
        description="lens model: none; k1 k2; k1 k2 p1 p2 k3; or with k4 k5 k6 for very wide angles",
    )
    print_contrast_max: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="largest contrast of the print under the light, (light − dark)/(light + dark), to use it",
    )
    height_max_mm: float | None = Field(
        default=None, gt=0, description="greatest height to be measured, mm; none: what the boards reached"
    )
