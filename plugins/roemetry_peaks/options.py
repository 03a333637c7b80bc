"""Options that the extractors share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from roemetry.stages import StageOptions


class PeakOptions(StageOptions):
    """What counts as a stripe."""

    threshold: Annotated[float, Field(ge=1.0, le=255.0)] | Literal["auto"] = Field(
        default="auto",
        description="grey levels (of 0…255, scaled for deeper images) by which a stripe must rise above the "
        "lowest level before it and fall again; auto: from the image's own noise, and from how high "
        "its stripes are",
    )
    width_min_px: float = Field(
        default=1.5,
        ge=0.0,
        le=100.0,
        description="smallest full width at half height, px: rejects hot pixels",
    )
    width_max_px: float = Field(
        default=40.0, gt=0.0, le=1000.0, description="largest full width at half height, px: rejects glare"
    )
    region: tuple[int, int, int, int] | None = Field(
        default=None,
        description="part of the (turned) image to search: first row, row after the last, first column, "
        "column after the last, px; none: all of it",
    )
    speckle_contrast: Annotated[float, Field(ge=0.0, le=1.0)] | Literal["auto"] = Field(
        default="auto",
        description="standard deviation of the light over its mean, from the laser's speckle; auto: from how "
        "much the stripes jump from row to row",
    )
    speckle_length_px: float = Field(
        default=0.8,
        gt=0.0,
        le=4.0,
        description="correlation length of the speckle, px: the standard deviation of the Gaussian that "
        "white noise would have to be smoothed with to look like it",
    )
