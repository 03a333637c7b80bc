"""The page of a calibration: residuals, coverage, correlations, and what its uncertainty does to heights."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from roemetry.calibrating.evidence_plots import (
    HeightUncertainty,
    correlation_map,
    coverage_map,
    height_map,
    residual_histogram,
    residual_map,
)
from roemetry.records import BELT, NOTHING, Evidence, Residuals, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Triangulator

_GRID = (6, 8)
"""Rows and columns of cells of the coverage map."""
_SHOWN_PARAMETERS_MAX = 60
"""Parameters up to which a map of their correlations can be read."""
_STRONG = 0.95
"""Correlation from which two parameters are named."""


def evidence_page(
    calibration: Calibration, evidence: Evidence, triangulator: Triangulator[Any], *, name: str
) -> str:
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
    from roemetry.html.page import environment_of  # jinja2 takes 50 ms; runs do without

    heights = height_uncertainty(calibration, triangulator)
    correlation, names = correlations(calibration)
    shown = 1 < len(names) <= _SHOWN_PARAMETERS_MAX
    return (
        environment_of("roemetry.calibrating")
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


_LEVELS = 5
"""Heights at which the uncertainty is shown."""
_ROWS = 3
"""Image rows at which it is shown."""
_REDRAWS = 200
"""A standard deviation of 200 draws is uncertain by 5 %."""
_SEED = 1
"""Fixed: the page of a calibration is always the same."""


def height_uncertainty(calibration: Calibration, triangulator: Triangulator[Any]) -> HeightUncertainty:
    """Triangulate points of known place with redrawn calibrations.

    Stripes are put where a level surface of each height would show them: by the view where that is exact,
    else by the displacement for each millimetre.
    """
    low, high = calibration.height_range_mm
    heights = np.linspace(max(low, 0.0), high, _LEVELS)
    rows = np.linspace(0.1, 0.9, _ROWS) * (calibration.image_size[0] - 1)
    rows = np.rint(rows)
    redraws = calibration.redraws(np.random.default_rng(_SEED))
    drawn = [next(redraws) for _ in range(_REDRAWS)]
    found = np.full((calibration.stripe_count, _LEVELS, _ROWS), np.nan)
    for level, height in enumerate(heights):
        stripes = _level(calibration, float(height))
        at = rows.astype(np.int64)
        z = np.stack([triangulator.triangulate(stripes, one).xyz_mm[:, at, 2] for one in drawn])
        found[:, level] = np.where(np.isnan(z).any(axis=0), np.nan, z.std(axis=0, ddof=1))
    return HeightUncertainty(heights, rows, found)


def _level(calibration: Calibration, height_mm: float) -> StripeMap:
    """Draw all stripes on a level surface."""
    rows, columns = calibration.image_size
    row = np.arange(rows, dtype=np.float64)
    rest = calibration.rest_line_px(row)
    view = calibration.view
    if view is not None and view.exact:
        x_px = level_line_px(calibration, row, height_mm)
    else:
        x_px = rest + calibration.displacement_px_per_mm[:, None] * height_mm
    x_px = np.where((x_px >= 0) & (x_px <= columns - 1), x_px, np.nan)
    there = np.isfinite(x_px)
    return StripeMap(
        x_px=x_px,
        x_std_px=np.where(there, 0.0, np.nan),
        product=np.where(there, BELT, NOTHING),
        seen=there,
        margin=np.full(x_px.shape, np.nan),
        ambiguous=np.zeros(x_px.shape, np.bool_),
        rest_px=rest,
        peak_stripe=np.empty(0, np.int16),
    )


def level_line_px(calibration: Calibration, row: Floats, height_mm: float) -> Floats:
    """(stripe, row) x where each stripe's plane is at a height in each image row, px: by regula falsi."""
    view = calibration.view
    if view is None:
        raise AssertionError("an exact view was promised")
    count, columns = calibration.stripe_count, calibration.image_size[1]
    stripe = np.broadcast_to(np.arange(count)[:, None], (count, row.size))

    def above(x_px: Floats) -> Floats:
        xy = np.stack([x_px, np.broadcast_to(row, x_px.shape)], axis=-1)
        return view.lift(xy, stripe)[..., 2] - height_mm

    start = calibration.rest_line_px(row)
    step = calibration.displacement_px_per_mm[:, None] * max(height_mm, 1.0)
    x0, x1 = start, np.clip(start + step, -columns, 2.0 * columns)
    z0, z1 = above(x0), above(x1)
    for _ in range(20):
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(np.abs(z1 - z0) > 0, x1 - z1 * (x1 - x0) / (z1 - z0), x1)
        x0, z0, x1 = x1, z1, ahead
        z1 = above(x1)
    return np.where(np.abs(z1) < 1e-6, x1, np.nan)
