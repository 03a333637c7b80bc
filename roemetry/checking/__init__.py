"""Checks of a calibration on a running line: a known block, measured again and again."""

from roemetry.checking.chart import Chart
from roemetry.checking.checking import check_calibration
from roemetry.checking.doubting import calibration_doubts
from roemetry.checking.fitting_penetration import fit_penetration, fit_penetration_in_one
from roemetry.checking.judging import Check, Quantity
from roemetry.checking.known_block import block_of

__all__ = [
    "Chart",
    "Check",
    "Quantity",
    "block_of",
    "calibration_doubts",
    "check_calibration",
    "fit_penetration",
    "fit_penetration_in_one",
]
