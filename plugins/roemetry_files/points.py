"""points/: every coded point of each acquisition, for other programs."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from roemetry.errors import RoemetryError
from roemetry.files import make_folder, write_whole
from roemetry.records import Trace
from roemetry.stages import Run, Sink, StageOptions
from roemetry_files.names import file_name

_PIXELS = ["stripe", "row (px)", "x (px)", "x standard uncertainty (px)", "rest x (px)", "product", "seen"]
_MILLIMETRES = ["X (mm)", "Y (mm)", "Z (mm)"]


class Points(Sink[StageOptions]):
    """Writes ``points/<acquisition>.csv`` with a line for each coded point.

    Stripes are counted from 1, left to right; product 0 is the belt. Pixels are those of the turned image.
    """

    def write(self, run: Run) -> Sequence[Path]:
        """Write a file for each acquisition that was coded."""
        folder = run.folder / "points"
        make_folder(folder)
        written = []
        for name in dict.fromkeys(row.acquisition for row in run.measurements()):
            try:
                trace = run.replay(name)
            except RoemetryError:
                continue  # its row in the record says why it could not be read
            if trace.stripes is None:
                continue
            path = folder / f"{file_name(name)}.csv"
            write_whole(path, _table(trace))
            written.append(path)
        return written


def _table(trace: Trace) -> str:
    stripes, profiles = trace.stripes, trace.profiles
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_PIXELS + (_MILLIMETRES if profiles is not None else []))
    if stripes is None:
        return text.getvalue()
    for stripe, row in np.argwhere(np.isfinite(stripes.x_px)):
        line: list[object] = [
            stripe + 1,
            row,
            *(_text(field[stripe, row]) for field in (stripes.x_px, stripes.x_std_px, stripes.rest_px)),
            stripes.product[stripe, row],
            int(stripes.seen[stripe, row]),
        ]
        if profiles is not None:
            at = np.flatnonzero(profiles.stripe == stripe)
            point = _point(profiles.row_px[at[0]], row) if at.size else None
            xyz = profiles.xyz_mm[at[0], point] if point is not None else (np.nan,) * 3
            line += [_text(value) for value in xyz]
        writer.writerow(line)
    return text.getvalue()


def _point(row_px: np.ndarray, row: int) -> int | None:
    found = np.flatnonzero(row_px == row)
    return int(found[0]) if found.size else None


def _text(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else ""
