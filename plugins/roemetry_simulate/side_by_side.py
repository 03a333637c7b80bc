"""Several products in one frame: each at a free place of the belt that stripes and camera cover."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import StageError
from roemetry_simulate.placing import moved_to
from roemetry_simulate.products import Drawn
from roemetry_simulate.render import Rig
from roemetry_simulate.scene_camera import view_mm

Flags = NDArray[np.bool_]

_CELL_MM = 0.5
_TRIES, _STARTS = 200, 20
_MARGIN_MM = 1.0


def side_by_side(
    products: Sequence[Drawn],
    rig: Rig,
    *,
    gap_mm: float,
    most_overhang_spacings: float,
    seed: int,
    name: str,
) -> tuple[Drawn, ...]:
    """Lay products where they keep off each other.

    Parameters
    ----------
    products : sequence of Drawn
        As they were drawn; they are moved, not turned.
    rig : Rig
        Footprints stay within its view of the belt.
    gap_mm : float
        Least gap between two footprints.
    most_overhang_spacings : float
        How far they may reach beyond the outermost planes, in mean spacings on the belt.
    seed : int
        Of the places, which are drawn uniformly and kept where they are free.
    name : str
        Of the item, for the message.

    Returns
    -------
    tuple of Drawn
        From left to right.

    Raises
    ------
    StageError
        There is no room for so many.
    """
    rng = np.random.default_rng([seed, 53])
    low_x, high_x, low_y, high_y = _room(rig, most_overhang_spacings)
    shape = (int((high_y - low_y) / _CELL_MM), int((high_x - low_x) / _CELL_MM))
    masks = [_mask(one) for one in products]
    fits = all(mask.shape[0] < shape[0] and mask.shape[1] < shape[1] for mask in masks)
    for _ in range(_STARTS if fits else 0):
        taken = np.zeros(shape, bool)
        laid = []
        for one, mask in zip(products, masks, strict=True):
            at = _free_place(rng, taken, mask)
            if at is None:
                break
            x_min, _, y_min, _ = one.solid.footprint_extent_mm()
            laid.append(moved_to(one, low_x + _CELL_MM * at[1] - x_min, low_y + _CELL_MM * at[0] - y_min))
            taken[at[0] : at[0] + mask.shape[0], at[1] : at[1] + mask.shape[1]] |= mask
            taken = _grown(taken, mask, at, gap_mm)
        else:
            return tuple(sorted(laid, key=lambda one: sum(one.solid.footprint_extent_mm()[:2])))
    raise StageError(
        f"{name}: there is no room for {len(products)} products on X = {low_x:.1f} to {high_x:.1f} mm, "
        f"Y = {low_y:.1f} to {high_y:.1f} mm of the belt with {gap_mm:g} mm between them",
        hint="take fewer or smaller products, or a smaller gap",
        at=("product", "in_frame"),
    )


def _room(rig: Rig, most_overhang_spacings: float) -> tuple[float, float, float, float]:
    x_min, x_max, y_min, y_max = view_mm(rig.camera, 0.0)
    feet = rig.laser.x_mm(0.5 * (y_min + y_max), 0.0)
    if feet.size > 1:
        beyond_mm = most_overhang_spacings * float(np.ptp(feet)) / (feet.size - 1)
        x_min = max(x_min, float(feet.min()) - beyond_mm)
        x_max = min(x_max, float(feet.max()) + beyond_mm)
    return x_min + _MARGIN_MM, x_max - _MARGIN_MM, y_min + _MARGIN_MM, y_max - _MARGIN_MM


def _mask(one: Drawn) -> Flags:
    """Cells of the product's extent that its footprint may touch."""
    from scipy.ndimage import binary_dilation

    x_min, x_max, y_min, y_max = one.solid.footprint_extent_mm()
    x, y = np.meshgrid(
        np.arange(x_min, x_max + _CELL_MM, _CELL_MM), np.arange(y_min, y_max + _CELL_MM, _CELL_MM)
    )
    mask: Flags = binary_dilation(np.isfinite(one.solid.heights_mm(x, y)[0]))
    return mask


def _free_place(rng: np.random.Generator, taken: Flags, mask: Flags) -> tuple[int, int] | None:
    for _ in range(_TRIES):
        row = int(rng.integers(0, taken.shape[0] - mask.shape[0]))
        column = int(rng.integers(0, taken.shape[1] - mask.shape[1]))
        if not (taken[row : row + mask.shape[0], column : column + mask.shape[1]] & mask).any():
            return row, column
    return None


def _grown(taken: Flags, mask: Flags, at: tuple[int, int], gap_mm: float) -> Flags:
    """Add what lies within the gap of the product that was laid last."""
    from scipy.ndimage import distance_transform_edt

    alone = np.ones(taken.shape, bool)
    alone[at[0] : at[0] + mask.shape[0], at[1] : at[1] + mask.shape[1]] = ~mask
    near: Flags = _CELL_MM * distance_transform_edt(alone) <= gap_mm
    return taken | near
