"""The paper's coding to the letter (section 3.3), kept to show what it does.

(a) Follow each line from the top row down with a 3 × 3 window until it ends; number the lines from left to
right; remove them. (b) The same from the bottom row up. (c) Follow what is left with a window 3 rows high
and 14 pixels wide, drop small areas, and give the bodies, in order, to the stripes that were interrupted.
"""

from __future__ import annotations

import numpy as np

from roemetry.records import UNCODED, Peaks
from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.coding.tracing import trace_fragments

_JOIN_ROWS = 20


def literal_codes(
    peaks: Peaks, rest_px: Floats, belt_window_px: int, body_window_px: int, smallest_area_px: int
) -> tuple[Integers, Floats]:
    """Code by interruption and order.

    Parameters
    ----------
    peaks
        The frame's peaks.
    rest_px
        (stripe, row) rest lines; only their number is used.
    belt_window_px, body_window_px
        Widths of the windows, px.
    smallest_area_px
        Bodies with fewer peaks are noise.

    Returns
    -------
    tuple
        (peak,) stripe or `UNCODED`, and (peak,) NaN: this way of coding has no margin.
    """
    stripes, rows = rest_px.shape
    stripe = np.full(len(peaks), UNCODED, np.int64)
    fragment, _ = trace_fragments(peaks.row_start, peaks.x_px, (belt_window_px - 1) / 2)
    present = np.flatnonzero(np.diff(peaks.row_start))
    first, last = present[0], present[-1]
    top = fragment[peaks.row_start[first] : peaks.row_start[first + 1]]
    bottom = fragment[peaks.row_start[last] : peaks.row_start[last + 1]]
    for number, line in enumerate(top[:stripes]):
        stripe[fragment == line] = number
    for number, line in enumerate(bottom[:stripes]):
        stripe[(fragment == line) & (stripe == UNCODED)] = number
    whole = set(top[:stripes]) & set(bottom[:stripes])
    interrupted = [number for number, line in enumerate(top[:stripes]) if line not in whole]

    left = np.flatnonzero(stripe == UNCODED)
    start = np.searchsorted(peaks.row[left], np.arange(rows + 1))
    body, bodies = trace_fragments(start, peaks.x_px[left], body_window_px / 2)
    areas = [np.flatnonzero(body == number) for number in range(bodies)]
    chains = _chains([left[area] for area in areas if area.size >= smallest_area_px], peaks, body_window_px)
    for number, chain in zip(interrupted, chains, strict=False):
        stripe[chain] = number
    return stripe, np.full(len(peaks), np.nan)


def _chains(bodies: list[Integers], peaks: Peaks, window_px: int) -> list[Integers]:
    """Join bodies that continue one another over a short gap; give them from left to right."""
    chains: list[Integers] = []
    for body in sorted(bodies, key=lambda area: int(peaks.row[area[0]])):
        for index, chain in enumerate(chains):
            gap = peaks.row[body[0]] - peaks.row[chain[-1]]
            if 0 < gap <= _JOIN_ROWS and abs(peaks.x_px[body[0]] - peaks.x_px[chain[-1]]) <= window_px:
                chains[index] = np.concatenate([chain, body])
                break
        else:
            chains.append(body)
    return sorted(chains, key=lambda chain: float(peaks.x_px[chain].mean()))
