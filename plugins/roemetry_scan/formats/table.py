"""CSV: a line a point, columns x, y, z (mm), and perhaps slice and point."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from roemetry.errors import DataError
from roemetry.io.files import write_bytes
from roemetry_scan.formats.points import Measured, flat, from_flat


def read(path: Path) -> Measured:
    """Read a table of points; DataError names the line that has too few or no numbers, or is cut off.

    A table has no header that says how long it is: one cut at the very end of a line is not told.
    """
    content = path.read_text("utf-8-sig")
    lines = csv.reader(content.splitlines())
    names = [name.strip().lower().split(" ")[0] for name in next(lines, [])]
    if not {"x", "y", "z"} <= set(names):
        raise DataError(f"{path}: its columns are {', '.join(names) or 'none'}, expected x, y, z, …")
    rows = []
    for number, line in enumerate(lines, start=2):
        if not line:
            continue
        try:
            rows.append([float(text) if text.strip() else np.nan for text in line])
        except ValueError:
            raise DataError(f"{path}, line {number}: not numbers: {','.join(line)[:60]}") from None
        if len(line) != len(names):
            raise DataError(f"{path}, line {number}: {len(line)} values for {len(names)} columns")
    # other programs may leave the last end of line out; ours never does
    if "point" in names and not content.endswith("\n"):  # `write` ends each line
        raise DataError(
            f"{path}, line {len(rows) + 1}: the last line is not ended: the file is cut off",
            hint="if it is whole, end its last line",
        )
    table = np.array(rows, np.float64).reshape(-1, len(names))
    at = {name: table[:, k] for k, name in enumerate(names)}
    return from_flat(np.column_stack([at[name] for name in "xyz"]), at.get("slice"), at.get("point"))


def write(path: Path, measured: Measured) -> list[Path]:
    """Write a line for each point, to a tenth of a micrometre."""
    xyz, slices, places = flat(measured)
    text = ["x (mm),y (mm),z (mm),slice,point\n"]
    text += [
        f"{x:.4f},{y:.4f},{z:.4f},{i},{k}\n"
        for (x, y, z), i, k in zip(xyz.tolist(), slices.tolist(), places.tolist(), strict=True)
    ]
    write_bytes(path, "".join(text).encode())
    return [path]
