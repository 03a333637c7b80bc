"""Solids that give the planes of light, against each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from roemetry.calibration import Calibration
from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet
from roemetry_pinhole.from_solids import solids_in
from roemetry_pinhole.second_targets import CONFLICT_STDS, check_scale, references


def check_beside_solids(
    calibration: Calibration, observed: CalibrationSet, made: Callable[[CalibrationSet], Calibration]
) -> dict[str, Any]:
    """Give residuals and notes of a calibration from solids with what its other targets say."""
    residuals, notes = check_solids(observed, made)
    found = replace(
        calibration,
        residuals={**calibration.residuals, **residuals},
        notes=(*calibration.notes, *notes),
    )
    # no board's print is what this scale comes from
    kinds = [shows for shows, _ in solids_in(observed)] or ["sphere_plate"]
    return check_scale(found, replace(_without(observed, kinds), ruler=None))


def check_solids(
    observed: CalibrationSet, made: Callable[[CalibrationSet], Calibration]
) -> tuple[dict[str, float], list[str]]:
    """Leave out each kind of solid in turn, and measure it with what the others give.

    Parameters
    ----------
    observed
        The images of solids.
    made
        Gives the calibration from a set; raises CalibrationError where it gives none.

    Returns
    -------
    tuple
        Residuals and notes; of solids that the others could not do without, a note.

    Raises
    ------
    CalibrationError
        One contradicts the others: the ratio and its uncertainty are told.
    """
    residuals: dict[str, float] = {}
    notes: list[str] = []
    kinds = list(dict.fromkeys(shows for shows, _ in solids_in(observed)))
    for left in kinds if len(kinds) > 1 else ():
        others = ", ".join(kind for kind in kinds if kind != left)
        try:
            calibration = made(_without(observed, [left]))
        except CalibrationError as error:
            notes.append(f"{left}: not checked: without it there is no calibration: {error.message}")
            continue
        alone = replace(_without(observed, [kind for kind in kinds if kind != left]), mm_per_count=None)
        found, said = references(calibration, alone)
        notes += said
        for one in found:
            if one.name != left:
                continue
            std = one.std(calibration.covariance)
            if abs(one.ratio - 1.0) > CONFLICT_STDS * std:
                raise CalibrationError(
                    f"{others} and {left} contradict each other: by the {others} {one.what} is "
                    f"{one.ratio:.4f} ± {std:.4f} times what is described",
                    hint="measure both with a calliper, or leave one out",
                )
            residuals |= {one.key: one.ratio, f"{one.key}_std": std}
            notes.append(
                f"{one.what} comes out {one.ratio:.4f} ± {std:.4f} times as described by the {others} alone"
            )
    return residuals, notes


def _without(observed: CalibrationSet, kinds: list[str]) -> CalibrationSet:
    gone: dict[str, Any] = dict.fromkeys(kinds)
    kept = tuple(one for one in observed.observations if one.shows not in kinds)
    return replace(observed, observations=kept, **gone)
