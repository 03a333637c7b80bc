"""From images to a calibration, its evidence, and its checks on a running line."""

from roemetry.calibrate.block_check import block_of, check_calibration
from roemetry.calibrate.evidence import evidence_page, height_uncertainty
from roemetry.calibrate.from_rig import calibrate, calibrate_with_evidence, default_path, observe
from roemetry.calibrate.penetration import fit_penetration, fit_penetration_in_one
from roemetry.run.control_chart import (
    QUANTITIES,
    Chart,
    Check,
    Quantity,
    calibration_doubts,
    chart_page,
)

__all__ = [
    "QUANTITIES",
    "Chart",
    "Check",
    "Quantity",
    "block_of",
    "calibrate",
    "calibrate_with_evidence",
    "calibration_doubts",
    "chart_page",
    "check_calibration",
    "default_path",
    "evidence_page",
    "fit_penetration",
    "fit_penetration_in_one",
    "height_uncertainty",
    "observe",
]
