"""A second metric reference in the set: the block and the staircase, measured with the new calibration."""

from __future__ import annotations

from typing import Any

import numpy as np

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet, Peaks
from roemetry_pinhole.frames import belt_pose, camera_of
from roemetry_pinhole.lens import straightened

_CONFLICT_STDS = 3.0
_STEP_MM = 0.05
_BELT_MM = 0.6
_POINTS_MIN = 60
_MAD_TO_STD = 1.4826
_DRAWS = 60


def check_scale(calibration: Calibration, observed: CalibrationSet) -> dict[str, Any]:
    """Measure block and staircase; give residuals and notes with what was found.

    Raises
    ------
    CalibrationError
        A height contradicts the board: the ratio and its uncertainty are told.
    """
    residuals, notes = dict(calibration.residuals), list(calibration.notes)
    asked: list[tuple[str, str, tuple[float, ...], float]] = []
    if observed.block is not None:
        asked.append(("block", "block", (observed.block.height_mm,), observed.block.tolerance_mm))
    if observed.staircase is not None:
        stairs = observed.staircase
        asked.append(("staircase", "staircase", stairs.heights_mm, stairs.tolerance_mm))
    for shows, name, heights, tolerance_mm in asked:
        views = observed.showing(shows)
        found = [_height(calibration, [view.peaks for view in views], height) for height in heights]
        known = [(m, u, h) for (m, u), h in zip(found, heights, strict=True) if np.isfinite(m)]
        if not views:
            continue
        if not known:
            notes.append(f"the {name} was not found in its images: it checks nothing")
            continue
        measured, std, height = (np.array(column) for column in zip(*known, strict=True))
        common = _common_relative(calibration, height)
        own = np.hypot(std, tolerance_mm / np.sqrt(3.0)) / height
        weight = own**-2
        ratio = float((weight * measured / height).sum() / weight.sum())
        uncertainty = float(np.sqrt(1.0 / weight.sum() + common**2))
        if abs(ratio - 1.0) > _CONFLICT_STDS * uncertainty:
            raise CalibrationError(
                f"board and {name} contradict each other: by the board the {name} is {ratio:.4f} ± "
                f"{uncertainty:.4f} times as high as described",
                hint="measure the board's pitch and the heights with a calliper: was the board printed to "
                "fit the page?",
            )
        residuals[f"{name}_height_ratio"] = ratio
        residuals[f"{name}_height_ratio_std"] = uncertainty
        notes.append(f"the {name}'s height comes out {ratio:.4f} ± {uncertainty:.4f} times as described")
    return {"residuals": residuals, "notes": tuple(notes)}


def _height(calibration: Calibration, images: list[Peaks], height_mm: float) -> tuple[float, float]:
    """Mean height of the points near a level, mm, and its standard uncertainty; NaN where there are few.

    Every peak is taken for every stripe; those of the right stripe gather at one height.
    """
    heights = []
    for peaks in images:
        z = _heights_of(calibration, peaks)
        on_belt = (np.abs(z) < _BELT_MM).any(axis=0)
        heights.append(z[:, ~on_belt].ravel())
    z = np.concatenate(heights) if heights else np.empty(0)
    room = 0.08 * height_mm + 0.3
    z = z[np.abs(z - height_mm) < room]
    if z.size < _POINTS_MIN:
        return np.nan, np.nan
    count, edge = np.histogram(z, np.arange(height_mm - room, height_mm + room + _STEP_MM, _STEP_MM))
    smooth = np.convolve(count, np.ones(3), "same")
    peak = float(edge[smooth.argmax()]) + 0.5 * _STEP_MM
    for _ in range(4):
        near = z[np.abs(z - peak) < 0.25]
        if near.size < _POINTS_MIN:
            return np.nan, np.nan
        peak = float(near.mean())
    batches = np.array([part.mean() for part in np.array_split(near, 12)])
    return peak, float(batches.std(ddof=1) / np.sqrt(12.0))


def _heights_of(calibration: Calibration, peaks: Peaks) -> Floats:
    """Give (stripe, peak) the height each peak would have on each plane, mm."""
    parameters = calibration.parameters
    camera = camera_of(parameters)
    xy = straightened((np.column_stack([peaks.x_px, peaks.row]) - camera[2:4]) / camera[:2], camera[4:])[0]
    ray = np.column_stack([xy, np.ones(len(xy))])
    up, origin = belt_pose(parameters["belt_per_mm"])[2, :3], belt_pose(parameters["belt_per_mm"])[2, 3]
    return np.asarray((ray @ up)[None, :] / (parameters["planes_per_mm"] @ ray.T) + origin)


def _common_relative(calibration: Calibration, heights_mm: Floats) -> float:
    """Relative standard uncertainty of a height in the image's middle, of the calibration, by redraws."""
    from roemetry_pinhole.frames import lines_at_height

    height = float(heights_mm.max())
    row = np.array([(calibration.image_size[0] - 1) / 2.0])
    x_px = lines_at_height(calibration.parameters, row, height)[:, 0]
    good = np.isfinite(x_px)
    found = []
    draws = calibration.redraws(np.random.default_rng(1))
    for _, drawn in zip(range(_DRAWS), draws, strict=False):
        parameters = drawn.parameters
        camera = camera_of(parameters)
        seen = np.column_stack([x_px[good], np.full(int(good.sum()), row[0])])
        xy = straightened((seen - camera[2:4]) / camera[:2], camera[4:])[0]
        ray = np.column_stack([xy, np.ones(len(xy))])
        pose = belt_pose(parameters["belt_per_mm"])
        planes = parameters["planes_per_mm"][good]
        found.append(float(((ray @ pose[2, :3]) / (ray * planes).sum(axis=1) + pose[2, 3]).mean()))
    return float(np.std(found, ddof=1)) / height
