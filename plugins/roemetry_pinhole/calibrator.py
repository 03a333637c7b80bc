"""Calibration of camera, planes of light and belt from a board in many poses, in one joint adjustment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.records import Board, CalibrationSet, Evidence
from roemetry.stages import Calibrator, Capabilities, StageOptions
from roemetry_pinhole.evidence import evidence_of
from roemetry_pinhole.first_camera import FirstCamera
from roemetry_pinhole.frames import (
    METHOD,
    covariance_of,
    displacements,
    parameters_of,
    rest_polynomials,
    view_of,
)
from roemetry_pinhole.joining import Joint, joint
from roemetry_pinhole.judging import judged
from roemetry_pinhole.second_targets import check_scale


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
        joined = self._joint(observed)
        board, adjusted, size = joined.board, joined.adjusted, joined.size
        first, seen = joined.first, joined.seen
        verdict = judged(adjusted, first, joined.gathered, board, size)
        parameters = parameters_of(adjusted.geometry, travel=joined.moves)
        covariance = covariance_of(adjusted.covariance, adjusted.unknowns, travel=joined.moves)
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

    def evidence(self, observed: CalibrationSet, calibration: Calibration) -> Evidence:
        """Show residuals, views left out in turn, stripes against each other, coverage, and a verdict."""
        return evidence_of(self._joint(observed), calibration)

    def _joint(self, observed: CalibrationSet) -> Joint:
        return joint(
            observed,
            lens=self.options.lens,
            camera_file=self.options.camera,
            print_contrast_max=self.options.print_contrast_max,
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
