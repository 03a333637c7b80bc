"""Variance components of a gauge study, with their intervals: analysis of variance, and average and range.

Model, crossed: y = μ + part_i + operator_j + interaction_ij + error_ijk, all effects random, normal,
independent. Nested (a part that only one operator can measure, such as one that is destroyed): y = μ +
operator_j + part_i(j) + error_ijk.

Sums of squares are quadratic forms y'Qy with Q the difference of two projections, of the model with an effect
and of the one without it (Henderson 1953, method 3): error, interaction after parts and operators, parts
after operators, operators after parts. In a balanced study these are those of every textbook; with gaps they
still have the expectation Σ σ²_k tr(Q Z_k Z_k'), which is solved for the components. An interaction that is
not significant is pooled with the error (AIAG MSA, 4th ed.); its interval and that of repeatability are
always those of the whole model, for an interaction that was not found may be there. A negative component is
set to zero.

Intervals are generalised confidence intervals (Tsui and Weerahandi 1989; Hamada and Weerahandi 2000 for gauge
studies): each sum of squares over a draw of its χ² is a draw of its expectation, the same equations give the
components, and the quantiles of these are the ends. They hold for ratios and sums of components alike. With
gaps the sums of squares for parts and operators are only nearly independent and nearly χ²: for a tenth of the
cells missing the intervals keep their level (see the page of the study); for many more they are approximate.

Average and range (AIAG MSA, 4th ed., table III-B 6): repeatability from the mean range over d₂, operators and
parts from the range of their means over d₂*(m, 1); balanced studies only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from roemetry.errors import DataError
from roemetry.records.arrays import Floats, Integers
from roemetry_study.table import StudyTable

POOLING_LEVEL = 0.05
"""An interaction whose F test has a larger p is pooled with the error: the level of the AIAG manual's worked
study. At 0.25 its published result is the same."""

DRAWS = 20_000
"""Of each χ²: ends of a 95 % interval then repeat within 1 % of its width."""

_ROUNDING = 1e-13  # share of the squares that is rounding alone: double precision, over a hundred readings

_SEED = 20_000_101  # the same study gives the same intervals each time


@dataclass(frozen=True, slots=True)
class Effect:
    """One line of the table of the analysis of variance."""

    name: str
    squares: float
    freedom: int
    f: float = math.nan
    p: float = math.nan

    @property
    def mean_square(self) -> float:
        """Sum of squares over its degrees of freedom."""
        return self.squares / self.freedom if self.freedom else math.nan


@dataclass(frozen=True, slots=True)
class Components:
    """Standard deviations of a gauge study, in the unit of the value, with draws of their uncertainty."""

    method: str
    std: dict[str, float]
    """``repeatability``, ``operator``, ``interaction``, ``reproducibility``, ``gauge``, ``part``,
    ``total``.
    """
    draws: dict[str, Floats]
    """The same, (draw,) each; empty where the method has no intervals."""
    effects: tuple[Effect, ...] = ()
    pooled: bool = False

    def interval(self, figure: Callable[[dict[str, Floats]], Floats]) -> tuple[float, float]:
        """Give the 95 % interval of a figure made of the components; NaN where the method has none."""
        if not self.draws:
            return math.nan, math.nan
        low, high = np.nanquantile(figure(self.draws), [0.025, 0.975])
        return float(low), float(high)


def analyse(table: StudyTable, *, nested: bool = False) -> Components:
    """Find the components by analysis of variance.

    The table may have gaps, but needs two parts and some cell with two trials. `nested`: each operator had
    parts of their own.

    Raises
    ------
    DataError
        Too few parts or no repetition, no variation at all, or effects that the gaps make inseparable.
    """
    values, part, operator = _checked(table, nested)
    values = values - values.mean()  # squares of what is far from zero would lose their digits
    cell = _codes([f"{p}\0{o}" for p, o in zip(part, operator, strict=True)])
    of_part, of_operator = _codes(cell.tolist() if nested else part), _codes(operator)
    one = np.zeros(values.size, np.int64)
    # each effect: the model that has it, None being all, and the model without it
    models: dict[str, tuple[tuple[Integers, ...] | None, tuple[Integers, ...]]]
    if nested:
        models = {"operator": ((of_operator,), (one,)), "part": ((cell,), (of_operator,))}
        if of_operator.max() == 0:
            models.pop("operator")
    elif of_operator.max() > 0:
        both = of_part, of_operator
        models = {
            "part": (both, (of_operator,)),
            "operator": (both, (of_part,)),
            "interaction": ((cell,), both),
        }
    else:
        models = {"part": ((of_part,), (one,))}
    models["repeatability"] = None, (cell,)
    forms = {
        name: _projection(full, values.size) - _projection(less) for name, (full, less) in models.items()
    }
    effects = {
        name: Effect(name, float(values @ q @ values), round(float(np.trace(q)))) for name, q in forms.items()
    }
    for name in ("part", "operator", "repeatability"):
        if name in effects and effects[name].freedom < 1:
            raise DataError(
                f"{table.source}: {name} cannot be told from the other effects: too many gaps",
                hint="measure some parts with every operator, and some twice",
            )
    error, inner = effects["repeatability"], effects.get("interaction")
    if error.squares <= _ROUNDING * sum(effect.squares for effect in effects.values()):
        raise DataError(
            f"{table.source}: every repetition gives the same value: repeatability is below the resolution",
            hint="give more digits; or are the repeated images copies of one file?",
        )
    pooled = inner is not None and not (inner.freedom and _f_test(inner, error)[1] <= POOLING_LEVEL)
    rest = error
    if inner is not None and pooled:
        rest = Effect("repeatability", error.squares + inner.squares, error.freedom + inner.freedom)
    # what each effect's F test divides by
    against = {"part": inner if inner is not None and not pooled else rest, "interaction": error}
    against["operator"] = effects["part"] if nested else against["part"]
    shown = tuple(
        Effect(name, effect.squares, effect.freedom, *_f_test(effect, against[name]))
        if name in against
        else effect
        for name, effect in effects.items()
    )
    groups = {"part": of_part, "operator": of_operator, "interaction": cell, "repeatability": None}
    draws = _drawn(forms, groups, effects)
    if pooled:
        forms["repeatability"] = forms["repeatability"] + forms.pop("interaction")
        effects["repeatability"] = rest
    squares = np.array([effects[name].squares for name in forms])
    variance = np.maximum(np.linalg.solve(_expectations(forms, groups), squares), 0.0)
    std = {name: float(found) for name, found in _sums(dict(zip(forms, variance, strict=True))).items()}
    return Components("analysis of variance", std, _sums(draws), shown, pooled)


def average_range(table: StudyTable) -> Components:
    """Find the components by average and range; DataError where the study is not balanced and crossed."""
    values, part, operator = _checked(table, False)
    of_part, of_operator = _codes(part), _codes(operator)
    parts, operators = int(of_part.max()) + 1, int(of_operator.max()) + 1
    counts = np.zeros((operators, parts), np.int64)
    np.add.at(counts, (of_operator, of_part), 1)
    trials = int(counts.max())
    if (counts != trials).any():
        raise DataError(
            f"{table.source}: average and range need every part measured equally often by every operator",
            hint="the analysis of variance allows gaps: leave --method out",
        )
    grid = values[np.lexsort((of_part, of_operator))].reshape(operators, parts, trials)

    def by_range(means: Floats) -> float:
        """Standard deviation by one range over d₂*(size, 1), its root mean square (Duncan 1955)."""
        # rounded to four digits, like K₁, K₂ and K₃ of the manual, a study comes out as it does elsewhere
        return float(np.ptp(means)) * round(1.0 / math.hypot(*range_constants(means.size)), 4)

    repeatability = float(np.ptp(grid, axis=2).mean()) * round(1.0 / range_constants(trials)[0], 4)
    of_means = by_range(grid.mean(axis=(1, 2))) if operators > 1 else 0.0
    variance = {
        "repeatability": repeatability**2,
        "operator": max(of_means**2 - repeatability**2 / (parts * trials), 0.0),
        "part": by_range(grid.mean(axis=(0, 2))) ** 2,
    }
    sums = _sums({name: np.array(value) for name, value in variance.items()})
    return Components("average and range", {name: float(value) for name, value in sums.items()}, {})


@cache
def range_constants(size: int) -> tuple[float, float]:
    """Give d₂ and d₃: mean and standard deviation of the range of so many standard normal values.

    By integration (Tippett 1925): no table.
    """
    from scipy.integrate import dblquad, quad
    from scipy.stats import norm

    mean = quad(lambda x: 1.0 - norm.cdf(x) ** size - norm.sf(x) ** size, -8.0, 8.0)[0]

    def both(low: float, high: float) -> float:
        inner = norm.cdf(high) - norm.cdf(low)
        return float(1.0 - norm.cdf(high) ** size - norm.sf(low) ** size + inner**size)

    second = 2.0 * dblquad(both, -8.0, 8.0, lambda high: -8.0, lambda high: high, epsabs=1e-7)[0]
    return float(mean), float(math.sqrt(second - mean**2))


def _checked(table: StudyTable, nested: bool) -> tuple[Floats, list[str], list[str]]:
    """Give values, part and operator of each reading; refuse what no variance can be found of."""
    values = table.numbers()
    part = [reading.part for reading in table.readings]
    operator = [reading.operator for reading in table.readings]
    if len(table.parts) < 2:
        raise DataError(
            f"{table.source}: one part: how much parts differ is not known, so no gauge can be judged by it",
            hint="measure at least five parts, better ten, over the range of the process; repeated "
            "readings of one known part make a type-1 study: give it a `reference`",
        )
    cells = {(p, o) for p, o in zip(part, operator, strict=True)}
    if len(cells) == values.size:
        raise DataError(
            f"{table.source}: no part was measured twice by the same operator: repeatability is not known",
            hint="at least two trials are needed, from fresh images each",
        )
    if nested and len({p for p, _ in cells}) < len(cells):
        raise DataError(
            f"{table.source}: a part was measured by two operators: the study is crossed, not nested"
        )
    if not np.ptp(values) > 0.0:
        raise DataError(
            f"{table.source}: every value is {values[0]:g}: there is no variation to share out",
            hint="is the value rounded more coarsely than it varies, or one image copied?",
        )
    return values, part, operator


def _f_test(effect: Effect, against: Effect) -> tuple[float, float]:
    from scipy.stats import f

    if not (effect.freedom and against.freedom and against.squares > 0.0):
        return math.nan, math.nan
    ratio = effect.mean_square / against.mean_square
    return ratio, float(f.sf(ratio, effect.freedom, against.freedom))


def _drawn(
    forms: dict[str, Floats], groups: dict[str, Integers | None], effects: dict[str, Effect]
) -> dict[str, Floats]:
    """Draw the components, never pooled: which model is right is uncertain, too."""
    known = {name: form for name, form in forms.items() if effects[name].freedom}
    rng = np.random.default_rng(_SEED)
    squares = np.array([[effects[name].squares] for name in known])
    freedom = np.array([[effects[name].freedom] for name in known])
    # E[SS] = ν·E[MS], and SS/χ² is a draw of E[MS]
    mean_square = squares / rng.chisquare(freedom, (len(known), DRAWS))
    solved = np.linalg.solve(_expectations(known, groups) / freedom, mean_square)
    return dict(zip(known, np.maximum(solved, 0.0), strict=True))


def _expectations(forms: dict[str, Floats], groups: dict[str, Integers | None]) -> Floats:
    """Give (form, component): what each component of variance 1 adds to each sum of squares."""

    def expected(form: Floats, group: Integers | None) -> float:
        found = float(np.trace(form) if group is None else form[group[:, None] == group].sum())
        return 0.0 if abs(found) < 1e-9 else found

    return np.array([[expected(form, groups[name]) for name in forms] for form in forms.values()])


def _projection(groups: Sequence[Integers] | None, size: int = 0) -> Floats:
    """Project on the space of the groups' means; None: all of (size,)."""
    return np.eye(size) if groups is None else _projection_of(*(group.tobytes() for group in groups))


@lru_cache(maxsize=8)
def _projection_of(*groups: bytes) -> Floats:
    """Project on the space of the groups' means; a plan analyses one design sixty times."""
    codes = [np.frombuffer(group, np.int64) for group in groups]
    z = np.concatenate([np.eye(int(group.max()) + 1)[group] for group in codes], axis=1)
    left, values, _ = np.linalg.svd(z, full_matrices=False)
    left = left[:, values > 1e-9 * values[0]]
    projection = np.asarray(left @ left.T)
    projection.flags.writeable = False
    return projection


def _codes(names: Sequence[str]) -> Integers:
    return np.unique(np.asarray(names), return_inverse=True)[1].astype(np.int64)


def _sums(variance: dict[str, Floats]) -> dict[str, Floats]:
    """Make standard deviations of variances, with their sums."""
    error = variance["repeatability"]
    zero = np.zeros_like(error)
    operator, inner = variance.get("operator", zero), variance.get("interaction", zero)
    gauge = error + operator + inner
    found = {
        "repeatability": error,
        "operator": operator,
        "interaction": inner,
        "reproducibility": operator + inner,
        "gauge": gauge,
        "part": variance["part"],
        "total": gauge + variance["part"],
    }
    return {name: np.sqrt(value) for name, value in found.items()}
