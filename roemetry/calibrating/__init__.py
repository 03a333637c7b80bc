"""From images to a calibration, its evidence, and its checks on a running line."""

from roemetry.calibrating.block_check import block_of, check_calibration
from roemetry.calibrating.control_chart import (
    QUANTITIES,
    Chart,
    Check,
    Quantity,
    calibration_doubts,
    chart_page,
)
from roemetry.calibrating.evidence import evidence_page, height_uncertainty
from roemetry.calibrating.from_rig import calibrate, calibrate_with_evidence, default_path, observe
from roemetry.calibrating.penetration import fit_penetration, fit_penetration_in_one

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
