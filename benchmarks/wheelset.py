"""Broken stripes of a real image without calibration: the coder `pieces`, against numbers by hand.

``python -m benchmarks wheelset``

The image is not part of the project: the environment variable ROEMETRY_REAL_DATA names its folder (default
``../shared/real``). It is turned so that stripes run from top to bottom. Pieces traced as by
`window-tracking` were numbered by a person; what `pieces` gives is counted against that.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.command import parser_of
from benchmarks.real_images import folder_of
from benchmarks.tables import table
from roemetry.records import Frame, Peaks, StripeMap
from roemetry_coding.pieces import Pieces
from roemetry_kernels.tracing import trace_fragments
from roemetry_peaks.gaussian import Gaussian

ROWS_MIN = 10
STEP_MAX_PX = 7.0
"""Pieces as they were numbered by hand: how long they are at least, and how far peaks may step."""

BY_HAND: dict[int, tuple[tuple[int, int], ...]] = {
    1: ((6, 497),),
    2: ((3, 401), (58, 427), (125, 759)),
    3: ((4, 339), (131, 388), (166, 434), (195, 715), (222, 779)),
    4: ((42, 287), (256, 671), (283, 737), (334, 785)),
    5: ((112, 256), (314, 629), (410, 762)),
    6: ((177, 224), (369, 596), (411, 694), (456, 724)),
    7: ((236, 193), (418, 567), (462, 661), (517, 703)),
    8: ((306, 171), (394, 207), (462, 327), (466, 539), (503, 625), (557, 664)),
    9: ((341, 133), (363, 144), (508, 508), (585, 623)),
    10: ((387, 104), (547, 470), (617, 584)),
    11: ((432, 76), (584, 442), (636, 540)),
    12: ((472, 48), (608, 123), (618, 412)),
    13: ((510, 21), (651, 111)),
    14: ((555, 0),),
}
"""Where the pieces of each stripe begin (column, row), as a person numbered them in the turned image."""


class Verdict(NamedTuple):
    """Pieces as traced, by their peaks; their numbers by hand and by the coder, 0 for none."""

    pieces: list[NDArray[np.int64]]
    by_hand: NDArray[np.int64]
    given: NDArray[np.int64]


def main() -> None:
    """Print what is numbered, right and wrong."""
    parser_of(__doc__).parse_args()
    folder = folder_of("multi_stripe")
    if folder is None:
        raise SystemExit("multi_stripe is not there: set ROEMETRY_REAL_DATA")
    image = cv2.imread(str(folder / "wheelset.jpg"), cv2.IMREAD_COLOR)
    turned = np.ascontiguousarray(np.rot90(image.max(axis=2)))
    peaks = Gaussian().extract(Frame(turned))
    stripes = Pieces().code(peaks, None)
    verdict = judged(peaks, stripes)
    tell(verdict)
    for reason in stripes.reasons:
        print(f"{reason.code}: {reason.text}")


def judged(peaks: Peaks, stripes: StripeMap) -> Verdict:
    """Put the coder's number of each traced piece beside the one by hand.

    A piece has the number of most of its peaks. The coder counts from 0, from the first stripe it has; the
    numbers by hand from 1: what most pieces differ by is no difference.
    """
    of, count = trace_fragments(peaks.row_start, peaks.x_px, STEP_MAX_PX)
    found = [np.flatnonzero(of == n) for n in range(count)]
    pieces = [at for at in found if at.size >= ROWS_MIN]
    hand = np.array([by_hand(float(peaks.x_px[at[0]]), int(peaks.row[at[0]])) for at in pieces])
    most = [np.bincount(np.maximum(stripes.peak_stripe[at], -1) + 1).argmax() for at in pieces]
    given = np.array(most, np.int64)
    both = (hand > 0) & (given > 0)
    shift = np.bincount(hand[both] - given[both] + 100).argmax() - 100 if both.any() else 0
    return Verdict(pieces, hand, np.where(given > 0, given + shift, 0))


def by_hand(x_px: float, row: int) -> int:
    """Give the number a person gave to the piece that begins here; 0 for none."""
    near = (n for n, starts in BY_HAND.items() if any(abs(x_px - a) + abs(row - b) <= 6.0 for a, b in starts))
    return next(near, 0)


def tell(verdict: Verdict) -> None:
    """Print the table."""
    rows = np.array([at.size for at in verdict.pieces])
    given, hand = verdict.given, verdict.by_hand
    lines = []
    for words, which in (
        ("all pieces of ten rows or more", rows > 0),
        ("numbered by hand", hand > 0),
        ("numbered, the same as by hand", (given != 0) & (given == hand)),
        ("numbered, another than by hand", (given != 0) & (hand > 0) & (given != hand)),
        ("numbered, and not by hand", (given != 0) & (hand == 0)),
        ("not numbered, but by hand", (given == 0) & (hand > 0)),
        ("not numbered, nor by hand", (given == 0) & (hand == 0)),
    ):
        lines.append([words, f"{which.sum()}", f"{rows[which].sum()}"])
    print(table(["", "pieces", "centres"], lines), end="")
