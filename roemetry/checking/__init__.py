"""Checks of a calibration on a running line: a known block, measured again and again."""

from roemetry.checking.chart import Chart
from roemetry.checking.checking import check_calibration
from roemetry.checking.doubting import calibration_doubts
from roemetry.checking.judging import Check, Quantity

__all__ = ["Chart", "Check", "Quantity", "calibration_doubts", "check_calibration"]
