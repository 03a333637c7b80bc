"""Calibration of camera, planes of light and belt from a board in many poses, in one joint adjustment.

Where nothing flat and level can be laid under the stripes, the direction of gravity g in the camera's frame,
as an inclinometer on the camera shows it, says how heights point, and the middle c of one board says where
they begin. That middle lies on the sight r, in the board's plane b·X = 1, so c = r/(b·r), and the level plane
through it is

    b'·X = 1,   b' = g (b·r)/(g·r):

linear in b, whose covariance goes through it. What the inclinometer is uncertain by, in both directions
across g, comes on top. Assumed: the inclinometer and the camera's axes are aligned, or their angle is in its
uncertainty.
"""

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
from roemetry.stages import Calibrator, Capabilities, StageOptions
from roemetry_pinhole.boards import Seen
from roemetry_pinhole.bundle import Adjusted
from roemetry_pinhole.findings import findings_of, target_views
from roemetry_pinhole.joint_adjustment import (
    JointAdjustment,
    adjust_jointly,
    camera_alone,
    known_planes_covariance,
    planes_by_solids,
)
from roemetry_pinhole.known_files import read_planes
from roemetry_pinhole.pinhole_plane import METHOD, covariance_of, derived, parameters_of
from roemetry_pinhole.scale import (
    check_scale,
    check_solids,
    of_lengths,
    rescaled,
    scaled_by_references,
    with_solid_checks,
)
from roemetry_pinhole.verdict import evidence_of, judged


class BoardOptions(StageOptions):
    """What is looked for, and what of a board's print is used."""

    lens: Literal["none", "radial", "brown", "rational"] = Field(
        default="brown",
        description="lens model: none; k1 k2; k1 k2 p1 p2 k3; or with k4 k5 k6 for very wide angles",
    )
    print_contrast_max: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="largest contrast of the print under the light, (light − dark)/(light + dark), to use it",
    )
    height_max_mm: float | None = Field(
        default=None, gt=0, description="greatest height to be measured, mm; none: what the boards reached"
    )


class PinholeCalibratorOptions(BoardOptions):
    """What is looked for."""

    camera: Path | None = Field(
        default=None,
        description="file with a camera that is known and not looked for: OpenCV's, as `roemetry calibrate "
        "--camera-only` writes it, or a calibration",
    )
    planes: Path | None = Field(
        default=None, description="OpenCV file with known planes of light: rows A, B, C, D, camera frame, mm"
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

    capabilities = Capabilities(
        tolerance_px=0.1, relative_tolerance=0.01, fixture="roemetry_pinhole.conformance:observed_of"
    )

    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate.

        Raises
        ------
        CalibrationError
            No board is described or seen, too few poses or too little variety, a stripe on fewer than two
            boards, no belt, a scale that two targets contradict, planes that do not agree, or residuals
            that are no noise; with what was left out and why.
        """

        def made(some: CalibrationSet) -> Calibration:
            return self._made(self._joint(some), some, lengths=True)

        if self.options.scale == "free":
            return scaled_by_references(
                self._joint(observed), observed, lambda scaled: self._made(scaled, observed, lengths=False)
            )
        if not planes_by_solids(observed) or self.options.planes is not None:
            calibration = made(observed)
            return replace(calibration, **check_scale(calibration, observed, self._joint(observed)))
        try:
            calibration = made(observed)
        except CalibrationError:
            # solids that contradict each other spoil the fit of all: then that is the reason to give
            check_solids(observed, made)
            raise
        return replace(calibration, **with_solid_checks(calibration, observed, made))

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

    def _made(self, joined: JointAdjustment, observed: CalibrationSet, *, lengths: bool) -> Calibration:
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
            height_range_mm=(
                0.0 if on_belt else min(0.0, verdict.height_min_mm),
                self.options.height_max_mm or verdict.height_max_mm,
            ),
            covariance=covariance,
            residuals=verdict.residuals,
            target=_described(joined),
            extractor=dict(observed.extractor),
            notes=(*notes, *joined.seen.notes, *(f"not used: {name}: {why}" for name, why in left_out)),
            reference=ON_BELT if on_belt else ON_BOARD,
            **derived(parameters, size),
        )

    _last: tuple[CalibrationSet, Seen, JointAdjustment | CalibrationError] | None = None
    """The last set, what its images showed, and its adjustment: evidence and findings are of the same."""

    def _look(self, observed: CalibrationSet) -> tuple[Seen, JointAdjustment | CalibrationError]:
        last = self._last
        # by identity: evidence and findings ask for the very set that was calibrated
        if last is None or last[0] is not observed:
            seen = Seen()
            try:
                last = observed, seen, self._adjusted(observed, seen)
            except CalibrationError as error:
                last = observed, seen, _with(seen.notes, error)
            self._last = last
        return last[1], last[2]

    def _joint(self, observed: CalibrationSet) -> JointAdjustment:
        found = self._look(observed)[1]
        if isinstance(found, CalibrationError):
            raise found
        return found

    def _adjusted(self, observed: CalibrationSet, seen: Seen) -> JointAdjustment:
        options = self.options
        if options.gravity is not None and options.reference_pose is None:
            raise CalibrationError(
                "gravity gives the direction of heights, but not where they begin",
                hint="name the pose of a board in reference_pose: heights begin at its middle",
            )
        pose = options.reference_pose
        if pose is not None and pose.isdigit():
            pose = str(int(pose))  # as images' names give it: without zeros in front
        found = adjust_jointly(
            observed,
            seen,
            lens=options.lens,
            camera_file=options.camera,
            print_contrast_max=options.print_contrast_max,
            fit_warp=options.flatness == "free",
            planes=self._planes(),
            reference_pose=pose,
        )
        if options.gravity is None:
            return found
        number = next(number for number, view in enumerate(found.first.views) if view.on_belt)
        at, shape = found.pose[number], found.adjusted.geometry
        middle = 0.5 * np.append(found.first.views[number].board.size_mm, 0.0)
        middle_mm = shape.rotation[at] @ middle + shape.shift[at]
        down = np.array(options.gravity)
        return replace(found, adjusted=levelled(found.adjusted, middle_mm, down, options.gravity_std_deg))

    def _of_known_planes(self, joined: JointAdjustment) -> tuple[Floats, str]:
        """Give the covariance of planes and belt by what the known planes are uncertain by, and a note."""
        angle, offset = self.options.planes_angle_std_deg, self.options.planes_offset_std_mm
        if not (angle or offset):
            size = joined.adjusted.geometry.planes.size + 3
            return np.zeros((size, size)), (
                "camera and planes of light were read from files and are taken as exact: their uncertainty "
                "is in no figure; planes_offset_std_mm and planes_angle_std_deg state it"
            )
        return known_planes_covariance(joined.measured, joined.adjusted, angle, offset), (
            f"planes of light were read from a file, each uncertain by {offset:g} mm along its normal and by "
            f"{angle:g}°, on its own; the camera is taken as exact"
        )

    def _planes(self) -> Floats | None:
        """Give the planes that are known; raise CalibrationError where it is not said up to which height."""
        if self.options.planes is None:
            return None
        if self.options.height_max_mm is None:
            raise CalibrationError(
                "known planes do not say up to which height the calibration is meant to be used",
                hint="give height_max_mm among the calibrator's options",
            )
        return read_planes(self.options.planes, sign=1 if self.options.planes_form == "Ax+By+Cz+D=0" else -1)


def _with(notes: list[str], error: CalibrationError) -> CalibrationError:
    """Give a refusal with what was noticed of the images: it may be the cause."""
    return CalibrationError("\n  ".join([error.message, *notes]), hint=error.hint)


def _described(joined: JointAdjustment) -> dict[str, object]:
    board = joined.board
    said: dict[str, object] = {}
    if board is not None:
        names = ("kind", "name", "columns", "rows", "pitch_mm", "tolerance_mm")
        said = {name: getattr(board, name) for name in names} | {"poses": len(joined.first.views)}
        layout = joined.first.views[0].marks.layout
        said |= {"layout": layout} if layout else {}
    if joined.solids is not None:
        shapes = joined.solids.shapes
        said |= {name: ", ".join(getattr(shape, name) for shape in shapes) for name in ("kind", "name")}
    return said


_GRAZING = 0.05  # cosine between gravity and a sight: nearer to level sights, heights would hardly be seen


def levelled(adjusted: Adjusted, middle_mm: Floats, gravity: Floats, std_deg: float) -> Adjusted:
    """Let heights count along gravity, from a board's middle; the belt in `adjusted` is the board's plane.

    `middle_mm` and `gravity`, downwards and of any length, are (3,) in the camera's frame of the turned image
    (x right, y down, z forward), `std_deg` is the standard uncertainty of gravity's direction, degrees.

    Raises
    ------
    CalibrationError
        The camera does not look down onto the level plane.
    """
    length = float(np.linalg.norm(gravity))
    down = gravity / (length or 1.0)
    sight = middle_mm / np.linalg.norm(middle_mm)
    drop = float(down @ sight)
    if not (length > 0.0 and drop > _GRAZING and down[2] > _GRAZING):
        raise CalibrationError(
            f"the camera does not look down onto a level plane: gravity is {gravity.tolist()}, the "
            f"cosine of its angle with the sight of the board {drop:.2f}, with its axis {down[2]:.2f}; "
            f"both have to be above {_GRAZING}",
            hint="gravity is the direction downwards in the turned image's camera frame: x right, y down, z "
            "forward; leave it out to count heights from the plane of the board itself",
        )
    # b' = g (b·r) / (g·r), linear in b
    turn = np.outer(down, sight) / drop
    step = np.eye(adjusted.covariance.shape[0])
    at = adjusted.unknowns.belt
    step[np.ix_(at, at)] = turn
    covariance = step @ adjusted.covariance @ step.T
    across = np.linalg.svd(down[None, :])[2][1:].T  # (3, 2): two directions across gravity
    scale = float(adjusted.geometry.belt @ sight) / drop
    # by gravity's error in both directions across it
    moved = np.radians(std_deg) * scale * (across - np.outer(down, sight @ across) / drop)
    covariance[np.ix_(at, at)] += moved @ moved.T
    belt = turn @ adjusted.geometry.belt
    return replace(adjusted, geometry=replace(adjusted.geometry, belt=belt), covariance=covariance)
