"""Stripes on a plane: straight lines once the lens's distortion is out, found among one image's peaks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry.records import Peaks

_STEP_MAX_PX = 3.0
_JOIN_PX = 2.5
_NEAR_PX = 2.0
_ROWS_MIN = 12
_FRAGMENT_ROWS_MIN = 6
_SHARE_MIN = 0.08
_ROUNDS = 3


@dataclass(frozen=True, eq=False, slots=True)
class StripeLine:
    """One stripe on a plane.

    Attributes
    ----------
    start, slope
        x = start + slope · y on the plane at distance 1, without distortion.
    peak
        (n,) indices of its peaks, by row.
    """

    start: float
    slope: float
    peak: Integers

    def ends(self, xy: Floats) -> Floats:
        """Give (2, 3) the rays of its two ends, from (peak, 2) places without distortion."""
        y = xy[self.peak[[0, -1]], 1]
        return np.column_stack([self.start + self.slope * y, y, np.ones(2)])


def find_lines(peaks: Peaks, xy: Floats, use: Flags, focal_px: float) -> list[StripeLine]:
    """Find the stripes, left to right.

    Parameters
    ----------
    peaks
        All peaks of the image.
    xy
        (peak, 2) the same on the plane at distance 1, without distortion.
    use
        (peak,) which of them lie on the plane that is looked at.
    focal_px
        To make pixels of distances there.
    """
    from roemetry_kernels.coding.tracing import trace_fragments

    chosen = np.flatnonzero(use)
    if not chosen.size:
        return []
    row_start = np.searchsorted(peaks.row[chosen], np.arange(peaks.image_size[0] + 1))
    fragment, _ = trace_fragments(row_start, np.ascontiguousarray(peaks.x_px[chosen]), _STEP_MAX_PX)
    order = np.argsort(fragment, kind="stable")
    parts = np.split(chosen[order], np.flatnonzero(np.diff(fragment[order])) + 1)
    lines: list[StripeLine] = []
    for part in sorted(parts, key=len, reverse=True):
        if len(part) < _FRAGMENT_ROWS_MIN:
            break
        off = [np.median(_off(line, xy[part])) * focal_px for line in lines]
        near = int(np.argmin(off)) if off else -1
        if near >= 0 and off[near] < _JOIN_PX:
            lines[near] = _fitted(np.concatenate([lines[near].peak, part]), xy, focal_px)
        elif len(part) >= _ROWS_MIN:
            lines.append(_fitted(part, xy, focal_px))
    longest = max((line.peak.size for line in lines), default=0)
    lines = [line for line in lines if line.peak.size >= max(_ROWS_MIN, _SHARE_MIN * longest)]
    middle = float(np.median(xy[chosen, 1]))
    lines.sort(key=lambda line: line.start + line.slope * middle)
    return _shared_out(lines, xy, chosen, focal_px)


def _shared_out(lines: list[StripeLine], xy: Floats, chosen: Integers, focal_px: float) -> list[StripeLine]:
    """Give each line every peak that is near it, also those of fragments too short to count."""
    if not lines:
        return lines
    for _ in range(_ROUNDS):
        off = np.stack([_off(line, xy[chosen]) * focal_px for line in lines])
        nearest = off.argmin(axis=0)
        mine = off.min(axis=0) < _NEAR_PX
        lines = [
            _fitted(chosen[mine & (nearest == number)], xy, focal_px)
            if (mine & (nearest == number)).sum() >= _ROWS_MIN
            else line
            for number, line in enumerate(lines)
        ]
    lines = _uncrossed(_merged(lines, xy, focal_px), xy[chosen, 1])
    return [replace(line, peak=np.sort(line.peak)) for line in lines]


def _uncrossed(lines: list[StripeLine], y: Floats) -> list[StripeLine]:
    """Of lines that cross on the board leave the shorter out: stripes of one fan do not cross."""
    ends = np.array([y.min(), y.max()])
    at = np.array([line.start + line.slope * ends for line in lines])
    kept: list[int] = []
    for number in sorted(range(len(lines)), key=lambda number: -lines[number].peak.size):
        apart = at[kept] - at[number]
        if not (apart.min(axis=1, initial=np.inf) * apart.max(axis=1, initial=-np.inf) < 0.0).any():
            kept.append(number)
    return [lines[number] for number in sorted(kept)]


def _merged(lines: list[StripeLine], xy: Floats, focal_px: float) -> list[StripeLine]:
    """Join neighbours that are one line in two parts, found before either was long enough to point well."""
    kept: list[StripeLine] = []
    for line in lines:
        if kept:
            y = xy[np.concatenate([kept[-1].peak, line.peak]), 1]
            at = np.array([y.min(), y.max()])
            apart = line.start - kept[-1].start + (line.slope - kept[-1].slope) * at
            if np.abs(apart).min() * focal_px < _JOIN_PX:
                kept[-1] = _fitted(np.unique(np.concatenate([kept[-1].peak, line.peak])), xy, focal_px)
                continue
        kept.append(line)
    return kept


def _off(line: StripeLine, xy: Floats) -> Floats:
    return np.abs(xy[:, 0] - line.start - line.slope * xy[:, 1])


def _fitted(part: Integers, xy: Floats, focal_px: float) -> StripeLine:
    """Fit by least absolute deviations (reweighted), so that strays do not count."""
    part = np.sort(part)
    x, y = xy[part, 0], xy[part, 1]
    weight = np.ones(part.size)
    start = slope = 0.0
    for _ in range(8):
        total = weight.sum()
        mean_x, mean_y = (weight * x).sum() / total, (weight * y).sum() / total
        spread = (weight * (y - mean_y) ** 2).sum()
        slope = float((weight * (y - mean_y) * (x - mean_x)).sum() / max(spread, 1e-30))
        start = float(mean_x - slope * mean_y)
        off = np.abs(x - start - slope * y) * focal_px
        weight = 1.0 / np.maximum(off, 0.2)
    return StripeLine(start, slope, part)


def settled(part: Integers, xy: Floats, focal_px: float) -> Integers:
    """Give those of a stripe's peaks that are near the line fitted to them."""
    line = _fitted(part, xy, focal_px)
    return np.asarray(line.peak[_off(line, xy[line.peak]) * focal_px < _NEAR_PX])


def strongest(lines: list[StripeLine], peaks: Peaks, count: int) -> list[StripeLine]:
    """Leave out lines beyond `count` that are far weaker: edges of the print, reflections."""
    if len(lines) <= count:
        return lines
    light = np.array([float(peaks.amplitude[line.peak].sum()) for line in lines])
    least = _STRAY_SHARE * np.sort(light)[-count]
    return [line for line, own in zip(lines, light, strict=True) if own >= least]


_STRAY_SHARE = 0.35
