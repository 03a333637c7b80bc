"""The sheet of points over a product's footprint that a mesh is laid through."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Product, Reason
from roemetry.records.arrays import Flags, Floats

_COLUMNS = 64  # places along a line that are joined to those of the next
_EDGE_PX = 0.5  # an outline nearer to the image's edge may go on beyond it
_FAR_MM = 4.0  # lines that end farther inside an outline show something else
_BEYOND_OUTER = Reason(
    "beyond-outer-stripes",
    "the product reaches beyond the outer stripes; what lies beyond is not in the number",
)


@dataclass(frozen=True, eq=False, slots=True)
class Sheet:
    """A grid over the product, shape (row, column, 3), mm, laid through the measured lines.

    Rows run along X, from tip to tip where there is an outline, columns along each line; `assumed` marks
    rows beyond the outer lines. `spacing_mm` is the mean distance of neighbouring lines; `miss_mm` how far
    a line lies from the bridge over its own place when it is left out, root mean square: of bridges twice
    as wide (NaN with fewer than five lines).
    """

    xyz_mm: Floats
    spacing_mm: float
    lines: tuple[Line, ...]
    miss_mm: float
    assumed: Flags
    reasons: tuple[Reason, ...]


def sheet_of(product: Product, step_mm: float) -> Sheet:
    """Lay a sheet over a product, its grid about `step_mm` wide.

    Raises
    ------
    StageError
        Too few stripes, a hole, or an outline that reaches the image's edge.
    """
    lines, reasons = lines_of(product)
    even = np.array([_evenly(line.xyz_mm, _COLUMNS) for line in lines])
    border, why = _border(product, lines)
    tips = [None if border is None else _tip(border, even, end) for end in (0, -1)]
    if why is None and any(tip is None for tip in tips):
        why = _BEYOND_OUTER
    stack = np.array([*([tips[0]] if tips[0] is not None else []), *even, *tips[1:][: tips[1] is not None]])
    gaps = np.linalg.norm(np.diff(stack, axis=0), axis=2).mean(axis=1)
    rows, assumed = [], []
    last = len(stack) - 1
    for k, gap in enumerate(gaps.tolist()):
        beyond = (k == 0 and tips[0] is not None) or (k == last - 1 and tips[1] is not None)
        for share in np.arange(parts := max(round(gap / step_mm), 1)) / parts:
            rows.append(_bridge(stack, k, float(share)))
            assumed.append(beyond and not (k == last - 1 and share == 0.0))
    rows.append(stack[-1])
    assumed.append(tips[1] is not None)
    long = float(np.median(np.linalg.norm(np.diff(even, axis=1), axis=2).sum(axis=1)))
    columns = max(round(long / step_mm), 6) + 1
    return Sheet(
        xyz_mm=np.array([_evenly(row, columns) for row in rows]),
        spacing_mm=float(np.linalg.norm(np.diff(even, axis=0), axis=2).mean()),
        lines=lines,
        miss_mm=_miss(even),
        assumed=np.array(assumed),
        reasons=reasons if why is None else (*reasons, why),
    )


def _evenly(points: Floats, count: int) -> Floats:
    """Resample an open line to `count` points at even distances."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(at, along, points[:, k]) for k in range(3)])


def _bridge(stack: Floats, k: int, share: float) -> Floats:
    """Give the row a share of the way from row k to the next: cubics with slopes from the neighbours."""
    here, there = stack[k], stack[k + 1]
    gap = float(np.linalg.norm(there - here, axis=1).mean())
    chord = (there - here) / gap
    slopes = []
    for inner, outer in ((k, k - 1), (k + 1, k + 2)):
        if not 0 <= outer < len(stack):
            slopes.append(chord)
            continue
        wide = float(np.linalg.norm(stack[outer] - stack[inner], axis=1).mean())
        other = (stack[inner] - stack[outer]) / wide * (1.0 if outer < inner else -1.0)
        slopes.append((chord * wide + other * gap) / (wide + gap))
    f = share
    row: Floats = (
        (1.0 + 2.0 * f) * (1.0 - f) ** 2 * here
        + f * f * (3.0 - 2.0 * f) * there
        + f * (1.0 - f) ** 2 * gap * slopes[0]
        - f * f * (1.0 - f) * gap * slopes[1]
    )
    return row


def _miss(even: Floats) -> float:
    """Root mean square of heights against the bridges over left-out lines."""
    if len(even) < 5:
        return float("nan")
    misses = []
    for k in range(2, len(even) - 2):
        rest = np.delete(even, k, axis=0)
        near, far = even[k - 1].mean(axis=0)[0], even[k + 1].mean(axis=0)[0]
        share = (even[k].mean(axis=0)[0] - near) / (far - near)
        misses.append(_bridge(rest, k - 1, float(np.clip(share, 0.0, 1.0)))[:, 2] - even[k, :, 2])
    return float(np.sqrt(np.mean(np.square(misses))))


def _border(product: Product, lines: tuple[Line, ...]) -> tuple[Floats | None, Reason | None]:
    """Place the outline at the height of the nearest lines' ends: (n, 3), or why there is none."""
    import cv2

    outline, view = product.outline, product.view
    if outline is None or view is None:
        return None, _BEYOND_OUTER
    rows, columns = product.calibration.image_size
    xy = outline.xy_px
    if ((xy < _EDGE_PX) | (xy > np.array([columns, rows]) - 1.0 - _EDGE_PX)).any():
        raise StageError(
            "the product's outline reaches the image's edge: a part is not seen",
            hint="place it within the image",
        )
    ends = np.array([line.xyz_mm[k] for line in lines for k in (0, -1)])
    border = view.at_height(xy, np.full(len(xy), float(np.median(ends[:, 2]))))
    for _ in range(2):
        off = np.linalg.norm(border[:, None, :2] - ends[None, :, :2], axis=2)
        weight = 1.0 / (1.0 + off) ** 2
        border = view.at_height(xy, (weight * ends[:, 2]).sum(axis=1) / weight.sum(axis=1))
    ring = border[:, None, :2].astype(np.float32)
    inside = [cv2.pointPolygonTest(ring, (float(x), float(y)), True) for x, y in ends[:, :2]]
    if float(np.median(inside)) > _FAR_MM or float(np.median(inside)) < -1.0:
        return None, Reason(
            "outline-disagrees",
            f"the outline is not that of what the stripes show: their ends lie {np.median(inside):+.1f} mm "
            "inside it; what lies beyond the outer stripes is not in the number",
        )
    return border, None


def _tip(border: Floats, even: Floats, end: int) -> Floats | None:
    """Give the part of the border beyond an outer line, from its low to its high Y, or None."""
    line, inner = even[end], even[1 if end == 0 else -2]
    low, high = line[0, :2], line[-1, :2]
    normal = np.array([high[1] - low[1], low[0] - high[0]])
    normal /= max(float(np.hypot(*normal)), 1e-9)
    side = -np.sign(float((inner.mean(axis=0)[:2] - low) @ normal))
    beyond = side * ((border[:, :2] - low) @ normal) > 0.0
    starts = np.flatnonzero(beyond & ~np.roll(beyond, 1))
    if starts.size != 1 or beyond.sum() < 5:
        return None
    part = np.roll(border, -int(starts[0]), axis=0)[: int(beyond.sum())]
    return _evenly(part if part[0, 1] < part[-1, 1] else part[::-1], _COLUMNS)


LEAST_LINES = 3  # two span no surface that is curved across them
_LEAST_POINTS = 4  # on a stripe that counts as a line
_GAP_MM = 3.0  # between neighbours along a line: some ten image rows of the herring roe rig
_FALLEN = 0.5  # of a line's height: rims of a gap that are lower are those of a hole
_SUNKEN_MM = 1.0  # mean depth of a line below the belt that no error of a belt's zero explains


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
