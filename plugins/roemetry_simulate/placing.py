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
from roemetry_simulate.scene_rig import view_mm
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
    if shift_mm == 0.0:
        return drawn
    reference = None if drawn.reference is None else moved(drawn.reference, shift_mm)
    figures = {
        name: value + shift_mm if name in ("x_min_mm", "x_max_mm", "centre_x_mm") else value
        for name, value in drawn.truth.figures.items()
    }
    return replace(
        drawn,
        solid=moved(drawn.solid, shift_mm),
        truth=replace(drawn.truth, figures=figures),
        reference=reference,
    )


def check_in_view(drawn: Drawn, rig: Rig, name: str) -> None:
    """Raise StageError, with sizes, for a product that reaches out of the view or up to the camera."""
    top_mm = _top_mm(drawn.solid)
    lowest_mm = min(float(rig.camera.centre_mm[2]), float(rig.laser.projector_mm[2]))
    if top_mm >= lowest_mm:
        raise StageError(
            f"{name}: the product is {top_mm:.1f} mm high, and camera or laser hang at {lowest_mm:.1f} mm",
            hint="make the product smaller, or hang them higher",
        )
    found, view = drawn.solid.footprint_extent_mm(), view_mm(rig.camera, 0.0)
    inside = found[0] >= view[0] and found[1] <= view[1] and found[2] >= view[2] and found[3] <= view[3]
    if not inside:
        raise StageError(
            f"{name}: the product {_why(found, view)}: it lies on X = {found[0]:.1f} to {found[1]:.1f} mm, "
            f"Y = {found[2]:.1f} to {found[3]:.1f} mm; the view is X = {view[0]:.1f} to {view[1]:.1f} mm, "
            f"Y = {view[2]:.1f} to {view[3]:.1f} mm of the belt",
            hint="make the product smaller, or let the camera see more",
        )


def _why(found: tuple[float, ...], view: tuple[float, ...]) -> str:
    larger = any(found[k + 1] - found[k] > view[k + 1] - view[k] for k in (0, 2))
    return "is larger than the view" if larger else "reaches out of the view"


def moved(solid: Solid, x_mm: float) -> Solid:
    """Return the same solid moved along belt X."""
    for kind, move in _MOVES.items():
        if isinstance(solid, kind):
            return move(solid, x_mm)
    raise TypeError(f"a {type(solid).__name__} cannot be moved")


def _move_parts(solid: PartsSolid, x_mm: float) -> PartsSolid:
    s = solid.surfaces.copy()
    # g(x - t, y, z): columns are part, xx, yy, zz, xy, xz, yz, x, y, z, constant
    s[:, 10] += s[:, 1] * x_mm**2 - s[:, 7] * x_mm
    s[:, 7] -= 2.0 * s[:, 1] * x_mm
    s[:, 8] -= s[:, 4] * x_mm
    s[:, 9] -= s[:, 5] * x_mm
    x_min, x_max, y_min, y_max = solid.extent_mm
    return replace(solid, surfaces=s, extent_mm=(x_min + x_mm, x_max + x_mm, y_min, y_max))


_MOVES: dict[type[Any], Callable[[Any, float], Solid]] = {
    GriddedSolid: lambda solid, x_mm: replace(solid, x0_mm=solid.x0_mm + x_mm),
    Block: lambda solid, x_mm: replace(solid, centre_x_mm=solid.centre_x_mm + x_mm),
    PartsSolid: _move_parts,
    MeshSolid: lambda solid, x_mm: replace(solid, corners_mm=solid.corners_mm + np.array([x_mm, 0.0, 0.0])),
}


def _top_mm(solid: Solid) -> float:
    return float(solid.body().top_mm)


def _view_at(rig: Rig, height_mm: float) -> tuple[float, float, float, float]:
    x_min, x_max, y_min, y_max = view_mm(rig.camera, height_mm)
    return x_min + _MARGIN_MM, x_max - _MARGIN_MM, y_min, y_max
