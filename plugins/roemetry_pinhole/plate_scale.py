"""How large a sphere plate comes out by a calibration, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.records import Peaks, SpherePlate
from roemetry_pinhole.ball_plate import Plate, find_plate, off_balls, points_of


@dataclass(frozen=True, eq=False, slots=True)
class PlateScale:
    """A sphere plate's lengths over those described.

    Attributes
    ----------
    ratio, own_std
        See `Reference` in `second_targets`.
    by_parameter
        (n,) derivative of ln ratio by the calibration's parameters.
    said
        What was seen, in words.
    """

    ratio: float
    own_std: float
    by_parameter: Floats
    said: str


def plate_scale(calibration: Calibration, images: list[Peaks], plate: SpherePlate) -> PlateScale | None:
    """Measure a sphere plate in one or more images; None where it is seen in none."""
    found = [one for peaks in images if (one := find_plate(calibration.parameters, peaks, plate)) is not None]
    if not found:
        return None
    weight = np.array([max(one.random_std(), 1e-7) ** -2 for one in found])
    share = weight / weight.sum()
    own = float(weight.sum() ** -0.5)
    # the plate is the same in all images: what its lengths are wrong by does not average out
    lengths = np.stack([_by_length(one, plate) for one in found])
    of_lengths = (share @ lengths) * plate.tolerance_mm / np.sqrt(3.0)
    ways = np.stack([_by_parameter(calibration, one, plate) for one in found])
    balls, points = sum(one.balls for one in found), sum(one.ball.size for one in found)
    rms_mm = float(np.sqrt(sum(one.rms_mm**2 * one.ball.size for one in found) / points))
    return PlateScale(
        ratio=float(np.exp(share @ np.log([one.pose[3] for one in found]))),
        own_std=float(np.sqrt(own**2 + of_lengths @ of_lengths)),
        by_parameter=np.asarray(share @ ways),
        said=f"sphere plate: {points} points on {balls} balls lie {rms_mm:.3f} mm (rms) off them",
    )


def _by_length(found: Plate, plate: SpherePlate) -> Floats:
    """(3,) derivatives of ln ratio by the described pitch, diameter and centres' height, 1/mm."""
    before = off_balls(found.at_mm, found.ball, plate, found.pose)[0]
    slopes = []
    for name in ("pitch_mm", "diameter_mm", "centre_height_mm"):
        longer = replace(plate, **{name: getattr(plate, name) + _STEP_MM})
        after = off_balls(found.at_mm, found.ball, longer, found.pose)[0]
        slopes.append(found.answer((after - before) / found.per_px) / _STEP_MM)
    return np.array(slopes)


def _by_parameter(calibration: Calibration, found: Plate, plate: SpherePlate) -> Floats:
    """(n,) derivatives of ln ratio by the calibration's parameters, by central differences."""
    std = np.sqrt(np.diag(calibration.covariance))
    slopes = np.zeros(std.size)
    for number in np.flatnonzero(std > 0):
        off = []
        for sign in (1.0, -1.0):
            step = np.zeros(std.size)
            step[number] = 0.1 * sign * std[number]
            at = points_of(_moved(calibration.parameters, step), found.stripe, found.x_px, found.row_px)
            off.append(off_balls(at, found.ball, plate, found.pose)[0])
        slopes[number] = found.answer((off[0] - off[1]) / found.per_px) / (0.2 * std[number])
    return slopes


def _moved(parameters: Mapping[str, Floats], step: Floats) -> dict[str, Floats]:
    moved, start = {}, 0
    for name, array in parameters.items():
        moved[name] = array + step[start : start + array.size].reshape(array.shape)
        start += array.size
    return moved


_STEP_MM = 1e-3
