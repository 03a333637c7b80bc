"""From images to a calibration, its evidence, and its checks on a running line."""

from roemetry.calibrating.block_check import (
    block_of,
    check_calibration,
    find_block,
    fit_penetration,
    fit_penetration_in_one,
    read_block,
)
from roemetry.calibrating.evidence import (
    correlations,
    coverage,
    evidence_page,
    height_uncertainty,
    level_line_px,
)
from roemetry.calibrating.from_rig import (
    calibrate,
    calibrate_camera,
    calibrate_with_evidence,
    default_path,
    observe,
)
from roemetry.run.control_chart import (
    QUANTITIES,
    Chart,
    Check,
    Quantity,
    calibration_doubts,
    chart_page,
    judge,
)

__all__ = [
    "QUANTITIES",
    "Chart",
    "Check",
    "Quantity",
    "block_of",
    "calibrate",
    "calibrate_camera",
    "calibrate_with_evidence",
    "calibration_doubts",
    "chart_page",
    "check_calibration",
    "correlations",
    "coverage",
    "default_path",
    "evidence_page",
    "find_block",
    "fit_penetration",
    "fit_penetration_in_one",
    "height_uncertainty",
    "judge",
    "level_line_px",
    "observe",
    "read_block",
]
