"""What each defect does to the dome of a skein."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.parameters import SkeinRecord

Floats = NDArray[np.float64]

_LEAST_SHARE = 0.12


def deform(
    record: SkeinRecord, height_mm: Floats, inside: Floats, a: Floats, v_mm: Floats
) -> tuple[Floats, Floats | None]:
    """Apply a skein's defect.

    Parameters
    ----------
    record : SkeinRecord
        Says which defect, where and how deep.
    height_mm : ndarray, shape (rows, columns)
        Dome over the rim without the defect.
    inside : ndarray, shape (rows, columns)
        q clipped to 0…1: 1 on the ridge, 0 at the rim and beyond.
    a, v_mm : ndarray, shape (rows, columns)
        Mid-line coordinates (see `roemetry_simulate.skein`).

    Returns
    -------
    height_mm : ndarray, shape (rows, columns)
        Dome with the defect.
    wall : ndarray or None
        For a broken skein the square (mm²) that ends it, positive on the side that is left.
    """
    changes = {
        "dented": _dent,
        "several-dents": _dents,
        "bent": _crease,
        "s-bent": _creases,
        "twisted": _twist,
        "folded": _fold,
    }
    if record.kind in changes:
        return changed(height_mm, inside, changes[record.kind](record, height_mm, a, v_mm)), None
    if record.kind == "broken":
        return height_mm, _break(record, a, v_mm)
    return height_mm, None


def changed(height_mm: Floats, inside: Floats, change_mm: Floats) -> Floats:
    """Add a change to a dome, within what a body with a rim can take.

    Parameters
    ----------
    height_mm, inside : ndarray, shape (rows, columns)
        See `deform`.
    change_mm : ndarray, shape (rows, columns)
        What to add, negative in a hollow.

    Returns
    -------
    ndarray, shape (rows, columns)
        Dome over the rim, millimetres.
    """
    # the change dies out at the rim, where the outline is
    change = change_mm * (1.0 - (1.0 - np.clip(inside / 0.35, 0.0, 1.0)) ** 2)
    share = 1.0 + change / np.maximum(height_mm, 1e-9) - _LEAST_SHARE
    # no deeper than a small share of the dome, approached smoothly
    share = _LEAST_SHARE + 0.5 * (share + np.hypot(share, 0.15))
    return np.where(change == 0.0, height_mm, share * height_mm)


def _place(record: SkeinRecord, a: Floats, v_mm: Floats) -> tuple[Floats, Floats]:
    """Distances (mm) along and across the mid-line from the defect's middle."""
    along = 0.5 * record.length_mm * (a - record.defect_along)
    return along, v_mm - 0.5 * record.width_mm * record.defect_across


def _dent(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return a smooth hollow of limited extent."""
    along, across = _place(record, a, v_mm)
    r2 = (2.0 * along / record.defect_length_mm) ** 2 + (2.0 * across / record.defect_width_mm) ** 2
    hollow: Floats = -record.defect_depth_mm * np.clip(1.0 - r2, 0.0, 1.0) ** 2
    return hollow


def dents(record: SkeinRecord) -> list[SkeinRecord]:
    """Return a record for each of several dents: the skein's own, then 1–3 more, drawn from its seed."""
    rng = np.random.default_rng([record.seed, 17])
    found = [record]
    for _ in range(int(rng.integers(1, 4))):
        along, across, depth = rng.uniform(-0.55, 0.55), rng.uniform(-0.35, 0.35), rng.uniform(2.0, 6.0)
        length, width = rng.uniform(5.0, 20.0, 2)
        deepest = max(0.5 * (record.thickness_mm - record.rim_height_mm), 2.0)
        found.append(
            replace(
                record,
                defect_along=float(along),
                defect_across=float(across),
                defect_depth_mm=float(min(depth, deepest)),
                defect_length_mm=float(length),
                defect_width_mm=float(width),
            )
        )
    return found


def _dents(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return the hollows of several dents; where they meet, the deepest counts."""
    return np.minimum.reduce([_dent(one, height_mm, a, v_mm) for one in dents(record)])


def _creases(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return two wrinkles, one on the inner side of each half of an S."""
    place = max(abs(record.defect_along), 0.25)
    right = replace(record, defect_along=place)
    left = replace(record, defect_along=-place, bend_deg=-record.bend_deg)
    return np.minimum(_crease(right, height_mm, a, v_mm), _crease(left, height_mm, a, v_mm))


def _crease(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return the wrinkle on the inner side of a bend, deepest at the edge, gone on the outer side."""
    along, _ = _place(record, a, v_mm)
    slant = np.tan(np.deg2rad(0.5 * record.defect_angle_deg))
    inner = np.sign(record.bend_deg) * v_mm / (0.5 * record.width_mm)
    share = 0.5 + 0.5 * np.tanh(2.0 * inner)
    sigma = 0.2 * record.defect_length_mm + 0.6
    wrinkle: Floats = -record.defect_depth_mm * share * np.exp(-0.5 * ((along - slant * v_mm) / sigma) ** 2)
    return wrinkle


def _twist(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return a lean of the ridge to one side, then the other, with a furrow that winds along."""
    phase = np.deg2rad(record.defect_angle_deg) + 2.2 * a
    half = 0.5 * record.width_mm
    furrow = v_mm - 0.45 * half * np.sin(phase)
    sigma = 0.12 * record.defect_width_mm + 1.2
    side = np.clip(v_mm / half, -1.0, 1.0)
    lean = -0.9 * record.defect_depth_mm * np.sin(phase) * side * (1.0 - side**2)
    wound: Floats = lean - 0.8 * record.defect_depth_mm * np.exp(-0.5 * (furrow / sigma) ** 2)
    return wound


def _fold(record: SkeinRecord, height_mm: Floats, a: Floats, v_mm: Floats) -> Floats:
    """Return a flap that lies over the rest with a rounded steep edge and a groove before it."""
    along, across = _place(record, a, v_mm)
    side = 1.0 if record.defect_along >= 0.0 else -1.0
    angle = np.deg2rad(40.0 + 0.6 * record.defect_angle_deg)
    d = side * along * np.cos(angle) + across * np.sin(angle)
    lip = 0.5 * record.defect_depth_mm * (1.0 + np.tanh(d / 1.2))
    back = np.exp(-np.maximum(d, 0.0) / 14.0)
    groove = 0.7 * record.defect_depth_mm * np.exp(-0.5 * ((d + 2.4) / 1.8) ** 2)
    flap: Floats = np.minimum(lip * back, 0.6 * height_mm) - groove
    return flap


def _break(record: SkeinRecord, a: Floats, v_mm: Floats) -> Floats:
    """Square (mm²) of a ragged steep end across the skein, beyond which nothing is left."""
    side = 1.0 if record.defect_along >= 0.0 else -1.0
    rng = np.random.default_rng([record.seed, 13])
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    sizes = np.array([1.0, 0.7, 0.4, 0.2]) * rng.uniform(0.5, 1.2, 4)
    ragged = sum(
        size * np.sin(2.0 * np.pi * v_mm / period + phase)
        for size, phase, period in zip(sizes, phases, (23.0, 13.0, 7.5, 4.5), strict=True)
    )
    at_mm = 0.5 * record.length_mm * (0.35 + 0.8 * abs(record.defect_along))
    slant = 0.4 * np.tan(np.deg2rad(record.defect_angle_deg))
    left_mm = at_mm - side * 0.5 * record.length_mm * a + slant * v_mm + ragged
    wall: Floats = np.maximum(18.0 * left_mm, -40.0)
    return wall
