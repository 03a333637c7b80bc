"""Calibration of camera, planes of light and belt from a board in many poses, in one joint adjustment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet, CameraFit, Evidence, ImageFinding
from roemetry.records.arrays import Floats
from roemetry.records.calibration import ON_BELT, ON_BOARD, Calibration
from roemetry.stages import Calibrator, Capabilities
from roemetry_pinhole.board_options import BoardOptions
from roemetry_pinhole.boards import Seen
from roemetry_pinhole.findings import findings_of
from roemetry_pinhole.joint import Joint, camera_alone, joint, of_planes, planes_by_solids
from roemetry_pinhole.known_files import read_planes
from roemetry_pinhole.levelling import levelled
from roemetry_pinhole.pinhole_plane import (
    METHOD,
    covariance_of,
    displacements,
    parameters_of,
    rest_polynomials,
    view_of,
)
from roemetry_pinhole.scale import (
    check_beside_solids,
    check_scale,
    check_solids,
    of_lengths,
    rescaled,
    scaled_by_references,
)
from roemetry_pinhole.target_views import target_views
from roemetry_pinhole.verdict import evidence_of, judged


class PinholeCalibratorOptions(BoardOptions):
    """What is looked for."""

    camera: Path | None = Field(
        default=None,
        description="file with a camera that is known and not looked for: OpenCV's, as `roemetry calibrate "
        "--camera-only` writes it, or a calibration",
    )
    planes: Path | None = Field(
        default=None,
        description="OpenCV file with known planes of light: rows A, B, C, D, camera frame, mm",
    )
    planes_form: Literal["Ax+By+Cz+D=0", "Ax+By+Cz-D=0"] = Field(
        default="Ax+By+Cz+D=0", description="what a row of the file of planes means"
    )
    planes_offset_std_mm: float = Field(
        default=0.0,
        ge=0,
        description="standard uncertainty of known planes' places along their normals, at the belt, mm",
    )
    planes_angle_std_deg: float = Field(
        default=0.0, ge=0, description="standard uncertainty of known planes' directions, degrees"
    )
    flatness: Literal["known", "free"] = Field(
        default="known",
        description="known: the board is flat; free: its shape is looked for, up to the fourth order",
    )
    scale: Literal["known", "free"] = Field(
        default="known",
        description="known: the board's pitch; free: looked for, from a block, a staircase or the encoder",
    )
    reference_pose: str | None = Field(
        default=None,
        description="where there is no belt: the pose, by the number in its image's name, whose board lies "
        "in the plane from which heights are measured",
    )
    gravity: tuple[float, float, float] | None = Field(
        default=None,
        description="with reference_pose: direction downwards in the camera's frame of the turned image (x "
        "right, y down, z forward), as an inclinometer shows it; heights count along it from that board's "
        "middle, and the board need not lie level",
    )
    gravity_std_deg: float = Field(
        default=0.5, ge=0, description="standard uncertainty of the direction of gravity, degrees"
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
        if self.options.scale == "free":
            return scaled_by_references(
                self._joint(observed), observed, lambda scaled: self._made(scaled, observed, lengths=False)
            )
        if not planes_by_solids(observed) or self.options.planes is not None:
            calibration = self._calibrated(observed)
            return replace(calibration, **check_scale(calibration, observed, self._joint(observed)))
        try:
            calibration = self._calibrated(observed)
        except CalibrationError:
            # solids that contradict each other spoil the fit of all: then that is the reason to give
            check_solids(observed, self._calibrated)
            raise
        return replace(calibration, **check_beside_solids(calibration, observed, self._calibrated))

    def camera(self, observed: CalibrationSet) -> CameraFit:
        """Find camera and lens alone; CalibrationError for too few poses, or poses too much alike."""
        return camera_alone(observed, lens=self.options.lens)

    def findings(self, observed: CalibrationSet) -> tuple[ImageFinding, ...]:
        """Show marks, stripe points that count, and why images do not, of the set calibrated last."""
        seen, joined = self._look(observed)
        return findings_of(observed, seen, None if isinstance(joined, CalibrationError) else joined)

    def evidence(self, observed: CalibrationSet, calibration: Calibration) -> Evidence:
        """Show residuals, views left out in turn, stripes against each other, coverage, and a verdict."""
        joined = self._joint(observed)
        if self.options.scale == "free" and joined.board is not None:
            joined = rescaled(joined, float(calibration.target["pitch_mm"]) / joined.board.pitch_mm)
        return replace(evidence_of(joined, calibration), views=target_views(joined, observed, calibration))

    def _calibrated(self, observed: CalibrationSet) -> Calibration:
        return self._made(self._joint(observed), observed, lengths=True)

    def _made(self, joined: Joint, observed: CalibrationSet, *, lengths: bool) -> Calibration:
        """Give the calibration of an adjustment, with the uncertainty of the targets' lengths or without."""
        adjusted, size = joined.adjusted, joined.size
        try:
            verdict = judged(joined, scale_is_known=lengths)
        except CalibrationError as error:
            raise _with(joined.seen.notes, error) from error
        parameters = parameters_of(adjusted.geometry, travel=joined.moves)
        covariance = covariance_of(adjusted.covariance, adjusted.unknowns, travel=joined.moves)
        if lengths:
            covariance = covariance + of_lengths(joined, parameters)
        notes = verdict.notes
        if self.options.planes is not None:
            own, note = self._of_known_planes(joined)
            first = 12  # the camera's numbers come first, and stay as they are
            covariance[first:, first:] += own
            notes = (*notes, note)
        left_out = joined.seen.left_out.items()
        on_belt = self.options.reference_pose is None
        return Calibration(
            method=METHOD,
            image_size=size,
            turn_deg=observed.observations[0].frame.turn_deg,
            rest_px=rest_polynomials(parameters, size),
            displacement_px_per_mm=displacements(parameters, size),
            height_range_mm=(
                0.0 if on_belt else min(0.0, verdict.height_min_mm),
                self.options.height_max_mm or verdict.height_max_mm,
            ),
            parameters=parameters,
            covariance=covariance,
            residuals=verdict.residuals,
            target=_described(joined),
            extractor=dict(observed.extractor),
            notes=(*notes, *joined.seen.notes, *(f"not used: {name}: {why}" for name, why in left_out)),
            view=view_of(parameters, size),
            reference=ON_BELT if on_belt else ON_BOARD,
        )

    _last: tuple[CalibrationSet, Seen, Joint | CalibrationError] | None = None
    """The last set, what its images showed, and its adjustment: evidence and findings are of the same."""

    def _look(self, observed: CalibrationSet) -> tuple[Seen, Joint | CalibrationError]:
        last = self._last
        if last is None or last[0] is not observed:
            seen = Seen()
            try:
                last = observed, seen, self._adjusted(observed, seen)
            except CalibrationError as error:
                last = observed, seen, _with(seen.notes, error)
            self._last = last
        return last[1], last[2]

    def _joint(self, observed: CalibrationSet) -> Joint:
        found = self._look(observed)[1]
        if isinstance(found, CalibrationError):
            raise found
        return found

    def _adjusted(self, observed: CalibrationSet, seen: Seen) -> Joint:
        options = self.options
        if options.gravity is not None and options.reference_pose is None:
            raise CalibrationError(
                "gravity says how heights point and not where they begin",
                hint="name the pose of a board in reference_pose: heights begin at its middle",
            )
        found = joint(
            observed,
            seen,
            lens=self.options.lens,
            camera_file=self.options.camera,
            print_contrast_max=self.options.print_contrast_max,
            bent=self.options.flatness == "free",
            planes=self._planes(),
            reference_pose=_plain_number(self.options.reference_pose),
        )
        if options.gravity is None:
            return found
        number = next(number for number, view in enumerate(found.first.views) if view.on_belt)
        pose, shape = found.pose[number], found.adjusted.geometry
        middle = 0.5 * np.append(found.first.views[number].board.size_mm, 0.0)
        middle_mm = shape.rotation[pose] @ middle + shape.shift[pose]
        down = np.array(options.gravity)
        return replace(found, adjusted=levelled(found.adjusted, middle_mm, down, options.gravity_std_deg))

    def _of_known_planes(self, joined: Joint) -> tuple[Floats, str]:
        """Give the covariance of planes and belt by what the known planes are uncertain by, and a note."""
        angle, offset = self.options.planes_angle_std_deg, self.options.planes_offset_std_mm
        if not (angle or offset):
            none = joined.adjusted.geometry.planes.size + 3
            return np.zeros((none, none)), (
                "camera and planes of light were read from files and are taken as exact: their uncertainty "
                "is in no figure; planes_offset_std_mm and planes_angle_std_deg state it"
            )
        return of_planes(joined.measured, joined.adjusted, angle, offset), (
            f"planes of light were read from a file, each uncertain by {offset:g} mm along its normal and by "
            f"{angle:g}°, on its own; the camera is taken as exact"
        )

    def _planes(self) -> Floats | None:
        """Give the planes that are known; raise CalibrationError where it is not said up to which height."""
        if self.options.planes is None:
            return None
        if self.options.height_max_mm is None:
            raise CalibrationError(
                "with known planes nothing tells up to which height the calibration is meant",
                hint="give height_max_mm among the calibrator's options",
            )
        return read_planes(self.options.planes, sign=1 if self.options.planes_form == "Ax+By+Cz+D=0" else -1)


def _with(notes: list[str], error: CalibrationError) -> CalibrationError:
    """Give a refusal with what was noticed of the images: it may be the cause."""
    return CalibrationError("\n  ".join([error.message, *notes]), hint=error.hint)


def _plain_number(pose: str | None) -> str | None:
    """Give the pose's number as images' names give it: without zeros in front."""
    return str(int(pose)) if pose is not None and pose.isdigit() else pose


def _described(joined: Joint) -> dict[str, object]:
    board = joined.board
    said: dict[str, object] = {}
    if board is not None:
        said = {
            "kind": board.kind,
            "name": board.name,
            "columns": board.columns,
            "rows": board.rows,
            "pitch_mm": board.pitch_mm,
            "tolerance_mm": board.tolerance_mm,
            "poses": len(joined.first.views),
        }
        layout = joined.first.views[0].marks.layout
        said |= {"layout": layout} if layout else {}
    if joined.solids is not None:
        shapes = joined.solids.shapes
        said |= {
            "kind": ", ".join(shape.kind for shape in shapes),
            "name": ", ".join(shape.name for shape in shapes),
        }
    return said
