"""What a file of heights or points holds, and how points become slices."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import DataError
from roemetry.records import Profiles
from roemetry.records.arrays import Flags, Floats, Integers

_CELLS_MAX = 200_000_000  # of a grid that a file describes: 1.6 GB of heights
_METRES = 1.0
"""A belt that is not even 1 mm long was measured in metres."""
_METRES_TO_MM = 5.0
"""Longer than so many metres it was measured in micrometres, or is no product on a belt."""


class Measured(NamedTuple):
    """Points in mm, in slices across the belt or as a cloud."""

    xyz_mm: Floats
    """(slice, point, 3), NaN where nothing was seen; or (n, 3), a cloud."""
    std_mm: float = math.nan
    """Standard uncertainty of single heights, mm, where the file states it."""


def measured_of(profiles: Profiles) -> Measured:
    """Give what was seen of slices: what was bridged or followed is left out."""
    return Measured(np.where(profiles.seen[..., None], profiles.xyz_mm, np.nan))


def profiles_of(measured: Measured, pixel_mm: float | None, name: str) -> Profiles:
    """Give slices that `label` can tell products in; a cloud is laid on a grid of pixels.

    Raises
    ------
    DataError
        Nothing is known in it, or its extent says that it is not in mm.
    """
    xyz = measured.xyz_mm
    known = np.asarray(np.isfinite(xyz).all(axis=-1))
    if np.count_nonzero(known) < 3:
        raise DataError(
            f"{name}: {int(known.sum())} points hold a height, all else is marked as not known",
            hint="is the value that marks what is not known the right one?",
        )
    points = xyz[known]
    extent = np.ptp(points[:, :2], axis=0)
    if extent.max() == 0.0:
        raise DataError(
            f"{name}: all {len(points)} points lie at one place: nothing was measured",
            hint="is the value that marks what is not known the right one?",
        )
    if extent.max() < _METRES:
        raise DataError(
            f"{name}: all of it is {extent[0]:.3g} × {extent[1]:.3g} mm: these look like metres",
            hint="state the unit: `unit: m` in the source's options",
        )
    if extent.max() > _METRES_TO_MM * 1000.0:
        raise DataError(
            f"{name}: it is {extent[0]:.3g} × {extent[1]:.3g} mm: these look like micrometres",
            hint="state the unit: `unit: um` in the source's options",
        )
    # a cloud: mean heights in pixels
    if xyz.ndim == 2:
        xyz = _gridded(points, pixel_mm or _spacing(points), name)
    known = np.asarray(np.isfinite(xyz).all(axis=-1))
    xyz = np.where(known[..., None], xyz, np.nan)
    many = known.shape[1]
    order, at = _sorted(xyz, known)
    xyz, known = xyz[order], known[order]
    step = np.diff(at)
    # a slice that is missing among others keeps its place
    usual = max(float(np.median(step)), 1e-9) if step.size else 1.0
    place = np.concatenate([[0], np.cumsum(np.maximum(np.rint(step / usual), 1.0))]).astype(np.int64)
    return Profiles(
        xyz_mm=xyz,
        product=np.where(known, 0, -1).astype(np.int16),
        seen=known,
        x_px=np.where(known, place[:, None].astype(np.float64), np.nan),
        row_px=np.where(known, np.arange(many, dtype=np.float64), np.nan),
        height_std_mm=np.where(known, measured.std_mm, np.nan),
        stripe=place,
        frame=np.arange(len(at)),
        plane=np.array([_plane(line[ok]) for line, ok in zip(xyz, known, strict=True)]),
    )


def _sorted(xyz: Floats, known: Flags) -> tuple[Integers, Floats]:
    """Give the slices that show anything, sorted along X, and the X of each, mm."""
    at = np.array(
        [np.median(line[on, 0]) if on.any() else np.nan for line, on in zip(xyz, known, strict=True)]
    )
    order = np.argsort(at, kind="stable")[: int(np.isfinite(at).sum())]
    return order, at[order]


def _plane(points: Floats) -> Floats:
    """Fit X = a + b·Y + c·Z to a slice where it says so; else a plane across X."""
    # a slice across X leans nowhere that could be told
    if len(points) < 3 or np.ptp(points[:, 0]) < 1e-6:
        return np.array([1.0, 0.0, 0.0, float(np.median(points[:, 0]))])
    design = np.column_stack([np.ones(len(points)), points[:, 1:]])
    a, b, c = np.linalg.lstsq(design, points[:, 0], rcond=1e-9)[0].tolist()
    # n·X = d with n of length 1
    size = math.sqrt(1.0 + b * b + c * c)
    return np.array([1.0, -b, -c, a]) / size


def _spacing(points: Floats) -> float:
    """Give the side of the square that each point of a cloud has to itself, mm."""
    area = float(np.prod(np.ptp(points[:, :2], axis=0)))
    # points lie unevenly: one per pixel at random leaves 37 % of the pixels empty (1/e), 1.44 leave 24 %
    return math.sqrt(max(area, 1e-12) / len(points)) * 1.2


def _gridded(points: Floats, pixel_mm: float, name: str) -> Floats:
    """Give (slice, point, 3) the mean height in each pixel of a grid, slices along X, points against Y."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    columns, rows = (int(size / pixel_mm) + 1 for size in high - low)
    if columns * rows > _CELLS_MAX:
        raise DataError(f"{name}: {columns} × {rows} pixels of {pixel_mm:g} mm are too many")
    i = np.minimum(((points[:, 0] - low[0]) / pixel_mm).astype(np.int64), columns - 1)
    # against Y: rows of an image run down
    j = np.minimum(((high[1] - points[:, 1]) / pixel_mm).astype(np.int64), rows - 1)
    cell: Integers = i * rows + j
    many = np.bincount(cell, minlength=columns * rows)
    with np.errstate(invalid="ignore"):
        z = np.bincount(cell, points[:, 2], minlength=columns * rows) / many
    xyz = np.empty((columns, rows, 3))
    xyz[..., 0] = (low[0] + pixel_mm * (np.arange(columns) + 0.5))[:, None]
    xyz[..., 1] = high[1] - pixel_mm * (np.arange(rows) + 0.5)
    xyz[..., 2] = z.reshape(columns, rows)
    return xyz


def sliced(measured: Measured) -> Floats:
    """Give (slice, point, 3); DataError for a cloud."""
    if measured.xyz_mm.ndim != 3:
        raise DataError("a cloud has no slices to lay side by side", hint="write it as PLY, PCD, LAS or CSV")
    return measured.xyz_mm


def flat(measured: Measured) -> tuple[Floats, Integers, Integers]:
    """Give points (n, 3) with each one's slice and place in it; of a cloud slice 0."""
    xyz = measured.xyz_mm
    if xyz.ndim == 2:
        return xyz, np.zeros(len(xyz), np.int64), np.arange(len(xyz))
    known = np.asarray(np.isfinite(xyz).all(axis=2))
    slices, places = np.nonzero(known)
    return xyz[known], slices, places


def from_flat(xyz: Floats, slices: Any, places: Any) -> Measured:
    """Give what `flat` was made of; a cloud where slices are not told."""
    # fewer than three points in any slice are no slices
    if slices is None or places is None or not len(slices) or int(places.max()) < 2:
        return Measured(xyz)
    slices, places = np.asarray(slices, np.int64), np.asarray(places, np.int64)
    if slices.min() < 0 or places.min() < 0 or (int(slices.max()) + 1) * (int(places.max()) + 1) > _CELLS_MAX:
        raise ValueError("slice and point number points that cannot be")
    shape = int(slices.max()) + 1, int(places.max()) + 1
    whole = np.full((*shape, 3), np.nan)
    whole[slices, places] = xyz
    return Measured(whole)
