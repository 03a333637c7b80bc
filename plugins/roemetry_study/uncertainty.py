"""Uncertainty of a measurement model by JCGM 100 and JCGM 101, a run's budget, comparisons.

JCGM 100 (the GUM): u² = Σ (∂f/∂x_k)² u_k², derivatives by central differences of one standard uncertainty,
effective degrees of freedom by Welch and Satterthwaite. JCGM 101: draws of every input, the shortest interval
of the results, and the test whether the first is good enough (clause 8.1: the ends of both intervals agree
within the numerical tolerance of two significant digits of u).

Comparison with reference values: Eₙ = (x − X) / √(U_x² + U_X²) with expanded uncertainties (ISO/IEC 17043),
and ζ = (x − X) / √(u_x² + u_X²) (ISO 13528): |Eₙ| ≤ 1, |ζ| ≤ 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from roemetry.errors import DataError
from roemetry.records import Measurement
from roemetry.records.arrays import Floats
from roemetry_study.table import estimate_of

COVERAGE = 0.95
DRAWS = 1_000_000
"""So many that an end of a 95 % interval repeats to about a thousandth of u (JCGM 101, clause 7.2)."""


@dataclass(frozen=True, slots=True)
class Input:
    """An input quantity of a measurement model.

    ``normal`` takes `value` and `std`; ``rectangular``, ``triangular`` and ``arcsine`` the half width `half`;
    ``t`` takes `std` and `freedom` (a mean of freedom + 1 readings).
    """

    value: float
    std: float = math.nan
    shape: Literal["normal", "rectangular", "triangular", "arcsine", "t"] = "normal"
    half: float = math.nan
    freedom: float = math.inf

    @property
    def standard(self) -> float:
        """Standard uncertainty of JCGM 100."""
        divisor = {"rectangular": math.sqrt(3.0), "triangular": math.sqrt(6.0), "arcsine": math.sqrt(2.0)}
        return self.half / divisor[self.shape] if self.shape in divisor else self.std

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw as JCGM 101, clause 6.4, assigns."""
        match self.shape:
            case "normal":
                off = self.std * rng.standard_normal(count)
            case "t":
                off = self.std * rng.standard_t(self.freedom, count)
            case "rectangular":
                off = rng.uniform(-self.half, self.half, count)
            case "triangular":
                off = 0.5 * rng.uniform(-self.half, self.half, (2, count)).sum(axis=0)
            case "arcsine":
                off = self.half * np.sin(2.0 * math.pi * rng.uniform(size=count))
        return np.asarray(self.value + off)


class Result(NamedTuple):
    """A value with its standard uncertainty and 95 % interval."""

    value: float
    std: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """A measurement model evaluated both ways."""

    gum: Result
    freedom: float
    """Effective degrees of freedom."""
    parts: Mapping[str, float]
    """What each input adds to the standard uncertainty of `gum`, |∂f/∂x| u."""
    monte_carlo: Result
    """Interval: the shortest."""
    validated: bool
    """Whether JCGM 100 is good enough here by clause 8.1 of JCGM 101."""


def evaluate(
    model: Callable[..., Floats], inputs: Mapping[str, Input], seed: int, draws: int = DRAWS
) -> Evaluation:
    """Evaluate a measurement model of independent inputs, by so many draws of a Monte Carlo method as well.

    The model takes keyword arguments by the inputs' names, each (draw,), and gives (draw,).
    """
    from scipy.stats import t

    def at(moved: str = "", stds: float = 0.0) -> float:
        """The model's value, one input moved by so many standard uncertainties."""
        values = {k: v.value + (stds * v.standard if k == moved else 0.0) for k, v in inputs.items()}
        return float(model(**{name: np.array([value]) for name, value in values.items()})[0])

    value = at()
    parts = {name: 0.5 * abs(at(name, 1.0) - at(name, -1.0)) for name in inputs}
    std = math.sqrt(sum(part**2 for part in parts.values()))
    below = sum(part**4 / inputs[name].freedom for name, part in parts.items())
    freedom = std**4 / below if below > 0.0 else math.inf
    k = float(t.ppf(0.5 + 0.5 * COVERAGE, min(freedom, 1e9)))
    rng = np.random.default_rng(seed)
    drawn = np.asarray(model(**{name: one.draw(rng, draws) for name, one in inputs.items()}))
    low, high = shortest_interval(drawn)
    gum = Result(value, std, value - k * std, value + k * std)
    found = Result(float(drawn.mean()), float(drawn.std(ddof=1)), low, high)
    tolerance = 0.5 * 10.0 ** (math.floor(math.log10(found.std)) - 1)
    validated = abs(gum.low - low) <= tolerance and abs(gum.high - high) <= tolerance
    return Evaluation(gum, freedom, parts, found, validated)


def shortest_interval(drawn: Floats) -> tuple[float, float]:
    """Give the shortest interval with `COVERAGE` of the draws (JCGM 101, clause 7.7)."""
    ordered = np.sort(drawn)
    within = round(COVERAGE * ordered.size)
    first = int((ordered[within:] - ordered[: ordered.size - within]).argmin())
    return float(ordered[first]), float(ordered[first + within])


class Cause(NamedTuple):
    """One cause of a run's uncertainty, over its products."""

    name: str
    std: float
    """Root mean square over the products, in the unit of the value."""
    percent: float
    """Of the variance."""
    to_halve_percent: float
    """To what share of itself it would have to shrink, together with all larger causes, so that the whole is
    halved, per cent; NaN: not even without them."""


def causes(rows: Sequence[Measurement], value: str) -> tuple[float, tuple[Cause, ...]]:
    """Give the standard uncertainty of a run's value, root mean square, and its causes, the largest first.

    Raises
    ------
    DataError
        No row states an uncertainty with its parts.
    """
    budgets = [
        (estimate.std * scale, {name: part * scale for name, part in estimate.budget.items()})
        for row in rows
        for estimate, scale in [estimate_of(row, value)]
        if estimate is not None and estimate.budget and math.isfinite(estimate.std)
    ]
    if not budgets:
        raise DataError(f"no row states the parts of `{value}`'s uncertainty", hint=_RUN_HINT)
    whole = float(np.mean([std**2 for std, _ in budgets]))
    variances = {
        name: float(np.mean([np.nan_to_num(parts.get(name, 0.0)) ** 2 for _, parts in budgets]))
        for name in dict.fromkeys(name for _, parts in budgets for name in parts)
    }
    found, larger = [], 0.0
    for name, variance in sorted(variances.items(), key=lambda item: -item[1]):
        larger += variance
        rest = 0.25 * whole - (whole - larger)  # what the larger ones and this may add up to
        remains = 100.0 * math.sqrt(rest / larger) if rest > 0.0 and larger > 0.0 else math.nan
        found.append(Cause(name, math.sqrt(variance), 100.0 * variance / whole, remains))
    return math.sqrt(whole), tuple(found)


_RUN_HINT = "run with `uncertainty: linear` in the recipe"


class Comparison(NamedTuple):
    """One product beside its reference value."""

    id: str
    value: float
    std: float
    reference: float
    reference_std: float
    en: float
    zeta: float


def compare(
    rows: Sequence[Measurement], value: str, references: Mapping[str, tuple[float, float]]
) -> tuple[Comparison, ...]:
    """Compare a run with reference values of one's own: a scale's, water displacement's.

    `references` are by id, with their standard uncertainties, in the unit of `value`.

    Raises
    ------
    DataError
        No product is in both, or the run states no uncertainty.
    """
    found = []
    for row in rows:
        estimate, scale = estimate_of(row, value)
        if row.id not in references or estimate is None or not math.isfinite(estimate.value):
            continue
        if not math.isfinite(estimate.std):
            raise DataError(
                f"{row.id}: its `{value}` states no uncertainty: a comparison would judge nothing",
                hint=_RUN_HINT,
            )
        reference, reference_std = references[row.id]
        own, std = scale * estimate.value, scale * estimate.std
        low, high = estimate.interval
        expanded = 0.5 * scale * (high - low) if math.isfinite(high - low) else 2.0 * std
        en = (own - reference) / math.hypot(expanded, 2.0 * reference_std)
        zeta = (own - reference) / math.hypot(std, reference_std)
        found.append(Comparison(row.id, own, std, reference, reference_std, en, zeta))
    if not found:
        raise DataError(
            "no product has both a value and a reference", hint="do the ids of run and table agree?"
        )
    return tuple(found)


def more_outside_than_chance(found: Sequence[Comparison]) -> bool:
    """Say whether more products have |Eₙ| > 1 than the coverage probability explains, at 1 %."""
    from scipy.stats import binom

    outside = sum(abs(one.en) > 1.0 for one in found)
    return outside > 0 and float(binom.sf(outside - 1, len(found), 1.0 - COVERAGE)) < 0.01


def comparison_words(found: Sequence[Comparison]) -> tuple[str, ...]:
    """Say whether the stated uncertainties are confirmed: the share within, and the spread of the scores."""
    from scipy.stats import chi2

    n = len(found)
    within = sum(abs(one.en) <= 1.0 for one in found)
    squares = float(np.square([one.zeta for one in found]).sum())
    if more_outside_than_chance(found):
        judged = "more lie outside than chance explains: the stated uncertainty is not confirmed"
    elif n >= 10 and float(chi2.sf(squares, n)) > 0.99:
        judged = "errors are surely smaller than stated: the stated uncertainty is wider than need be"
    else:
        judged = "the stated uncertainty is confirmed as far as so many can"
    ratio = math.sqrt(squares / n)
    return (
        f"{within} of {n} within |Eₙ| ≤ 1; errors are {ratio:.2f} times what is stated, root mean square",
        judged,
    )
