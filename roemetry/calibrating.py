"""From a rig file to a calibration."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from roemetry.calibration import Calibration
from roemetry.errors import CalibrationError
from roemetry.files import sha256_of
from roemetry.preparing import prepare
from roemetry.records import AcquisitionReference, CalibrationSet, Frame, Observation
from roemetry.registry import Registry, discover
from roemetry.rig import Rig


def calibrate(rig: Rig, *, registry: Registry | None = None) -> Calibration:
    """Run the rig's extractor over its images and hand the peaks to its calibrator.

    Raises
    ------
    CalibrationError
        The images differ in size, or the calibrator refuses; with the reason and what to do.
    DataError
        An image cannot be read.
    """
    registry = registry or discover()
    source = registry.load(registry.find("source", "image-files"))()
    extractor = rig.extractor.make()
    observations = []
    hashes: dict[str, str] = {}
    for shows, paths in rig.images.items():
        for path in paths:
            acquisition = source.read(AcquisitionReference(path.stem, {"laser": path}))
            frame = prepare(
                acquisition,
                channel=rig.file.channel,
                turn_deg=rig.file.turn_deg,
                subtract="none",
                bit_depth=rig.file.bit_depth,
                sensor=rig.sensor,
            )
            observations.append(Observation(shows, frame, extractor.extract(frame)))
            found = sha256_of(path)
            if found in hashes.values():
                raise CalibrationError(
                    f"{path} is the same image as another one",
                    hint="name each image once: twice tells no more",
                )
            hashes[f"{shows}/{path.name}"] = found
    if not observations:
        raise CalibrationError(
            f"{rig.path}: there are no images to calibrate from", hint="name them in `images`"
        )
    _same_size([observation.frame for observation in observations])
    observed = CalibrationSet(
        observations=tuple(observations),
        stripe_count=rig.file.stripes,
        block=rig.block,
        working_distance_mm=rig.file.working_distance_mm,
        extractor=rig.extractor.described(),
    )
    calibration: Calibration = rig.calibrator.make().calibrate(observed)
    return replace(calibration, image_sha256=hashes, made=datetime.now(UTC).isoformat(timespec="seconds"))


def default_path(rig: Rig) -> Path:
    """Where the calibration goes if nobody says otherwise: beside the rig file."""
    return rig.path.with_name("calibration.yaml")


def _same_size(frames: list[Frame]) -> None:
    for frame in frames[1:]:
        if frame.size != frames[0].size:
            raise CalibrationError(
                f"{frame.name} is {frame.size[1]} × {frame.size[0]} pixels, "
                f"{frames[0].name} is {frames[0].size[1]} × {frames[0].size[0]}",
                hint="take all images with one camera and one region of interest",
            )
