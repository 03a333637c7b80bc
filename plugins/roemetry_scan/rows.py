"""Where the places of a rig's image lie in space, asked of its triangulator once for all lines of a scan.

The rig stands still, so a place (x, row) of the image is the same point for every line. The recipe's own
triangulator, whichever it is, is asked at 33 places of each row, and cubics between them do for all lines.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from roemetry.records import StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages import Triangulator
from roemetry_kernels.compiling import float_kernel

_NODES = 33
"""Of each row: between them a plane seen in perspective follows a cubic to 1e-9 of its distance."""


class RowTable(NamedTuple):
    """Points at evenly spaced places of each row."""

    points: Floats
    """(stripe, row, node, 4) X, Y, Z, mm, and the standard uncertainty of Z, mm, for one pixel of it in x."""
    plane: Floats
    """(stripe, 4) planes of light as in `Profiles`."""
    step_px: float
    """Distance of neighbouring nodes, of which the first lies at x = 0."""


def points_of_rows(calibration: Calibration, triangulator: Triangulator[Any]) -> RowTable:
    """Ask a triangulator for the points of 33 places of each row."""
    rows, columns = calibration.image_size
    count = calibration.stripe_count
    step = (columns - 1) / (_NODES - 1)
    points = np.full((count, rows, _NODES, 4), np.nan)
    plane = np.empty((0, 4))
    shape = (count, rows)
    # each node is asked in all rows at once, with an uncertainty of one pixel, so that the answer is a factor
    for node in range(_NODES):
        made = triangulator.triangulate(
            StripeMap(
                x_px=np.full(shape, node * step),
                x_std_px=np.ones(shape),
                product=np.ones(shape, np.int16),
                seen=np.ones(shape, np.bool_),
                margin=np.ones(shape),
                ambiguous=np.zeros(shape, np.bool_),
                rest_px=np.full(shape, np.nan),
                peak_stripe=np.empty(0, np.int16),
            ),
            calibration,
        )
        points[:, :, node, :3] = made.xyz_mm
        points[:, :, node, 3] = made.height_std_mm
        plane = made.plane
    return RowTable(points, plane, step)


def placed(
    x_px: Floats, x_std_px: Floats, table: RowTable, stripe: int, shift_mm: Floats
) -> tuple[Floats, Floats]:
    """Give (line, row, 3) points in the moving frame, mm, and (line, row) the noise of their heights, mm."""
    points, std = _placed(
        np.ascontiguousarray(x_px), np.ascontiguousarray(x_std_px), table.points[stripe], table.step_px,
        np.ascontiguousarray(shift_mm),
    )  # fmt: skip
    return points, std


@float_kernel
def _placed(
    x_px: Floats, x_std_px: Floats, nodes: Floats, step_px: float, shift: Floats
) -> tuple[Floats, Floats]:
    lines, rows = x_px.shape
    count = nodes.shape[1]
    points = np.full((lines, rows, 3), np.nan)
    std = np.full((lines, rows), np.nan)
    for i in range(lines):
        for r in range(rows):
            x = x_px[i, r] / step_px
            if math.isnan(x):
                continue
            # four nodes about the place: one before, three from it on; at the ends the outermost four
            k = min(max(int(x) - 1, 0), count - 4)
            u = x - k - 1.0
            # Lagrange's cubic through nodes at −1, 0, 1 and 2
            a = -u * (u - 1.0) * (u - 2.0) / 6.0
            b = (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0
            c = -(u + 1.0) * u * (u - 2.0) / 2.0
            d = (u + 1.0) * u * (u - 1.0) / 6.0
            for m in range(3):
                # the line's point, moved back by the way of the belt
                points[i, r, m] = (
                    a * nodes[r, k, m] + b * nodes[r, k + 1, m] + c * nodes[r, k + 2, m]
                    + d * nodes[r, k + 3, m] - shift[i, m]
                )  # fmt: skip
            std[i, r] = x_std_px[i, r] * (
                a * nodes[r, k, 3] + b * nodes[r, k + 1, 3] + c * nodes[r, k + 2, 3] + d * nodes[r, k + 3, 3]
            )
    return points, std
