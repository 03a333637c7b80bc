"""The page of a calibration: one file that opens anywhere."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from roemetry.arrays import Floats, Integers
from roemetry.calibration import Calibration
from roemetry.evidence.drawing import (
    correlation_map,
    coverage_map,
    height_map,
    residual_histogram,
    residual_map,
)
from roemetry.evidence.height_uncertainty import HeightUncertainty, height_uncertainty
from roemetry.pages.templating import environment_of
from roemetry.records import Evidence, Residuals
from roemetry.stages import Triangulator

_GRID = (6, 8)
_SHOWN_PARAMETERS_MAX = 60
_STRONG = 0.95


def page(calibration: Calibration, evidence: Evidence, triangulator: Triangulator[Any], *, name: str) -> str:
    """Write the whole page as one text.

    Parameters
    ----------
    calibration
        What is told about.
    evidence
        What its calibrator can show for it.
    triangulator
        The one that understands the calibration: it says what its uncertainty does to heights.
    name
        Of the rig.
    """
    heights = height_uncertainty(calibration, triangulator)
    correlation, names = correlations(calibration)
    shown = 1 < len(names) <= _SHOWN_PARAMETERS_MAX
    return (
        environment_of("roemetry.evidence")
        .get_template("calibration.html.j2")
        .render(
            name=name,
            calibration=calibration,
            evidence=evidence,
            residuals=[
                (one, residual_map(one, calibration.image_size), residual_histogram(one), _figures(one))
                for one in evidence.residuals
                if len(one.error)
            ],
            coverage=_coverages(evidence, calibration.image_size),
            heights=[(row, height_map(heights, n)) for n, row in enumerate(heights.row_px)],
            height_words=_height_words(heights),
            correlation=correlation_map(correlation, names) if shown else None,
            strong=_strong(correlation, names),
            strong_from=_STRONG,
            version=version("roemetry"),
        )
    )


def coverage(one: Residuals, image_size: tuple[int, int]) -> Integers:
    """Count what was observed in each of the image's cells, (6, 8)."""
    rows, columns = image_size
    row = np.clip((one.xy_px[:, 1] / rows * _GRID[0]).astype(np.int64), 0, _GRID[0] - 1)
    column = np.clip((one.xy_px[:, 0] / columns * _GRID[1]).astype(np.int64), 0, _GRID[1] - 1)
    return np.bincount(row * _GRID[1] + column, minlength=_GRID[0] * _GRID[1]).reshape(_GRID)


def _coverages(evidence: Evidence, image_size: tuple[int, int]) -> list[tuple[str, float, Markup]]:
    """Give title, covered share and drawing of every set of places; sets at the same places once."""
    found: list[tuple[str, float, Markup]] = []
    known: list[Residuals] = []
    for one in evidence.residuals:
        if one.held_out or not len(one.error):
            continue
        if any(np.array_equal(one.xy_px, other.xy_px) for other in known):
            continue
        known.append(one)
        count = coverage(one, image_size)
        found.append((one.title, float((count > 0).mean()), coverage_map(count, one.title, image_size)))
    return found


def correlations(calibration: Calibration) -> tuple[Floats, list[str]]:
    """Correlation matrix of the parameters that are uncertain at all, and their names."""
    names = []
    for parameter, values in calibration.parameters.items():
        if values.size == 1:
            names.append(parameter)
        else:
            names += [f"{parameter} {'.'.join(str(n + 1) for n in at)}" for at in np.ndindex(values.shape)]
    std = np.sqrt(np.maximum(np.diag(calibration.covariance), 0.0))
    known = np.flatnonzero(std > 0)
    matrix = calibration.covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    return matrix, [names[n] for n in known]


class _Figures(NamedTuple):
    """Of one set of residuals."""

    points: int
    rms: float
    largest: float
    bias: float


def _figures(one: Residuals) -> _Figures:
    error = one.error[np.isfinite(one.error)]
    return _Figures(
        error.size,
        float(np.sqrt((error**2).mean())),
        float(np.abs(error).max()),
        float(error.mean()),
    )


def _height_words(found: HeightUncertainty) -> tuple[float, float]:
    """Median and largest standard uncertainty, mm."""
    if not np.isfinite(found.std_mm).any():
        return float("nan"), float("nan")
    return float(np.nanmedian(found.std_mm)), float(np.nanmax(found.std_mm))


def _strong(correlation: Floats, names: list[str]) -> list[tuple[str, str, float]]:
    """Pairs that can hardly be told apart, the strongest first, ten at most."""
    one, other = np.tril_indices(len(names), -1)
    strong = [
        (names[i], names[k], float(correlation[i, k]))
        for i, k in zip(one, other, strict=True)
        if abs(correlation[i, k]) > _STRONG
    ]
    return sorted(strong, key=lambda pair: -abs(pair[2]))[:10]
