"""The paper's coding to the letter (section 3.3): what `window-tracking` is compared with.

(a) Follow each line from the top row down with a 3 × 3 window until it ends; number the lines from left to
right; remove them. (b) The same from the bottom row up. (c) Follow what is left with a window 3 rows high and
14 pixels wide, drop small areas, and give the bodies, in order, to the stripes that were interrupted.

A follower walks from belt to product wherever the surface rises gently, and a stripe whose body is hidden
shifts the number of every body to its right, without notice.
"""

from __future__ import annotations

import numpy as np

from roemetry.records import UNLABELLED, Peaks, StripeMap
from roemetry.records.arrays import Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Coder
from roemetry_kernels.bridging import BridgingOptions, bridged
from roemetry_kernels.consistency import refuse_uncodable
from roemetry_kernels.rest_lines import calibrated_rest_lines
from roemetry_kernels.tracing import trace_fragments
from roemetry_paper.window_tracking import refuse_dark_rows

_BELT_WINDOW_PX, _BODY_WINDOW_PX = 3, 14  # widths of the windows, as the paper has them
_AREA_PX_MIN = 10  # bodies with fewer peaks are noise; the size is not in the print
_JOIN_ROWS = 20  # rows of a break over which a body goes on: as long a gap as is bridged


def literal_codes(peaks: Peaks, stripes: int) -> Integers:
    """Code by interruption and order: (peak,) stripe or `UNLABELLED`; there is no margin."""
    rows = peaks.image_size[0]
    stripe = np.full(len(peaks), UNLABELLED, np.int64)
    fragment, _ = trace_fragments(peaks.row_start, peaks.x_px, (_BELT_WINDOW_PX - 1) / 2)
    present = np.flatnonzero(np.diff(peaks.row_start))
    first, last = present[0], present[-1]
    top = fragment[peaks.row_start[first] : peaks.row_start[first + 1]]
    bottom = fragment[peaks.row_start[last] : peaks.row_start[last + 1]]
    for number, line in enumerate(top[:stripes]):
        stripe[fragment == line] = number
    for number, line in enumerate(bottom[:stripes]):
        stripe[(fragment == line) & (stripe == UNLABELLED)] = number
    whole = set(top[:stripes]) & set(bottom[:stripes])
    interrupted = [number for number, line in enumerate(top[:stripes]) if line not in whole]

    left = np.flatnonzero(stripe == UNLABELLED)
    start = np.searchsorted(peaks.row[left], np.arange(rows + 1))
    body, bodies = trace_fragments(start, peaks.x_px[left], _BODY_WINDOW_PX / 2)
    areas = [np.flatnonzero(body == number) for number in range(bodies)]
    chains = _chains([left[area] for area in areas if area.size >= _AREA_PX_MIN], peaks)
    for number, chain in zip(interrupted, chains, strict=False):
        stripe[chain] = number
    return stripe


def _chains(bodies: list[Integers], peaks: Peaks) -> list[Integers]:
    """Join bodies that continue one another over a short gap; give them from left to right."""
    chains: list[Integers] = []
    for body in sorted(bodies, key=lambda area: int(peaks.row[area[0]])):
        for index, chain in enumerate(chains):
            gap = peaks.row[body[0]] - peaks.row[chain[-1]]
            if 0 < gap <= _JOIN_ROWS and abs(peaks.x_px[body[0]] - peaks.x_px[chain[-1]]) <= _BODY_WINDOW_PX:
                chains[index] = np.concatenate([chain, body])
                break
        else:
            chains.append(body)
    return sorted(chains, key=lambda chain: float(peaks.x_px[chain].mean()))


class Literal(Coder[BridgingOptions]):
    """Codes by interruption and order."""

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame of a calibrated camera; refuse what `window-tracking` refuses."""
        assert calibration is not None
        refuse_uncodable(peaks, calibration)
        refuse_dark_rows(peaks)
        rest = calibrated_rest_lines(peaks, calibration)
        gap_rows, points = self.options.longest_gap_rows, self.options.smallest_product_points
        stripe = literal_codes(peaks, rest.x_px.shape[0])
        return bridged(
            peaks, stripe, np.full(len(peaks), np.nan), rest,
            longest_gap_rows=gap_rows, smallest_product_points=points, reasons=[],
        )  # fmt: skip
