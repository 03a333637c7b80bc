"""Faults of sensor and transport in one frame: lines that no sensor gives, and parts of another frame.

Lines. A sensor's noise makes every row and every column another one; so lines of one content are a fault of
the transport, and other lines have been lost.

Joins. A lens blurs: from one pixel to the next, light changes by a part of what it changes by over six. Where
it changes by all of that at once, at many places along one boundary between two rows or two columns and
hardly beside it, two frames were joined there; where it changes to and fro, lines of two frames alternate.
Edges of products and shadows are blurred, too, and lie along rows or columns by accident only; both flanks of
a line thinner than a pixel are sharp. A join that crosses no stripe on a product is not seen here.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.records.arrays import Floats, Integers

_SAMPLED = 8
"""Every eighth pixel of a line is compared first: noise makes lines differ in far fewer."""
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
_ROWS_ASKED = 320
"""Of more than twice as many rows some are passed over: those tell as well whether columns were joined."""
_BESIDE, _TIMES_BESIDE = 3, 1.25
"""So many times those of the boundaries up to so far away come on top: specks make steps, and thin lines."""
_STEP_SHARE, _STEP_MIN = 0.25, 0.05
"""Least step, of the stripes' grey level (the 99th percentile) and of white: noise is below."""


def check_lines(laser: Frame) -> None:
    """Refuse an image with lines that no sensor gives: sent twice, or filled with one grey level."""
    for lines, what in ((laser.pixels, "row"), (laser.pixels.swapaxes(0, 1), "column")):
        found = _repeated(lines)
        if found is not None:
            raise DataError(
                f"{laser.name}: the {what} {found} and others have the very content of {what}s before them, "
                f"which no sensor's noise allows: {what}s were lost, and filled up",
                hint="look at cable, network and frame grabber; take the image again",
            )


def _repeated(lines: NDArray[Any]) -> int | None:
    """Give the first of the lines that repeat others; None of none."""
    like = _line_before(lines[:, ::_SAMPLED])
    if like is None:
        return None
    lag = np.arange(len(lines)) - like
    # two lines in a row, each so many lines after its like
    twice = 1 + np.flatnonzero((lag[1:] > 0) & (lag[1:] == lag[:-1]))
    repeated = [line for line in twice.tolist() if (lines[line] == lines[like[line]]).all()]
    if not repeated:
        return None
    last = np.setdiff1d(np.arange(len(lines)), like[lag > 0])
    level = [line for line in repeated if (lines[line] == lines[line].flat[0]).all()]
    if len(last) < _NOISY_SHARE * (len(lines) - len(level)):
        return None
    usual = lines[np.setdiff1d(last, level)]
    clipped = bool(level) and float((usual == lines[level[0]].flat[0]).mean()) > _CLIPPED_SHARE
    return None if clipped and len(level) == len(repeated) else repeated[0]


def _line_before(sampled: NDArray[Any]) -> Integers | None:
    """Give of each line the last one before it of the same content, or itself; None where all differ."""
    flat = sampled.reshape(len(sampled), -1).astype(np.float64)
    key = flat @ _weights(flat.shape[1])
    ranked = np.sort(key)
    if not (ranked[1:] == ranked[:-1]).any():
        return None
    order = np.argsort(key, kind="stable")
    again = key[order[1:]] == key[order[:-1]]
    before = np.arange(len(sampled))
    before[order[1:][again]] = order[:-1][again]
    return before


@lru_cache(maxsize=8)
def _weights(size: int) -> Floats:
    """Give whole numbers, with which sums stay below 2^53: equal lines have equal ones in whatever order."""
    return np.random.default_rng(0).integers(1, 2**24, size).astype(np.float64)


def check_joins(frame: Frame) -> None:
    """Refuse an image of one channel that is joined of two; DataError with the place of the join."""
    pixels = frame.pixels
    least = math.floor(max(_STEP_SHARE * _bright(pixels[::8, ::8].ravel()), _STEP_MIN * frame.white))
    for lines, axis, what in (
        (pixels, 0, "rows"),
        (pixels[:: max(2, len(pixels) // _ROWS_ASKED)], 1, "columns"),
    ):
        place = _joined_after(lines, axis, least)
        if place is not None:
            raise DataError(
                f"{frame.name}: between the {what} {place} and {place + 1} the image breaks off, sharper "
                "than any lens draws: lines are lost there, or a part is another frame's",
                hint="look at cable, network and frame grabber; take the image again",
            )


def _bright(some: NDArray[Any]) -> float:
    """Give the 99th percentile, as numpy does but in a fifth of the time."""
    at = 0.99 * (some.size - 1)
    low, high = np.partition(some, [math.floor(at), math.ceil(at)])[[math.floor(at), math.ceil(at)]].tolist()
    return float(low + (at - math.floor(at)) * (high - low))


def _joined_after(lines: NDArray[Any], axis: int, least: int) -> int | None:
    """Give the line along an axis after which the image breaks off; None where it does nowhere."""
    import cv2

    columns, size, most = lines.shape[1], lines.shape[axis], _JOINED_SHARE * lines.shape[1 - axis]
    grey = np.ascontiguousarray(lines).reshape(-1)
    away = columns if axis == 0 else 1
    steps = cv2.absdiff(grey[:-away], grey[away:]).reshape(-1)
    place = np.flatnonzero(steps > least)
    at = place // columns if axis == 0 else place % columns
    inside = (at >= _REACH // 2 - 1) & (at < size - _REACH // 2)
    place, at = place[inside], at[inside]
    # most images end here: no boundary has enough steep steps, whatever they are
    if not at.size or np.bincount(at).max() <= most:
        return None
    around = grey[place + away * np.arange(1 - _REACH // 2, 1 + _REACH // 2)[:, None]]
    step, change = steps[place], around.max(axis=0) - around.min(axis=0)
    joined = np.bincount(at[change - step <= step // _AT_ONCE], minlength=size)
    to_and_fro = np.maximum(around[2:], around[:-2]) - np.minimum(around[2:], around[:-2])
    alternate = np.bincount(at[to_and_fro.max(axis=0) <= step // _TO_AND_FRO], minlength=size)
    if max(joined.max(), alternate.max()) <= most:
        return None
    joined, alternate = joined[:-1], alternate[:-1]
    beside = np.max([np.roll(joined, k) for k in range(-_BESIDE, _BESIDE + 1) if k], axis=0)
    count = np.maximum(alternate, joined - _TIMES_BESIDE * beside)
    return int(count.argmax()) if count.max() > most else None
