"""What a calibrator can show for a calibration: figures against their limits, residuals where they arose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from roemetry.records.arrays import Checker, Floats, Integers


@dataclass(frozen=True, slots=True)
class EvidenceFigure:
    """One number that speaks for or against a calibration.

    Attributes
    ----------
    title
        For people.
    value, limit
        What was found, and what it may be at most; NaN where there is no limit.
    unit
        ``mm``, ``px``, ``1`` for a pure number, …
    basis
        What it was found from, and how.
    """

    title: str
    value: float
    unit: str
    basis: str
    limit: float = math.nan


@dataclass(frozen=True, eq=False, slots=True)
class Residuals:
    """Differences between what was observed and what the model says, each at its place in the image.

    Attributes
    ----------
    title
        For people.
    unit
        Of `error`.
    xy_px
        (n, 2) where in the (turned) image, px.
    error
        (n,) signed difference, observed less modelled.
    group
        (n,) number of the view or stripe it belongs to.
    basis
        What was observed, and what is drawn.
    held_out
        True where the model did not know these observations.
    """

    title: str
    unit: str
    xy_px: Floats
    error: Floats
    group: Integers
    basis: str
    held_out: bool = False

    def __post_init__(self) -> None:
        check = Checker(self)
        count = check.array("xy_px", np.float64, (None, 2)).shape[0]
        check.array("error", np.float64, (count,))
        check.array("group", np.int64, (count,))
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class Evidence:
    """All that a calibrator can show.

    Attributes
    ----------
    verdict
        In a few sentences: whether, and for what, the calibration may be used.
    figures, residuals
        What the verdict rests on.
    """

    verdict: tuple[str, ...] = ()
    figures: tuple[EvidenceFigure, ...] = ()
    residuals: tuple[Residuals, ...] = ()
