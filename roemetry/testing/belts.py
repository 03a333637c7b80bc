"""Belts under each pattern, seen by cameras at rest and by cameras that have moved since the calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roemetry.records import Peaks
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.testing.circles import CircleRig, level, moved_circles
from roemetry.testing.dots import DotRig, moved_dots
from roemetry.testing.scenes import GridRig, LinearRig, moved_grid, moved_rig

Motion = tuple[float, float, float, float]
"""As `Alignment` has them: px, rad, relative, rad."""
SHIFT: Motion = (0.8, 0.0, 0.0, 0.0)
_LEAN: Motion = (0.0, 0.0, 0.0, 8e-4)
_FAR_SHIFT: Motion = (5.0, 0.0, 0.0, 0.0)
_FAR_TURN: Motion = (0.0, np.radians(8.0), 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Belt:
    """A belt under a pattern, and how well an aligner of that pattern must know it."""

    calibration: Calibration
    moved: Callable[[Calibration, Alignment], Calibration]
    at_rest: Peaks
    """With a product on it, where the calibration has it."""
    seen: Callable[[Calibration], Peaks]
    """By the camera of a calibration."""
    unseen: Peaks
    places_px: Callable[[Calibration], Floats]
    """Where a calibration has the belt's light; NaN where there is none."""
    small: Sequence[Motion]
    far: Sequence[Motion]
    """small, far: motions that an aligner corrects, and those that it refuses."""
    within_px: float
    foreign: Peaks | None = None
    """Peaks that are not of this pattern."""

    def calibration_after(self, motion: Motion) -> Calibration:
        """Give the true calibration of a camera that has moved."""
        return self.moved(self.calibration, Alignment(np.array(motion), np.zeros((4, 4))))

    def after(self, motion: Motion) -> Peaks:
        """Give what that camera sees."""
        return self.seen(self.calibration_after(motion))


def belt_under(pattern: str) -> Belt:
    """Give the belt under one of the patterns that `Capabilities` names."""
    return _BELTS[pattern]()


def _of_lines() -> Belt:
    rig = LinearRig()
    rows, dome = np.arange(rig.rows, dtype=np.float64), rig.px_per_mm * rig.dome()

    def peaks(x_px: Floats) -> Peaks:
        return rig.peaks(x_px, scatter_px=0.1).peaks

    return Belt(
        rig.calibration(), moved_rig, peaks(rig.rest_px() + dome),
        lambda seen: peaks(seen.rest_line_px(rows) + dome), peaks(np.full((rig.stripes, rig.rows), np.nan)),
        lambda seen: seen.rest_line_px(rows),
        (SHIFT, _turn(8.7e-3), _zoom(6e-3)), (_FAR_TURN,), within_px=0.1,
    )  # fmt: skip


def _of_dots() -> Belt:
    rig = DotRig()
    dome = rig.points_mm(np.maximum(rig.hill(16.0) - 8.0, 0.0))

    def places(seen: Calibration, points_mm: Floats) -> Floats:
        assert seen.view is not None
        return seen.view.project(points_mm)

    at_rest = rig.dots(places(rig.dot_calibration(), dome))
    return Belt(
        rig.dot_calibration(), moved_dots, at_rest, lambda seen: rig.dots(places(seen, dome)),
        rig.dots(np.full((1, 2), np.nan)), lambda seen: places(seen, rig.points_mm(rig.level())),
        (SHIFT, _LEAN, _turn(9e-3), _zoom(9e-3)), (_FAR_SHIFT, _FAR_TURN), within_px=0.1,
        foreign=replace(at_rest, dots=None),
    )  # fmt: skip


def _of_grids() -> Belt:
    rig = GridRig()
    hill = [np.where(height > 2.0, height, 0.0) for height in rig.hill()]

    def rest_px(seen: Calibration) -> list[Floats]:
        assert seen.across is not None
        return [
            made.rest_line_px(np.arange(family.rows, dtype=np.float64))
            for family, made in ((rig, seen), (rig.across, seen.across))
        ]

    def after(seen: Calibration) -> Peaks:
        upright, across = (
            family.peaks(rest + family.px_per_mm * height, scatter_px=0.05).peaks
            for family, rest, height in zip((rig, rig.across), rest_px(seen), hill, strict=True)
        )
        return replace(upright, across=across)

    at_rest = rig.grid_peaks((hill[0], hill[1]))
    return Belt(
        rig.grid_calibration(), moved_grid, at_rest, after,
        rig.grid_peaks((np.full_like(hill[0], np.nan), np.full_like(hill[1], np.nan))),
        lambda seen: np.concatenate([rest.ravel() for rest in rest_px(seen)]),
        (SHIFT, _LEAN, _turn(7e-3), _zoom(7e-3)), (_FAR_SHIFT, _FAR_TURN), within_px=0.1,
        foreign=replace(at_rest, across=None),
    )  # fmt: skip


def _of_circles() -> Belt:
    """Give a belt without a product after a motion; where circles end, their rows tell less: 0.15 px."""
    rig = CircleRig()
    rows, there = np.arange(rig.rows, dtype=np.float64), np.isfinite(rig.x_on_rows(level))

    def places(seen: Calibration) -> Floats:
        return np.where(there, seen.rest_line_px(rows), np.nan)

    return Belt(
        rig.circle_calibration(), moved_circles, rig.circle_peaks(rig.x_on_rows(rig.circle_dome(8.0)))[0],
        lambda seen: rig.circle_peaks(places(seen))[0],
        rig.circle_peaks(np.full((rig.stripes, rig.rows), np.nan))[0], places,
        (SHIFT, _turn(9e-3), _zoom(9e-3)), (_FAR_SHIFT,), within_px=0.15,
    )  # fmt: skip


def _turn(angle_rad: float) -> Motion:
    return (0.0, angle_rad, 0.0, 0.0)


def _zoom(share: float) -> Motion:
    return (0.0, 0.0, share, 0.0)


_BELTS = {"lines": _of_lines, "dots": _of_dots, "grid": _of_grids, "circles": _of_circles}
