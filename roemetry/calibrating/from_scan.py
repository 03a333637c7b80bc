"""The belt's motion, added to a calibration from a scan of a known body that the rig file names."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any

from roemetry.config.rig import Rig
from roemetry.errors import CalibrationError
from roemetry.records import Acquisition, Frame
from roemetry.records.calibration import Calibration
from roemetry.run.preprocess import prepare
from roemetry.run.scan import gather
from roemetry.run.stage_errors import wrap_stage_error
from roemetry.stages.registry import Registry


def base_of(rig: Rig) -> Calibration | None:
    """Give the calibration that the rig's scan is to complete; None where the rig's images make it."""
    scan = rig.file.scan
    return None if scan is None or scan.base is None else Calibration.load(rig.path.parent / scan.base)


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
    stripes = gather(lines, partial(_prepared, rig), stages, calibration)
    triangulator = registry.load(registry.find("triangulator", calibration.method))()
    with wrap_stage_error("assembler", rig.scan_assembler):
        motion, figures = rig.scan_assembler.make().motion(
            stripes, lines, calibration, triangulator, target, right=scan.runs == "right"
        )
    return replace(
        calibration,
        motion=motion,
        residuals={**calibration.residuals, **figures},
        made=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _prepared(rig: Rig, acquisition: Acquisition) -> Frame:
    return prepare(
        acquisition,
        channel=rig.file.channel,
        contrast=rig.file.contrast,
        turn_deg=rig.file.turn_deg,
        bit_depth=rig.file.bit_depth,
        subtract="none",
        sensor=rig.sensor,
    )
