"""The search for stripes along image rows: peaks that rise and fall by a threshold.

From the row's first pixel on, the lowest level is kept until a pixel exceeds it by more than the threshold;
from there the highest is kept until a pixel falls below it by more than the threshold. That ends a peak.

A search along a row waits for itself: what a pixel means depends on those before it. Different rows do not
wait for each other. So a block of 128 rows is turned until the pixels of one column lie side by side in
memory; then one vector instruction takes the same step in 16 to 64 rows. Row after row, skipping dark
blocks, the same search takes 3.5 times as long: 0.36 instead of 0.1 ms for a VGA image, 2.6 instead of 0.7
to 1.1 ms for 3 Mpix.

Here, too, stands what is asked of stripes once they are measured (`peak_window`): which are none, and which
have one flank in glare.

It fails for a stripe at the border that does not fall by the threshold on both sides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined, kernel
from roemetry_kernels.image_levels import outshone, usual_height
from roemetry_peaks.searching import Area

Pixels = NDArray[Any]
Places = NDArray[np.int32]

_PEAKS_A_ROW = 32  # room made at first


class Tops(NamedTuple):
    """Tops of peaks, sorted by row, then column."""

    row: Places
    """(peak,) image row."""
    first: Places
    last: Places
    """first, last: (peak,) columns of the first and the last pixel of the top: the same unless it is a
    plateau."""


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
    whole = -(-part.shape[1] * size // WORD) * WORD // size  # rounded up to whole words
    padded = np.zeros((part.shape[0], whole), image.dtype)
    padded[:, : part.shape[1]] = part
    words = padded.view(np.uint64)
    words.flags.writeable = False  # as the image is: one type for the compiler
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
        dark, lowest = gathered.view(kind), np.empty(LANES * tile, kind)
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
            lowest[:] = full
            start[:] = 0
            found: Any = np.uint64(0)
            rising, darker = True, False
            for x in range(0, columns, CHUNK):
                width = min(CHUNK, columns - x)
                fetched = (width + tile - 1) // tile
                begin = (first_row + y - top) * pitch + first_word + x // tile
                gather(
                    line, np.uint64(begin), np.uint64(pitch), np.uint64(rows), np.uint64(fetched), one_tile,
                    gathered,
                )  # fmt: skip
                may_skip = rising and width % tile == 0
                taken = np.uint64(fetched)
                if may_skip and keeps_level(dark, taken, one_tile, threshold, extreme, lowest):
                    darker = True
                    continue
                if darker:
                    lower_to(lowest, one_tile, extreme)
                    lowest[:] = full
                    darker = False
                top_here[:] = 1
                if of_bytes:
                    turn_bytes(gathered, turned)
                    steps_of_bytes(levels, width, threshold, extreme, falling, top_here, ended)
                else:
                    turn_pairs(gathered, turned)
                    steps_of_pairs(levels, width, threshold, extreme, falling, top_here, ended)
                rising = not falling.any()
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
                            twice |= filled & (filled - one)  # two bits or more
                        # Written whether or not it ended: a branch would be guessed wrong half of the time.
                        if twice == 0:
                            for j in range(one_tile):
                                k: Any = w * one_tile + j
                                # the sum of all pixels, of which at most one is not 0
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


@inlined
def keeps_level(dark: Levels, count: int, tile: int, threshold: int, extreme: Levels, lowest: Levels) -> bool:
    """Say whether no lane can rise by more than the threshold in what was gathered; if so, note its lows.

    Most of an image between stripes is so: neither turned nor searched.

    Parameters
    ----------
    dark
        What `gather` filled, in pixels.
    count, tile, threshold
        How many words of each row it took; pixels in a word; grey levels.
    extreme, lowest
        (lane,) lowest level so far of each lane, of which none looks for a fall; and (lane × tile) the same
        since `lower_to`, in the order in which pixels were gathered; changed.
    """
    row, words = _LANES, _CHUNK // tile
    low = high = dark[0]
    for r in range(tile):
        begin, some = r * words * row, count * row
        for k in range(some):
            low = min(low, dark[begin + k])
            high = max(high, dark[begin + k])
        if int(high) - int(low) > threshold:
            return False
    low = min(low, min(np.min(extreme), np.min(lowest)))
    if int(high) - int(low) > threshold:
        return False
    for r in range(tile):
        for c in range(count):
            begin, to = (r * words + c) * row, r * row
            for k in range(row):
                lowest[to + k] = min(lowest[to + k], dark[begin + k])
    return True


@inlined
def lower_to(lowest: Levels, tile: int, extreme: Levels) -> None:
    """Carry the lows of `keeps_level` over to the lanes, in place."""
    groups = _LANES // tile
    for word in range(_LANES):  # the words of one row of tiles lie one after the other
        lane = word % groups * tile + word // groups
        for k in range(tile):
            extreme[lane] = min(extreme[lane], lowest[word * tile + k])


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
    # blocks off the diagonal change places by three exclusive ors each
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
                    lowered = kind(max(level, enough) - enough)  # not below 0
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


# Unsigned, which no index from the end can be.
_ONE, _TWO, _THREE, _FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@float_kernel
def unfit_stripes(row: Places, limits: Any, values: Floats) -> NDArray[np.uint64]:
    """Give the numbers of what is no stripe.

    Parameters
    ----------
    row, limits, values
        (peak,) image row; `Limits`; and (6, peak) values as `roemetry_peaks.peak_window` has them.
    """
    width_min_px, width_max_px, share_min, height_min = limits
    middles, widths, heights = values[0], values[1], values[2]
    count = row.shape[0]
    unfit, highest, lowest = 0, 0.0, np.inf
    for i in range(np.uint64(count)):
        unfit += 0 if (widths[i] >= width_min_px) & (widths[i] <= width_max_px) else 1
        highest, lowest = max(highest, heights[i]), min(lowest, heights[i])
    if unfit == 0 and lowest >= max(share_min * highest, height_min):
        return np.empty(0, np.uint64)
    least = max(share_min * usual_height(row, middles, heights) if share_min > 0.0 else -np.inf, height_min)
    # Nearly all are kept: which may not be is asked of many at a time, and only those are looked at.
    looked_at, clear = np.zeros(-(-count // WORD) * WORD, np.uint8), max(share_min * highest, least)
    for i in range(np.uint64(count)):
        fits = (heights[i] >= clear) & (widths[i] >= width_min_px) & (widths[i] <= width_max_px)
        looked_at[i] = 0 if fits else 1
    words = looked_at.view(np.uint64)
    dropped, gone = np.empty(count, np.uint64), np.uint64(0)
    for word in range(np.uint64(words.shape[0])):
        if words[word] == 0:
            continue
        begin = np.int64(word) * WORD
        for i in range(begin, min(begin + WORD, count)):
            low = heights[i] < share_min * highest
            low = heights[i] < least or (low and outshone(row, middles, heights, i, share_min))
            dropped[gone] = i
            gone += np.uint64(low or not width_min_px <= widths[i] <= width_max_px)
    return dropped[:gone]


@float_kernel
def closed_up(
    dropped: NDArray[np.uint64],
    row: NDArray[np.int64],
    places: NDArray[np.int32],
    flags: NDArray[np.uint8],
    values: Floats,
) -> int:
    """Leave out those stripes, in place; gives the number of those that are left, which stand first.

    The other parameters are those that `roemetry_peaks.peak_window.stripes_around` gives.
    """
    gone = dropped.shape[0]
    if gone > 0:
        _closed_up(row, dropped, gone)
        _closed_up(flags, dropped, gone)
        for side in range(places.shape[0]):
            _closed_up(places[side], dropped, gone)
        for field in range(values.shape[0]):
            _closed_up(values[field], dropped, gone)
    return row.shape[0] - gone


@inlined
def _closed_up(numbers: Any, dropped: NDArray[np.uint64], gone: int) -> None:
    """Move numbers forwards over those that are dropped."""
    for g in range(np.uint64(gone)):
        by, k = g + _ONE, dropped[g] + _ONE
        end = dropped[by] if by < np.uint64(gone) else np.uint64(numbers.shape[0])
        # Four are read before one is written: so they move together.
        while k + _FOUR <= end:
            first, second, third, fourth = (
                numbers[k],
                numbers[k + _ONE],
                numbers[k + _TWO],
                numbers[k + _THREE],
            )
            to = k - by
            numbers[to], numbers[to + _ONE], numbers[to + _TWO] = first, second, third
            numbers[to + _THREE] = fourth
            k += _FOUR
        while k < end:
            numbers[k - by] = numbers[k]
            k += _ONE


GLARE = 128
"""Flag of a stripe of which one flank lies in glare, in no record: its middle is all that is known of it."""

TOO_WIDE = 2.0
"""Times as wide as stripes are on the mean: if none is, nothing is looked at."""
GLARING = 0.97
"""Of white, that a stripe with glare beside it reaches."""
_GOES_ON, _GOES_ON_PX = 0.25, 2.0  # of the stripe's width, and in px, from where a flank was leading
_JUMP, _JUMP_PX = 0.5, 3.0  # of the stripe's width, and in px, that a flank is farther out in glare
_KNOWN_ROWS = 5  # that a stripe has gone on for before
_ROWS_MAX = 40  # in glare
_TURNS = 0.2  # by how much each row counts in what a stripe leans and how wide it is


@float_kernel
def take_off_glare(
    white: int,
    share_min: float,
    row: NDArray[np.int64],
    flags: NDArray[np.uint8],
    values: Floats,
) -> None:
    """Give stripes of which one flank lies in glare the width that they had before, in place.

    Parameters
    ----------
    white
        Grey level from which on a pixel is saturated.
    share_min
        Of the highest stripe's height: what is lower, such as ripples beside stripes, is not followed.
    row, flags, values
        What `peak_window.stripes_around` fills, sorted; `GLARE` is added to `flags`.
    """
    middles, widths = values[0], values[1]
    least = share_min * np.max(values[2])
    seen_middles, seen_widths = middles.copy(), widths.copy()
    count = row.shape[0]
    left, right = np.empty(count), np.empty(count)
    lean, width, known, rows = np.zeros(count), np.empty(count), np.zeros(count), np.zeros(count)
    for way in (1, -1):
        first = 0 if way > 0 else count - 1
        begin = end = here = first  # those of the row before, and where this row begins
        for k in range(count):
            i = first + way * k
            if row[i] != row[here]:
                begin, end = here, i
                here = i
                if way * (row[i] - row[begin]) != 1:
                    begin = end
            left[i], right[i] = seen_middles[i] - 0.5 * seen_widths[i], seen_middles[i] + 0.5 * seen_widths[i]
            if values[2, i] < least:
                left[i] = right[i] = np.nan  # near to nothing
            lean[i], width[i], known[i], rows[i] = 0.0, seen_widths[i], 0.0, 0.0
            p = _before(left, right, lean, width, known, i, begin, end, way)
            if p < 0:
                continue
            off_left, off_right = left[i] - left[p] - lean[p], right[i] - right[p] - lean[p]
            jump = max(_JUMP * width[p], _JUMP_PX)
            if max(abs(off_left), abs(off_right)) <= jump:
                turns = _TURNS if known[p] > 0.0 else 1.0
                lean[i] = lean[p] + turns * 0.5 * (off_left + off_right)
                width[i] = width[p] + _TURNS * (seen_widths[i] - width[p])
                known[i] = known[p] + 1.0
                continue
            bright = min(values[2, i] + values[3, i], values[2, p] + values[3, p]) >= GLARING * white
            if not (bright and known[p] >= _KNOWN_ROWS and rows[p] < _ROWS_MAX):
                continue
            near = max(_GOES_ON * width[p], _GOES_ON_PX)
            if abs(off_left) < near and off_right > jump:
                left[i] -= (1.0 - _TURNS) * off_left
                right[i] = left[i] + width[p]
            elif abs(off_right) < near and off_left < -jump:
                right[i] -= (1.0 - _TURNS) * off_right
                left[i] = right[i] - width[p]
            else:
                continue
            lean[i], width[i], known[i], rows[i] = lean[p], width[p], known[p], rows[p] + 1.0
            if width[p] < widths[i]:
                middles[i], widths[i] = 0.5 * (left[i] + right[i]), width[p]
                flags[i] |= GLARE


@inlined
def _before(
    left: Floats,
    right: Floats,
    lean: Floats,
    width: Floats,
    known: Floats,
    i: int,
    begin: int,
    end: int,
    way: int,
) -> int:
    """Give the stripe of the row before that goes on as one; −1 for none.

    That is the one of which both flanks go on, else of those known and of which one does the narrowest: glare
    that has gone on for some rows is wide.
    """
    before, narrowest = -1, np.inf
    p = begin
    while p != end:
        off_left, off_right = abs(left[i] - left[p] - lean[p]), abs(right[i] - right[p] - lean[p])
        near = max(_GOES_ON * width[p], _GOES_ON_PX)
        if max(off_left, off_right) < near:
            return p
        if min(off_left, off_right) < near and known[p] >= _KNOWN_ROWS and width[p] < narrowest:
            before, narrowest = p, width[p]
        p += way
    return before
