"""Faults of sensor and transport in one frame: lines that no sensor gives, and parts of another frame.

Lines. A sensor's noise makes every row and every column another one; so lines of one content are a fault of
the transport, and other lines have been lost. So is a line of one dark level beside one with light in it.

Joins. A lens blurs: from one pixel to the next, light changes by a part of what it changes by over six. Where
it changes by all of that at once, at many places along one boundary between two rows or two columns and
hardly beside it, two frames were joined there; where it changes to and fro, lines of two frames alternate.
Edges of products and shadows are blurred, too, and lie along rows or columns by accident only; both flanks of
a line thinner than a pixel are sharp. A join that crosses no stripe on a product is not seen here.

Repeats. Noise makes every frame another one, too, where it shows light: stretches of a row that are to the
last grey level what they were in the frame before have not been taken anew. A frame that is the very same as
a whole is left alone: then a file was copied. A few lit pixels repeat by accident, as a stripe's flank does
in a word of eight bytes; four and more hardly ever do, unless JPEG has taken the noise away: then as many
repeat alone, too, or are those of the row above. What comes from another frame than the one before is not
seen.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.records.arrays import Integers

_SAMPLED = 8
"""Every eighth pixel of a line is compared first: noise makes lines differ in far fewer."""
_ENOUGH_WORDS = 3
"""Of eight bytes, in which noise makes all lines differ: others are compared where these do not."""
_ODD = np.uint64(0x9E3779B97F4A7C15)
"""An odd number of 64 bits, whose powers weigh the bytes of a line."""
_WEIGHTS = tuple(_ODD ** np.uint64(k + 1) for k in range(_ENOUGH_WORDS))
_UPPER_HALF = np.uint64(32)
_IN_A_ROW, _LEVEL = 2, 9
"""So many lines in a row, each so many lines after its like; of the very same line more than fit into a
JPEG's block, which is level where it is dark."""
_NOISY_SHARE = 0.9
"""With fewer lines that differ from all others the image has no noise that would tell lines apart."""
_CLIPPED_SHARE = 0.5
"""Where so many pixels of the usual line have the level of a level one, the sensor is dark or white there."""

_REACH = 6
"""Pixels over which light changes: three on either side of a boundary."""
_AT_ONCE = 9
"""A step that is so many times what is left of the change over `_REACH` is no lens's."""
_TO_AND_FRO = 4
"""The same of a step and the difference of a pixel from the one after the next, where lines alternate."""
_JOINED_SHARE = 1 / 32
"""Of 150 whole images of four makers and three cameras no boundary has so steep steps at more than 1 in 48
places; most seams across products have them at 1 in 25 or more."""
_BESIDE, _TIMES_BESIDE = 3, 1.25
"""So many times those of the boundaries up to so far away come on top: specks make steps, and thin lines."""
_ROWS_APART, _ROWS_SAMPLED, _SURE = 4, 256, 0.25
"""One of four rows, of 256 at least, tells between which columns to look at all rows: where these have a
quarter of the steps that are expected there. Of joins with just enough of them chance hides one in 1,000."""
_STEP_SHARE, _STEP_MIN = 0.25, 0.05
"""Least step, of the stripes' grey level (the 99th percentile) and of white: most noise is below."""
_NOISE_QUANTILE, _TIMES_NOISE = 0.75, 3
"""So many times the step that a quarter of all neighbours exceeds: of Gaussian noise one step in 1,800 is
larger, where a join is told by one in 32; in stripes and texture three of four pixels lie on none."""


_RUN = 4
"""Words of eight bytes one after another that repeat: 32 pixels of a grey image."""
_LIT_GREY = 8
"""A byte holds light that is so much brighter than the darkest one of its word: a stripe, whose photon noise
is a few grey levels."""
_LIT_MIN = 4
"""Bytes with light in two words: of 104 pairs of whole frames of three makers 15 have up to four such pairs
of words that repeat by accident, or are as in the row above."""
_RUNS_MIN = 8
"""Stretches with such a pair that repeat: of those 104 pairs of whole frames none has one."""
_ALONE_SHARE = 0.5
"""As many pairs that repeat alone or are as in the row above, of the stretches. Of 197 blocks of another
frame 193 have less, and four more, since a block's sides cut stretches; whole frames that JPEG has robbed of
their noise have 1.7 and more."""


def check_repeats(laser: Frame, before: NDArray[Any]) -> None:
    """Refuse a frame of which a part is the frame before; `before` as acquired, like `laser`."""
    if before.shape != laser.pixels.shape or before.dtype != laser.pixels.dtype:
        return
    new, old = _words(laser.pixels), _words(before)
    count = new.shape[1] // _RUN
    again = new == old
    runs = np.ascontiguousarray(again[:, : count * _RUN]).view(np.uint32) == _ALL_FOUR
    if np.count_nonzero(runs) < _RUNS_MIN:  # nearly always
        return
    row, run = runs.nonzero()
    stretches = new[:, : count * _RUN].reshape(len(new), count, _RUN)[row, run]
    row = row[_pairs(_lit(stretches, ~_level(stretches))).any(axis=1)]
    if len(row) < _RUNS_MIN or again.all():
        return
    lit = ~_level(new)
    near = runs & lit[:, : count * _RUN].reshape((*runs.shape, _RUN)).any(axis=2)
    near[:, 1:] |= near[:, :-1].copy()  # the rest of a part's rows is no accident
    near[:, :-1] |= near[:, 1:].copy()
    alone = lit & again
    alone[:, : count * _RUN] &= ~np.repeat(near, _RUN, axis=1)
    alone[:, count * _RUN :] = False
    by_accident = np.count_nonzero(_pairs(_lit(new, alone)))
    by_accident += np.count_nonzero(_pairs(_lit(new[1:], lit[1:] & (new[1:] == new[:-1]))))
    if by_accident > _ALONE_SHARE * len(row):
        return
    raise DataError(
        f"{laser.name}: from row {row.min()} to row {row.max()} a part of the image is identical to the "
        "image before, to the last grey level, which a sensor's noise makes impossible: one of the two "
        "contains a part of the other",
        hint="look at cable, network and frame grabber; take the image again",
    )


_SAME_BYTES = np.uint64(0x0101010101010101)
_ALL_FOUR = np.uint32(0x01010101)
"""Four truths side by side, as one number: `_RUN` words that repeat."""


def _words(pixels: NDArray[Any]) -> NDArray[np.uint64]:
    """View rows as words of eight bytes, (row, word); what is left at a row's end is cut off."""
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    return np.ascontiguousarray(rows[:, : rows.shape[1] // 8 * 8]).view(np.uint64)


def _level(words: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Say which words are one byte eight times over."""
    return np.asarray(words == (words & np.uint64(0xFF)) * _SAME_BYTES)


def _lit(words: NDArray[np.uint64], which: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Count the bytes that hold light in some of the words, (row, word); 0 in the others."""
    grey = words[which].view(np.uint8).reshape(-1, 8)
    lit = np.zeros(words.shape, np.int8)
    lit[which] = np.count_nonzero(grey - grey.min(axis=1, initial=255)[:, None] >= _LIT_GREY, axis=1)
    return lit


def _pairs(lit: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Say which words, (row, word), hold with the next one light that does not repeat by accident."""
    return np.asarray(lit[:, :-1] + lit[:, 1:] >= _LIT_MIN)


LineTeller = Callable[[NDArray[Any]], bool]
"""`roemetry.stages.Extractor.lines_differ` of an extractor."""


def not_told(pixels: NDArray[Any]) -> bool:
    """Leave the comparison to this module."""
    return False


def check_lines(laser: Frame, lines_differ: LineTeller = not_told) -> None:
    """Refuse an image with lines that no sensor gives: sent twice, or filled with one grey level.

    `lines_differ` is `Extractor.lines_differ`, which saves the comparison here where it tells.
    """
    import cv2

    pixels, found = laser.pixels, None
    pixels.max()  # a frame comes from memory in half the time in order: what is asked below lies scattered
    if pixels.ndim == 2 and lines_differ(pixels):  # nearly always
        return
    for what in ("row", "column"):
        if what == "row":
            if not _all_sound(_middle_of_rows(pixels)):
                found = _repeated(pixels, pixels[:, ::_SAMPLED])
        elif not _all_sound(_middle_of_columns(pixels)):
            by_column = cv2.transpose(np.ascontiguousarray(pixels[::_SAMPLED]))
            found = _repeated(pixels.swapaxes(0, 1), by_column)
        if found is not None:
            raise DataError(
                f"{laser.name}: the {what} {found} and others are identical to {what}s before them, which a "
                f"sensor's noise makes impossible: {what}s were lost, and filled up",
                hint="look at cable, network and frame grabber; take the image again",
            )


def _repeated(lines: NDArray[Any], some: NDArray[Any]) -> int | None:
    """Give the first of the lines that repeat others; None of none. `some`: every eighth of their pixels."""
    sampled = np.ascontiguousarray(some).reshape(len(lines), -1)
    words = _words(sampled)
    if words.size and _same_at_ends(words).any():
        filled = _filled(lines, (words == words[:, :1]).all(axis=1))
        if filled is not None:
            return filled
    if _all_differ(words):
        return None
    size, content = sampled[0].nbytes, sampled.tobytes()
    last: dict[bytes, int] = {}
    lag_before = in_a_row = 0
    repeated: list[int] = []
    for line in range(len(lines)):
        one = content[line * size : (line + 1) * size]
        lag = line - last.get(one, line)
        in_a_row = in_a_row + 1 if lag and lag == lag_before else 1
        enough = lag and in_a_row >= (_LEVEL if lag == 1 else _IN_A_ROW)
        if enough and (lines[line] == lines[line - lag]).all():
            repeated.append(line)
        last[one], lag_before = line, lag
    if not repeated:
        return None
    one_grey = [line for line in repeated if (lines[line] == lines[line].flat[0]).all()]
    if len(last) < _NOISY_SHARE * (len(lines) - len(one_grey)):
        return None
    usual = lines[[line for line in last.values() if line not in one_grey]]
    clipped = bool(one_grey) and float((usual == lines[one_grey[0]].flat[0]).mean()) > _CLIPPED_SHARE
    return None if clipped and len(one_grey) == len(repeated) else repeated[0]


def _all_sound(words: NDArray[np.uint64]) -> bool:
    """Say for certain that no line is of one level or like another, by a few of their words.

    False tells nothing.
    """
    return words.shape[1] > 1 and not (words[:, 0] == words[:, 1]).any() and _all_differ(words)


def _middle_of_rows(pixels: NDArray[Any]) -> NDArray[np.uint64]:
    """Give words of each row that lie side by side, which are fetched much sooner than far apart."""
    words = _words(pixels)
    first = max(0, words.shape[1] - _ENOUGH_WORDS) // 2
    return np.ascontiguousarray(words[:, first : first + _ENOUGH_WORDS])


def _middle_of_columns(pixels: NDArray[Any]) -> NDArray[np.uint64]:
    """Give words of every eighth pixel of each column, as many at least."""
    import cv2

    reach = 8 * _ENOUGH_WORDS * _SAMPLED
    first = max(0, len(pixels) - reach) // 2
    return _words(cv2.transpose(np.ascontiguousarray(pixels[first : first + reach : _SAMPLED])))


def _same_at_ends(words: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Say which lines may be of one level, by three of their words: nearly none is."""
    first = words[:, 0]
    return np.asarray((first == words[:, -1]) & (first == words[:, words.shape[1] // 2]))


def _filled(lines: NDArray[Any], level: NDArray[np.bool_]) -> int | None:
    """Give the first line of one dark level beside a line with light in it: no light ends within a pixel.

    `level` says which lines may be of one level. Where the sensor clips darkness by itself, none is told.
    """
    if level.mean() > _CLIPPED_SHARE:  # beside one line of light nearly all columns are; specks end at once
        return None
    other: NDArray[Any] | None = None
    for line in np.flatnonzero(level):
        neighbours = [k for k in (line - 1, line + 1) if 0 <= k < len(lines) and not level[k]]
        grey = lines[line].flat[0]
        if not neighbours or (lines[line] != grey).any():
            continue
        other = lines[~level] if other is None else other  # all of the image: asked for in few
        if (other < grey).any():
            continue
        lit = max(int(lines[k].max()) for k in neighbours) - int(grey) >= _STEP_SHARE * int(other.max())
        if lit and float((other == grey).mean()) <= _CLIPPED_SHARE:
            return int(line)
    return None


def _all_differ(words: NDArray[np.uint64]) -> bool:
    """Say for certain that no two lines are alike, by sums of their words; False tells nothing."""
    sums: NDArray[np.uint64]
    if words.shape[1] > _ENOUGH_WORDS:
        weights = _ODD ** np.arange(1, words.shape[1] + 1, dtype=np.uint64)
        sums = (words @ weights).astype(np.uint64, copy=False)
    else:  # one after the other takes half as long
        sums = np.zeros(len(words), np.uint64)
        for word, weight in zip(words.T, _WEIGHTS, strict=False):
            sums += word * weight
    for some in ((sums >> _UPPER_HALF).astype(np.uint32), sums):  # half of the bits are sorted twice as fast
        some.sort()
        if (some[1:] != some[:-1]).all():
            return True
    return False


StepCounter = Callable[[NDArray[Any], int], tuple[Integers, Integers, Integers] | None]
"""`roemetry.stages.Extractor.count_steps` of an extractor."""


def not_counted(pixels: NDArray[Any], least: int) -> None:
    """Leave the counting to this module."""


def check_joins(frame: Frame, count_steps: StepCounter = not_counted) -> None:
    """Refuse an image of one channel that is joined of two; DataError with the place of the join.

    `count_steps` is `Extractor.count_steps`: compiled, it takes a tenth of the time that whole arrays take.
    """
    import cv2

    bright = _bright(frame.pixels[::_SAMPLED, ::_SAMPLED])
    least = int(max(_STEP_SHARE * bright, _STEP_MIN * frame.white))
    counted = count_steps(frame.pixels, least)
    for what, axis in (("rows", 0), ("columns", 1)):
        enough = _JOINED_SHARE * frame.size[1 - axis]
        if counted is None:
            may_be = _may_be_joined(frame.pixels, axis, least, enough)
        else:
            may_be = _of_counted(counted, axis, enough)
        if not may_be.any():  # nearly always
            continue
        lines = frame.pixels if axis == 0 else cv2.transpose(frame.pixels)
        near = _with_neighbours(may_be, _BESIDE)
        count, place = _most_joined(lines, least, near)
        if count > enough and least < (noise := _over_noise(frame.pixels)):
            count, place = _most_joined(lines, noise, near)
        if count > enough:
            raise DataError(
                f"{frame.name}: between the {what} {place} and {place + 1} the image breaks off more sharply "
                "than any lens can draw: lines are lost there, or a part belongs to another frame",
                hint="look at cable, network and frame grabber; take the image again",
            )


def _bright(pixels: NDArray[Any]) -> float:
    """Give the highest grey level that a hundredth of the pixels reach."""
    some = np.ascontiguousarray(pixels)
    enough, level = some.size - 99 * some.size // 100, 0
    # bit by bit: a quarter of the time of sorting
    for bit in reversed(range(8 * some.itemsize)):
        higher = level | 1 << bit
        if np.count_nonzero(some >= higher) >= enough:
            level = higher
    return float(level)


def _most_joined(lines: NDArray[Any], least: int, near: NDArray[np.bool_]) -> tuple[float, int]:
    """Give the most steps of two frames that were joined at one boundary, over those beside it, and which."""
    joined, alternate = _steep_steps(lines, least, near)
    count = np.maximum(alternate, joined - _TIMES_BESIDE * _most_beside(joined))
    place = int(count.argmax())
    return float(count[place]), place


def _over_noise(pixels: NDArray[Any]) -> int:
    """Give a step that noise alone hardly ever makes: as it makes them between most neighbours in a row."""
    import cv2

    steps = np.sort(
        cv2.absdiff(pixels[::_SAMPLED, ::2][:, : pixels.shape[1] // 2], pixels[::_SAMPLED, 1::2]).ravel()
    )
    return int(_TIMES_NOISE * int(steps[int(_NOISE_QUANTILE * steps.size)]))


def _of_counted(counted: tuple[Integers, Integers, Integers], axis: int, enough: float) -> NDArray[np.bool_]:
    """Say the same as `_may_be_joined` by what is counted, but for what it asks of rows around a step."""
    may_be = counted[axis] > enough
    if axis == 1:
        may_be[1:-1] &= counted[2][1:-1] > enough
    return may_be


def _may_be_joined(pixels: NDArray[Any], axis: int, least: int, enough: float) -> NDArray[np.bool_]:
    """Say at which boundaries between rows (axis 0) or columns (1) there may be enough steep steps.

    Of a step s that is at once or to and fro, the pixels on both sides of its own differ by 1.5 s at most; of
    a stripe's flank by twice that. So what takes all pixels around a step is hardly ever asked. Between
    columns, of which stripes have many steep steps, some rows tell where to ask.
    """
    import cv2

    apart = 1 if axis == 0 else max(1, min(_ROWS_APART, len(pixels) // _ROWS_SAMPLED))
    some = np.ascontiguousarray(pixels) if apart == 1 else pixels[_sampled(len(pixels), apart)]
    next_ = some.shape[1] if axis == 0 else 1
    steep = np.zeros(some.size, np.bool_)
    line = some.reshape(-1)  # across the ends of rows, too: not counted
    np.greater(cv2.absdiff(line[:-next_], line[next_:]).ravel(), least, out=steep[:-next_])
    may_be = _per_boundary(steep.reshape(some.shape), axis)[: pixels.shape[axis] - 1] > (
        enough if apart == 1 else _SURE * enough / apart
    )
    found = np.flatnonzero(may_be[1:-1]) + 1
    if found.size:
        first, last = int(found[0]), int(found[-1])
        near = np.ascontiguousarray(_part(pixels, axis, first - 1, last + 3))  # one before to two after each
        next_, line = near.shape[1] if axis == 0 else 1, near.reshape(-1)
        step = cv2.absdiff(line[next_ : -2 * next_], line[2 * next_ : -next_]).ravel()
        beyond = cv2.subtract(cv2.absdiff(line[: -3 * next_], line[3 * next_ :]).ravel(), step)
        at_once = np.zeros(near.size, np.bool_)
        twice = cv2.max(cv2.add(beyond, beyond), least + 1).ravel()
        np.less_equal(twice, step, out=at_once[: step.size])
        may_be[first : last + 1] &= (
            _per_boundary(at_once.reshape(near.shape), axis)[: last + 1 - first] > enough
        )
    return may_be


@lru_cache(maxsize=8)
def _sampled(rows: int, apart: int) -> NDArray[np.int64]:
    """Give one row of each so many, drawn: every second row may be another frame's."""
    first = np.arange(0, rows - apart + 1, apart)
    return first + np.random.default_rng(0).integers(apart, size=first.size)


def _part(pixels: NDArray[Any], axis: int, first: int, end: int) -> NDArray[Any]:
    """Give the rows (axis 0) or columns (1) from the first to before the end."""
    return pixels[first:end] if axis == 0 else pixels[:, first:end]


def _apart(pixels: NDArray[Any], axis: int, far: int) -> NDArray[Any]:
    """Give by how much each pixel differs from that so many rows (axis 0) or columns (1) on."""
    import cv2

    some, others = _part(pixels, axis, 0, -far), _part(pixels, axis, far, pixels.shape[axis])
    return np.asarray(cv2.absdiff(some, others))


def _steep_steps(lines: NDArray[Any], least: int, wanted: NDArray[np.bool_]) -> tuple[Integers, Integers]:
    """Count, at wanted boundaries between lines, where light changes at once, and where to and fro."""
    import cv2

    before, after = _REACH // 2 - 1, _REACH // 2
    wanted = wanted.copy()
    wanted[:before], wanted[len(wanted) - before :] = False, False  # the image ends within their reach
    needed = _with_neighbours(np.append(wanted, False), after)
    some = lines[needed]
    whole, most = np.ones((_REACH, 1), np.uint8), np.ones((_REACH - 2, 1), np.uint8)
    step = _apart(some, 0, 1)
    change = (cv2.dilate(some, whole, anchor=(0, before)) - cv2.erode(some, whole, anchor=(0, before)))[:-1]
    to_and_fro = cv2.dilate(_apart(some, 0, 2), most, anchor=(0, before))
    steep = step > least
    at_once = steep & (change - step <= step // _AT_ONCE)
    alternate = steep[:-1] & (to_and_fro <= step[:-1] // _TO_AND_FRO)
    counts = np.zeros((2, len(wanted)), np.int64)
    of_some = np.flatnonzero(wanted[needed[:-1]])
    for count, found in zip(counts, (at_once, alternate), strict=True):
        count[wanted] = _per_boundary(found)[of_some]
    return counts[0], counts[1]


def _most_beside(count: Integers) -> NDArray[np.float32]:
    """Give the most that is counted at the boundaries up to `_BESIDE` away on either side."""
    import cv2

    ring = np.ones((1, 2 * _BESIDE + 1), np.uint8)
    ring[0, _BESIDE] = 0
    return np.asarray(cv2.dilate(count[None].astype(np.float32), ring)[0])


def _per_boundary(found: NDArray[np.bool_], axis: int = 0) -> Integers:
    """Count what was found at each boundary between two rows (axis 0) or columns (1)."""
    import cv2

    counted: Integers = cv2.reduce(found.view(np.uint8), 1 - axis, cv2.REDUCE_SUM, dtype=cv2.CV_32S)
    return counted.ravel()


def _with_neighbours(chosen: NDArray[np.bool_], far: int) -> NDArray[np.bool_]:
    """Choose what lies up to so far from what is chosen, too."""
    return np.convolve(chosen, np.ones(2 * far + 1), "same") > 0.5
