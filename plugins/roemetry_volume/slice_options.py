"""Options of the slice estimators."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from roemetry_volume.underside import UndersideOptions

Ends = Literal["taper", "hold", "none"]


class SliceOptions(UndersideOptions):
    """Options of estimators from slices."""

    ends: Ends = Field(
        default="taper",
        description="beyond the outer slices: by their taper, or their area held half a spacing, or nothing",
    )


class SliceSumOptions(SliceOptions):
    """Options of the plain sum."""

    ends: Ends = Field(
        default="hold",
        description="beyond the outer slices: by their taper, or their area held half a spacing, or nothing",
    )
