"""Calibration of lines in two families that stand between each other, by colour.

Each family is calibrated as lines are, by `pinhole-plane`, which so has lines twice as far apart to number.
Both tell of one camera and one belt, and of the same marks on the same boards: they are joined as the
families of a grid are (`roemetry_pinhole.grid`), the planes of each following what both say of camera and
belt. How far the families lie apart is a check. What comes out is a calibration of `pinhole-plane`, in which
lines of both families take turns.

It assumes as much as `pinhole-plane` does of each family, and that the extractor tells the colours apart: a
peak in the wrong family is a stray one there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet, Observation
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages import Calibrator, Capabilities
from roemetry_pinhole.calibrator import BoardOptions, PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.grid import APART_MAX, FamilyFound, joined_findings
from roemetry_pinhole.pinhole_plane import derived, flat


class PinholeTwoFamiliesCalibrator(Calibrator[BoardOptions]):
    """Camera, lens, the planes of both families, and the belt."""

    capabilities = Capabilities(fixture="roemetry_pinhole.conformance:two_families_observed_of")

    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate.

        Raises
        ------
        CalibrationError
            As `pinhole-plane` does of either family, which is named; peaks say nothing of families; or these
            tell of different cameras.
        """
        shared = self.options.model_dump(include=set(BoardOptions.model_fields))
        one = PinholeCalibrator(PinholeCalibratorOptions(**shared))
        found = []
        for family, name in enumerate(("first", "second")):
            try:
                found.append(one.calibrate(_part(observed, family)))
            except CalibrationError as error:
                said = f"lines of the {name} colour: {error.message}"
                raise CalibrationError(said, hint=error.hint) from error
        return _joined(*found)


def _part(observed: CalibrationSet, family: int) -> CalibrationSet:
    """Give the images with the peaks of one family."""

    def mine(one: Observation) -> Observation:
        """Give an observation with the peaks of the family alone."""
        peaks = one.peaks
        if not len(peaks):
            return one
        if peaks.family is None:
            raise CalibrationError(
                "the peaks say nothing of families",
                hint="set `extractor: two-channels` and `second_channel`",
            )
        return replace(one, peaks=peaks.some(peaks.family == family, family=None))

    # lines take turns: the first family has one more where the number is odd
    count = (observed.stripe_count + 1 - family) // 2
    return replace(observed, stripe_count=count, observations=tuple(map(mine, observed.observations)))


def _joined(first: Calibration, second: Calibration) -> Calibration:
    """Give the calibration of both families, whose planes take turns."""
    one, other = (FamilyFound.of(flat(x.parameters), x.covariance, x.stripe_count) for x in (first, second))
    shared, covariance, off = one.combined(other)
    if off > APART_MAX:
        raise CalibrationError(
            f"the lines of the two colours give cameras that are {off:.1f} standard deviations apart",
            hint="did neither projector nor camera move between the images?",
        )
    count = first.stripe_count + second.stripe_count
    planes, gain, own = np.empty((count, 3)), np.empty((count, 3, 15)), np.zeros((count, 3, count, 3))
    for start, found in enumerate((one, other)):
        moved = found.planes + found.gain @ (shared - found.shared)
        planes[start::2] = moved.reshape(-1, 3)
        gain[start::2] = found.gain.reshape(-1, 3, 15)
        lines = len(moved) // 3
        own[start::2, :, start::2] = found.own.reshape(lines, 3, lines, 3)
    # in the order of the parameters: camera, planes, belt
    follow = np.vstack([np.eye(15)[:12], gain.reshape(-1, 15), np.eye(15)[12:]])
    whole: Floats = follow @ covariance @ follow.T
    # what is left of each family's planes where the shared is known
    whole[12:-3, 12:-3] += own.reshape(3 * count, 3 * count)
    parameters = {
        "focal_px": shared[:2],
        "principal_px": shared[2:4],
        "distortion": shared[4:12],
        "planes_per_mm": planes,
        "belt_per_mm": shared[12:],
    }
    return replace(
        first,
        covariance=0.5 * (whole + whole.T),
        **derived(parameters, first.image_size),
        **joined_findings(first, second, off, "second", "second colour"),
    )
