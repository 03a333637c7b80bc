"""Products on the belt, item by item: drawn from a family, placed in view, alone or side by side.

An item's product has a seed of its own, so that each item can be made again by itself. One that does not fit
into the view is refused with both sizes, not cut. Several in a frame are moved, not turned, to free places
drawn uniformly, on a grid of half a millimetre that holds what is taken and its gap; after 200 tries for one
the belt is emptied and all are laid anew, up to 20 times.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roemetry.config.scene_parts import NONE, ProductPart, family_options
from roemetry.errors import StageError
from roemetry_simulate.optics import view_mm
from roemetry_simulate.products import MODELS, PRODUCTS, Drawn
from roemetry_simulate.products.mesh import MeshSolid
from roemetry_simulate.products.parts import PartsSolid
from roemetry_simulate.render import Rig
from roemetry_simulate.solid import (
    FIELDS,
    PARTS,
    Block,
    EmptyBelt,
    ExactBody,
    Fields,
    GriddedSolid,
    Reach,
    Solid,
)

_NEXT_IN_FRAME = 1_000_000_000
"""From the seed of a frame's product to that of its next, so that no other item's first has it."""


@dataclass(frozen=True, slots=True)
class ItemProducts:
    """One item's products from left to right (none for an empty belt), and the seed of the first."""

    seed: int
    products: tuple[Drawn, ...]

    @property
    def solid(self) -> Solid:
        """All of them as one solid."""
        return as_one_solid([one.solid for one in self.products]) if self.products else EmptyBelt()


def draw_item(part: ProductPart, rig: Rig, number: int, seed: int) -> ItemProducts:
    """Draw the products of an item (number from 0); seeds count up from the set's.

    Raises
    ------
    StageError
        A product is larger than the view, or there is no room for so many.
    """
    chosen = part.items[number] if number < len(part.items) else None
    # items that were chosen come first; the others count on from the set's own seed
    item_seed = seed + number - len(part.items) if chosen is None else chosen.seed
    if part.family == NONE:
        return ItemProducts(item_seed, ())
    family = PRODUCTS[part.family]
    options = family_options(part.family, part.options | ({} if chosen is None else chosen.options), MODELS)
    name = f"item {number + 1}, {part.family} of seed {item_seed}"
    if part.in_frame > 1:
        drawn = [family.draw(item_seed + _NEXT_IN_FRAME * k, options) for k in range(part.in_frame)]
        return ItemProducts(item_seed, side_by_side(drawn, rig, part, item_seed, name))
    # drawn where the family puts it, then moved into reach
    one = family.draw(item_seed, options)
    if part.keep_in_reach:
        one = in_reach(one, rig, part.most_overhang_spacings)
    check_in_view(one, rig, name)
    return ItemProducts(item_seed, (one,))


Floats = NDArray[np.float64]

_MARGIN_MM = 1.0  # kept free at the view's border, so that an outline stays whole in the image


def in_reach(drawn: Drawn, rig: Rig, most_overhang_spacings: float) -> Drawn:
    """Move a product along X until its ends keep within the view and near the outer stripes.

    An end may lie `most_overhang_spacings` mean spacings beyond the outermost planes. Moved by as little as
    need be; one that is too long is moved as far as it helps.
    """
    x_min, x_max, y_min, y_max = drawn.solid.footprint_extent_mm()
    # at a quarter of its height: where ends are lit and seen, not at the belt
    height_mm = 0.25 * drawn.solid.body().top_mm
    low, high, _, _ = view_mm(rig.camera, height_mm)
    low, high = low + _MARGIN_MM, high - _MARGIN_MM
    fan = np.sort(rig.laser.x_mm(0.5 * (y_min + y_max), height_mm))
    if fan.size > 1:
        beyond_mm = most_overhang_spacings * float(np.diff(fan).mean())
        low, high = max(low, float(fan[0]) - beyond_mm), min(high, float(fan[-1]) + beyond_mm)
    # as far as needed from one side, or from the other; too long for both it is left where it helps
    shift_mm = max(low - x_min, 0.0) + min(high - x_max, 0.0)
    return drawn if shift_mm == 0.0 else moved_to(drawn, shift_mm, 0.0)


def moved_to(drawn: Drawn, x_mm: float, y_mm: float) -> Drawn:
    """Return the same product, moved on the belt, with its reference and its truth."""
    figures = dict(drawn.truth.figures)
    for axis, by_mm in (("x", x_mm), ("y", y_mm)):
        for name in (f"{axis}_min_mm", f"{axis}_max_mm", f"centre_{axis}_mm"):
            if name in figures:
                figures[name] += by_mm
    return replace(
        drawn,
        solid=moved(drawn.solid, x_mm, y_mm),
        truth=replace(drawn.truth, figures=figures),
        reference=None if drawn.reference is None else moved(drawn.reference, x_mm, y_mm),
    )


def check_in_view(drawn: Drawn, rig: Rig, name: str) -> None:
    """Raise StageError, with sizes, for a product that reaches out of the view or up to the camera."""
    top_mm = drawn.solid.body().top_mm
    lowest_mm = min(float(rig.camera.centre_mm[2]), float(rig.laser.projector_mm[2]))
    if top_mm >= lowest_mm:
        raise StageError(
            f"{name}: the product is {top_mm:.1f} mm high, and camera or laser hang at {lowest_mm:.1f} mm",
            hint="make the product smaller, or hang them higher",
            at=("product",),
        )
    found, view = drawn.solid.footprint_extent_mm(), view_mm(rig.camera, 0.0)
    inside = found[0] >= view[0] and found[1] <= view[1] and found[2] >= view[2] and found[3] <= view[3]
    if not inside:
        raise StageError(
            f"{name}: the product {_why(found, view)}: it lies on X = {found[0]:.1f} to {found[1]:.1f} mm, "
            f"Y = {found[2]:.1f} to {found[3]:.1f} mm; the view is X = {view[0]:.1f} to {view[1]:.1f} mm, "
            f"Y = {view[2]:.1f} to {view[3]:.1f} mm of the belt",
            hint="make the product smaller, or let the camera see more",
            at=("product",),
        )


def _why(found: tuple[float, ...], view: tuple[float, ...]) -> str:
    larger = any(found[k + 1] - found[k] > view[k + 1] - view[k] for k in (0, 2))
    return "is larger than the view" if larger else "reaches out of the view"


def moved(solid: Solid, x_mm: float, y_mm: float = 0.0) -> Solid:
    """Return the same solid moved along belt X and Y."""
    for kind, move in _MOVES.items():
        if isinstance(solid, kind):
            return move(solid, x_mm, y_mm)
    raise TypeError(f"a {type(solid).__name__} cannot be moved")


def _move_parts(solid: PartsSolid, x_mm: float, y_mm: float) -> PartsSolid:
    s = solid.surfaces.copy()
    # g(x - t, y - u, z): columns are part, xx, yy, zz, xy, xz, yz, x, y, z, constant
    s[:, 10] += s[:, 1] * x_mm**2 - s[:, 7] * x_mm
    s[:, 10] += s[:, 2] * y_mm**2 - s[:, 8] * y_mm + s[:, 4] * x_mm * y_mm
    s[:, 7] -= 2.0 * s[:, 1] * x_mm + s[:, 4] * y_mm
    s[:, 8] -= 2.0 * s[:, 2] * y_mm + s[:, 4] * x_mm
    s[:, 9] -= s[:, 5] * x_mm + s[:, 6] * y_mm
    x_min, x_max, y_min, y_max = solid.extent_mm
    return replace(solid, surfaces=s, extent_mm=(x_min + x_mm, x_max + x_mm, y_min + y_mm, y_max + y_mm))


_MOVES: dict[type[Any], Callable[[Any, float, float], Solid]] = {
    GriddedSolid: lambda solid, x, y: replace(solid, x0_mm=solid.x0_mm + x, y0_mm=solid.y0_mm + y),
    Block: lambda solid, x, y: replace(
        solid, centre_x_mm=solid.centre_x_mm + x, centre_y_mm=solid.centre_y_mm + y
    ),
    PartsSolid: _move_parts,
    MeshSolid: lambda solid, x, y: replace(solid, corners_mm=solid.corners_mm + np.array([x, y, 0.0])),
}


Flags = NDArray[np.bool_]

_CELL_MM = 0.5  # of the grid that places are looked for on: gaps are kept to half a millimetre
_TRIES, _STARTS = 200, 20  # places that are tried for a product, and beginnings with an empty belt


def side_by_side(
    products: Sequence[Drawn], rig: Rig, part: ProductPart, seed: int, name: str
) -> tuple[Drawn, ...]:
    """Lay products where they keep off each other, and return them from left to right.

    They are moved, not turned, to places drawn uniformly and kept where they are free: footprints within
    the view of the belt, apart, and beyond the outermost planes only as far as `part` says. Raises
    StageError, which begins with the item's name, where there is no room for so many.
    """
    rng = np.random.default_rng([seed, 53])
    low_x, high_x, low_y, high_y = _room(rig, part.most_overhang_spacings)
    shape = (int((high_y - low_y) / _CELL_MM), int((high_x - low_x) / _CELL_MM))
    masks = [_mask(one) for one in products]
    # larger than the view: no number of tries helps
    fits = all(mask.shape[0] < shape[0] and mask.shape[1] < shape[1] for mask in masks)
    for _ in range(_STARTS if fits else 0):
        taken = np.zeros(shape, bool)
        laid = []
        for one, mask in zip(products, masks, strict=True):
            at = _free_place(rng, taken, mask)
            if at is None:
                break
            # by the cell that was found to where the footprint must begin
            x_min, _, y_min, _ = one.solid.footprint_extent_mm()
            laid.append(moved_to(one, low_x + _CELL_MM * at[1] - x_min, low_y + _CELL_MM * at[0] - y_min))
            taken[at[0] : at[0] + mask.shape[0], at[1] : at[1] + mask.shape[1]] |= mask
            taken = _grown(taken, mask, at, part.gap_mm)
        else:
            # left to right by the middles
            return tuple(sorted(laid, key=lambda one: sum(one.solid.footprint_extent_mm()[:2])))
    raise StageError(
        f"{name}: there is no room for {len(products)} products on X = {low_x:.1f} to {high_x:.1f} mm, "
        f"Y = {low_y:.1f} to {high_y:.1f} mm of the belt with {part.gap_mm:g} mm between them",
        hint="take fewer or smaller products, or a smaller gap",
        at=("product", "in_frame"),
    )


def _room(rig: Rig, most_overhang_spacings: float) -> tuple[float, float, float, float]:
    x_min, x_max, y_min, y_max = view_mm(rig.camera, 0.0)
    lines_x = rig.laser.x_mm(0.5 * (y_min + y_max), 0.0)
    if lines_x.size > 1:
        beyond_mm = most_overhang_spacings * float(np.ptp(lines_x)) / (lines_x.size - 1)
        x_min = max(x_min, float(lines_x.min()) - beyond_mm)
        x_max = min(x_max, float(lines_x.max()) + beyond_mm)
    return x_min + _MARGIN_MM, x_max - _MARGIN_MM, y_min + _MARGIN_MM, y_max - _MARGIN_MM


def _mask(one: Drawn) -> Flags:
    """Cells of the product's extent that its footprint may touch."""
    from scipy.ndimage import binary_dilation

    x_min, x_max, y_min, y_max = one.solid.footprint_extent_mm()
    x, y = np.meshgrid(
        np.arange(x_min, x_max + _CELL_MM, _CELL_MM), np.arange(y_min, y_max + _CELL_MM, _CELL_MM)
    )
    # one cell wider all round: the footprint may end anywhere in a cell
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

    # distance of every cell from the product
    alone = np.ones(taken.shape, bool)
    alone[at[0] : at[0] + mask.shape[0], at[1] : at[1] + mask.shape[1]] = ~mask
    near: Flags = _CELL_MM * distance_transform_edt(alone) <= gap_mm
    return taken | near


_NEAR_MM = 0.5  # a point of a skin lies within this of its own footprint, but on walls that lean out


@dataclass(frozen=True, eq=False)
class Group:
    """Solids that do not touch each other: all gridded, all of exact parts (or blocks), or all meshes."""

    members: tuple[Solid, ...]

    @property
    def visible_volume_mm3(self) -> float:
        """Sum of the members' visible volumes."""
        return sum(one.visible_volume_mm3 for one in self.members)

    @property
    def true_volume_mm3(self) -> float:
        """Sum of the members' volumes."""
        return sum(one.true_volume_mm3 for one in self.members)

    @property
    def footprint_mm2(self) -> float:
        """Sum of the members' footprints."""
        return sum(one.footprint_mm2 for one in self.members)

    def heights_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Highest and lowest Z over belt positions of one shape; NaN outside all footprints."""
        found = [one.heights_mm(x_mm, y_mm) for one in self.members]
        top, bottom = found[0]
        for higher, lower in found[1:]:
            top, bottom = np.fmax(top, higher), np.fmin(bottom, lower)
        return top, bottom

    def footprint_extent_mm(self) -> tuple[float, float, float, float]:
        """Smallest and largest X, smallest and largest Y of all footprints, millimetres."""
        left, right, near, far = np.array([one.footprint_extent_mm() for one in self.members]).T
        return float(left.min()), float(right.max()), float(near.min()), float(far.max())

    def body(self) -> ExactBody | Fields:
        """Return the kernels' form."""
        gridded = [one for one in self.members if isinstance(one, GriddedSolid)]
        exact = [one for one in self.members if isinstance(one, PartsSolid | Block)]
        meshes = [one for one in self.members if isinstance(one, MeshSolid)]
        if len(gridded) == len(self.members):
            return _fields(gridded)
        if len(exact) == len(self.members):
            return _parts([one.body() for one in exact])
        if len(meshes) == len(self.members):
            corners = np.concatenate([one.corners_mm for one in meshes])
            return MeshSolid(corners, np.nan, np.nan, np.nan).body()
        raise TypeError("the solids of a group are of one kind")

    def member_at(self, points_mm: Floats) -> NDArray[np.int16]:
        """Tell which member, from 1, each of some points (n, 3) of their skins belongs to."""
        label = np.zeros(len(points_mm), np.int16)
        around = [
            (0.0, 0.0),
            *((_NEAR_MM * np.cos(a), _NEAR_MM * np.sin(a)) for a in np.arange(8) * np.pi / 4),
        ]
        for dx, dy in around:
            for number, one in enumerate(self.members, start=1):
                over = np.isfinite(one.heights_mm(points_mm[:, 0] + dx, points_mm[:, 1] + dy)[0])
                label[(label == 0) & over] = number
        left = label == 0
        if left.any():
            # a wall that leans out by more than that: the nearest footprint's extent
            x, y = points_mm[left, 0], points_mm[left, 1]
            ends = [one.footprint_extent_mm() for one in self.members]
            off = [
                np.hypot(np.fmax(np.fmax(a - x, x - b), 0.0), np.fmax(np.fmax(c - y, y - d), 0.0))
                for a, b, c, d in ends
            ]
            label[left] = 1 + np.argmin(off, axis=0)
        return label


def as_one_solid(solids: Sequence[Solid]) -> Solid:
    """Return one solid for the kernels: the only one itself, or a group."""
    return solids[0] if len(solids) == 1 else Group(tuple(solids))


def _fields(members: Sequence[GriddedSolid]) -> Fields:
    places, first = [], 0
    for one in members:
        body, (rows, columns) = one.body(), one.grid.shape[:2]
        places.append(
            [body.x0_mm, body.y0_mm, body.step_mm, body.top_mm, body.mid_slope, body.u_slope_mm,
             float(first), float(rows), float(columns)]
        )  # fmt: skip
        first += rows * columns
    nodes, table = np.concatenate([one.grid.reshape(-1, 3) for one in members]), np.array(places)
    for array in (nodes, table):
        array.flags.writeable = False
    reach = _reach([one.body().reach for one in members])
    return Fields(FIELDS, reach, reach[5], nodes, table)


def _parts(members: Sequence[ExactBody]) -> ExactBody:
    tables, first = [], 0.0
    for one in members:
        table = one.surfaces.copy()
        # numbers of parts go on from member to member
        table[:, 0] += first
        first = float(table[-1, 0]) + 1.0
        tables.append(table)
    reach = _reach([one.reach for one in members])
    surfaces, bounds = np.concatenate(tables), np.array([reach])
    for array in (surfaces, bounds):
        array.flags.writeable = False
    return ExactBody(PARTS, reach, reach[5], surfaces=surfaces, boxes=bounds)


def _reach(boxes: Sequence[Reach]) -> Reach:
    low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
    return (float(low[0]), float(low[1]), float(low[2]), float(high[3]), float(high[4]), float(high[5]))
