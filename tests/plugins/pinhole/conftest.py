"""The kit's rig as boards and belt show it, and its calibration: made once for all tests of this folder."""

from __future__ import annotations

from dataclasses import replace

import pytest

from roemetry.records import CalibrationSet
from roemetry.records.calibration import Calibration
from roemetry.testing import LinearRig
from roemetry_pinhole.calibrator import PinholeCalibrator
from roemetry_pinhole.conformance import observed_of


@pytest.fixture(scope="session")
def observed() -> CalibrationSet:
    return observed_of(LinearRig())


@pytest.fixture(scope="session")
def calibrated(observed: CalibrationSet) -> Calibration:
    return PinholeCalibrator().calibrate(observed)


@pytest.fixture(scope="session")
def boards(observed: CalibrationSet) -> CalibrationSet:
    """Without the belt."""
    return replace(observed, observations=tuple(one for one in observed.observations if one.shows != "belt"))


@pytest.fixture(scope="session")
def belt(observed: CalibrationSet) -> CalibrationSet:
    """The belt alone."""
    only = tuple(one for one in observed.observations if one.shows == "belt")
    return replace(observed, observations=only, board=None)
