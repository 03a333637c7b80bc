"""Parts whose value is known: bias, linearity, and the type-1 study of one part (Cg and Cgk).

Bias is the mean of the readings less the reference. Linearity is the line of the bias over the reference, by
least squares over the readings, with its slope's and its ends' intervals (AIAG MSA, 4th ed., chapter III-B).
Type 1: Cg = 0.2 T / 6 s and Cgk = (0.1 T − |bias|) / 3 s for a tolerance of width T; other houses divide by 4
s and 2 s, so the divisor is said wherever the figure stands. Intervals: χ² for Cg, that of a capability index
for Cgk (Bissell 1990).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from roemetry.errors import DataError
from roemetry.records.arrays import Floats
from roemetry_study.table import StudyTable

CAPABLE = 1.33
"""Cg and Cgk asked for."""
READINGS_MIN, READINGS_WANTED = 10, 50
"""Of a type-1 study: below ten s is known to a quarter of itself only; fifty are asked for."""
PROBABILITY = 0.95  # of all intervals that are stated here


@dataclass(frozen=True, slots=True)
class Bias:
    """Bias at one part, in the unit of the value."""

    part: str
    reference: float
    readings: int
    bias: float
    low: float
    high: float
    """bias, low, high: mean less reference and its 95 % interval by t; NaN from one reading."""

    @property
    def significant(self) -> bool:
        """Whether zero lies outside the interval."""
        return self.low > 0.0 or self.high < 0.0


@dataclass(frozen=True, slots=True)
class Linearity:
    """Bias over the range of references: bias = intercept + slope · reference."""

    slope: float
    slope_interval: tuple[float, float]
    intercept: float
    largest: float
    """Largest |bias| of the line over the references' range."""
    significant: bool
    """Whether the line leaves zero somewhere in the range, by its 95 % band."""


@dataclass(frozen=True, slots=True)
class TypeOne:
    """Repeated readings of one part against a tolerance."""

    part: str
    reference: float
    readings: int
    std: float
    bias: Bias
    cg: float
    cg_interval: tuple[float, float]
    cgk: float
    cgk_interval: tuple[float, float]
    verdict: str
    words: tuple[str, ...]


def biases(table: StudyTable) -> tuple[Bias, ...]:
    """Give the bias at each part that has a reference, by the reference's size."""
    by_part: dict[tuple[str, float], list[float]] = {}
    for part, reference, value in _known(table):
        by_part.setdefault((part, reference), []).append(value)
    found = [_bias(part, reference, np.array(values)) for (part, reference), values in by_part.items()]
    return tuple(sorted(found, key=lambda one: one.reference))


def _known(table: StudyTable) -> list[tuple[str, float, float]]:
    """Give part, reference and value of each reading of a part that has a reference."""
    references = table.references()
    return [
        (reading.part, references[reading.part], value)
        for reading, value in zip(table.readings, table.numbers().tolist(), strict=True)
        if reading.part in references
    ]


def linearity(table: StudyTable) -> Linearity | None:
    """Fit the bias over the reference; None where fewer than three parts have a reference."""
    if len(set(table.references().values())) < 3:
        return None
    from scipy.stats import linregress, t

    x, y = np.array([(reference, value) for _, reference, value in _known(table)]).T
    fit = linregress(x, y - x)
    factor = float(t.ppf(0.5 + 0.5 * PROBABILITY, x.size - 2))
    half = factor * fit.stderr
    ends = np.linspace(x.min(), x.max(), 21)
    line = fit.intercept + fit.slope * ends
    # the line's standard deviation: of its mean, and of its slope about the middle
    band = factor * fit.stderr * np.sqrt(x.var() + (ends - x.mean()) ** 2)
    return Linearity(
        float(fit.slope),
        (float(fit.slope - half), float(fit.slope + half)),
        float(fit.intercept),
        float(np.abs(line).max()),
        bool((np.abs(line) > band).any()),
    )


def type_one(table: StudyTable, tolerance: float) -> TypeOne:
    """Judge repeated readings of one known part against a tolerance's width, in the unit of the value.

    Raises
    ------
    DataError
        More than one part, no reference, too few readings, or no variation.
    """
    from scipy.stats import chi2, norm

    references = table.references()
    if len(table.parts) != 1 or not references:
        raise DataError(f"{table.source}: a type-1 study is of one part with a `reference`")
    (part,) = table.parts
    values = table.numbers()
    n = values.size
    if n < READINGS_MIN:
        raise DataError(
            f"{table.source}: {n} readings of {part}, expected {READINGS_WANTED}, at the "
            f"very least {READINGS_MIN}"
        )
    if not tolerance > 0.0:
        raise DataError("a type-1 study compares with a tolerance", hint="give its width with --tolerance")
    s = float(values.std(ddof=1))
    if s == 0.0:
        raise DataError(
            f"{table.source}: all {n} readings are {values[0]:g}: the resolution hides the scatter",
            hint="give more digits; or are the images copies of one file?",
        )
    bias = _bias(part, references[part], values)
    cg, cgk = 0.2 * tolerance / (6.0 * s), (0.1 * tolerance - abs(bias.bias)) / (3.0 * s)
    low, high = (math.sqrt(chi2.ppf(q, n - 1) / (n - 1)) for q in (0.025, 0.975))
    half = norm.ppf(0.5 + 0.5 * PROBABILITY) * math.sqrt(1.0 / (9.0 * n) + cgk**2 / (2.0 * (n - 1)))
    verdict = "capable" if min(cg, cgk) >= CAPABLE else "not capable"
    words = [f"{verdict}: Cg {cg:.2f} (0.2 T / 6 s), Cgk {cgk:.2f}; at least {CAPABLE} is required"]
    if bias.significant:
        words.append(f"bias {bias.bias:+.4g} is significant (95 %: {bias.low:+.4g} to {bias.high:+.4g})")
    if n < READINGS_WANTED:
        words.append(f"{n} of {READINGS_WANTED} recommended readings")
    intervals = (cg * low, cg * high), (cgk - half, cgk + half)
    return TypeOne(
        part, references[part], n, s, bias, cg, intervals[0], cgk, intervals[1], verdict, tuple(words)
    )


CATCHWEIGHER_LIMITS = (
    (50.0, 0.0048, 0.0),
    (100.0, 0.0, 0.24),
    (200.0, 0.0024, 0.0),
    (300.0, 0.0, 0.48),
    (500.0, 0.0016, 0.0),
    (1000.0, 0.0, 0.8),
    (10_000.0, 0.0008, 0.0),
    (15_000.0, 0.0, 8.0),
    (math.inf, 0.00053, 0.0),
)
"""Up to each load, g: largest standard deviation of the errors of class X(1), as a share of the load and in g
(OIML R 51, MID annex MI-006; from memory of the text)."""


def catchweigher_words(table: StudyTable) -> str:
    """Hold the errors of weights against the classes of catchweighers, as a yardstick; no legal verification.

    Raises
    ------
    DataError
        No part has a reference.
    """
    pairs = [(reference, value - reference) for _, reference, value in _known(table)]
    if len(pairs) < READINGS_MIN:
        raise DataError(f"{table.source}: {len(pairs)} readings with a reference, expected {READINGS_MIN}")
    load, error = np.array(pairs).T
    limits = np.array([next(max(s * m, g) for most, s, g in CATCHWEIGHER_LIMITS if m <= most) for m in load])
    times = float((error / limits).std(ddof=1))
    needed = next((k for k in _CLASSES if times <= k), None)
    found = f"no class: X({_CLASSES[-1]:g}) is the widest" if needed is None else f"class X({needed:g})"
    return (
        f"as a yardstick only, no legal verification: errors' standard deviation is {times:.2f} times the "
        f"limit of catchweigher class X(1) (OIML R 51): {found}"
    )


_CLASSES = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Of catchweighers that are told apart, by the factor on the limits of X(1)."""


def _bias(part: str, reference: float, values: Floats) -> Bias:
    mean = float(values.mean()) - reference
    if values.size < 2:
        return Bias(part, reference, 1, mean, math.nan, math.nan)
    from scipy.stats import t

    half = t.ppf(0.5 + 0.5 * PROBABILITY, values.size - 1) * values.std(ddof=1) / math.sqrt(values.size)
    return Bias(part, reference, values.size, mean, mean - float(half), mean + float(half))
