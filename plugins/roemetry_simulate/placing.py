"""Keep a product where the rig sees it: move it along X, or say that it is too large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import StageError
from roemetry_simulate.products import Drawn
from roemetry_simulate.products.mesh import MeshSolid
from roemetry_simulate.products.parts import PartsSolid
from roemetry_simulate.render import Rig
from roemetry_simulate.scene_camera import view_mm
from roemetry_simulate.solid import Block, GriddedSolid, Solid

Floats = NDArray[np.float64]

_MARGIN_MM = 1.0


def in_reach(drawn: Drawn, rig: Rig, most_overhang_spacings: float) -> Drawn:
    """Move a product along X until its ends keep within the view and near the outer stripes.

    Parameters
    ----------
    drawn : Drawn
        The product as it was drawn.
    rig : Rig
        What sees it.
    most_overhang_spacings : float
        How far an end may lie beyond the outermost planes, in mean spacings on the belt.

    Returns
    -------
    Drawn
        The same product, moved by as little as need be; one that is too long is moved as far as it helps.
    """
    x_min, x_max, y_min, y_max = drawn.solid.footprint_extent_mm()
    height_mm = 0.25 * _top_mm(drawn.solid)
    fan = np.sort(rig.laser.x_mm(0.5 * (y_min + y_max), height_mm))
    spacing_mm = float(np.diff(fan).mean()) if fan.size > 1 else 0.0
    low, high, _, _ = _view_at(rig, height_mm)
    if fan.size > 1:
        low = max(low, float(fan[0]) - most_overhang_spacings * spacing_mm)
        high = min(high, float(fan[-1]) + most_overhang_spacings * spacing_mm)
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
    top_mm = _top_mm(drawn.solid)
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


def _top_mm(solid: Solid) -> float:
    return float(solid.body().top_mm)


def _view_at(rig: Rig, height_mm: float) -> tuple[float, float, float, float]:
    x_min, x_max, y_min, y_max = view_mm(rig.camera, height_mm)
    return x_min + _MARGIN_MM, x_max - _MARGIN_MM, y_min, y_max
