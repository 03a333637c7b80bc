"""Traced pieces of stripes, who stands beside whom, and which end points at which beginning."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Peaks
from roemetry.records.arrays import Flags, Floats, Integers

SLOPE_ROWS = 12
"""Rows at an end that say where it points."""
_THROUGH_ROWS, _THROUGH_OFF, _THROUGH_TURN = 12, 0.05, math.radians(20.0)
"""A break that is no break: rows, how far beside where both ends point, spacings, and its turn, rad."""
_CUT_ROWS, _STEP_ASIDE_PX = 6, 2.5
"""A trace that steps aside by so much is cut there; rows on either side that say where it goes."""
_FIT_ROUNDS, _FIT_WITHIN = 12, 0.4
"""Fit of the spacing: rounds, and the logarithm beyond which a distance is not that of neighbours."""
_FIT_PAIRS_MIN = 50
_TURN_MAX = math.radians(45.0)
"""What turns by more is not taken for the same stripe, nor for its neighbour, rad."""
_OVERLAP_ROWS, _FACES = 15, 1.5
_BORDER_SPACINGS = 0.5
_BORDER_ROWS = 3


class Ends(NamedTuple):
    """First and last peak of each piece, and where it points there: columns a row."""

    row: Integers
    x_px: Floats
    slope: Floats


class Side(NamedTuple):
    """Two pieces side by side with nothing between.

    On how many rows, how far apart, spacings, and whether they run the same way.
    """

    rows: int
    spacings: float
    along: bool


@dataclass(frozen=True, eq=False, slots=True)
class Pieces:
    """All traced pieces of a frame.

    Attributes
    ----------
    peaks
        Of each piece, its peaks' numbers, from top to bottom.
    top, bottom
        Its two ends.
    sides
        By (piece, piece to its right): neighbours.
    left_of
        (piece, piece) True where the first stands left of the second on some row.
    off
        (piece, piece) how far beside the place to which both point the second begins, below the first's end,
        spacings, signed; infinite where it does not begin below.
    gap
        (piece, piece) rows from the first's end to the second's beginning.
    faces
        (piece, piece) True where the second begins below the first's end, or up to `_OVERLAP_ROWS` above, and
        no further than `_FACES` spacings beside it.
    through
        (piece, piece) True where the second goes on from the first with hardly a break.
    border_top, border_bottom
        (piece,) True where the end lies at the image's border: the stripe goes on outside.
    spacing_px
        (piece,) how far neighbours are from each other where it begins, square to them, px.
    """

    peaks: list[Integers]
    top: Ends
    bottom: Ends
    sides: dict[tuple[int, int], Side]
    left_of: Flags
    off: Floats
    gap: Integers
    faces: Flags
    through: Flags
    border_top: Flags
    border_bottom: Flags
    spacing_px: Floats

    @property
    def count(self) -> int:
        """Number of pieces."""
        return len(self.peaks)


def pieces_of(peaks: Peaks, fragment: Integers, rows_min: int) -> Pieces:
    """Give the pieces of at least `rows_min` peaks, and how they lie to each other.

    Parameters
    ----------
    peaks
        The frame's peaks.
    fragment
        (peak,) traced fragment.
    rows_min
        Shorter fragments are no pieces.
    """
    order = np.argsort(fragment, kind="stable")
    whole = np.split(order, np.flatnonzero(np.diff(fragment[order])) + 1)
    parts = [part for one in whole for part in _cut(one, peaks.x_px[one])]
    kept = [part for part in parts if part.size >= rows_min]
    slope = np.zeros(len(peaks))
    of = np.full(len(peaks), -1, np.int64)
    for number, part in enumerate(kept):
        of[part] = number
        slope[part] = _slopes(peaks.row[part], peaks.x_px[part])
    top, bottom = _ends(peaks, kept, at_end=False), _ends(peaks, kept, at_end=True)
    mine = np.flatnonzero(of >= 0)
    pairs = _pairs(peaks.row[mine], peaks.x_px[mine], slope[mine], of[mine])
    spacing = _spacing(pairs)
    off, gap, faces = _offs(top, bottom, spacing)
    through = (gap > 0) & (gap <= _THROUGH_ROWS + 1) & (np.abs(off) <= _THROUGH_OFF)
    through &= np.abs(np.arctan(bottom.slope)[:, None] - np.arctan(top.slope)[None, :]) <= _THROUGH_TURN
    through &= (through.sum(axis=1, keepdims=True) == 1) & (through.sum(axis=0, keepdims=True) == 1)
    return Pieces(
        kept,
        top,
        bottom,
        _sides(pairs, spacing),
        _left_of(peaks.row[mine], of[mine], len(kept)),
        off,
        gap,
        faces,
        through,
        _at_border(top, peaks.image_size, spacing),
        _at_border(bottom, peaks.image_size, spacing),
        _spacing_at(spacing, top.x_px, top.row),
    )


class _Pairs(NamedTuple):
    """Peaks next to each other in a row.

    Their pieces, the middle between them, their distance square to the stripes, px, and the angle, rad.
    """

    left: Integers
    right: Integers
    row: Integers
    x_px: Floats
    square_px: Floats
    turn: Floats


def _cut(part: Integers, x_px: Floats) -> list[Integers]:
    """Cut a trace where it steps aside from where it was going on both sides, or turns sharply."""
    if part.size <= 2 * _CUT_ROWS:
        return [part]
    window = np.lib.stride_tricks.sliding_window_view(x_px, _CUT_ROWS)
    at = np.arange(_CUT_ROWS) - 0.5 * (_CUT_ROWS - 1)
    mean, slope = window.mean(axis=1), window @ (at / (at**2).sum())
    above, below = slice(0, -_CUT_ROWS), slice(_CUT_ROWS, None)  # windows that end and begin at a step
    between = 0.5 * _CUT_ROWS * (slope[above] + slope[below])
    aside = np.abs(mean[below] - mean[above] - between) / np.sqrt(1.0 + (between / _CUT_ROWS) ** 2)
    turn = np.abs(np.arctan(slope[above]) - np.arctan(slope[below]))
    worst = np.maximum(aside / _STEP_ASIDE_PX, turn / _TURN_MAX)
    at_step = (worst > 1.0) & (worst >= np.roll(worst, 1)) & (worst > np.roll(worst, -1))
    return np.split(part, np.flatnonzero(at_step) + _CUT_ROWS)


def _slopes(row: Integers, x_px: Floats) -> Floats:
    """Columns a row along a piece, over `SLOPE_ROWS`."""
    at = np.arange(row.size)
    before, after = np.maximum(at - SLOPE_ROWS // 2, 0), np.minimum(at + SLOPE_ROWS // 2, row.size - 1)
    slope: Floats = (x_px[after] - x_px[before]) / np.maximum(row[after] - row[before], 1)
    return slope


def _ends(peaks: Peaks, kept: list[Integers], *, at_end: bool) -> Ends:
    tip = -1 if at_end else 0
    part = slice(-SLOPE_ROWS, None) if at_end else slice(0, SLOPE_ROWS)
    slope = [
        float(np.polyfit(peaks.row[k[part]] - peaks.row[k[tip]], peaks.x_px[k[part]], 1)[0])
        if k.size > 2
        else 0.0
        for k in kept
    ]
    at = np.array([k[tip] for k in kept], np.int64)
    return Ends(peaks.row[at], peaks.x_px[at], np.array(slope, np.float64))


def _pairs(row: Integers, x_px: Floats, slope: Floats, of: Integers) -> _Pairs:
    k = np.flatnonzero(np.diff(row) == 0)
    lean = np.sqrt(1.0 + np.clip(slope[k] * slope[k + 1], 0.0, None))
    middle = 0.5 * (x_px[k] + x_px[k + 1])
    turn = np.abs(np.arctan(slope[k]) - np.arctan(slope[k + 1]))
    return _Pairs(of[k], of[k + 1], row[k], middle, (x_px[k + 1] - x_px[k]) / lean, turn)


def _spacing(pairs: _Pairs) -> Floats:
    """Fit the logarithm of the distance of neighbours over the image: most pairs are neighbours."""
    if not pairs.row.size:
        return np.zeros(3)
    log = np.log(np.maximum(pairs.square_px, 1e-3))
    fit = np.array([np.median(log), 0.0, 0.0])
    if log.size < _FIT_PAIRS_MIN:
        return fit
    terms = np.column_stack([np.ones(log.size), pairs.x_px, pairs.row])
    for _ in range(_FIT_ROUNDS):
        near = np.abs(log - terms @ fit) < _FIT_WITHIN
        if near.sum() < _FIT_PAIRS_MIN:
            break
        fit = np.linalg.lstsq(terms[near], log[near], rcond=None)[0]
    return fit


def _spacing_at(spacing: Floats, x_px: Floats, row: NDArray[np.generic]) -> Floats:
    at: Floats = np.exp(np.clip(spacing[0] + spacing[1] * x_px + spacing[2] * row, -3.0, 12.0))
    return at


def _sides(pairs: _Pairs, spacing: Floats) -> dict[tuple[int, int], Side]:
    ratio = pairs.square_px / _spacing_at(spacing, pairs.x_px, pairs.row)
    order = np.lexsort((pairs.right, pairs.left))
    left, right, ratio, turn = pairs.left[order], pairs.right[order], ratio[order], pairs.turn[order]
    cuts = np.flatnonzero((np.diff(left) != 0) | (np.diff(right) != 0)) + 1
    return {
        (int(left[k[0]]), int(right[k[0]])): Side(
            int(k.size), float(np.median(ratio[k])), bool(np.median(turn[k]) <= _TURN_MAX)
        )
        for k in np.split(np.arange(left.size), cuts)
        if k.size
    }


def _left_of(row: Integers, of: Integers, count: int) -> Flags:
    """Say who stands left of whom, at any distance."""
    found = np.zeros((count, count), np.bool_)
    for step in range(1, row.size):
        same = row[step:] == row[:-step]
        if not same.any():
            break
        found[of[:-step][same], of[step:][same]] = True
    return found


def _offs(top: Ends, bottom: Ends, spacing: Floats) -> tuple[Floats, Integers, Flags]:
    """Give (upper, lower) offsets, spacings, rows from end to beginning, and whether they face each other."""
    gap = top.row[None, :] - bottom.row[:, None]
    slope = 0.5 * (bottom.slope[:, None] + top.slope[None, :])
    beside = (bottom.x_px[:, None] + slope * gap - top.x_px[None, :]) / np.sqrt(1.0 + slope**2)
    off = beside / _spacing_at(spacing, top.x_px, top.row)[None, :]
    turn = np.abs(np.arctan(bottom.slope)[:, None] - np.arctan(top.slope)[None, :])
    faces = (gap > -_OVERLAP_ROWS) & (np.abs(off) <= _FACES)
    return np.where((gap > 0) & (turn <= _TURN_MAX), off, np.inf), gap, faces


def _at_border(ends: Ends, size: tuple[int, int], spacing: Floats) -> Flags:
    reach = _BORDER_SPACINGS * _spacing_at(spacing, ends.x_px, ends.row)
    beside = (ends.x_px < reach) | (ends.x_px > size[1] - 1 - reach)
    border: Flags = beside | (ends.row < _BORDER_ROWS) | (ends.row >= size[0] - _BORDER_ROWS)
    return border
