"""Where an extractor looks for stripes, and what it takes for one: the options that all have.

For the core's check for joined frames it counts steps of the grey level. The core has no compiled code, and
whole arrays of numpy pass ten times over all pixels. Here each pixel is fetched once, in numbers as narrow as
the pixels are, and pieces of rows that are dark throughout are passed over.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Frame
from roemetry.records.arrays import Integers
from roemetry.stages import Extractor, StageOptions
from roemetry.stages.kinds import OptionsT
from roemetry_kernels.compiling import kernel
from roemetry_kernels.differing_lines import lines_differ
from roemetry_kernels.image_levels import plain_layout

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


_BAND = 16  # rows that are looked at together: what is found in a column of them fits into a byte
_WORD = 8  # columns that are asked at once whether one of them is lit


def count_steps(pixels: NDArray[Any], least: int) -> tuple[Integers, Integers, Integers]:
    """Count steps by more than `least` at each boundary between two rows, and between two columns.

    Parameters
    ----------
    pixels
        (row, column) grey levels of 8 or 16 bits.
    least
        Grey levels.

    Returns
    -------
    tuple
        (rows − 1,) steps from row to row; (columns − 1,) from column to column; and (columns − 1,) those of
        the latter that may be a break of the image: from the pixel before to that after, the grey level
        changes by no more than one and a half steps. The first and the last of these mean nothing.
    """
    plain = plain_layout(pixels)
    rows, columns = plain.shape
    by_row, by_column, breaks = (np.zeros(many, np.int64) for many in (rows, columns, columns))
    steps = _steps_of_bytes if plain.dtype == np.uint8 else _steps_of_pairs
    steps(plain, least, by_row, by_column, breaks)
    return by_row[1:], by_column[:-1], breaks[:-1]


def _counting_made(kind: type[np.unsignedinteger[Any]]) -> Any:
    """Compile the counting for pixels of one type: in wider numbers it would take several times as long."""

    @kernel
    def count(
        pixels: NDArray[Any], least: int, by_row: Integers, by_column: Integers, breaks: Integers
    ) -> None:
        """Add to the counts of each row and column; see `count_steps`."""
        rows, columns = pixels.shape
        high, low = np.zeros(columns + 1, kind), np.zeros(columns + 1, kind)
        steep, broken = np.empty(columns, kind), np.empty(columns, kind)
        lit = np.zeros(-(-columns // _WORD) * _WORD, np.uint8)
        words = lit.view(np.uint64)
        enough, one, two, three, four = kind(least), np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
        wide = np.uint64(columns)
        x: Any
        y: Any
        for band in range(0, rows, _BAND):
            first, end = np.uint64(max(band - 1, 0)), np.uint64(min(band + _BAND, rows))
            for x in range(wide):
                high[x] = low[x] = pixels[first, x]
            y = first + one
            while y + three < end:  # four rows at a time: what is compared stays in registers
                for x in range(wide):
                    a, b, c, d = pixels[y, x], pixels[y + one, x], pixels[y + two, x], pixels[y + three, x]
                    high[x] = max(high[x], max(max(a, b), max(c, d)))
                    low[x] = min(low[x], min(min(a, b), min(c, d)))
                y += four
            while y < end:
                for x in range(wide):
                    high[x], low[x] = max(high[x], pixels[y, x]), min(low[x], pixels[y, x])
                y += one
            high[wide], low[wide] = high[wide - one], low[wide - one]
            # two columns that differ by no more over all of the band hold no step
            for x in range(wide):
                most, lowest = max(high[x], high[x + one]), min(low[x], low[x + one])
                lit[x] = kind(most - lowest) > enough
            # only from the first such word to the last
            begin, last = 0, words.shape[0]
            while begin < last and words[begin] == 0:
                begin += 1
            while last > begin and words[last - 1] == 0:
                last -= 1
            if begin == last:
                continue
            left, right = np.uint64(begin * _WORD), min(last * _WORD, columns)
            for y in range(first + one, end):
                found = 0
                for x in range(left, np.uint64(right)):
                    here, above = pixels[y, x], pixels[y - one, x]
                    found += kind(max(here, above) - min(here, above)) > enough
                by_row[y] += found
            for x in range(left, np.uint64(right)):
                steep[x] = broken[x] = 0
            inner, outer = np.uint64(max(begin * _WORD, 1)), np.uint64(max(min(right, columns - 2), 0))
            for y in range(np.uint64(band), end):
                for x in range(left, np.uint64(min(right, columns - 1))):
                    here, after = pixels[y, x], pixels[y, x + one]
                    steep[x] = kind(steep[x] + kind(kind(max(here, after) - min(here, after)) > enough))
                for x in range(inner, outer):
                    here, after = pixels[y, x], pixels[y, x + one]
                    before, beyond = pixels[y, x - one], pixels[y, x + two]
                    step = kind(max(here, after) - min(here, after))
                    far = kind(max(before, beyond) - min(before, beyond))
                    more = kind(max(far, step) - step)
                    breaks_off = kind(step > enough) & kind(more <= kind(step >> kind(1)))
                    broken[x] = kind(broken[x] + breaks_off)
            for x in range(left, np.uint64(right)):
                by_column[x] += steep[x]
                breaks[x] += broken[x]

    return count


_steps_of_bytes = _counting_made(np.uint8)
_steps_of_pairs = _counting_made(np.uint16)
