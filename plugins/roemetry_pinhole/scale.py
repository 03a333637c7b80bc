"""What the lengths that the scale comes from are uncertain by does to the parameters."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from roemetry.arrays import Floats
from roemetry.records import Board
from roemetry_pinhole.frames import parameters_of
from roemetry_pinhole.joining import Joint


def of_lengths(joined: Joint, parameters: Mapping[str, Floats]) -> Floats:
    """Give the covariance that the targets' own tolerances add to that of the adjustment."""
    if joined.solids is None:
        if joined.board is None:
            size = flat(parameters).size
            return np.zeros((size, size))
        return grown(parameters, relative_of(joined.board) ** 2)
    mean = flat(parameters)
    found = np.zeros((mean.size, mean.size))
    for geometry in joined.solids.by_tolerance:
        way = flat(parameters_of(geometry, travel=False)) - mean
        found += np.outer(way, way)
    return found


def grown(parameters: Mapping[str, Floats], variance: float) -> Floats:
    """Give the covariance if all lengths grow together, by a share of the given variance."""
    way = by_scale(parameters)
    return np.asarray(variance * np.outer(way, way))


def by_scale(parameters: Mapping[str, Floats]) -> Floats:
    """Give (n,) derivatives of the parameters by the logarithm of all lengths."""
    found = {name: np.zeros_like(array) for name, array in parameters.items()}
    for name in ("planes_per_mm", "belt_per_mm"):
        found[name] = -parameters[name]
    if "travel_mm_per_count" in parameters:
        found["travel_mm_per_count"] = parameters["travel_mm_per_count"]
    return flat(found)


def relative_of(board: Board) -> float:
    """Give the relative standard uncertainty of a board's lengths."""
    longer = max(board.columns, board.rows) * board.pitch_mm
    return float(board.tolerance_mm / np.sqrt(3.0) / longer)


def flat(parameters: Mapping[str, Floats]) -> Floats:
    """Give all parameters in the order of the covariance."""
    return np.concatenate([np.ravel(array) for array in parameters.values()])
