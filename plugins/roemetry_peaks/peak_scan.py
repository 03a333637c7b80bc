"""The search for stripes along image rows: peaks that rise and fall by a threshold, compiled.

Rows side by side: an image's pixels turned so that one step searches many rows at once, compiled.

A search along a row waits for itself: what a pixel means depends on those before it. Different rows do not
wait for each other. So a block of rows is turned until the pixels of one column lie side by side in memory;
then one vector instruction takes the same step in 16 to 64 rows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import inlined, kernel

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
        Grey levels, contiguous and read-only (`roemetry_kernels.image_levels.plain_layout`).
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


def _scan_made(kind: type[np.unsignedinteger[Any]]) -> Any:
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
                    # int64: without the compiler a sum with an 8-bit number would not fit
                    top_before[k] = left + x + np.int64(top_here[k]) - 2 if top_here[k] > 1 else top_before[k]
            for k in range(LANES):
                start[k + 1] += start[k]
            for p in range(found):
                to = count + np.int64(start[lane[p]])
                start[lane[p]] += one
                if to < row.shape[0]:
                    row[to], first[to] = y + lane[p], tops[p]
                    # Unsigned, which no index from the end can be.
                    at = np.uint64((y + np.int64(lane[p])) * length + tops[p])
                    end = at + np.uint64(1)
                    while pixels[end] == pixels[at]:
                        end += np.uint64(1)
                    last[to] = tops[p] + np.int64(end - at) - 1
            count += np.int64(found)
        return count

    return scan


LANES = 128  # rows side by side
CHUNK = 64  # columns that are turned at a time: what is worked on stays in the first cache
WORD = 8  # bytes of the words that pixels are moved in

_TOGETHER = 8  # columns that a lane is taken over before it is put down
_LANES, _CHUNK = np.uint64(LANES), np.uint64(CHUNK)
_2, _3, _4 = np.uint64(2), np.uint64(3), np.uint64(4)

Words = NDArray[np.uint64]
Levels = NDArray[Any]


@inlined
def copied(source: Any, begin: int, count: int, target: Any, to: int) -> None:
    """Copy one piece of memory; the places unsigned, which none from the end can be: many at a time then."""
    read, write = np.uint64(begin), np.uint64(to)
    for k in range(np.uint64(count)):
        target[write + k] = source[read + k]


@inlined
def gather(words: Words, begin: int, pitch: int, rows: int, count: int, tile: int, gathered: Words) -> None:
    """Take `count` words of each row and lay those of every `tile`-th row side by side.

    All numbers are unsigned, which no index from the end can be: only then are words moved without asking.

    Parameters
    ----------
    words
        The image's pixels, row after row.
    begin, pitch
        Place of the first word, and how far it is from there to the next row's.
    rows, count, tile
        How many rows, how many words of each (at most a chunk's), and every how many rows lie side by side.
    gathered
        To be filled.
    """
    groups = _LANES // tile
    room = _CHUNK // tile
    for r in range(rows):
        from_word, to = begin + r * pitch, r % tile * (room * groups) + r // tile
        if count == room:
            # Mostly so; the number of words is then known to the compiler.
            for c in range(room):
                gathered[to + c * groups] = words[from_word + c]
        else:
            for c in range(count):
                gathered[to + c * groups] = words[from_word + c]


@kernel
def turn_bytes(gathered: Words, turned: Words) -> None:
    """Turn tiles of 8 × 8 bytes, by exchanging blocks of 4, then 2, then 1 byte between words.

    Parameters
    ----------
    gathered
        Word (i, c, g): columns 8c … 8c + 7 of row 8g + i.
    turned
        To be filled: word (x, g) holds rows 8g … 8g + 7 of column x.
    """
    groups = LANES // 8
    step = CHUNK // 8 * groups
    for c in range(CHUNK // 8):
        p = c * groups
        q = 8 * p
        for g in range(groups):
            a0, a1 = gathered[p + g], gathered[p + step + g]
            a2, a3 = gathered[p + 2 * step + g], gathered[p + 3 * step + g]
            a4, a5 = gathered[p + 4 * step + g], gathered[p + 5 * step + g]
            a6, a7 = gathered[p + 6 * step + g], gathered[p + 7 * step + g]
            b0, b1, b2, b3, b4, b5, b6, b7 = _exchanged_bytes(a0, a1, a2, a3, a4, a5, a6, a7)
            turned[q + g], turned[q + groups + g] = b0, b1
            turned[q + 2 * groups + g], turned[q + 3 * groups + g] = b2, b3
            turned[q + 4 * groups + g], turned[q + 5 * groups + g] = b4, b5
            turned[q + 6 * groups + g], turned[q + 7 * groups + g] = b6, b7


@kernel
def turn_pairs(gathered: Words, turned: Words) -> None:
    """Turn tiles of 4 × 4 pixels of two bytes; as `turn_bytes`, with 4 for 8."""
    groups = LANES // 4
    step = CHUNK // 4 * groups
    for c in range(CHUNK // 4):
        p = c * groups
        q = 4 * p
        for g in range(groups):
            a0, a1 = gathered[p + g], gathered[p + step + g]
            a2, a3 = gathered[p + 2 * step + g], gathered[p + 3 * step + g]
            b0, b1, b2, b3 = _exchanged_pairs(a0, a1, a2, a3)
            turned[q + g], turned[q + groups + g] = b0, b1
            turned[q + 2 * groups + g], turned[q + 3 * groups + g] = b2, b3


@inlined
def turn_tile_of_bytes(words: Words, first: int, apart: int, turned: Words) -> None:
    """Turn one tile of 8 × 8 bytes: a word, `apart` from the next, holds 8 rows of a column.

    In `turned` it holds 8 columns of a row.
    """
    a0, a1, a2, a3 = words[first], words[first + apart], words[first + _2 * apart], words[first + _3 * apart]
    later = first + _4 * apart
    a4, a5, a6, a7 = words[later], words[later + apart], words[later + _2 * apart], words[later + _3 * apart]
    a0, a1, a2, a3, a4, a5, a6, a7 = _exchanged_bytes(a0, a1, a2, a3, a4, a5, a6, a7)
    turned[0], turned[1], turned[2], turned[3] = a0, a1, a2, a3
    turned[4], turned[5], turned[6], turned[7] = a4, a5, a6, a7


@inlined
def turn_tile_of_pairs(words: Words, first: int, apart: int, turned: Words) -> None:
    """Turn one tile of 4 × 4 pixels of two bytes; as `turn_tile_of_bytes`, with 4 for 8."""
    a0, a1, a2, a3 = words[first], words[first + apart], words[first + _2 * apart], words[first + _3 * apart]
    turned[0], turned[1], turned[2], turned[3] = _exchanged_pairs(a0, a1, a2, a3)


@inlined
def _exchanged_bytes(a0: Any, a1: Any, a2: Any, a3: Any, a4: Any, a5: Any, a6: Any, a7: Any) -> Any:
    s4, s2, s1 = np.uint64(32), np.uint64(16), np.uint64(8)
    m4, m2, m1 = np.uint64(0xFFFFFFFF), np.uint64(0xFFFF0000FFFF), np.uint64(0xFF00FF00FF00FF)
    t0, t1 = ((a0 >> s4) ^ a4) & m4, ((a1 >> s4) ^ a5) & m4
    t2, t3 = ((a2 >> s4) ^ a6) & m4, ((a3 >> s4) ^ a7) & m4
    a0, a1, a2, a3 = a0 ^ (t0 << s4), a1 ^ (t1 << s4), a2 ^ (t2 << s4), a3 ^ (t3 << s4)
    a4, a5, a6, a7 = a4 ^ t0, a5 ^ t1, a6 ^ t2, a7 ^ t3
    t0, t1 = ((a0 >> s2) ^ a2) & m2, ((a1 >> s2) ^ a3) & m2
    t2, t3 = ((a4 >> s2) ^ a6) & m2, ((a5 >> s2) ^ a7) & m2
    a0, a1, a4, a5 = a0 ^ (t0 << s2), a1 ^ (t1 << s2), a4 ^ (t2 << s2), a5 ^ (t3 << s2)
    a2, a3, a6, a7 = a2 ^ t0, a3 ^ t1, a6 ^ t2, a7 ^ t3
    t0, t1 = ((a0 >> s1) ^ a1) & m1, ((a2 >> s1) ^ a3) & m1
    t2, t3 = ((a4 >> s1) ^ a5) & m1, ((a6 >> s1) ^ a7) & m1
    a0, a2, a4, a6 = a0 ^ (t0 << s1), a2 ^ (t1 << s1), a4 ^ (t2 << s1), a6 ^ (t3 << s1)
    return a0, a1 ^ t0, a2, a3 ^ t1, a4, a5 ^ t2, a6, a7 ^ t3


@inlined
def _exchanged_pairs(a0: Any, a1: Any, a2: Any, a3: Any) -> Any:
    s2, s1 = np.uint64(32), np.uint64(16)
    m2, m1 = np.uint64(0xFFFFFFFF), np.uint64(0xFFFF0000FFFF)
    t0, t1 = ((a0 >> s2) ^ a2) & m2, ((a1 >> s2) ^ a3) & m2
    a0, a1, a2, a3 = a0 ^ (t0 << s2), a1 ^ (t1 << s2), a2 ^ t0, a3 ^ t1
    t0, t1 = ((a0 >> s1) ^ a1) & m1, ((a2 >> s1) ^ a3) & m1
    return a0 ^ (t0 << s1), a1 ^ t0, a2 ^ (t1 << s1), a3 ^ t1


def _steps_made(kind: type[np.unsignedinteger[Any]]) -> Callable[..., None]:
    """Compile the step for pixels of one type: in wider numbers it would take twice to five times as long."""
    full, none = kind(np.iinfo(kind).max), kind(0)

    @kernel
    def steps(
        levels: Levels,
        columns: int,
        threshold: int,
        extreme: Levels,
        falling: Levels,
        top: Levels,
        ended: Levels,
    ) -> None:
        """Search the next columns of all lanes for levels that rise and fall by more than the threshold.

        A lane looks for a rise above its lowest level, then for a fall below its highest. Both are one step:
        a lane that looks for a fall has all its levels complemented, which makes it a rise above the lowest.

        Parameters
        ----------
        levels
            (columns × lanes) grey levels, turned; columns after those may be changed.
        columns
            How many of them to search.
        threshold
            Grey levels, below the type's largest.
        extreme
            (lane,) lowest level so far, of complemented levels where the lane is falling; changed.
        falling
            (lane,) all bits set where a fall is looked for, else none; changed.
        top
            (lane,) where the lowest level so far lies, the leftmost of several: 2 and the column, or 1 where
            it lies before these columns; changed.
        ended
            (columns × lanes) to be filled: where a peak ended, `top` of its highest level; else 0.
        """
        enough = kind(threshold)
        whole = -(-columns // _TOGETHER) * _TOGETHER
        # What a lane sees twice in a row changes nothing.
        for at in range(columns * LANES, whole * LANES):
            levels[at] = levels[at - LANES]
        for x in range(0, whole, _TOGETHER):
            begin = np.uint64(x * LANES)
            k: Any
            for k in range(_LANES):
                mode, lowest, lies = falling[k], extreme[k], top[k]
                for j in range(_TOGETHER):
                    here, at = kind(x + 2 + j), begin + np.uint64(j * LANES) + k
                    level = kind(levels[at] ^ mode)
                    lowered = kind(max(level, enough) - enough)
                    turns = full if lowered > lowest else none
                    ended[at] = turns & mode & lies
                    lies = here if lowered > lowest or level < lowest else lies
                    lowest = kind(level ^ full) if lowered > lowest else min(lowest, level)
                    mode = kind(mode ^ turns)
                falling[k], extreme[k], top[k] = mode, lowest, lies

    return steps


steps_of_bytes = _steps_made(np.uint8)
steps_of_pairs = _steps_made(np.uint16)


_scan_bytes = _scan_made(np.uint8)
_scan_pairs = _scan_made(np.uint16)
