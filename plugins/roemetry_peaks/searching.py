"""Where an extractor looks for stripes, and what it takes for one: the options that all have."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

from numpy.typing import NDArray
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Frame
from roemetry.records.arrays import Integers
from roemetry.stages import Extractor, StageOptions
from roemetry.stages.kinds import OptionsT
from roemetry_kernels.frame_checks import count_steps, lines_differ

Narrowest = Annotated[
    float, Field(ge=0.0, le=100.0, description="smallest full width at half height, px: rejects hot pixels")
]


class SearchOptions(StageOptions):
    """What counts as a stripe."""

    threshold: Annotated[float, Field(ge=1.0, le=255.0)] | Literal["auto"] = Field(
        default="auto",
        description="grey levels (of 0…255, scaled for deeper images) by which a stripe must rise above the "
        "light on both sides of it; auto: from the image's own noise, and from how high its stripes are",
    )
    width_min_px: Narrowest = 1.5
    width_max_px: float = Field(
        default=40.0, gt=0.0, le=1000.0, description="largest full width at half height, px: rejects glare"
    )
    region: tuple[int, int, int, int] | None = Field(
        default=None,
        description="part of the (turned) image to search: first row, row after the last, first column, "
        "column after the last, px; none: all of it",
    )


class Area(NamedTuple):
    """The part of an image that is searched: rows and columns from the first to the one after the last."""

    top: int
    bottom: int
    left: int
    right: int


def searched(frame: Frame, region: tuple[int, int, int, int] | None) -> Area:
    """Give the part of the frame to search; raise StageError where it does not lie within the frame."""
    rows, columns = frame.size
    if region is None:
        return Area(0, rows, 0, columns)
    top, bottom, left, right = region
    if not (0 <= top < bottom <= rows and 0 <= left < right <= columns):
        raise StageError(
            f"region {list(region)} does not lie within the image of {rows} rows and {columns} columns",
            hint="give first row, row after the last, first column, column after the last",
        )
    return Area(*region)


class RowExtractor(Extractor[OptionsT]):
    """An extractor that measures each row by itself."""

    def rows_apart(self) -> int:
        """Give 0: frames of a scan may lie one below the other."""
        return 0

    def count_steps(self, pixels: NDArray[Any], least: int) -> tuple[Integers, Integers, Integers]:
        """Count steps of the grey level in one pass."""
        return count_steps(pixels, least)

    def lines_differ(self, pixels: NDArray[Any]) -> bool:
        """Say for certain that all lines differ, by a few compiled comparisons."""
        return lines_differ(pixels)
