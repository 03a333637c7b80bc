"""Triangles as an STL file."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats


def stl_of(triangles: Floats, name: str) -> bytes:
    """Write (n, 3, 3) triangles, mm, as binary STL; the name stands in its head."""
    along = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.sqrt((along**2).sum(axis=1))
    record = np.zeros(
        len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    )
    record["normal"] = along / length[:, None]
    record["corners"] = triangles
    head = f"roemetry {name}, mm".encode("ascii", "replace")[:80].ljust(80)
    return head + np.uint32(len(triangles)).tobytes() + record.tobytes()
