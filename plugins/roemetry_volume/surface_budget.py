"""How far the volume below the surface may be off, by cause."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from roemetry.records.arrays import Floats
from roemetry.records.view import View
from roemetry_volume.fusing import LONG_AXIS, Fused
from roemetry_volume.surface import plate_through, without_slice

OUTLINE_STD_PX = 0.3
"""Taken where the outliner does not say how sure its contour is."""

OUTLINE = "outline"
"""The cause that a run draws itself, by moving the contour."""

# chosen so that 95 % intervals hold the truth as often as they say: docs/reference/plugins/outline-surface.md
_BETWEEN = 0.13  # of what leaving single slices out changes, in quadrature: with them, gaps are half as wide
_FEW = 7.0  # and that over the square of their number: few slices do not show how smooth the product is
_STIFFER = 30.0
_SETTINGS = 0.4  # of what a plate so much stiffer changes
_LEAST_STD = 0.0004  # of the volume: the border's place and shape, however many stripes there are
_STEP_MM = 0.2
"""Of differences: about the rim's own uncertainty, since what is square there is not even nearly linear."""


def budget_of(fused: Fused, view: View, outline_std_px: float) -> dict[str, float]:
    """Give standard uncertainties by cause, mm³: between slices, settings, outline, rim."""
    px_mm = _mm_per_px(fused, view)
    std_px = OUTLINE_STD_PX if math.isnan(outline_std_px) else outline_std_px
    return {
        "between slices": math.hypot(_left_out(fused), *(step.std_mm3 for step in fused.steps)),
        "settings": math.hypot(
            _SETTINGS * (_stiffer(fused) - fused.volume_mm3), _LEAST_STD * fused.volume_mm3
        ),
        OUTLINE: std_px * px_mm * abs(_per_mm_outwards(fused, np.ones(fused.height_mm.size))),
        "rim": fused.rim.std_mm * abs(_per_mm_of_rim(fused)),
    }


def _left_out(fused: Fused) -> float:
    """Part of what the volume changes by when each slice in turn is left out, in quadrature."""
    total = 0.0
    volume = fused.volume_mm3
    slices = np.unique(fused.knots.slice)
    for number in slices:
        changed = replace(fused.plate, coefficients=without_slice(fused.plate, fused.knots, int(number)))
        values = changed.at(LONG_AXIS * fused.s, fused.v)
        total += (_volume(fused, values) - volume) ** 2
    return (_BETWEEN + _FEW / slices.size**2) * math.sqrt(total)


def _stiffer(fused: Fused) -> float:
    rim = fused.contour[~fused.open_end][::2]
    plate = plate_through(
        fused.knots, LONG_AXIS * rim[:, 0], rim[:, 1], np.full(rim.shape[0], 6.0), stiffness=_STIFFER
    )
    return _volume(fused, plate.at(LONG_AXIS * fused.s, fused.v))


def _per_mm_outwards(fused: Fused, outwards: Floats) -> float:
    """Change of volume when each point of the border moves outwards by so many times a millimetre, mm²."""
    steps = np.roll(fused.border.xy_mm, -1, axis=0) - fused.border.xy_mm
    edge = np.hypot(steps[:, 0], steps[:, 1]) * fused.height_mm * outwards
    rim = fused.contour[~fused.open_end]
    inner = rim - (fused.border.outward @ _turn(fused))[~fused.open_end]
    fall = np.maximum(fused.plate.at(LONG_AXIS * inner[:, 0], inner[:, 1]), 0.0) * outwards[~fused.open_end]
    change = _rim_right(fused, rim[::2], _STEP_MM * fall[::2])
    values = fused.plate.at(LONG_AXIS * fused.s, fused.v) + _moved(fused, change)
    return float(edge.sum()) + (_volume(fused, values) - fused.volume_mm3) / _STEP_MM


def _per_mm_of_rim(fused: Fused) -> float:
    """Change of volume when the rim is taken higher by a millimetre, and the border placed there, mm².

    A border that is placed higher on its line of sight moves inwards by the ray's tilt; where the camera
    sees the wall, the border is the wall's foot and stays.
    """
    from roemetry_kernels.volume.surface_spline import add_points

    knots, upright = fused.knots, fused.rim.upright
    over = (np.sign(knots.u) * np.sqrt(np.abs(knots.u)) if upright else knots.u) - _STEP_MM
    fall = (over * np.abs(over) if upright else over) - knots.u
    change = np.zeros_like(fused.plate.right)
    unused = np.zeros((3 * (fused.plate.grid[4] + 3) + 4, change.size))
    add_points(unused, change, fused.plate.grid, knots.s, knots.v, fall, knots.weight)
    values = fused.plate.at(LONG_AXIS * fused.s, fused.v) + _moved(fused, change)
    raised = (_volume(fused, values, _STEP_MM) - fused.volume_mm3) / _STEP_MM
    return raised + _per_mm_outwards(fused, -np.maximum(fused.border.tilt, 0.0))


def _rim_right(fused: Fused, rim: Floats, values: Floats) -> Floats:
    from roemetry_kernels.volume.surface_spline import add_points

    change = np.zeros_like(fused.plate.right)
    unused = np.zeros((3 * (fused.plate.grid[4] + 3) + 4, change.size))
    add_points(
        unused, change, fused.plate.grid, LONG_AXIS * rim[:, 0], rim[:, 1], values, np.full(rim.shape[0], 6.0)
    )
    return change


def _moved(fused: Fused, change: Floats) -> Floats:
    moved = replace(fused.plate, coefficients=fused.plate.moved_by(change))
    return moved.at(LONG_AXIS * fused.s, fused.v)


def _volume(fused: Fused, values: Floats, rim_shift_mm: float = 0.0) -> float:
    return float((fused.weight_mm2 * fused.heights(values, rim_shift_mm)).sum())


def _turn(fused: Fused) -> Floats:
    """Turn from the belt to along and across the product."""
    design = fused.border.xy_mm - fused.border.xy_mm.mean(axis=0)
    turn, *_ = np.linalg.lstsq(design, fused.contour - fused.contour.mean(axis=0), rcond=None)
    return np.asarray(turn)


def _mm_per_px(fused: Fused, view: View) -> float:
    """Size of a pixel at the middle of the border."""
    middle = np.append(fused.border.xy_mm.mean(axis=0), float(np.mean(fused.height_mm)))
    step = view.project(np.stack([middle, middle + np.array([1.0, 0.0, 0.0])]))
    return 1.0 / float(np.hypot(*(step[1] - step[0])))
