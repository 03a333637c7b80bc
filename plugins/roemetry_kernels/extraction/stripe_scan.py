"""The search for stripes along image rows: peaks that rise and fall by a threshold, compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_kernels.extraction.lane_steps import (
    CHUNK,
    LANES,
    WORD,
    Words,
    gather,
    steps_of_bytes,
    steps_of_pairs,
    turn_bytes,
    turn_pairs,
    turn_tile_of_bytes,
    turn_tile_of_pairs,
)

Pixels = NDArray[Any]
Places = NDArray[np.int32]

_PEAKS_A_ROW = 32  # room made at first


class Area(NamedTuple):
    """The part of an image that is searched: rows and columns from the first to the one after the last."""

    top: int
    bottom: int
    left: int
    right: int


class Tops(NamedTuple):
    """Tops of peaks, sorted by row, then column.

    Attributes
    ----------
    row : ndarray of int32, shape (peak,)
        Image row.
    first, last : ndarray of int32, shape (peak,)
        Columns of the first and the last pixel of the top: the same unless it is a plateau.
    """

    row: Places
    first: Places
    last: Places


def stripe_tops(image: Pixels, threshold: int, area: Area) -> Tops:
    """Find the peaks of each row that rise and fall by more than `threshold` grey levels.

    From the row's first pixel on, the lowest level is kept until a pixel exceeds it by more than the
    threshold; from there on the highest level is kept until a pixel falls below it by more than the
    threshold. That ends a peak, whose top is the leftmost run of pixels at its highest level, and the search
    begins anew. A stripe that the area's border cuts off before it has fallen is not found.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels, contiguous and read-only (`roemetry_kernels.extraction.grey_levels.plain_layout`).
    threshold
        Grey levels; a difference equal to it is not enough.
    area
        What is searched.
    """
    room = _PEAKS_A_ROW * (area.bottom - area.top)
    scan = _scan_bytes if image.dtype == np.uint8 else _scan_pairs
    threshold = min(threshold, int(np.iinfo(image.dtype).max) - 1)
    words, top, left = _as_words(image, area)
    while True:
        row, first, last = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32)
        count = scan(words, top, left, image.reshape(-1), image.shape[1], threshold, *area, row, first, last)
        if count <= room:
            return Tops(row[:count], first[:count], last[:count])
        room = count


def _as_words(image: Pixels, area: Area) -> tuple[Words, int, int]:
    """View the image in words, and give row and word where the area begins; a copy where that cannot be."""
    size = image.dtype.itemsize
    if (image.shape[1] * size) % WORD == 0 and (area.left * size) % WORD == 0:
        words = image.view(np.uint64)
        if words.flags.aligned:
            return words, area.top, area.left * size // WORD
    part = image[area.top : area.bottom, area.left : area.right]
    whole = -(-part.shape[1] * size // WORD) * WORD // size
    padded = np.zeros((part.shape[0], whole), image.dtype)
    padded[:, : part.shape[1]] = part
    words = padded.view(np.uint64)
    words.flags.writeable = False
    return words, 0, 0


def _made(kind: type[np.unsignedinteger[Any]]) -> Any:
    """Compile the search for pixels of one type."""
    of_bytes = kind is np.uint8
    tile = WORD // np.dtype(kind).itemsize
    full = np.iinfo(kind).max
    bits_a_pixel = np.uint64(8 * WORD // tile)
    one_pixel, one_tile, one, groups = (
        np.uint64(full),
        np.uint64(tile),
        np.uint64(1),
        np.uint64(LANES // tile),
    )
    # A word's pixels with the value 1 each, their highest bits, their other bits, and where the last begins.
    units = np.uint64(((1 << 8 * WORD) - 1) // full)
    high_bits, last_pixel = units << np.uint64(8 * WORD // tile - 1), np.uint64(8 * WORD) - bits_a_pixel
    low_bits = ~high_bits

    @kernel
    def scan(
        words: Words,
        first_row: int,
        first_word: int,
        pixels: Pixels,
        length: int,
        threshold: int,
        top: int,
        bottom: int,
        left: int,
        right: int,
        row: Places,
        first: Places,
        last: Places,
    ) -> int:
        """Search the area; gives the number of peaks, also of those there is no room for."""
        gathered = np.zeros(LANES * CHUNK // tile, np.uint64)
        turned = np.empty(LANES * CHUNK // tile, np.uint64)
        levels = turned.view(kind)
        ended_words = np.empty(LANES * CHUNK // tile, np.uint64)
        ended = ended_words.view(kind)
        extreme, falling, top_here = np.empty(LANES, kind), np.empty(LANES, kind), np.empty(LANES, kind)
        top_before = np.empty(LANES, np.int32)
        start = np.empty(LANES + 1, np.uint64)
        ends_in, of_lane = np.empty(groups, np.uint64), np.empty(one_tile, np.uint64)
        columns = right - left
        line, pitch = words.reshape(-1), words.shape[1]
        lane = np.empty(LANES * (columns // 2 + 1) + 1, np.int16)
        tops = np.empty(LANES * (columns // 2 + 1) + 1, np.int32)
        count: Any = 0
        for y in range(top, bottom, LANES):
            rows = min(LANES, bottom - y)
            # A lane's first pixel is its lowest level; lanes without a row see black.
            gathered[:] = 0
            extreme[:] = full
            falling[:] = 0
            top_before[:] = left
            start[:] = 0
            found: Any = np.uint64(0)
            for x in range(0, columns, CHUNK):
                width = min(CHUNK, columns - x)
                fetched = (width + tile - 1) // tile
                begin = (first_row + y - top) * pitch + first_word + x // tile
                gather(
                    line,
                    np.uint64(begin),
                    np.uint64(pitch),
                    np.uint64(rows),
                    np.uint64(fetched),
                    one_tile,
                    gathered,
                )
                top_here[:] = 1
                if of_bytes:
                    turn_bytes(gathered, turned)
                    steps_of_bytes(levels, width, threshold, extreme, falling, top_here, ended)
                else:
                    turn_pairs(gathered, turned)
                    steps_of_pairs(levels, width, threshold, extreme, falling, top_here, ended)
                # Peaks end in few tiles of so many columns and lanes; there most often once a lane.
                for c in range(np.uint64(0), np.uint64(width), one_tile):
                    for w in range(groups):
                        ends_in[w] = np.uint64(0)
                    for j in range(one_tile):
                        for w in range(groups):
                            ends_in[w] |= ended_words[(c + j) * groups + w]
                    for w in range(groups):
                        if ends_in[w] == 0:
                            continue
                        if of_bytes:
                            turn_tile_of_bytes(ended_words, c * groups + w, groups, of_lane)
                        else:
                            turn_tile_of_pairs(ended_words, c * groups + w, groups, of_lane)
                        twice = np.uint64(0)
                        for j in range(one_tile):
                            filled = (((of_lane[j] & low_bits) + low_bits) | of_lane[j]) & high_bits
                            twice |= filled & (filled - one)
                        # Written whether or not it ended: a branch would be guessed wrong half of the time.
                        if twice == 0:
                            for j in range(one_tile):
                                k: Any = w * one_tile + j
                                top_at = np.int64((of_lane[j] * units) >> last_pixel)
                                lane[found] = k
                                tops[found] = left + x + top_at - 2 if top_at > 1 else top_before[k]
                                ends = np.uint64(top_at > 0)
                                start[k + one] += ends
                                found += ends
                            continue
                        for j in range(one_tile):
                            k = w * one_tile + j
                            bits = of_lane[j]
                            while bits != 0:
                                top_at = np.int64(bits & one_pixel)
                                lane[found] = k
                                tops[found] = left + x + top_at - 2 if top_at > 1 else top_before[k]
                                ends = np.uint64(top_at > 0)
                                start[k + one] += ends
                                found += ends
                                bits >>= bits_a_pixel
                for k in range(LANES):
                    top_before[k] = left + x + top_here[k] - 2 if top_here[k] > 1 else top_before[k]
            for k in range(LANES):
                start[k + 1] += start[k]
            for p in range(found):
                to = count + np.int64(start[lane[p]])
                start[lane[p]] += one
                if to < row.shape[0]:
                    row[to], first[to] = y + lane[p], tops[p]
                    # Unsigned, which no index from the end can be.
                    at = np.uint64((y + lane[p]) * length + tops[p])
                    end = at + np.uint64(1)
                    while pixels[end] == pixels[at]:
                        end += np.uint64(1)
                    last[to] = tops[p] + np.int64(end - at) - 1
            count += np.int64(found)
        return count

    return scan


_scan_bytes = _made(np.uint8)
_scan_pairs = _made(np.uint16)
