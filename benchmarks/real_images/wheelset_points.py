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

POINTS = Path(__file__).with_name("wheelset_points.csv")
STRIPE = "stripe"

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
