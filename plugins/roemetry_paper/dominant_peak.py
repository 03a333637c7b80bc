"""The paper's peaks: maxima that rise above the valleys on both sides by a threshold.

Lee, de Silva, Croft, Wu (2000), section 3.2. The scan walks the inner rows of a grey image (the first and
last row and column are not searched), from left to right; in the kernels ``f`` is a row's grey levels. A
measurement adds what is known of each peak. Places are whole pixels, and their uncertainty is not modelled.
Ours are the automatic threshold, and the valley that is the lowest so far.

Along a row, a maximum is a pixel not lower than the one before and higher than the one after; a minimum is
one lower than the one before and not higher than the one after. The search goes left to right: its start is
at first the row's first pixel, its end the minimum after the first maximum. The highest maximum between them
is dominant if it exceeds both by more than the threshold; then the end becomes the next start. Else the end
moves on to the next minimum. Of several equal maxima the leftmost counts.

Decided where the paper is silent: behind the last minimum the row's last pixel is an end. Criterion 1 is
printed as a difference between the two minima; it is read as between the peak and each of them.

What to know before trusting it:

- Positions are whole pixels, `x_std_px` is not stated.
- The last pixel of a plateau counts, so a saturated stripe is reported 1 to 4 px to the right of its middle.
  That is millimetres of height, unless belt and product saturate alike.
- With ``start: fixed`` the start keeps its grey level however dark the row gets after it. A stripe to the
  right of a bright image border, or of a step halfway down another stripe's slope, is lost unless it exceeds
  that level too. ``start: lowest`` mends this; it is a peak search with hysteresis.
- The threshold is fixed: stripes dimmer than it are lost. ``threshold: auto`` mends this.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Floats, Integers
from roemetry.records.stripes import EDGE, SATURATED
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import (
    SHARE_MIN,
    automatic_rise,
    clipped_beyond,
    doubts,
    faint,
    grey,
    plain_layout,
    scaled_level,
)

_BORDER_PX = 2  # a peak this near to the left or right border pixel may be cut off
_BLOCK = 16  # pixels looked at together where nothing happens: one vector of 16-bit pixels
_PEAKS_A_ROW = 64  # room made at first

Pixels = NDArray[Any]
Bytes = NDArray[np.uint8]


class DominantPeakOptions(StageOptions):
    """Options of `DominantPeak`."""

    threshold: Annotated[float, Field(ge=0.0, le=255.0)] | Literal["auto"] = Field(
        default=100.0,
        description="grey levels (of 0…255, scaled for deeper images) by which a peak must exceed the "
        "valleys before and after it; one that exceeds them by just as much does not count. auto (not the "
        "paper's): from the image's own noise, and from how high its stripes are",
    )
    start: Literal["fixed", "lowest"] = Field(
        default="fixed",
        description="what counts as the valley before a peak. fixed: where the last peak ended (at first the "
        "row's first pixel), as the paper has it. lowest: the lowest valley since then",
    )


class DominantPeak(Extractor[DominantPeakOptions]):
    """Finds peaks that exceed the valleys on both sides by a threshold (Lee et al. 2000, section 3.2)."""

    capabilities = Capabilities(tolerance_px=0.55, saturated_tolerance_px=3.0)
    expected_failures: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "check_brightness_does_not_matter": "the threshold is a fixed number of grey levels: a stripe "
            "that rises less above its valleys is lost, and comes back in a brighter image",
        }
    )

    def extract(self, frame: Frame) -> Peaks:
        """Find the dominant peaks of all rows but the first and the last."""
        # numba: loaded only when something runs
        stated, pixels = self.options.threshold, grey(frame)
        # whole grey levels, rounded down: differences are whole, so `>` means the same as for the fraction
        threshold = rise_of(frame) if stated == "auto" else math.floor(scaled_level(stated, frame))
        lowest = self.options.start == "lowest"
        scan = dominant_peaks(pixels, threshold, lowest=lowest, white=frame.highest)
        # an automatic threshold lets light pass that is low beside the stripes
        return as_peaks(frame, without_faint(scan) if stated == "auto" else scan)


def rise_of(frame: Frame) -> int:
    """Choose by how much a peak must rise, from the image's noise, grey levels."""
    rows, columns = frame.size
    return automatic_rise(plain_layout(grey(frame)), frame.white, 0, rows, 0, columns)


def without_faint(scan: Scan) -> Scan:
    """Leave out what is low beside the image's other peaks."""
    kept = ~faint(scan.row, scan.x_px, scan.amplitude, SHARE_MIN)
    return scan if kept.all() else type(scan)._make(values[kept] for values in scan)


def as_peaks(frame: Frame, scan: Scan) -> Peaks:
    """Make the record of what a scan found in the frame; the scans do not model an uncertainty of x."""
    reasons = doubts(frame.pixels, frame.white, scan.row, scan.x_px, scan.width_px)
    not_stated = np.full(scan.row.shape[0], np.nan)
    scan = scan._replace(flags=scan.flags | clipped_beyond(frame, scan.row, scan.x_px))
    return Peaks(image_size=frame.size, x_std_px=not_stated, reasons=reasons, **scan._asdict())


class Scan(NamedTuple):
    """What a scan found, one element a peak, sorted by row, then x: the fields of `Peaks` it can fill."""

    row: Integers
    """(peak,) image row."""
    x_px: Floats
    """(peak,) position along the row, px."""
    amplitude: Floats
    """(peak,) grey levels above `background`: by so much the peak rises above the valleys on both sides."""
    background: Floats
    """(peak,) grey level of the higher of the two valleys; a valley is the lowest level between a peak and
    its neighbour, or the image border."""
    width_px: Floats
    """(peak,) full width at half of the amplitude, px; NaN where the amplitude is 0."""
    flags: Bytes
    """(peak,) sum of `SATURATED` (at the white level) and `EDGE` (within 2 px of the left or right border
    pixel)."""


def dominant_peaks(image: Pixels, threshold: int, *, lowest: bool, white: int) -> Scan:
    """Find peaks that exceed the valleys before and after them by more than `threshold` grey levels.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels; an image that is not contiguous is copied first.
    threshold
        Grey levels; a difference equal to it is not enough.
    lowest
        What counts as the valley before a peak. False: the valley that ended the last peak (at first the
        row's first pixel), however much lower the row falls later. True: the lowest valley since then.
    white
        Grey level from which on a pixel is saturated.
    """
    pixels = plain_layout(image)
    room = _PEAKS_A_ROW * pixels.shape[0]
    # a row of noise may hold more peaks than there is room for
    while True:
        row, at = np.empty(room, np.int64), np.empty(room, np.int64)
        x_px, flags = np.empty(room, np.float64), np.empty(room, np.uint8)
        count = _scan_dominant(pixels, threshold, lowest, row, at, x_px, flags)
        if count <= room:
            break
        # it counted on without writing: in the second run all fit
        room = count
    # Copies, so that a record which is kept for long does not hold the unused room.
    row, x_px, flags = row[:count].copy(), x_px[:count].copy(), flags[:count].copy()
    amplitude, background, width_px = np.empty(count), np.empty(count), np.empty(count)
    _measure(pixels, white, row, at[:count], x_px, amplitude, background, width_px, flags)
    return Scan(row, x_px, amplitude, background, width_px, flags)


@kernel
def _scan_dominant(
    image: Pixels, threshold: int, lowest: bool, row: Integers, at: Integers, x_px: Floats, flags: Bytes
) -> int:
    """Section 3.2 in one walk along each row; gives the number of peaks, also of those there is no room for.

    The search over lists of maxima and minima, put into three states: only a pixel above start + threshold
    can be dominant, so all below are passed over (1); from there on the highest pixel is kept until the row
    falls by more than the threshold below it (2); where that fall ends is the end, and the next start (3).
    The highest pixel between two minima is a maximum, and the last one of its plateau, if that is kept.
    """
    rows, columns = image.shape
    count = 0
    for y in range(1, rows - 1):
        f = image[y]
        # as int64: differences of unsigned grey levels wrap around
        start = np.int64(f[0])
        x = 1
        while True:
            # 1: look for a pixel above start + threshold, a block at a time as long as none has one.
            while x < columns - _BLOCK:
                block = f[x : x + _BLOCK]
                high = block[0]
                low = block[0]
                for k in range(_BLOCK):
                    high = max(high, block[k])
                    low = min(low, block[k])
                # the lowest the start can have become within the block
                valley = min(start, np.int64(low)) if lowest else start
                if np.int64(high) > valley + threshold:
                    # Most blocks that come here have such a pixel; one that has not costs its own walk.
                    stop = x + _BLOCK
                    while x < stop and np.int64(f[x]) <= start + threshold:
                        if lowest:
                            start = min(start, np.int64(f[x]))
                        x += 1
                    if x < stop:
                        break
                else:
                    # nothing in the block exceeds the threshold: 16 pixels passed over at once
                    start = valley
                    x += _BLOCK
            while x < columns - 1 and np.int64(f[x]) <= start + threshold:
                if lowest:
                    start = min(start, np.int64(f[x]))
                x += 1
            # the last column is not searched
            if x >= columns - 1:
                break
            # 2: keep the highest pixel until the row falls. The last pixel may end a peak, not be one.
            top = np.int64(f[x])
            peak = x
            x += 1
            while x < columns:
                level = np.int64(f[x])
                # on a plateau the last pixel counts, as the paper's definition of a maximum has it
                if level > top or (level == top and peak == x - 1):
                    top = level
                    peak = x
                elif level < top - threshold:
                    # fallen by more than the threshold: the second criterion is met as well
                    break
                x += 1
            # the row ended before it fell far enough: no peak
            if x == columns:
                break
            # 3: the next minimum, or the row's last pixel.
            # the minimum that ends the peak is the next start
            while x < columns - 1 and f[x + 1] < f[x]:
                x += 1
            start = np.int64(f[x])
            if count < row.shape[0]:
                row[count] = y
                at[count] = peak
                x_px[count] = peak
                flags[count] = 0
            count += 1
            x += 1
    return count


@kernel
def _measure(
    image: Pixels,
    white: int,
    row: Integers,
    at: Integers,
    x_px: Floats,
    amplitude: Floats,
    background: Floats,
    width_px: Floats,
    flags: Bytes,
) -> None:
    """Amplitude, background, width and flags of the peaks at the pixels `at`, sorted by row, then x."""
    columns = image.shape[1]
    count = row.shape[0]
    left_valley = np.int64(0)
    for i in range(count):
        f = image[row[i]]
        peak = at[i]
        top = np.int64(f[peak])
        # the first of a row: its valley reaches back to the row's first pixel
        if i == 0 or row[i - 1] != row[i]:
            left_valley = _lowest(f[: peak + 1])
        last = i == count - 1 or row[i + 1] != row[i]
        # up to the next peak, or to the row's end
        right_valley = _lowest(f[peak:] if last else f[peak : at[i + 1] + 1])
        # the higher valley: the peak must stand out on both sides
        base = max(left_valley, right_valley)
        # what lies to the right of this peak lies to the left of the next
        left_valley = right_valley
        background[i] = base
        amplitude[i] = top - base
        width_px[i] = np.nan
        if top > base:
            # Both valleys lie below half height, so each walk ends before the neighbouring peak.
            half = 0.5 * (top + base)
            left = peak - 1
            while f[left] >= half:
                left -= 1
            right = peak + 1
            while f[right] >= half:
                right += 1
            # In floats, since differences of unsigned grey levels may wrap around.
            rise = np.float64(f[left + 1]) - np.float64(f[left])
            fall = np.float64(f[right - 1]) - np.float64(f[right])
            # between pixels by straight lines through half height
            width_px[i] = (right - (half - f[right]) / fall) - (left + (half - f[left]) / rise)
        if top >= white:
            flags[i] |= SATURATED
        if x_px[i] <= _BORDER_PX or x_px[i] >= columns - 1 - _BORDER_PX:
            flags[i] |= EDGE


@kernel
def _lowest(levels: Pixels) -> int:
    lowest = levels[0]
    for k in range(levels.shape[0]):
        lowest = min(lowest, levels[k])
    return np.int64(lowest)  # type: ignore[return-value]
