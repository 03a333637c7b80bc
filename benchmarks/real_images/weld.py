"""One line in a V groove, with reflections beside it: what is found of the line, and what of the rest.

The line was marked by hand: six points, straight between them; the bottom of the groove has no light of its
own. Speckle moves the middle of a single row's light by 0.4 to 0.7 px, so known is a parabola through those
middles along each straight part, looked at over the image eight times as large. It is turned by 90°, so that
the line crosses the rows.

What looks at one row cannot know that a small bright spot is a reflection. So the peaks also go through the
coder `window-tracking`, which needs no calibration: what it makes a stripe of is the profile.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.real_images import prepared, sound
from benchmarks.tables import Table, number, percent
from roemetry.errors import RoemetryError
from roemetry.records import Peaks
from roemetry.records.arrays import Floats
from roemetry.stages import Extractor
from roemetry.stages.registry import discover

LINE = ((2.0, 390.0), (518.0, 385.0), (735.0, 585.0)), ((818.0, 583.0), (1042.0, 389.0), (1278.0, 400.0))
"""(x, y) of the line's corners in the image as it is, px: left flank, right flank."""
NEAR_PX = 10.0
WIDTH_MAX_PX = 20.0
_AROUND_PX, _CORNER_PX = 14, 6  # of the marks: where light is the line's; where two parts meet
_ABOVE = 15.0  # grey levels above the column's median, that are light


def weld(home: Path, stages: Mapping[str, Extractor[Any]]) -> Table:
    """Judge extractors on the weld, whose images are in a folder."""
    image = cv2.imread(str(home / "weld2.png"))
    frame = prepared(image, turn_deg=90, channel="max")
    columns = image.shape[1]
    line = line_of(image)[::-1]  # turned by 90°, the last column is the first row
    rows = []
    for name, stage in stages.items():
        for limit in (None, WIDTH_MAX_PX):
            used, label = stage, name
            if limit is not None:
                if "width_max_px" not in type(stage.options).model_fields:
                    continue
                used = type(stage)(stage.options.model_copy(update={"width_max_px": limit}))
                label = f"{name}, widths to {limit:.0f} px"
            peaks = used.extract(frame)
            row, x_px = sound(peaks)
            off = np.abs(x_px - line[row])
            near, lit = off <= NEAR_PX, np.isfinite(line)
            seen = np.zeros(columns, bool)
            seen[row[near]] = True
            count = int(lit.sum())
            rows.append([
                label, f"{percent(int((seen & lit).sum()), count)} of {count}",
                number(float(np.median(off[near])) if near.any() else float("nan"), 2),
                str(int((~near).sum())), str(int(np.unique(row[~near]).size)),
                str(int(near.sum() - seen.sum())), profile_of(peaks, line),
            ])  # fmt: skip
    head = [
        "extractor", "columns of the line found, %", "median distance from it, px", "peaks off the line",
        "columns with such", "second peaks on the line",
        "profile: stripes; columns of the line, %; points off the line",
    ]  # fmt: skip
    return Table(f"Weld groove: the line as marked by hand, ± {NEAR_PX:.0f} px", head, rows)


def line_of(image: NDArray[Any]) -> Floats:
    """Give the line's y for each column, NaN where it has no light of its own."""
    light = image.max(axis=2).astype(np.float64)
    light = np.clip(light - np.median(light, axis=0) - _ABOVE, 0.0, None)
    line = np.full(light.shape[1], np.nan)
    for part in LINE:
        for (begin, y_begin), (end, y_end) in itertools.pairwise(part):
            columns = np.arange(int(begin), int(end) + 1)
            marked = np.rint(np.interp(columns, (begin, end), (y_begin, y_end))).astype(np.int64)
            rows = marked + np.arange(-_AROUND_PX, _AROUND_PX + 1)[:, None]
            here = light[rows, columns]
            middle = (here * rows).sum(axis=0) / np.maximum(here.sum(axis=0), 1.0)
            kept = (here.sum(axis=0) > 0) & (columns > begin + _CORNER_PX) & (columns < end - _CORNER_PX)
            for _ in range(5):
                path = np.polyval(np.polyfit(columns[kept], middle[kept], 2), columns)
                off = np.abs(middle - path)
                kept &= off <= 3.0 * 1.4826 * float(np.median(off[kept]))
            line[columns] = path
    return line


def profile_of(peaks: Peaks, line: Floats) -> str:
    """Code the peaks, and say what became of the line and of what lies off it."""
    registry = discover()
    coder = registry.load(registry.find("coder", "window-tracking"))()
    try:
        stripes = coder.code(peaks, None)
    except RoemetryError as refusal:
        return f"refused: {str(refusal).splitlines()[0]}"
    seen = np.where(stripes.seen, stripes.x_px, np.nan)
    known = np.isfinite(line)
    near = np.abs(seen - line) <= NEAR_PX
    on_line = near.any(axis=0)[known].mean() if len(near) else 0.0
    off = int((np.isfinite(seen) & ~near & known).sum())
    return f"{stripes.stripe_count}; {100.0 * on_line:.1f}; {off}"
