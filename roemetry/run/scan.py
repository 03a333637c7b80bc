"""The lines of a scan through extractor and coder, into one map of stripes that the assembler places.

A frame of a scan shows a moving belt, so nothing is asked of it but its stripes: the coder gets the
calibration only where it has to tell several stripes apart. A line that cannot be followed is left empty and
counted; only if none can, the scan is refused. Where extractor and coder allow it, several frames of one line
are given to them at once, one below the other: each call costs as much as two frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from roemetry.errors import RoemetryError, StageError
from roemetry.records import NOTHING, Acquisition, Frame, Profiles, Reason, ScanLines, StripeMap
from roemetry.records.arrays import Integers
from roemetry.records.calibration import Calibration
from roemetry.records.view import View

_PIXELS_AT_ONCE = 5_200_000
"""Of the frames that are given at once, ten of 1280 × 400: more saves little time, and takes memory."""
_DAMAGED_MAX = 0.02
"""Share of frames, of more than one: what damages more of them damages others where nothing shows it."""


def gather(
    lines: ScanLines,
    ready: Callable[[Acquisition], Frame],
    stages: Mapping[str, Any],
    calibration: Calibration,
) -> StripeMap:
    """Give (line · stripe, row) the stripes of every line; those of a line that cannot be followed are NaN.

    Parameters
    ----------
    lines
        With frames of the calibration's size.
    ready
        Makes a frame ready for the extractor, as the source says.
    stages
        With extractor and coder, perhaps a smoother.

    Raises
    ------
    StageError
        No line could be followed, or several frames are damaged; with what was said of the first.
    """
    rows, count = calibration.image_size[0], calibration.stripe_count
    shape = (len(lines.count) * count, rows)
    x_px, x_std_px = np.full(shape, np.nan), np.full(shape, np.nan)
    seen = np.zeros(shape, np.bool_)
    apart = _rows_apart(stages, count)
    at_once = 1 if apart is None else max(1, _PIXELS_AT_ONCE // math.prod(calibration.image_size))
    first_fault: Exception | None = None
    followed, damaged, reach = 0, 0, 0.0
    stack = _Stack(at_once, apart or 0)
    for begin in range(0, len(lines.count), at_once):
        frames: dict[int, Frame] = {}
        for line in range(begin, min(begin + at_once, len(lines.count))):
            try:
                frame = _read(lines, line, ready, calibration.image_size)
                frames[line] = stack.put(len(frames), frame)
            except RoemetryError as error:
                first_fault = first_fault or error
                damaged += 1
        alike = len(frames) > 1 and _alike(frames)
        groups = [frames] if alike else [{line: frame} for line, frame in frames.items()]
        while groups:
            group = groups.pop(0)
            try:
                frame = stack.whole(group) if len(group) > 1 else next(iter(group.values()))
                found = _stripes_of(frame, stages, calibration)
            except RoemetryError as error:
                if len(group) > 1:  # one of them may have spoiled it for all
                    groups = [{line: frame} for line, frame in group.items()]
                else:
                    first_fault = first_fault or error
                continue
            here = (np.array(list(group))[:, None] * count + np.arange(count)).ravel()
            of_lines, std_px, known = (
                values.reshape(len(group), -1)[:, : count * rows].reshape(-1, rows)
                for values in (found.x_px, found.x_std_px, found.seen)
            )
            # a coder joins product to belt by a straight line; the assembler knows what lies between
            x_px[here], x_std_px[here], seen[here] = np.where(known, of_lines, np.nan), std_px, known
            reach = found.correlation_rows
            followed += len(group)
    if max(1.0, _DAMAGED_MAX * len(lines.count)) < damaged < len(lines.count):
        raise StageError(
            f"{damaged} of {len(lines.count)} frames cannot be used; the first: {first_fault}",
            hint="others may be damaged and not show it: look at the frames, at cable and frame grabber",
        )
    if not followed:
        raise StageError(f"no line of the scan could be followed; of the first: {first_fault}")
    unknown = np.broadcast_to(np.nan, shape)
    said: tuple[Reason, ...] = ()
    if first_fault is not None:
        left = len(lines.count) - followed
        text = f"in {left} of {len(lines.count)} frames no line could be followed: not seen there"
        said = (Reason("lines-unreadable", f"{text}; of the first: {first_fault}"),)
    return StripeMap(
        x_px=x_px,
        x_std_px=x_std_px,
        product=np.where(np.isnan(x_px), np.int16(NOTHING), np.int16(1)),
        seen=seen,
        margin=unknown,
        ambiguous=np.broadcast_to(np.False_, shape),
        rest_px=unknown,
        peak_stripe=np.empty(0, np.int16),
        reasons=said,
        correlation_rows=reach,
    )


def _rows_apart(stages: Mapping[str, Any], stripes: int) -> int | None:
    """Give the empty rows that keep frames apart; None where stages want one frame at a time."""
    if stripes > 1 or "smoother" in stages:
        return None
    apart = [stages[kind].rows_apart() for kind in ("extractor", "coder")]
    return None if None in apart else max(apart)


def _read(lines: ScanLines, line: int, ready: Callable[[Acquisition], Frame], size: tuple[int, int]) -> Frame:
    frame = ready(Acquisition("", (lines.frame(line),)))
    if frame.size != size:
        raise StageError(
            f"frame {line + lines.start} is {frame.size[1]} × {frame.size[0]} pixels, those of the "
            f"calibration are {size[1]} × {size[0]}"
        )
    return frame


def _alike(frames: Mapping[int, Frame]) -> bool:
    return len({(frame.pixels.dtype, frame.highest, frame.sensor) for frame in frames.values()}) == 1


class _Stack:
    """Frames one below the other, with empty rows between, in memory that all groups of a scan share."""

    def __init__(self, room: int, apart: int) -> None:
        self._room, self._apart = room, apart
        self._pixels = np.empty((0, 0, 0), np.uint8)

    def put(self, place: int, frame: Frame) -> Frame:
        """Copy a frame's pixels to its place, while they are in the cache from being checked.

        Gives the frame with its pixels there, so that the array it came with can be freed.
        """
        if self._room == 1:
            return frame
        rows, columns = frame.size
        shape = (self._room, rows + self._apart, columns)
        if self._pixels.shape != shape or self._pixels.dtype != frame.pixels.dtype:
            self._pixels = np.zeros(shape, frame.pixels.dtype)
        self._pixels[place, :rows] = frame.pixels
        return replace(frame, pixels=self._pixels[place, :rows])

    def whole(self, group: Mapping[int, Frame]) -> Frame:
        """Give the frames of a group that were put in this order, and are alike, as one."""
        first = next(iter(group.values()))
        return replace(first, pixels=self._pixels[: len(group)].reshape(-1, first.size[1]))


def _stripes_of(frame: Frame, stages: Mapping[str, Any], calibration: Calibration) -> StripeMap:
    """Give the stripes of a frame, or of several in one."""
    peaks = stages["extractor"].extract(frame)
    found: StripeMap = stages["coder"].code(peaks, calibration if calibration.stripe_count > 1 else None)
    if "smoother" in stages:
        found = stages["smoother"].smooth(found)
    return found


def placed_only(
    stripes: StripeMap, lines: ScanLines, profiles: Profiles, stripe: int
) -> tuple[StripeMap, ScanLines]:
    """Leave of a scan what was placed: a row of the map for each slice, with the slice's labels.

    `stripe` is that of which slices were made.
    """
    at = profiles.frame * (stripes.stripe_count // len(lines.count)) + stripe
    # a peak that was left out, of a stray reflection say, may lie where a flank was followed since
    x_px = np.where(profiles.seen, stripes.x_px[at], np.nan)
    product = np.where(np.isnan(x_px), np.int16(NOTHING), profiles.product)
    # what lies on nothing that counts is left out: a StripeMap knows no point without a label
    x_px = np.where(product == NOTHING, np.nan, x_px)
    unknown = np.broadcast_to(np.nan, x_px.shape)
    kept = StripeMap(
        x_px=x_px,
        x_std_px=stripes.x_std_px[at],
        product=product,
        seen=stripes.seen[at] & ~np.isnan(x_px),
        margin=unknown,
        ambiguous=np.broadcast_to(np.False_, x_px.shape),
        rest_px=unknown,
        peak_stripe=np.empty(0, np.int16),
        correlation_rows=stripes.correlation_rows,
    )
    index: Integers = profiles.frame
    return kept, ScanLines(lines.frame, lines.count[index], lines.number[index], (0, len(index)), lines.start)


@dataclass(frozen=True)
class Placing:
    """The triangulator of a scan: triangulates its lines and places them, as often as is asked."""

    assembler: Any
    lines: ScanLines
    triangulator: Any

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give the slices that a calibration makes of the stripes."""
        found: Profiles = self.assembler.place(stripes, self.lines, calibration, self.triangulator)
        return found

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of a calibration's parameters."""
        found: View | None = self.triangulator.view(calibration)
        return found


def cut_by_scan(profiles: Profiles, number: int) -> Reason | None:
    """Say why nothing can be stated of a product that the scan's first or last line still shows."""
    if not (profiles.product[[0, -1]] == number).any():
        return None
    return Reason(
        "cut-by-scan",
        "the product reaches the first or last line of the scan: a part is not seen (begin and end with bare "
        "belt, or raise the source's longest_product_lines)",
    )


def measured_by_another(profiles: Profiles) -> Calibration:
    """Give a calibration that stands for a sensor that was calibrated elsewhere and gives slices in mm."""
    heights = profiles.xyz_mm[:, :, 2]
    top = float(np.nanmax(heights)) if np.isfinite(heights).any() else 0.0
    slices, points = profiles.product.shape
    return Calibration(
        method="slices",
        image_size=(points, slices),
        turn_deg=0,
        rest_px=np.arange(slices, dtype=np.float64)[:, None],
        displacement_px_per_mm=np.ones(slices),
        height_range_mm=(0.0, max(0.0, top)),
        parameters={},
        covariance=np.zeros((0, 0)),
    )
