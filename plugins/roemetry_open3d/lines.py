"""A product's stripes as lines in space, in the order in which they cut the belt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Product, Reason
from roemetry.records.arrays import Flags, Floats

LEAST_LINES = 3
_LEAST_POINTS = 4
_GAP_MM = 3.0
_FALLEN = 0.5
_SUNKEN_MM = 1.0


class Line(NamedTuple):
    """Points of one slice along rising Y: `xyz_mm` (n, 3), `std_mm` (n,) of their height, `seen` (n,)."""

    xyz_mm: Floats
    std_mm: Floats
    seen: Flags


def lines_of(product: Product) -> tuple[tuple[Line, ...], tuple[Reason, ...]]:
    """Give the lines along rising X, and what is to be said of them.

    Raises
    ------
    StageError
        Fewer than three stripes lie on the product, one of them lies below the belt, or one shows a hole: no
        single sheet goes through both of its rims.
    """
    profiles = product.profiles
    mine = _between_seen(
        (profiles.product == product.number) & np.isfinite(profiles.xyz_mm[..., 2]), profiles.seen
    )
    lit = np.flatnonzero(mine.sum(axis=1) >= _LEAST_POINTS)
    if lit.size < LEAST_LINES:
        raise StageError(
            f"only {lit.size} {'stripe lies' if lit.size == 1 else 'stripes lie'} on the product with "
            f"{_LEAST_POINTS} points or more: no surface goes through so few",
            hint="a finer fan of stripes, or a larger product",
        )
    y0 = float(np.median(profiles.xyz_mm[..., 1][mine]))
    plane = profiles.plane
    at = (plane[lit, 3] - plane[lit, 1] * y0) / plane[lit, 0]
    lit = lit[np.argsort(at, kind="stable")]
    lines, gaps = [], []
    for index in lit.tolist():
        points = profiles.xyz_mm[index][mine[index]]
        order = np.argsort(points[:, 1], kind="stable")
        line = Line(
            points[order],
            profiles.height_std_mm[index][mine[index]][order],
            profiles.seen[index][mine[index]][order],
        )
        stripe = int(profiles.stripe[index]) + 1
        if (depth := -float(line.xyz_mm[:, 2].mean())) > _SUNKEN_MM:
            raise StageError(
                f"the slice of stripe {stripe} lies {depth:.1f} mm below the belt: no product does",
                hint="look at the coding, the calibration and the belt's zero",
            )
        if _has_gap(line, stripe):
            gaps.append(stripe)
        lines.append(line)
    return tuple(lines), _reasons(lit, profiles.stripe, gaps)


def _between_seen(mine: Flags, seen: Flags) -> Flags:
    """Keep the points between the outermost seen ones of each slice: bridges beyond run down to the belt."""
    lit = mine & seen
    begun = np.logical_or.accumulate(lit, axis=1)
    to_come = np.logical_or.accumulate(lit[:, ::-1], axis=1)[:, ::-1]
    kept: Flags = mine & begun & to_come
    return kept


def _has_gap(line: Line, stripe: int) -> bool:
    """Say whether points are missing along a line; raise where that is a hole."""
    y, z = line.xyz_mm[:, 1], line.xyz_mm[:, 2]
    wide = np.flatnonzero(np.diff(y) > _GAP_MM)
    for k in wide.tolist():
        if max(z[k], z[k + 1]) < _FALLEN * float(z.max()):
            raise StageError(
                f"the surface falls away and rises again over {y[k + 1] - y[k]:.1f} mm of stripe {stripe}: a "
                "hole, or two products, which no single closed sheet can follow",
                hint="a slice estimator counts nothing there and says so",
            )
    return bool(wide.size)


def _reasons(lit: np.ndarray, stripes: np.ndarray, gaps: list[int]) -> tuple[Reason, ...]:
    reasons = []
    dead = int((np.abs(np.diff(stripes[lit])) - 1).clip(0).sum())
    if dead:
        reasons.append(
            Reason(
                "dead-stripe",
                f"{dead} {'stripe' if dead == 1 else 'stripes'} between others on the product "
                f"{'shows' if dead == 1 else 'show'} nothing; the surface was bridged over the gap",
            )
        )
    if gaps:
        where = ", ".join(str(stripe) for stripe in gaps)
        reasons.append(
            Reason(
                "gap-in-slice", f"rows neither seen nor bridged (stripe {where}); joined by a straight line"
            )
        )
    return tuple(reasons)
