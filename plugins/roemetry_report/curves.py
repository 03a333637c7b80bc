"""Coded stripes as drawable lines: belt, product, bridged."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from roemetry.records import BELT, StripeMap
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette, svg

_POINTS_MAX = 6000
"""More points than these make a section too large; then only every n-th row is drawn."""


def curves(stripes: StripeMap, *, product: int | None = None) -> Markup:
    """Draw every stripe: on the belt thin and grey, on a product thick and coloured, bridged dashed.

    Parameters
    ----------
    stripes
        What the coder gave.
    product
        Draw this product's points only; None draws all products and the belt.
    """
    step = row_step(stripes)
    parts = []
    for index in range(stripes.stripe_count):
        x, label, seen = stripes.x_px[index], stripes.product[index], stripes.seen[index]
        colour = palette.stripe_colour(index)
        body = label > BELT if product is None else label == product
        if product is None:
            parts += _path(x, seen & (label == BELT), step, "c-belt", palette.BELT)
            parts += _path(x, ~seen & (label == BELT), step, "c-belt c-bridged", palette.BELT, join=True)
        parts += _path(x, seen & body, step, "c-body", colour)
        parts += _path(x, ~seen & body, step, "c-body c-bridged", colour, join=True)
    return Markup("").join(parts)


def row_step(stripes: StripeMap) -> int:
    """Every how many rows a point is drawn."""
    return max(1, -(-int(np.isfinite(stripes.x_px).sum()) // _POINTS_MAX))


def runs(mask: Flags) -> Iterator[tuple[int, int]]:
    """Give first and one-past-last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _path(x: Floats, mask: Flags, step: int, kind: str, colour: str, *, join: bool = False) -> list[Markup]:
    """Give one path for all runs; `join` draws from the known point before to the one after each run."""
    data = []
    for begin, end in runs(mask):
        first = begin - 1 if join and begin > 0 and np.isfinite(x[begin - 1]) else begin
        last = end if join and end < len(x) and np.isfinite(x[end]) else end - 1
        rows = np.arange(first, last + 1, step)
        if rows[-1] != last:
            rows = np.append(rows, last)
        data.append(svg.line(x[rows], rows.astype(np.float64)))
    if not data:
        return []
    return [Markup('<path class="c {}" stroke="{}" d="{}"/>').format(kind, colour, "".join(data))]
