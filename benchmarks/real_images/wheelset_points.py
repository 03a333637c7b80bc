"""The other program's points that our extractors did not match, judged by eye.

`wheelset_points.csv` holds every point that any of `gaussian`, `maximum-likelihood`, `log-parabola`,
`centre-of-gravity` and `steger` was more than 3 px away from when it was made. Each was looked at ten times
as large, with the other program's line and a bar of 3 px to either side, and without any peaks of ours:

- ``stripe``: the middle of the stripe lies within 3 px, as the eye carries the stripe on through glare and
  where paint cuts its end off slantwise; also whatever was in doubt
- ``beside``: the middle lies farther away: the line fans out into a corner, or bends off to the border
- ``border``: the stripe's middle has left the image: the row shows a flank. It was taken to lie half of the
  stripe's width from the flank; the width is that of the nearest rows in which both flanks are to be seen

A point that is not in the file counts as `stripe`.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

POINTS = Path(__file__).with_name("wheelset_points.csv")
STRIPE = "stripe"
_SCALE = 10
_HALF_PX = 17
_ACROSS = 5
_BAR_PX = 3.0
_COLOURS = {STRIPE: (80, 255, 80), "beside": (60, 60, 255), "border": (255, 120, 255)}

Point = tuple[int, float]


def verdicts(turn_deg: int, rows: int) -> dict[Point, str]:
    """Read what was judged in the rows (0°) or in the columns (90°), turned as the image is: by (row, x)."""
    axis = "row" if turn_deg == 0 else "column"
    with POINTS.open(encoding="utf-8", newline="") as lines:
        found = [each for each in csv.DictReader(lines) if each["axis"] == axis]
    return {
        (int(each["index"]) if turn_deg == 0 else rows - 1 - int(each["index"]), float(each["place"])): (
            each["verdict"]
        )
        for each in found
    }


def have_stripe(wanted: Sequence[Point], judged: dict[Point, str]) -> list[bool]:
    """Tell which points have a stripe's middle under them; those that were not judged have."""
    return [judged.get(point, STRIPE) == STRIPE for point in wanted]


def sheet(path: Path, pixels: NDArray[Any], wanted: Sequence[Point], judged: dict[Point, str]) -> None:
    """Write an image of what was looked at: a cell for each run of judged points, coloured by verdict."""
    cells = [_cell(pixels, wanted, run, judged) for run in _runs(sorted(judged))]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % _ACROSS)
    lines = [np.hstack(cells[at : at + _ACROSS]) for at in range(0, len(cells), _ACROSS)]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack(lines))


def _runs(points: Sequence[Point]) -> list[list[Point]]:
    """Join points of rows that follow each other, at most 2 missing, and not 8 px apart."""
    runs: list[list[Point]] = []
    for row, x_px in points:
        for run in runs:
            if 0 <= row - run[-1][0] <= 3 and abs(x_px - run[-1][1]) < 8.0:
                run.append((row, x_px))
                break
        else:
            runs.append([(row, x_px)])
    return runs


def _cell(
    pixels: NDArray[Any], wanted: Sequence[Point], run: list[Point], judged: dict[Point, str]
) -> NDArray[Any]:
    middle = np.mean(run, axis=0).astype(int)
    padded = np.pad(pixels, _HALF_PX, constant_values=40)
    part = padded[middle[0] : middle[0] + 2 * _HALF_PX + 1, middle[1] : middle[1] + 2 * _HALF_PX + 1]
    large = cv2.resize(part, None, fx=_SCALE, fy=_SCALE, interpolation=cv2.INTER_NEAREST)
    shown = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)

    def place(row: float, x_px: float) -> tuple[int, int]:
        return (
            int((x_px - middle[1] + _HALF_PX + 0.5) * _SCALE),
            int((row - middle[0] + _HALF_PX + 0.5) * _SCALE),
        )

    for row, x_px in wanted:
        if max(abs(row - middle[0]), abs(x_px - middle[1])) > _HALF_PX:
            continue
        colour = _COLOURS[judged[row, x_px]] if (row, x_px) in run else (255, 160, 0)
        if (row, x_px) in run:
            cv2.line(shown, place(row, x_px - _BAR_PX), place(row, x_px + _BAR_PX), colour, 1)
        cv2.circle(shown, place(row, x_px), 3, colour, -1)
    cv2.putText(shown, f"row {run[0][0]}, x {run[0][1]:g}", (4, 14), 0, 0.5, (0, 255, 255), 1)
    cv2.rectangle(shown, (0, 0), (shown.shape[1] - 1, shown.shape[0] - 1), (90, 90, 90), 1)
    return np.asarray(shown)
