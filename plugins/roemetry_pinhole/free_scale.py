"""The scale looked for: lengths come from block, staircase or encoder, and the board's pitch with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet
from roemetry_pinhole.joining import Joint
from roemetry_pinhole.scale import by_scale
from roemetry_pinhole.second_targets import CONFLICT_STDS, Reference, references

_ROUNDS_MAX = 8
_STILL = 1e-6


def scaled_by_references(
    joined: Joint, observed: CalibrationSet, made: Callable[[Joint], Calibration]
) -> Calibration:
    """Make the calibration in which the references have the lengths that are described.

    Parameters
    ----------
    joined
        The adjustment with the board's pitch as described.
    observed
        The images of the references.
    made
        Gives the calibration of an adjustment, its covariance without that of any length.

    Raises
    ------
    CalibrationError
        There is no reference, or two contradict each other.
    """
    if joined.board is None or joined.solids is not None:
        raise CalibrationError(
            "the scale is to be looked for, but it comes from the solids' own lengths",
            hint="leave `scale: free` out, or show the board under the laser",
        )
    described_mm = joined.board.pitch_mm
    for _ in range(_ROUNDS_MAX):
        calibration = made(joined)
        found, missed = references(calibration, observed)
        if not found:
            raise CalibrationError(
                "the scale is to be looked for, and nothing beside the board tells it"
                + "".join(f"\n  {note}" for note in missed),
                hint="add images of a block or a staircase, or encoder_counts with encoder_mm_per_count; if "
                "you measured the board with a ruler, correct pitch_mm and tolerance_mm and leave "
                "`scale: free` out",
            )
        share = _shares(found, calibration.covariance)
        off = float(share @ np.log([one.ratio for one in found]))
        if abs(off) < _STILL:
            break
        joined = rescaled(joined, float(np.exp(-off)))
    _check_agreement(found, calibration.covariance)
    covariance, std = _covariance(found, share, calibration)
    names = ", ".join(one.name for one in found)
    pitch_mm = float(calibration.target["pitch_mm"])
    note = (
        f"scale: looked for, from {names}; the board's pitch comes out as {pitch_mm:.5g} mm, "
        f"{pitch_mm / described_mm:.4f} ± {std:.4f} times what is described"
    )
    residuals = {"pitch_ratio": pitch_mm / described_mm, "pitch_ratio_std": std}
    for one in found if len(found) > 1 else ():
        residuals |= {one.key: one.ratio, f"{one.key}_std": one.std(calibration.covariance)}
    return replace(
        calibration,
        covariance=covariance,
        residuals={**calibration.residuals, **residuals},
        notes=(*calibration.notes, note, *missed),
    )


def rescaled(joined: Joint, factor: float) -> Joint:
    """Adjust again with a board that is larger by a factor; what stands under it keeps its thickness."""
    board, measured = joined.board, joined.measured
    if board is None:
        raise AssertionError("there is a board")
    found = joined.adjusted.geometry
    bend = found.bend
    if bend is not None:
        bend = replace(
            bend,
            middle_mm=factor * bend.middle_mm,
            reach_mm=factor * bend.reach_mm,
            coefficients_mm=factor * bend.coefficients_mm,
        )
    start = replace(
        found,
        shift=factor * found.shift,
        planes=found.planes / factor,
        belt=found.belt / factor,
        travel=factor * found.travel,
        bend=bend,
    )
    measured = replace(
        measured,
        start=start,
        corners=replace(measured.corners, board_mm=factor * measured.corners.board_mm),
        feet=replace(measured.feet, board_mm=measured.feet.board_mm * [factor, factor, 1.0]),
    )
    marker_mm = None if board.marker_mm is None else factor * board.marker_mm
    return replace(
        joined,
        board=replace(board, pitch_mm=factor * board.pitch_mm, marker_mm=marker_mm),
        measured=measured,
        adjusted=measured.adjusted(),
    )


def _shares(found: list[Reference], covariance: Floats) -> Floats:
    weight = np.array([max(one.std(covariance), 1e-9) ** -2 for one in found])
    return np.asarray(weight / weight.sum())


def _check_agreement(found: list[Reference], covariance: Floats) -> None:
    for number, one in enumerate(found):
        for other in found[number + 1 :]:
            apart = one.by_parameter - other.by_parameter
            std = float(np.sqrt(one.own_std**2 + other.own_std**2 + apart @ covariance @ apart))
            ratio = one.ratio / other.ratio
            if abs(np.log(ratio)) > CONFLICT_STDS * std:
                raise CalibrationError(
                    f"{one.name} and {other.name} contradict each other: by the {other.name} {one.what} is "
                    f"{ratio:.4f} ± {std:.4f} times what is described",
                    hint="measure both with a calliper, or leave one out",
                )


def _covariance(found: list[Reference], share: Floats, calibration: Calibration) -> tuple[Floats, float]:
    """Covariance when the references' lengths are kept, and the scale's relative standard uncertainty.

    All lengths follow −ln ratio, which depends on the parameters and on the references' own errors.
    """
    way = by_scale(calibration.parameters)
    slope = share @ np.array([one.by_parameter for one in found])
    own = float((share**2) @ np.array([one.own_std**2 for one in found]))
    kept = np.eye(way.size) - np.outer(way, slope)
    covariance = calibration.covariance
    std = float(np.sqrt(own + slope @ covariance @ slope))
    return np.asarray(kept @ covariance @ kept.T + own * np.outer(way, way)), std
