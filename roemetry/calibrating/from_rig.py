"""From a rig file to a calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.calibrating.evidence import findings_page
from roemetry.config.recipe_file import Colour, Contrast
from roemetry.config.rig import Rig, pose_of
from roemetry.errors import CalibrationError
from roemetry.io.files import sha256_of, write_whole
from roemetry.records import (
    Acquisition,
    AcquisitionReference,
    CalibrationSet,
    CameraFit,
    Evidence,
    Frame,
    Observation,
    Peaks,
    TargetView,
)
from roemetry.records.calibration import Calibration
from roemetry.run.pace import OnProgress, Pace, silent
from roemetry.run.preprocess import prepare
from roemetry.run.scan import gather
from roemetry.run.stage_errors import wrap_stage_error
from roemetry.stages import Calibrator
from roemetry.stages.kinds import check_result_type
from roemetry.stages.registry import Registry, discover


def calibrate(rig: Rig, *, registry: Registry | None = None, on_progress: OnProgress = silent) -> Calibration:
    """Run the rig's extractor over its images and hand the peaks to its calibrator.

    `on_progress` is called with (steps done, of how many, time that the others will take, s): an image is a
    step, and the adjustment.

    Raises
    ------
    CalibrationError
        The images differ in size, or the calibrator refuses; with the reason and what to do.
    DataError
        An image cannot be read.
    """
    registry = registry or discover()
    if (base := base_of(rig)) is not None:
        return with_motion(rig, base, registry)
    steps = _Steps(rig, on_progress)
    calibration = _calibrated(rig, rig.calibrator.make(), *observe(rig, registry, steps.done))
    steps.done(_ADJUSTED)
    return calibration if rig.file.scan is None else with_motion(rig, calibration, registry)


def calibrate_with_evidence(
    rig: Rig,
    *,
    registry: Registry | None = None,
    doctor: Path | None = None,
    on_progress: OnProgress = silent,
) -> tuple[Calibration, Evidence]:
    """Calibrate, and give what the calibrator can show for it; raises and tells progress as `calibrate`.

    `doctor` is a page (HTML) to write of each image, what was found in it and why it was or was not used; it
    is written where the calibrator refuses as well.
    """
    registry = registry or discover()
    if (base := base_of(rig)) is not None:
        return with_motion(rig, base, registry), Evidence()
    steps = _Steps(rig, on_progress, evidence=True)
    observed, hashes = observe(rig, registry, steps.done)
    calibrator = rig.calibrator.make()
    refusal = ""
    try:
        calibration = _calibrated(rig, calibrator, observed, hashes)
        steps.done(_ADJUSTED)
        evidence = calibrator.evidence(observed, calibration)
        steps.done(_SHOWN)
        if rig.file.scan is not None:
            calibration = with_motion(rig, calibration, registry)
    except CalibrationError as error:
        refusal = str(error)
        raise
    finally:
        if doctor is not None:
            write_whole(doctor, findings_page(calibrator.findings(observed), rig.file.name, refusal))
    return calibration, evidence if evidence.views else replace(evidence, views=_as_observed(observed))


def _as_observed(observed: CalibrationSet) -> tuple[TargetView, ...]:
    """Give the images with all their peaks, where a calibrator does not say what it used of them."""
    return tuple(
        TargetView(
            one.frame.name,
            one.frame,
            np.column_stack([one.peaks.x_px, one.peaks.row.astype(np.float64)]),
            np.full(len(one.peaks), -1),
        )
        for one in observed.observations
    )


def _calibrated(
    rig: Rig, calibrator: Calibrator[Any], observed: CalibrationSet, hashes: dict[str, str]
) -> Calibration:
    with wrap_stage_error("calibrator", rig.calibrator):
        calibration: Calibration = check_result_type("calibrator", calibrator.calibrate(observed))
    return replace(calibration, image_sha256=hashes, made=datetime.now(UTC).isoformat(timespec="seconds"))


def calibrate_camera(rig: Rig, path: Path, *, registry: Registry | None = None) -> CameraFit:
    """Find camera and lens alone from the rig's boards, and write them as OpenCV does.

    Raises
    ------
    CalibrationError
        As `calibrate`.
    DataError
        An image cannot be read.
    OutputError
        The file cannot be written.
    """
    import cv2

    observed, _ = observe(rig, registry or discover())
    with wrap_stage_error("calibrator", rig.calibrator):
        found: CameraFit = check_result_type("camera", rig.calibrator.make().camera(observed))
    storage = cv2.FileStorage(path.suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    rows, columns = found.image_size
    (fx, fy), (cx, cy) = found.focal_px, found.principal_px
    storage.write("image_width", columns)
    storage.write("image_height", rows)
    storage.write("camera_matrix", np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))
    storage.write("distortion_coefficients", found.distortion[None])
    storage.write("standard_uncertainties", found.std[None])
    storage.write("rms_px", found.rms_px)
    write_whole(path, storage.releaseAndGetString())
    return found


class _Steps:
    """Counts what is done of a calibration."""

    def __init__(self, rig: Rig, on_progress: OnProgress, *, evidence: bool = False) -> None:
        kinds = Counter(shows for _, shows, paths in _groups(rig) for _ in paths)
        kinds.update([_ADJUSTED, *([_SHOWN] if evidence else [])])
        self._pace, self._tell = Pace(kinds, cost=_COST), on_progress
        self._done, self._of = 0, kinds.total()

    def done(self, kind: str) -> None:
        self._pace.done(kind)
        self._done += 1
        self._tell(self._done, self._of, self._pace.left_s())


_ADJUSTED, _SHOWN = "adjusted", "shown"
_COST = {_ADJUSTED: 40.0, _SHOWN: 40.0}
"""What the steps of a calibration cost in comparison: reading an image costs 1."""


def _groups(rig: Rig) -> list[tuple[int, str, list[Path]]]:
    """Give (number of the board, what is shown, the images of it) for all that the rig's file names."""
    groups = [(0, shows, list(paths)) for shows, paths in rig.images.items()]
    for further, (_, images) in enumerate(rig.more_boards, start=1):
        groups += [(further, shows, list(paths)) for shows, paths in images.items()]
    return groups


def observe(
    rig: Rig, registry: Registry, on_read: Callable[[str], None] = lambda shows: None
) -> tuple[CalibrationSet, dict[str, str]]:
    """Read a rig's images and find their peaks; give what the calibrator receives, and the images' hashes.

    A laser image of a board has its peaks from the difference to its laser-off partner, where there is one
    in the same light. `on_read` is called after each image with what it shows, as `Rig.images` names it.

    Raises
    ------
    CalibrationError
        There is no image, an image stands there twice, or sizes differ.
    DataError
        An image cannot be read.
    """
    source = registry.load(registry.find("source", "image-files"))()
    extractor = rig.extractor.make()
    observations: list[Observation] = []
    hashes: dict[str, str] = {}
    plain: dict[tuple[int, str, str], Frame] = {}
    first: Frame | None = None
    groups = _groups(rig)
    count = Counter(path.name for *_, paths in groups for path in paths)
    for board, shows, paths in groups:
        target = shows.removesuffix("_laser")
        on_board = target in ("board", "board_on_belt")
        lit = not on_board or target != shows
        for index, path in enumerate(paths):
            read: Frame = source.read(AcquisitionReference(path.stem, {"laser": path})).frames[0]
            if count[path.name] > 1:  # in another folder there is one of the same name
                read = replace(read, name=f"{path.parent.name}/{path.name}")
            first = first or read
            _same_size(first, read)
            found = sha256_of(path)
            if found in hashes.values():
                raise CalibrationError(
                    f"{path} is the same image as another one",
                    hint="name each image once: twice tells no more",
                )
            hashes[f"{shows}/{path.name}" if not board else f"{board + 1}/{shows}/{path.name}"] = found
            pose = pose_of(path) if on_board else ""
            # marks are black and white: the laser's contrast would leave nothing of them
            frame = _prepared(read, None, rig, contrast="none" if on_board else rig.file.contrast)
            if not lit:
                if shows == "board_on_belt" and rig.file.encoder_counts:
                    frame = replace(frame, encoder_count=rig.file.encoder_counts[index])
                plain[board, target, pose] = read
                shown = replace(frame, role="plain")
                observations.append(Observation(target, shown, _none(frame), pose, board))
                on_read(shows)
                continue
            partner = plain.get((board, target, pose))
            if partner is not None and _other_scene(partner, read):
                partner = None  # it shows the board, not what to subtract
            light = _prepared(
                read, partner, rig, contrast=rig.file.contrast, second_channel=rig.file.second_channel
            )
            with wrap_stage_error("extractor", rig.extractor):
                peaks = check_result_type("extractor", extractor.extract(light))
            observations.append(Observation(target, frame, peaks, pose, board))
            on_read(shows)
    if not observations:
        raise CalibrationError(
            f"{rig.path}: there are no images to calibrate from", hint="name them in `images`"
        )
    observed = CalibrationSet(
        observations=tuple(observations),
        stripe_count=rig.file.stripes or 0,
        block=rig.block,
        working_distance_mm=rig.file.working_distance_mm,
        extractor=rig.extractor.described(),
        board=rig.board,
        staircase=rig.staircase,
        pyramid=rig.pyramid,
        mm_per_count=_per_count(rig),
        sphere_plate=rig.sphere_plate,
        ruler=rig.ruler,
        more_boards=tuple(board for board, _ in rig.more_boards),
    )
    return observed, hashes


def _per_count(rig: Rig) -> tuple[float, float] | None:
    known_mm = rig.file.encoder_mm_per_count
    return None if known_mm is None else (known_mm, rig.file.encoder_mm_per_count_std)


def default_path(rig: Rig) -> Path:
    """Where the calibration goes if nobody says otherwise: beside the rig file."""
    return rig.path.with_name("calibration.yaml")


def _prepared(
    laser: Frame,
    partner: Frame | None,
    rig: Rig,
    *,
    contrast: Contrast,
    second_channel: Colour | None = None,
) -> Frame:
    """One channel, turned; the light of the laser alone where there is a laser-off partner."""
    frames = (laser,) if partner is None else (laser, replace(partner, role="dark"))
    options: dict[str, Any] = {
        "channel": rig.file.channel,
        "second_channel": second_channel,
        "contrast": contrast,
        "turn_deg": rig.file.turn_deg,
        "bit_depth": rig.file.bit_depth,
        "subtract": "none" if partner is None else "dark",
        "sensor": rig.sensor,
    }
    return prepare(Acquisition(laser.name, frames), **options)


def _other_scene(plain: Frame, laser: Frame) -> bool:
    """Say whether the laser-off image shows something else than the laser image less the laser.

    Light adds: nothing is darker with the laser on. Much that is a little darker was lit by a lamp before; a
    little that is much darker has moved, and the edges of its print would pass for stripes.
    """
    off, on = plain.pixels, laser.pixels
    if off.ndim != on.ndim:  # one is grey: of the other the brightest colour counts
        off, on = (one.max(axis=2) if one.ndim == 3 else one for one in (off, on))
    darker = off.astype(np.float32) - on
    return any(float((darker > grey * laser.white).mean()) > share for grey, share in _DARKER_MAX)


_DARKER_MAX = ((0.02, 0.25), (0.15, 0.003))
"""Of white, and of the image: noise of two images is 0.01 to 0.02 of white; a chessboard that moved by a
pixel changes a hundredth of the image by half of its contrast."""


def _none(frame: Frame) -> Peaks:
    nothing = np.empty(0)
    return Peaks(
        image_size=frame.size,
        row=np.empty(0, np.int64),
        x_px=nothing,
        x_std_px=nothing,
        amplitude=nothing,
        background=nothing,
        width_px=nothing,
        flags=np.empty(0, np.uint8),
    )


def _same_size(first: Frame, frame: Frame) -> None:
    if frame.size != first.size:
        raise CalibrationError(
            f"{frame.name} is {frame.size[1]} × {frame.size[0]} pixels, "
            f"{first.name} is {first.size[1]} × {first.size[0]}",
            hint="take all images with one camera and one region of interest",
        )


def base_of(rig: Rig) -> Calibration | None:
    """Give the calibration that the rig's scan is to complete; None where the rig's images make it."""
    scan = rig.file.scan
    return None if scan is None or scan.base is None else Calibration.load(rig.path.parent / scan.base)


_NO_ENDS = (
    "the line of light reaches the image's sides, or no `sensor` says how uncertain its places are: no scan "
    "can notice that the camera comes nearer. Let the light end within the image on both sides of the belt, "
    "or carry a body of known size through it now and then"
)


def with_motion(rig: Rig, calibration: Calibration, registry: Registry) -> Calibration:
    """Measure the motion from the rig's scan and give the calibration that knows it.

    Raises
    ------
    CalibrationError
        No target fits a scan, there is more than one scan, or the motion could not be told.
    DataError
        The scan cannot be read.
    """
    scan = rig.file.scan
    assert scan is not None
    assert rig.scan_source is not None
    assert rig.scan_coder is not None
    assert rig.scan_assembler is not None
    target = rig.pyramid or rig.sphere_plate
    if target is None:
        raise CalibrationError(
            f"{rig.path}: a scan needs a body whose shape tells the motion",
            hint="describe it under `pyramid` or `sphere_plate`",
        )
    source = rig.scan_source.make()
    found = source.references(rig.path.parent / scan.path)
    if len(found) != 1:
        raise CalibrationError(
            f"{rig.path}: scan.path names {len(found)} scans or parts of one, expected one pass",
            hint="raise part_lines in scan.source.options if one pass has more lines than that",
        )
    lines = source.read(found[0]).lines
    if lines is None:
        raise CalibrationError(f"{rig.path}: the source {scan.source.use} gives no lines of a scan")
    stages: dict[str, Any] = {"extractor": rig.extractor.make(), "coder": rig.scan_coder.make()}
    stripes = gather(lines, partial(_prepared_line, rig), stages, calibration)
    triangulator = registry.load(registry.find("triangulator", calibration.method))()
    with wrap_stage_error("assembler", rig.scan_assembler):
        motion, figures = rig.scan_assembler.make().motion(
            stripes, lines, calibration, triangulator, target, right=scan.runs == "right"
        )
    notes = calibration.notes
    if np.isnan(motion.line_ends_rows).any():
        notes = (*notes, _NO_ENDS)
    return replace(
        calibration,
        motion=motion,
        notes=notes,
        residuals={**calibration.residuals, **figures},
        made=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _prepared_line(rig: Rig, acquisition: Acquisition) -> Frame:
    return prepare(
        acquisition,
        channel=rig.file.channel,
        contrast=rig.file.contrast,
        turn_deg=rig.file.turn_deg,
        bit_depth=rig.file.bit_depth,
        subtract="none",
        sensor=rig.sensor,
    )
