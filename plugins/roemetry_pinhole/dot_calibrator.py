"""Calibration of camera, rays of a matrix of dots, and belt, from a board in many poses.

Dots are numbered on the empty belt and, by the place of the projector, on the boards
(`roemetry_pinhole.dot_lattice`); rays follow with the boards' marks (`roemetry_pinhole.dot_rays`). It assumes
that camera and projector stood still and boards are as flat as described: dots that scatter more than they
state by `_FACTOR_MAX` refuse. It fails where many dots are seen on too few surfaces.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import CalibrationError
from roemetry.records import EDGE, SATURATED, WIDE, CalibrationSet, Observation, Peaks, Rays
from roemetry.records.arrays import Flags, Floats
from roemetry.records.calibration import Calibration
from roemetry.records.light import meet
from roemetry.stages import Calibrator, Capabilities
from roemetry_pinhole.boards import on_board, on_even_print
from roemetry_pinhole.calibrator import BoardOptions
from roemetry_pinhole.dot_lattice import numbered_on_boards, on_belt
from roemetry_pinhole.dot_rays import (
    METHOD,
    DotPoints,
    adjusted_rays,
    places_of,
    rays_of,
    rest_lines,
    view_of,
)
from roemetry_pinhole.geometry import ON_BELT, rays
from roemetry_pinhole.initial_intrinsics import InitialCamera, belt_under
from roemetry_pinhole.joint_adjustment import marks_alone
from roemetry_pinhole.pinhole_plane import belt_pose

_ADDED_STD_PX = 0.02  # of every dot, beside its stated error: print and paper are not quite even
_FACTOR_MAX = 6.0
"""Times its stated error, that a dot scatters at most: a bent board or a moved projector make it more."""
_MISSING_MAX = 0.2  # share of rays that may be seen on too few boards


class PinholeDotsOptions(BoardOptions):
    """The pattern, and what is looked for."""

    lines: int = Field(
        default=11, ge=2, le=200, description="dots in each column; columns are the rig's stripes"
    )
    camera: Path | None = Field(
        default=None, description="file with a camera that is known and not looked for"
    )


class PinholeDotsCalibrator(Calibrator[PinholeDotsOptions]):
    """Camera, lens, a ray of light for each dot, and the belt, from a board in many poses."""

    capabilities = Capabilities(pattern="dots", fixture="roemetry_pinhole.conformance:dots_observed_of")

    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate.

        Raises
        ------
        CalibrationError
            No board, too few poses, no board on the belt or no image of the empty belt, dots that are not
            the pattern's, that cannot be numbered or do not agree; with what was left out and why.
        """
        options, count = self.options, observed.stripe_count * self.options.lines
        if any(one.peaks.dots is None for one in observed.observations if one.frame.role == "laser"):
            raise CalibrationError("the extractor finds lines, not dots", hint="set `extractor: dots`")
        seen, first, marks = marks_alone(observed, options.lens, options.camera)
        size, belts = observed.observations[0].frame.size, observed.showing("belt")
        board = observed.board
        assert board is not None
        points = self._points(first, belts, observed.stripe_count)
        found = adjusted_rays(marks, points, count)
        missing = int(np.isnan(found.lines[:, 0]).sum())
        if missing > _MISSING_MAX * count:
            raise CalibrationError(
                f"{missing} of {count} dots are seen on too few surfaces to determine their rays",
                hint="hold the board under all of the pattern, in ten poses and more",
            )
        if found.factor > _FACTOR_MAX:
            raise CalibrationError(
                f"dots on boards scatter {found.factor:.1f} times as much about their rays as they should",
                hint="is the board flat, its pitch right? Did projector or camera move between the images?",
            )
        made, parameters, covariance = rays_of(found, marks.unknowns, observed.stripe_count)
        view = view_of(parameters, made.lines, size)
        rest, displacement = rest_lines(view, made.lines)
        used = found.used
        on_boards = places_of(found.geometry, points)[used, 2]
        flat = made.lines.reshape(-1, 4)[points.ray[used]]
        off = meet(view, flat, points.xy_px[used], points.covariance_px2[used]).z_mm - on_boards
        return Calibration(
            method=METHOD,
            image_size=size,
            turn_deg=observed.observations[0].frame.turn_deg,
            rest_px=rest,
            displacement_px_per_mm=displacement,
            height_range_mm=(0.0, options.height_max_mm or float(np.percentile(on_boards, 99.5))),
            parameters=parameters,
            covariance=covariance,
            residuals={
                "dots_rms_px": float(np.sqrt((found.residual_px[used] ** 2).sum(axis=1).mean() / 2.0)),
                "dots_std_factor": found.factor,
                "dots_left_out": 1.0 - float(used.mean()),
                "dots_per_ray": float(used.sum() / max(count - missing, 1)),
                "rays_missing": float(missing),
                "heights_rms_mm": float(np.sqrt((off**2).mean())),
            },
            target={"kind": board.kind, "name": board.name, "poses": len(first.views)},
            extractor=dict(observed.extractor),
            notes=(
                *seen.notes,
                *_of_neighbours(missing, made),
                *(f"not used: {name}: {why}" for name, why in seen.left_out.items()),
            ),
            view=view,
            rays=made,
        )

    def _points(self, first: InitialCamera, belts: tuple[Observation, ...], columns: int) -> DotPoints:
        """Number the dots of all images."""
        belt = belt_under(first, next(n for n, view in enumerate(first.views) if view.on_belt))
        parts: list[_Seen] = []
        for one in belts:
            use = (one.peaks.flags & (EDGE | WIDE | SATURATED)) == 0
            parts.append(_Seen.of(ON_BELT, one.peaks, use, np.ones(use.size, np.bool_), belt, first.camera))
        for number, view in enumerate(first.views):
            if view.laser is None:
                continue
            peaks = view.laser.peaks
            # dots on edges of the print are followed, for the others hang together by them, and not measured
            even = np.ones(len(peaks), np.bool_)
            if view.plain is not None:
                even = on_even_print(peaks, view.plain.frame, self.options.print_contrast_max)
            sight = rays(first.camera, _places(peaks))[:, :2]
            place = on_board(sight, first.rotation[number], first.shift[number])
            margin = view.board.margin_mm
            use = ((place > -margin) & (place < view.board.size_mm + margin)).all(axis=1)
            use &= (peaks.flags & (EDGE | WIDE | SATURATED)) == 0
            parts.append(_Seen.of(number, peaks, use, even, first.surface(number), first.camera))
        to_belt = belt_pose(belt)
        in_belt_frame = [one.place_mm @ to_belt[:3, :3].T + to_belt[:3, 3] for one in parts]
        at = on_belt(parts[0].xy_px, columns, self.options.lines, belts[0].frame.name)
        on = at[:, 0] >= 0
        numbers, _ = numbered_on_boards(
            in_belt_frame[0][on], at[on], in_belt_frame[1:], [one.xy_px for one in parts[1:]]
        )
        found = []
        for dots, mine in zip(parts, [at, *numbers], strict=True):
            some = (mine[:, 0] >= 0) & dots.even
            ray = mine[some] @ np.array([self.options.lines, 1])
            covariance = dots.covariance_px2[some] + _ADDED_STD_PX**2 * np.eye(2)
            found.append((np.full(ray.size, dots.pose), ray, dots.xy_px[some], covariance))
        return DotPoints(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _of_neighbours(missing: int, rays: Rays) -> tuple[str, ...]:
    """Say how many rays were filled in."""
    if not missing:
        return ()
    left = int(np.isnan(rays.lines[..., 0]).sum())
    said = f"rays seen on too few surfaces: {missing}, taken from those around them: {missing - left}"
    return (f"{said}, unknown: {left}" if left else said,)


def _places(peaks: Peaks) -> Floats:
    assert peaks.dots is not None
    return np.column_stack([peaks.x_px, peaks.dots.y_px])


class _Seen(NamedTuple):
    """Dots of one image that may be used, of a pose or the belt."""

    pose: int
    xy_px: Floats
    covariance_px2: Floats
    even: Flags
    """(dot,) Whether the print is even there."""
    place_mm: Floats
    """(dot, 3) in the camera's frame."""

    @classmethod
    def of(cls, pose: int, peaks: Peaks, use: Flags, even: Flags, surface: Floats, camera: Floats) -> _Seen:
        """Give those to be used; they lie on the surface (3,) p·X = 1."""
        assert peaks.dots is not None
        xy_px = _places(peaks)[use]
        ray = rays(camera, xy_px)
        place_mm = ray / (ray @ surface)[:, None]
        return cls(pose, xy_px, peaks.dots.covariance_px2[use], even[use], place_mm)
