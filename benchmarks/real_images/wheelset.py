"""Twenty stripes on a curved part: against another program's centre lines, and against marks made by hand.

The other program's lines run on through the black band of the image, which must have been painted over
later, so only those of its points count that have light. Which of these have a stripe's middle under them was
judged by eye. Where a stripe runs along the rows it has no
centre in them: each point is looked for either in the image as it is or in the image turned by 90°, in
whichever the line is steeper.

The other program's points that our extractors did not match were judged by eye: `wheelset_points.csv` holds
every point that any of `gaussian`, `maximum-likelihood`, `log-parabola`, `centre-of-gravity` and `steger` was
more than 3 px away from when it was made. Each was looked at ten times as large, with the other program's
line and a bar of 3 px to either side, without any peaks of ours; one that is not in the file is a `stripe`:

- ``stripe``: the middle of the stripe lies within 3 px, as the eye carries the stripe on through glare and
  where paint cuts its end off slantwise; also whatever was in doubt
- ``beside``: the middle lies farther away: the line fans out into a corner, or bends off to the border
- ``border``: the stripe's middle has left the image: the row shows a flank. It was taken to lie half of the
  stripe's width from the flank; the width is that of the nearest rows in which both flanks are to be seen

The marks (`wheelset_marks.csv`): in 100 rows and 100 columns, evenly spaced, each run of at least 3 pixels
above grey level 30 was proposed by a program, drawn over the image at three times its size, and judged by
eye:

- ``stripe``: the line; the middle of the run was seen to be its middle
- ``glare``: light that is no line: the streak that joins three stripes, and bulges beside stripes
- ``merged``: line and glare in one run, or an overexposed blob: not judged
- ``grazing``: the line runs along the row (the column): not judged

A peak in a stripe's run is right, but a second one in the same run is false; so is one in glare or on no
run.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.real_images import prepared, sound
from benchmarks.tables import Table, number, percent
from roemetry.records import Frame
from roemetry.stages import Extractor

MARKS = Path(__file__).with_name("wheelset_marks.csv")
POINTS = Path(__file__).with_name("wheelset_points.csv")
MATCH_PX = 3.0
_LIT = 60
_NEAR_PX = 13
_SLACK_PX = 2.0


@dataclass(frozen=True)
class Marked:
    """A run that was looked at: in row (column) `index`, from pixel `first` to `last`."""

    index: int
    first: float
    last: float
    verdict: str


def wheelset(home: Path, stages: Mapping[str, Extractor[Any]]) -> Table:
    """Judge extractors on the wheel set, whose images are in a folder."""
    image = cv2.imread(str(home / "wheelset.jpg"))
    centres = cv2.imread(str(home / "wheelset_author_centres.png"))
    rows = []
    for name, stage in stages.items():
        off: list[float] = []
        there: list[bool] = []
        counts = np.zeros(6, int)
        for turn_deg in (0, 90):
            frame = prepared(image, turn_deg=turn_deg, channel="max")
            row, x_px = sound(stage.extract(frame))
            wanted = list(lit_centres(centres, frame, turn_deg))
            off += distances(frame, wanted, row, x_px)
            by_eye = verdicts(turn_deg, frame.size[0])
            there += have_stripe(wanted, by_eye)
            _, tally = judged(marks(turn_deg, frame.size[0]), row, x_px)
            counts += tally
        away = np.array(off)
        matched = away <= MATCH_PX
        stripes, hit, extra, twice, glare, unlit = counts
        rows.append([
            name, f"{100.0 * matched.mean():.1f} of {matched.size}",
            f"{100.0 * matched[there].mean():.1f} of {sum(there)}",
            number(float(np.median(away[np.isfinite(away)])), 2), f"{percent(hit, stripes)} of {stripes}",
            percent(extra, hit + extra), f"{twice} / {glare} / {unlit}",
        ])  # fmt: skip
    head = [
        "extractor", f"its points within {MATCH_PX:.0f} px, %",
        "of those with a stripe's middle under them, %", "median distance, px", "marked crossings found, %",
        "false among the peaks judged, %", "twice on one stripe / on glare / on no light",
    ]  # fmt: skip
    title = "Wheel set: another program's lit centres, and 200 rows and columns marked by hand"
    return Table(title, head, rows)


def lit_centres(centres: NDArray[Any], frame: Frame, turn_deg: int) -> Iterable[tuple[int, float]]:
    """Give (row, x) of the other program's line where it is steep and the image has light."""
    drawn = np.rot90(centres[..., 2] > 0, turn_deg // 90)
    steep = is_steep(drawn)
    light = cv2.dilate(np.ascontiguousarray(frame.pixels), np.ones((3, 3), np.uint8))
    for row, line in enumerate(drawn):
        edge = np.flatnonzero(np.diff(line.astype(np.int8), prepend=0, append=0))
        for first, end in zip(edge[::2], edge[1::2], strict=True):
            x_px = 0.5 * (first + end - 1)
            if steep[row, int(x_px)] and light[row, int(x_px)] > _LIT:
                yield row, x_px


def is_steep(drawn: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell where a drawn line runs more along the columns than along the rows, from its pixels near by."""
    there = np.ascontiguousarray(drawn, np.float64)
    y, x = np.mgrid[: there.shape[0], : there.shape[1]].astype(np.float64)

    def near(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(cv2.boxFilter(there * values, -1, (_NEAR_PX, _NEAR_PX), normalize=False))

    count = np.maximum(near(np.ones_like(there)), 1.0)
    spread = [near(at**2) - near(at) ** 2 / count for at in (x, y)]
    return np.asarray(drawn & (spread[1] > spread[0]))


def distances(
    frame: Frame, wanted: Iterable[tuple[int, float]], row: NDArray[np.int64], x_px: NDArray[np.float64]
) -> list[float]:
    """Give each point's distance to the nearest peak of its row, px; infinite where there is none."""
    begin = np.searchsorted(row, np.arange(frame.size[0] + 1))
    return [float(np.abs(x_px[begin[y] : begin[y + 1]] - x).min(initial=np.inf)) for y, x in wanted]


def _by_eye(path: Path, turn_deg: int, rows: int) -> Iterator[tuple[int, dict[str, str]]]:
    """Read what was judged in the rows (0°) or in the columns (90°), by row of the turned image."""
    axis = "row" if turn_deg == 0 else "column"
    with path.open(encoding="utf-8", newline="") as lines:
        for each in csv.DictReader(lines):
            if each["axis"] == axis:
                index = int(each["index"])
                yield index if turn_deg == 0 else rows - 1 - index, each


def marks(turn_deg: int, rows: int) -> list[Marked]:
    """Give the marks of the rows or of the columns."""
    return [
        Marked(index, float(each["first"]), float(each["last"]), each["verdict"])
        for index, each in _by_eye(MARKS, turn_deg, rows)
    ]


def verdicts(turn_deg: int, rows: int) -> dict[tuple[int, float], str]:
    """Give the verdicts on the other program's points, by (row, x)."""
    found = _by_eye(POINTS, turn_deg, rows)
    return {(index, float(each["place"])): each["verdict"] for index, each in found}


def have_stripe(wanted: Sequence[tuple[int, float]], judged: dict[tuple[int, float], str]) -> list[bool]:
    """Tell which points have a stripe's middle under them; those that were not judged have."""
    return [judged.get(point, "stripe") == "stripe" for point in wanted]


def judged(
    marked: list[Marked], row: NDArray[np.int64], x_px: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Tell which peaks are not wrong (those of unmarked rows pass), and count.

    The counts: marked stripes, those found, false peaks, of them second ones, on glare, on no light.
    """
    right = np.ones(len(row), bool)
    stripes = hit = twice = glare = unlit = 0
    for index in sorted({each.index for each in marked}):
        here = np.flatnonzero(row == index)
        free = set(here.tolist())
        for run in (each for each in marked if each.index == index):
            inside = here[(x_px[here] >= run.first - _SLACK_PX) & (x_px[here] <= run.last + _SLACK_PX)]
            free -= set(inside.tolist())
            if run.verdict == "stripe":
                stripes += 1
                hit += bool(inside.size)
                twice += max(inside.size - 1, 0)
                middle = 0.5 * (run.first + run.last)
                right[inside[np.argsort(np.abs(x_px[inside] - middle))[1:]]] = False
            elif run.verdict == "glare":
                glare += inside.size
                right[inside] = False
        unlit += len(free)
        right[list(free)] = False
    return right, np.array([stripes, hit, twice + glare + unlit, twice, glare, unlit])
