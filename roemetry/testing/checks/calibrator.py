"""What every calibrator keeps: a known rig comes back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.stages import Calibrator
from roemetry.testing.comparing import difference
from roemetry.testing.fixtures import calibration_set_for
from roemetry.testing.scenes import SEED, LinearRig
from roemetry.testing.verdict import refused, require


def check_rest_lines_come_back(calibrator: Calibrator[Any]) -> None:
    """Every stripe's rest line comes back within the declared `tolerance_px`, on every row."""
    rig = LinearRig()
    calibration = calibrator.calibrate(calibration_set_for(calibrator, rig))
    off = np.abs(calibration.rest_line_px(np.arange(rig.rows, dtype=np.float64)) - rig.rest_px()).max()
    limit = calibrator.capabilities.tolerance_px
    require(off <= limit, f"rest lines are off by up to {off:.3g} px, {limit:g} px are declared")


def check_displacements_come_back_with_their_sign(calibrator: Calibrator[Any]) -> None:
    """Every stripe's px per mm comes back within the `relative_tolerance`, with the side of the laser."""
    for rig in (LinearRig(), LinearRig().mirrored()):
        found = calibrator.calibrate(calibration_set_for(calibrator, rig)).displacement_px_per_mm
        off = np.abs(found / rig.px_per_mm - 1.0).max()
        limit = calibrator.capabilities.relative_tolerance
        require(off <= limit, f"displacements per mm are off by up to {off:.2%}, {limit:.2%} are declared")


def check_the_covariance_can_be_drawn_from(calibrator: Calibrator[Any]) -> None:
    """The covariance is symmetric, has no negative direction, and gives finite parameters when drawn from."""
    calibration = calibrator.calibrate(calibration_set_for(calibrator, LinearRig()))
    covariance = calibration.covariance
    require(bool(np.isfinite(covariance).all()), "the covariance is not finite")
    require(np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0), "the covariance is not symmetric")
    lowest, highest = np.linalg.eigvalsh(covariance)[[0, -1]]
    require(lowest >= -1e-9 * highest, f"the covariance has the eigenvalue {lowest:.3g}")
    drawn = calibration.redraw(np.random.default_rng(SEED)).parameters
    require(all(bool(np.isfinite(a).all()) for a in drawn.values()), "drawn parameters are not finite")


def check_it_survives_its_file(calibrator: Calibrator[Any]) -> None:
    """The calibration can be written to its file and read again without a change."""
    import tempfile
    from pathlib import Path

    calibration = calibrator.calibrate(calibration_set_for(calibrator, LinearRig()))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.yaml"
        calibration.save(path)
        found = difference(calibration.to_dict(), type(calibration).load(path).to_dict())
    require(found is None, f"read again, {found}")


def check_no_image_is_refused(calibrator: Calibrator[Any]) -> None:
    """Without any observation it refuses by a `CalibrationError` that says what is missing."""
    observed = replace(calibration_set_for(calibrator, LinearRig()), observations=())
    with refused("a set without observations", CalibrationError):
        calibrator.calibrate(observed)


def check_a_wrong_number_of_stripes_is_refused(calibrator: Calibrator[Any]) -> None:
    """Images that show another number of stripes than the rig has are refused by a `CalibrationError`."""
    observed = calibration_set_for(calibrator, LinearRig())
    with refused("seven stripes where nine are expected", CalibrationError):
        calibrator.calibrate(replace(observed, stripe_count=9))


CHECKS = (
    check_rest_lines_come_back,
    check_displacements_come_back_with_their_sign,
    check_the_covariance_can_be_drawn_from,
    check_it_survives_its_file,
    check_no_image_is_refused,
    check_a_wrong_number_of_stripes_is_refused,
)
