"""The sinks `points` (CSV) and `point-cloud` (PLY): a file of every labelled point for each acquisition."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from roemetry.errors import RoemetryError
from roemetry.io.files import make_folder, write_bytes
from roemetry.records import Trace
from roemetry.stages import Run, Sink, StageOptions

_PIXELS = ["stripe", "row (px)", "x (px)", "x standard uncertainty (px)", "rest x (px)", "product", "seen"]
_MILLIMETRES = ["X (mm)", "Y (mm)", "Z (mm)", "random part of Z standard uncertainty (mm)"]


def write_each(
    run: Run, folder: str, ending: str, content: Callable[[Trace], bytes | None]
) -> Sequence[Path]:
    """Write ``folder/<acquisition>ending`` for each acquisition of which `content` gives anything.

    What cannot be read again is passed over: its row in the record says why.
    """
    place = run.folder / folder
    make_folder(place)
    written = []
    for name in dict.fromkeys(row.acquisition for row in run.measurements()):
        try:
            made = content(run.replay(name))
        except RoemetryError:
            continue
        if made is None:
            continue
        # whatever a source calls its acquisitions, the file stays in its folder
        path = place / f"{name.replace('/', '_').replace(chr(92), '_')}{ending}"
        write_bytes(path, made)
        written.append(path)
    return written


class Points(Sink[StageOptions]):
    """Writes ``points/<acquisition>.csv`` with a line for each labelled point.

    Stripes are counted from 1, left to right; product 0 is the belt. Pixels are those of the turned image.
    """

    def write(self, run: Run) -> Sequence[Path]:
        """Write a file for each acquisition that was labelled."""
        return write_each(run, "points", ".csv", _table)


def _table(trace: Trace) -> bytes | None:
    stripes, profiles = trace.stripes, trace.profiles
    if stripes is None:
        return None
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_PIXELS + (_MILLIMETRES if profiles is not None else []))
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
            there = (at[0], point) if point is not None else None
            xyz = (np.nan,) * 4 if there is None else (*profiles.xyz_mm[there], profiles.height_std_mm[there])
            line += [_text(value) for value in xyz]
        writer.writerow(line)
    return text.getvalue().encode()


def _point(row_px: np.ndarray, row: int) -> int | None:
    found = np.flatnonzero(row_px == row)
    return int(found[0]) if found.size else None


def _text(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else ""


_POINT = np.dtype(
    [
        ("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("z_std_mm", "<f4"),
        ("stripe", "<i4"), ("product", "<i4"), ("seen", "u1"),
    ]
)  # fmt: skip
_PLY = {"<f8": "double", "<f4": "float", "<i4": "int", "|u1": "uchar"}


class PointCloud(Sink[StageOptions]):
    """Writes ``point_clouds/<acquisition>.ply``, binary, belt frame, mm.

    Beside x, y, z each point has its random standard uncertainty in z (NaN: not modelled), its stripe from 1,
    its product (0: belt) and whether it was seen (1) or bridged (0), as scalar fields.
    """

    def write(self, run: Run) -> Sequence[Path]:
        """Write a file for each acquisition that was triangulated."""
        return write_each(run, "point_clouds", ".ply", _ply)


def _ply(trace: Trace) -> bytes | None:
    profiles = trace.profiles
    if profiles is None:
        return None
    known = np.isfinite(profiles.xyz_mm).all(axis=2) & (profiles.product >= 0)
    points = np.empty(int(known.sum()), dtype=_POINT)
    for axis, name in enumerate("xyz"):
        points[name] = profiles.xyz_mm[known][:, axis]
    points["z_std_mm"] = profiles.height_std_mm[known]
    points["stripe"] = np.broadcast_to(profiles.stripe[:, None] + 1, known.shape)[known]
    points["product"] = profiles.product[known]
    points["seen"] = profiles.seen[known]
    properties = [f"property {_PLY[_POINT[name].str]} {name}" for name in _POINT.names or ()]
    header = [
        "ply", "format binary_little_endian 1.0", "comment roemetry: belt frame, mm",
        f"element vertex {len(points)}", *properties, "end_header\n",
    ]  # fmt: skip
    return "\n".join(header).encode("ascii") + points.tobytes()
