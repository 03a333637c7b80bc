"""Calibration of camera, planes of light and belt from a board in many poses, in one joint adjustment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.errors import CalibrationError
from roemetry.records import Board, CalibrationSet
from roemetry.stages import Calibrator, Capabilities, StageOptions
from roemetry_pinhole.adjustment import Adjusted, adjust
from roemetry_pinhole.equations import Corners, Feet
from roemetry_pinhole.first_camera import FirstCamera, first_camera, free_numbers
from roemetry_pinhole.frames import (
    METHOD,
    covariance_of,
    displacements,
    parameters_of,
    rest_polynomials,
    view_of,
)
from roemetry_pinhole.geometry import CAMERA, Geometry, unknowns_of
from roemetry_pinhole.judging import judged
from roemetry_pinhole.opencv_file import read_camera
from roemetry_pinhole.second_targets import check_scale
from roemetry_pinhole.stripe_points import Gathered, gather
from roemetry_pinhole.views import BoardView, board_views


class PinholeCalibratorOptions(StageOptions):
    """What is looked for."""

    lens: Literal["none", "radial", "brown", "rational"] = Field(
        default="brown",
        description="lens model: none; k1 k2; k1 k2 p1 p2 k3; or with k4 k5 k6 for very wide angles",
    )
    camera: Path | None = Field(
        default=None,
        description="OpenCV file with a camera matrix and distortion that are known and not looked for",
    )
    print_contrast_max: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="largest contrast of the print under a stripe, (light − dark)/(light + dark), to use it",
    )
    height_max_mm: float | None = Field(
        default=None, gt=0, description="greatest height to be measured, mm; none: what the boards reached"
    )


class PinholeCalibrator(Calibrator[PinholeCalibratorOptions]):
    """Camera, lens, a plane of light for each stripe, and the belt, from a board in many poses."""

    Options = PinholeCalibratorOptions
    capabilities = Capabilities(
        tolerance_px=0.1, relative_tolerance=0.01, fixture="roemetry_pinhole.conformance:observed_of"
    )

    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate.

        Raises
        ------
        CalibrationError
            No board is described or seen, too few poses or too little variety, a stripe on fewer than two
            boards, no belt, a scale that two targets contradict, planes that do not agree, or residuals that
            are no noise; with what was left out and why.
        """
        board = observed.board
        if board is None:
            raise CalibrationError(
                "no board is described",
                hint="add `board:` to the rig file: its kind, columns, rows and pitch_mm",
            )
        seen = board_views(observed, board)
        tried = len({(one.shows, one.pose) for one in observed.observations if one.shows in _BOARDS})
        if not tried:
            raise CalibrationError("there is no image of the board", hint="name them in images.board")
        size = observed.observations[0].frame.size
        known = None if self.options.camera is None else read_camera(self.options.camera)
        first = first_camera(seen, size, self.options.lens, known, tried)
        pose, counts, first = _placed(first)
        gathered = gather(
            first,
            board,
            observed.showing("belt"),
            observed.stripe_count,
            counts,
            print_contrast_max=self.options.print_contrast_max,
        )
        seen.left_out |= gathered.left_out
        adjusted = self._adjusted(first, gathered, board, pose, counts, known)
        verdict = judged(adjusted, first, gathered, board, size)
        parameters = parameters_of(adjusted.geometry, travel=_moves(counts))
        covariance = covariance_of(adjusted.covariance, adjusted.unknowns, travel=_moves(counts))
        covariance = covariance + _of_scale(parameters, board)
        top_mm = self.options.height_max_mm or verdict.height_max_mm
        calibration = Calibration(
            method=METHOD,
            image_size=size,
            turn_deg=observed.observations[0].frame.turn_deg,
            rest_px=rest_polynomials(parameters, size),
            displacement_px_per_mm=displacements(parameters, size),
            height_range_mm=(0.0, top_mm),
            parameters=parameters,
            covariance=covariance,
            residuals=verdict.residuals,
            target={"kind": board.kind, "name": board.name} | _described(board, first),
            extractor=dict(observed.extractor),
            notes=(*verdict.notes, *(f"not used: {name}: {why}" for name, why in seen.left_out.items())),
            view=view_of(parameters, size),
        )
        return replace(calibration, **check_scale(calibration, observed))

    def _adjusted(
        self,
        first: FirstCamera,
        gathered: Gathered,
        board: Board,
        pose: np.ndarray,
        counts: Floats,
        known: Floats | None,
    ) -> Adjusted:
        marks = [view.marks for view in first.views]
        size = [len(one.xy_px) for one in marks]
        corners = Corners(
            np.repeat(pose, size),
            np.concatenate([one.board_mm for one in marks]),
            np.concatenate([one.xy_px for one in marks]),
            np.repeat(counts, size),
        )
        feet = _feet(first.views, board, pose, counts)
        lies = [number for number, view in enumerate(first.views) if view.on_belt]
        belt = gathered.belt
        if lies:
            # the first board on the belt says where the belt is, to start with
            normal = first.rotation[lies[0]][:, 2]
            belt = normal / (normal @ first.shift[lies[0]] + board.thickness_mm)
        if belt is None or not np.isfinite(belt).all():
            raise CalibrationError(
                "nothing shows where the belt is",
                hint="name images of the empty belt in images.belt, or of the board lying on it in "
                "images.board_on_belt",
            )
        if not lies and observed_lines(gathered) < 2:
            raise CalibrationError(
                "one stripe on the empty belt does not tell how the belt is tilted",
                hint="lay the board on the belt and name the image in images.board_on_belt",
            )
        keep = np.unique(pose)
        start = Geometry(
            camera=first.camera,
            rotation=first.rotation[keep],
            shift=first.shift[keep],
            planes=gathered.planes,
            belt=belt,
            travel=np.zeros(3),
        )
        unknowns = unknowns_of(
            start,
            free_camera=np.zeros(CAMERA, np.bool_) if known is not None else free_numbers(self.options.lens),
            planes=True,
            belt=True,
            travel=_moves(counts),
        )
        renumbered = np.searchsorted(keep, pose)
        points = replace(
            gathered.points,
            pose=np.where(gathered.points.pose < 0, gathered.points.pose, renumbered[gathered.points.pose]),
        )
        return adjust(
            start,
            unknowns,
            replace(corners, pose=np.searchsorted(keep, corners.pose)),
            points,
            replace(feet, pose=np.searchsorted(keep, feet.pose)),
            foot_std_mm=max(board.flatness_mm, 0.005) / np.sqrt(3.0),
        )


_BOARDS = ("board", "board_on_belt")


def observed_lines(gathered: Gathered) -> int:
    """Give the number of stripes seen on the empty belt."""
    return int(np.unique(gathered.points.stripe[gathered.points.pose < 0]).size)


def _placed(first: FirstCamera) -> tuple[np.ndarray, Floats, FirstCamera]:
    """Give each view the pose it belongs to and the encoder counts it was carried on since.

    Boards that lie on the belt with known encoder counts were laid there once and are carried along.
    """
    pose = np.arange(len(first.views))
    counts = np.zeros(len(first.views))
    carried = [n for n, view in enumerate(first.views) if view.on_belt and np.isfinite(view.count)]
    for number in carried:
        pose[number] = carried[0]
        counts[number] = first.views[number].count - first.views[carried[0]].count
    return pose, counts, first


def _moves(counts: Floats) -> bool:
    return bool(np.ptp(counts) > 0) if counts.size else False


def _feet(views: list[BoardView], board: Board, pose: np.ndarray, counts: Floats) -> Feet:
    """Three corners of the underside of each board that lies on the belt."""
    width, height = board.columns * board.pitch_mm, board.rows * board.pitch_mm
    places = np.array([[0.0, 0.0], [width, 0.0], [0.5 * width, height]])
    places = np.column_stack([places, np.full(3, board.thickness_mm)])
    lies = [number for number, view in enumerate(views) if view.on_belt]
    return Feet(
        np.repeat(pose[lies], 3).astype(np.int64), np.tile(places, (len(lies), 1)), np.repeat(counts[lies], 3)
    )


def _of_scale(parameters: dict[str, Floats], board: Board) -> Floats:
    """Covariance that the board's own tolerance adds: all lengths grow together."""
    longer = max(board.columns, board.rows) * board.pitch_mm
    relative = board.tolerance_mm / np.sqrt(3.0) / longer
    by_scale = {name: np.zeros_like(array) for name, array in parameters.items()}
    for name in ("planes_per_mm", "belt_per_mm"):
        by_scale[name] = -parameters[name]
    if "travel_mm_per_count" in parameters:
        by_scale["travel_mm_per_count"] = parameters["travel_mm_per_count"]
    way = np.concatenate([array.ravel() for array in by_scale.values()])
    return np.asarray(relative**2 * np.outer(way, way))


def _described(board: Board, first: FirstCamera) -> dict[str, object]:
    layout = first.views[0].marks.layout
    said = {
        "columns": board.columns,
        "rows": board.rows,
        "pitch_mm": board.pitch_mm,
        "tolerance_mm": board.tolerance_mm,
        "poses": len(first.views),
    }
    return said | ({"layout": layout} if layout else {})
