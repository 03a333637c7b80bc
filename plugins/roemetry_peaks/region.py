"""The part of a frame that is searched."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roemetry.errors import StageError
from roemetry.records import Frame

if TYPE_CHECKING:
    from roemetry_peaks.peak_scan import Area


def searched(frame: Frame, region: tuple[int, int, int, int] | None) -> Area:
    """Give the part of the frame to search; raise StageError where it does not lie within the frame."""
    from roemetry_peaks.peak_scan import Area

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
