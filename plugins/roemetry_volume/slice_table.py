"""A product's slices in the order in which they cut the belt, with what they stand for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry.errors import StageError
from roemetry.records import Product, Profiles

LEAST_SLICES = 3


class Slices(NamedTuple):
    """Slices with points on the product, along rising rest X.

    Attributes
    ----------
    stripe : ndarray of int64, shape (n,)
        Stripe of each.
    t_mm, area_mm2, width_mm, held_mm : ndarray of float64, shape (n,)
        Rest X; area; extent along Y; half the ways to both neighbours.
    table : ndarray of float64, shape (n, 12)
        All columns of `roemetry_kernels.slice_areas`.
    reach_mm, limited : tuple
        At both ends: distance to the next stripe (the mean spacing where there is none), and whether there
        is one.
    missing : int
        Stripes between others on the product without a point.
    seen_mm3, joined_mm3, assumed_mm3 : float
        What was seen, what was bridged along a stripe, what stands over stripes without a point.
    """

    stripe: Integers
    t_mm: Floats
    area_mm2: Floats
    width_mm: Floats
    held_mm: Floats
    table: Floats
    reach_mm: tuple[float, float]
    limited: tuple[bool, bool]
    missing: int
    seen_mm3: float
    joined_mm3: float
    assumed_mm3: float


def slices_of(product: Product) -> Slices:
    """Cut a product into its slices.

    Raises
    ------
    StageError
        Fewer than three stripes lie on the product, or a plane of light runs along X.
    """
    from roemetry_kernels import slice_areas as columns

    profiles = product.profiles
    table = table_of(profiles, product.number)
    lit = np.flatnonzero(table[:, columns.COUNT])
    if not lit.size:
        raise StageError("no stripe on the product", hint="there is nothing to sum; look at the coding")
    if lit.size < LEAST_SLICES:
        raise StageError(
            f"only {lit.size} {'stripe lies' if lit.size == 1 else 'stripes lie'} on the product: what is "
            "between and beyond is not known",
            hint="a finer fan of stripes, or a larger product",
        )
    t_all = table[:, columns.AT]
    if np.isnan(t_all).any():
        named = int(profiles.stripe[np.isnan(t_all)][0]) + 1
        raise StageError(f"the plane of stripe {named} runs along X: slices have no spacing there")
    lit = lit[np.argsort(t_all[lit], kind="stable")]
    rows, t = table[lit], t_all[lit]
    stripe, frame = profiles.stripe[lit], profiles.frame[lit]
    gap = np.diff(t)
    if not (gap > 0.0).all():
        raise StageError("two slices lie at the same place", hint="one slice for each stripe and frame")
    # Stripe numbers tell of stripes without a point, within a frame: a scan's frames overlap as they like.
    step = np.where(frame[1:] == frame[:-1], np.maximum(np.abs(np.diff(stripe)), 1), 1)
    spacing = gap / step
    before, after = _beyond(t_all, t[0], t[-1])
    usual = float(spacing.mean())
    held = np.zeros(t.size)
    held[:-1] += 0.5 * gap
    held[1:] += 0.5 * gap
    own = np.zeros(t.size)
    own[:-1] += 0.5 * spacing
    own[1:] += 0.5 * spacing
    seen, joined = rows[:, columns.SEEN], rows[:, columns.BRIDGED] + rows[:, columns.FILLED]
    return Slices(
        stripe=stripe,
        t_mm=t,
        area_mm2=rows[:, columns.AREA].copy(),
        width_mm=rows[:, columns.WIDTH].copy(),
        held_mm=held,
        table=rows,
        reach_mm=(usual if before is None else before, usual if after is None else after),
        limited=(before is not None, after is not None),
        missing=int((step - 1).sum()),
        seen_mm3=float(seen @ own),
        joined_mm3=float(joined @ own),
        assumed_mm3=float((seen + joined) @ (held - own)),
    )


def table_of(profiles: Profiles, number: int) -> Floats:
    """Give the kernel's table; points in any order are put into that of the rows first."""
    from roemetry_kernels.slice_areas import slice_areas

    for _ in range(2):
        table: Floats
        table, ordered = slice_areas(
            profiles.xyz_mm,
            profiles.product,
            profiles.seen,
            profiles.row_px,
            profiles.plane,
            profiles.frame,
            number,
        )
        if ordered:
            break
        profiles = _in_rows(profiles)
    return table


def _in_rows(profiles: Profiles) -> Profiles:
    order = np.argsort(profiles.row_px, axis=1, kind="stable")

    def moved(values: Any) -> Any:
        return np.take_along_axis(values, order, axis=1)

    return replace(
        profiles,
        xyz_mm=np.take_along_axis(profiles.xyz_mm, order[:, :, None], axis=1),
        product=moved(profiles.product),
        seen=moved(profiles.seen),
        x_px=moved(profiles.x_px),
        row_px=moved(profiles.row_px),
        height_std_mm=moved(profiles.height_std_mm),
    )


def _beyond(t_all: Floats, first: float, last: float) -> tuple[float | None, float | None]:
    """Distance from both outer slices to the next stripe outside, or None."""
    before, after = t_all[t_all < first], t_all[t_all > last]
    return (
        first - float(before.max()) if before.size else None,
        float(after.min()) - last if after.size else None,
    )
