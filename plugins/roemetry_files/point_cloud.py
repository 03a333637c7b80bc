"""point_clouds/: every calibrated point of each acquisition as PLY, for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from roemetry.records import Trace
from roemetry.stages import Run, Sink, StageOptions
from roemetry_files.each_acquisition import write_each

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
