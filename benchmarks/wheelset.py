"""Broken stripes of a real image without calibration: what order alone can number, against numbers by hand.

``python -m benchmarks wheelset [--picture FILE]``

The image is not part of the project: the environment variable ROEMETRY_REAL_DATA names its folder (default
``../shared/real``). It is turned so that stripes run from top to bottom, and traced by `window-tracking`,
which gives each piece a number of its own. Here pieces are joined where one ends and another begins just
where it points, and what stands side by side in unbroken order is numbered. What order and direction leave
open is not numbered.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.real_images import folder_of
from roemetry.records import Frame
from roemetry_paper.window_tracking import WindowTracking
from roemetry_peaks.gaussian import Gaussian

ROWS_MIN = 10
REACH_ROWS = 120
SLOPE_ROWS = 12
NEAR, FAR = 0.3, 0.6
"""The next piece begins within the first share of a stripe spacing of where it should, no other within the
second. What is further away by many rows is no rival."""
RIVAL_ROWS = 20
SIDE_ROWS = 15
"""Rows on which two must stand side by side to be neighbours."""

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


class Piece(NamedTuple):
    """A traced piece: its rows, which follow each other with few gaps, and columns."""

    row: NDArray[np.int64]
    x_px: NDArray[np.float64]

    def slope(self, at_end: bool) -> float:
        """Columns a row near an end."""
        part = slice(-SLOPE_ROWS, None) if at_end else slice(0, SLOPE_ROWS)
        return float(np.polyfit(self.row[part], self.x_px[part], 1)[0])


def main() -> None:
    """Print what is joined and numbered, right and wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--picture", type=Path, help="draw the numbers into this file")
    given = parser.parse_args()
    folder = folder_of("multi_stripe")
    if folder is None:
        raise SystemExit("multi_stripe is not there: set ROEMETRY_REAL_DATA")
    image = cv2.imread(str(folder / "wheelset.jpg"), cv2.IMREAD_COLOR)
    turned = np.ascontiguousarray(np.rot90(image.max(axis=2)))
    pieces = traced(turned)
    number = numbered(pieces)
    told = [by_hand(piece) for piece in pieces]
    tell(pieces, number, told)
    if given.picture:
        draw(given.picture, turned, pieces, number)


def traced(turned: NDArray[np.uint8]) -> list[Piece]:
    """Give the pieces of at least `ROWS_MIN` rows."""
    peaks = Gaussian().extract(Frame(turned))
    of = WindowTracking().code(peaks, None).peak_stripe.astype(np.int64)
    found = [np.flatnonzero(of == n) for n in np.unique(of[of >= 0])]
    return [Piece(peaks.row[at], peaks.x_px[at]) for at in found if at.size >= ROWS_MIN]


def numbered(pieces: list[Piece]) -> list[int]:
    """Give each piece a stripe from 1, left to right; 0 where order and direction leave it open."""
    group = list(range(len(pieces)))
    for one, other in _joined(pieces):
        group = [group[one] if g == group[other] else g for g in group]
    next_of = _next_to(pieces, group)
    chain = _longest_chain(next_of)
    place = {g: n + 1 for n, g in enumerate(chain)}
    return [place.get(g, 0) for g in group]


def _spacing(pieces: list[Piece], of: Piece, at_row: int) -> float:
    """Median distance to the nearest pieces on the rows about one, px."""
    gaps = []
    for row in range(at_row - SLOPE_ROWS, at_row + SLOPE_ROWS + 1):
        here = of.x_px[np.abs(of.row - row).argmin()]
        there = [float(p.x_px[p.row == row][0]) for p in pieces if p is not of and (p.row == row).any()]
        gaps += [min(abs(x - here) for x in there)] if there else []
    return float(np.median(gaps)) if gaps else 0.0


def _joined(pieces: list[Piece]) -> list[tuple[int, int]]:
    """Pair ends with beginnings below that lie where both point, if nothing else lies nearly so."""
    off = np.full((len(pieces), len(pieces)), np.inf)
    gaps = np.zeros(off.shape, np.int64)
    for i, upper in enumerate(pieces):
        spacing = _spacing(pieces, upper, int(upper.row[-1]))
        for j, lower in enumerate(pieces):
            gap = gaps[i, j] = int(lower.row[0] - upper.row[-1])
            if 0 < gap <= REACH_ROWS and spacing > 0.0:
                slope = 0.5 * (upper.slope(at_end=True) + lower.slope(at_end=False))
                off[i, j] = abs(upper.x_px[-1] + slope * gap - lower.x_px[0]) / spacing
    found = []
    for i, j in zip(*np.nonzero(off <= NEAR), strict=True):
        rivals = (off <= FAR) & (gaps <= gaps[i, j] + RIVAL_ROWS)
        if rivals[i].sum() == 1 and rivals[:, j].sum() == 1:
            found.append((int(i), int(j)))
    return found


def _next_to(pieces: list[Piece], group: list[int]) -> dict[int, int]:
    """Give each group the one that stands next to its right, where that is so on all rows but a few."""
    votes: dict[tuple[int, int], int] = {}
    for row in range(min(int(p.row[0]) for p in pieces), max(int(p.row[-1]) for p in pieces) + 1):
        here = sorted(
            (float(p.x_px[p.row == row][0]), g)
            for p, g in zip(pieces, group, strict=True)
            if (p.row == row).any()
        )
        for (_, one), (_, other) in pairwise(here):
            votes[one, other] = votes.get((one, other), 0) + (one != other)
    right: dict[int, int] = {}
    for one in set(group):
        to = {other: n for (a, other), n in votes.items() if a == one}
        if to:
            best = max(to, key=lambda other: to[other])
            back = {a: n for (a, other), n in votes.items() if other == best}
            if to[best] >= SIDE_ROWS and max(back, key=lambda a: back[a]) == one:
                right[one] = best
    return right


def _longest_chain(next_of: dict[int, int]) -> list[int]:
    """Follow who stands next to whom, from each group on; the longest way."""
    best: list[int] = []
    for start in next_of:
        chain = [start]
        while chain[-1] in next_of and next_of[chain[-1]] not in chain:
            chain.append(next_of[chain[-1]])
        best = chain if len(chain) > len(best) else best
    return best


def by_hand(piece: Piece) -> int:
    """Give the number a person gave; 0 for none."""
    x, y = piece.x_px[0], piece.row[0]
    return next(
        (n for n, starts in BY_HAND.items() if any(abs(x - a) + abs(y - b) <= 6.0 for a, b in starts)), 0
    )


def tell(pieces: list[Piece], number: list[int], told: list[int]) -> None:
    """Print the table."""
    rows = np.array([piece.row.size for piece in pieces])
    given, hand = np.array(number), np.array(told)
    print("| | pieces | centres |\n|---|---|---|")
    for words, which in (
        ("all pieces of ten rows or more", rows > 0),
        ("numbered by hand", hand > 0),
        ("numbered, the same as by hand", (given > 0) & (given == hand)),
        ("numbered, another than by hand", (given > 0) & (hand > 0) & (given != hand)),
        ("numbered, and not by hand", (given > 0) & (hand == 0)),
        ("not numbered, but by hand", (given == 0) & (hand > 0)),
        ("not numbered, nor by hand", (given == 0) & (hand == 0)),
    ):
        print(f"| {words} | {which.sum()} | {rows[which].sum()} |")


def draw(path: Path, turned: NDArray[np.uint8], pieces: list[Piece], number: list[int]) -> None:
    """Draw pieces in the colour of their number; what has none is grey."""
    picture = cv2.resize(cv2.cvtColor(turned // 3, cv2.COLOR_GRAY2BGR), None, fx=2.0, fy=2.0)
    for piece, n in zip(pieces, number, strict=True):
        hue = np.array([[[(n * 67) % 180, 200, 255 if n else 110]]], np.uint8)
        colour = tuple(int(v) for v in cv2.cvtColor(hue, cv2.COLOR_HSV2BGR)[0, 0]) if n else (150, 150, 150)
        points = np.column_stack([2.0 * piece.x_px + 0.5, 2.0 * piece.row + 1.0]).astype(np.int32)
        cv2.polylines(picture, [points], False, colour, 3)
        middle = points[len(points) // 2]
        cv2.putText(picture, str(n) if n else "?", (int(middle[0]) + 6, int(middle[1])), 0, 0.8, colour, 2)
    cv2.imwrite(str(path), picture)


if __name__ == "__main__":
    main()
