"""Rows side by side: an image's pixels turned so that one step searches many rows at once, compiled.

A search along a row waits for itself: what a pixel means depends on those before it. Different rows do not
wait for each other. So a block of rows is turned until the pixels of one column lie side by side in memory;
then one vector instruction takes the same step in 16 to 64 rows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import inlined, kernel

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


def _made(kind: type[np.unsignedinteger[Any]]) -> Callable[..., None]:
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


steps_of_bytes = _made(np.uint8)
steps_of_pairs = _made(np.uint16)
