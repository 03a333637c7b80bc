"""Agreement of classes: with oneself, with each other, and with what is true.

Kappa is agreement beyond chance: Cohen's for a pair, Fleiss' over all (Fleiss 1971; AIAG MSA, 4th ed.,
chapter III-C). Readings of one part hang together, so every interval is by parts: Wilson's, for as many
independent readings as the scatter between parts is worth (Kish's design effect; for kappa, the scatter by
leaving out one part at a time).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from roemetry.errors import DataError
from roemetry.records.arrays import Floats
from roemetry_study.table import Reading, StudyTable

PARTS_MIN = 10
"""Below ten parts a share of them is known to a third of the whole: nothing is told."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A share or a kappa, with its 95 % interval; NaN where it is not defined."""

    value: float
    low: float
    high: float
    of: int
    """How many readings, or pairs of readings, it rests on."""


@dataclass(frozen=True, slots=True)
class Operator:
    """One operator, head, or classifier."""

    name: str
    repeats: Figure
    """Share of parts that were always given one class by this operator; NaN with one trial."""
    right: Figure
    """Share of readings with the reference's class; NaN without a reference."""
    kappa: Figure
    """Kappa against the reference."""
    missed: Figure
    """Share of readings of bad parts that were called good."""
    false_alarm: Figure
    """Share of readings of good parts that were not called good."""
    bias: float
    """Readings called good over parts that are good, less 1: above 0 it passes too many."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """What a study of classes found."""

    parts: int
    readings: int
    operators: tuple[Operator, ...]
    between: Figure
    """Fleiss' kappa over all readings."""
    pairs: tuple[tuple[str, str, Figure], ...]
    """Cohen's kappa of each pair of operators."""
    words: tuple[str, ...]


def agreement(table: StudyTable, good: str) -> Agreement:
    """Compare classes, with or without references; misses and false alarms are counted by the class `good`.

    Raises
    ------
    DataError
        Fewer than ten parts, or one class throughout.
    """
    classes = tuple(sorted({r.value for r in table.readings} | {r.reference for r in table.readings} - {""}))
    if len(table.parts) < PARTS_MIN:
        raise DataError(f"{table.source}: {len(table.parts)} parts, expected {PARTS_MIN} at least, better 50")
    if len(classes) < 2:
        raise DataError(
            f"{table.source}: every reading is `{classes[0]}`: agreement beyond chance has no meaning"
        )
    parts = [[r for r in table.readings if r.part == part] for part in table.parts]

    def between(some: Sequence[Sequence[Reading]], one: str, other: str) -> tuple[float, float]:
        """Compare two operators' readings of each part, trial by trial in order."""
        pairs: list[tuple[str, str]] = []
        for part in some:
            own, theirs = ([r.value for r in part if r.operator == name] for name in (one, other))
            pairs += zip(own, theirs, strict=False)
        return _cohen(pairs)

    operators, words = [], []
    for name in table.operators:
        mine = [[r for r in part if r.operator == name] for part in parts]
        known = [[r for r in part if r.reference] for part in mine]
        passed = sum(r.value == good for part in known for r in part)
        truly = sum(r.reference == good for part in known for r in part)
        one = Operator(
            name,
            _share([[len({r.value for r in part}) == 1] for part in mine if len(part) > 1]),
            _share([[r.value == r.reference for r in part] for part in known]),
            _kappa(lambda some: _cohen([(r.value, r.reference) for part in some for r in part]), known),
            _share([[r.value == good for r in part if r.reference != good] for part in known]),
            _share([[r.value != good for r in part if r.reference == good] for part in known]),
            passed / truly - 1.0 if truly else math.nan,
        )
        operators.append(one)
        if math.isfinite(one.missed.value):
            words.append(
                f"{one.name}: calls {one.missed.value:.1%} of the bad ones `{good}` "
                f"(95 %: {one.missed.low:.1%} to {one.missed.high:.1%}), {one.false_alarm.value:.1%} of the "
                f"good ones not; kappa against the reference {one.kappa.value:.2f}"
            )
    over_all = _kappa(lambda some: _fleiss(some, classes), parts)
    if math.isfinite(over_all.value):
        words.append(
            f"all readings agree with kappa {over_all.value:.2f} (95 %: {over_all.low:.2f} to "
            f"{over_all.high:.2f}); above 0.75 is good, below 0.40 poor (AIAG MSA)"
        )
    pairs = tuple(
        (one, other, _kappa(partial(between, one=one, other=other), parts))
        for one, other in combinations(table.operators, 2)
    )
    readings = len(table.readings)
    return Agreement(len(parts), readings, tuple(operators), over_all, pairs, tuple(words))


def _share(by_part: Sequence[Sequence[bool]]) -> Figure:
    """Give a share with its interval: Wilson's, of the effective number of independent readings."""
    parts = [np.array(part, np.float64) for part in by_part if len(part)]
    if not parts:
        return Figure(math.nan, math.nan, math.nan, 0)
    n = sum(part.size for part in parts)
    share = sum(float(part.sum()) for part in parts) / n
    rest = np.array([part.sum() - share * part.size for part in parts])
    variance = len(parts) / max(len(parts) - 1, 1) * float((rest**2).sum()) / n**2
    return Figure(share, *_wilson(share, variance, len(parts), n), n)


def _wilson(share: float, variance: float, parts: int, readings: int) -> tuple[float, float]:
    """Give Wilson's interval for as many independent readings as a share of this variance has.

    They are no more than readings, and no fewer than one; where all agree, no more than parts. The quantile
    is Student's, for the variance is known from so many parts only.
    """
    from scipy.stats import t

    effective = float(parts)
    if variance > 0.0:
        effective = min(max(share * (1.0 - share) / variance, 1.0), float(readings))
    z = float(t.ppf(0.975, max(parts - 1, 1)))
    middle = (share + z * z / (2.0 * effective)) / (1.0 + z * z / effective)
    half = z * math.sqrt(share * (1.0 - share) / effective + (z / (2.0 * effective)) ** 2)
    half /= 1.0 + z * z / effective
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _kappa(
    figure: Callable[[Sequence[Sequence[Reading]]], tuple[float, float]], parts: Sequence[Sequence[Reading]]
) -> Figure:
    """Give a kappa, 1 less observed over expected disagreement, with its interval.

    Its variance is found by leaving out one part at a time; the interval is Wilson's, of the disagreement, so
    that it stays below 1 and leans to where kappa can go.
    """
    kept = [part for part in parts if part]
    n, readings = len(kept), sum(len(part) for part in kept)
    observed, expected = figure(kept) if kept else (math.nan, math.nan)
    value = 1.0 - observed / expected if expected > 0.0 else math.nan
    if n < PARTS_MIN or not math.isfinite(value):
        return Figure(value, math.nan, math.nan, readings)
    without = np.array([figure([*kept[:k], *kept[k + 1 :]]) for k in range(n)])
    ratio = without[:, 0] / without[:, 1]
    variance = (n - 1) / n * float(np.nansum((ratio - np.nanmean(ratio)) ** 2)) * expected**2
    low, high = _wilson(min(observed, 1.0), variance, n, readings)
    return Figure(value, max(1.0 - high / expected, -1.0), 1.0 - low / expected, readings)


def _cohen(pairs: Sequence[tuple[str, str]]) -> tuple[float, float]:
    """Give observed and expected disagreement of pairs (Cohen 1960)."""
    n = len(pairs)
    if not n:
        return math.nan, math.nan
    first, second = Counter(a for a, _ in pairs), Counter(b for _, b in pairs)
    apart = sum(a != b for a, b in pairs) / n
    return apart, 1.0 - sum(first[name] * second[name] for name in first) / n**2


def _fleiss(parts: Sequence[Sequence[Reading]], classes: Sequence[str]) -> tuple[float, float]:
    """Give observed and expected disagreement, for any number of readings of a part from two on (Fleiss)."""
    counts: list[Floats] = []
    for part in parts:
        found = Counter(r.value for r in part)
        if len(part) > 1:
            counts.append(np.array([found[name] for name in classes], np.float64))
    if not counts:
        return math.nan, math.nan
    table = np.array(counts)
    size = table.sum(axis=1)
    agreed = float((((table * (table - 1.0)).sum(axis=1)) / (size * (size - 1.0))).mean())
    return 1.0 - agreed, 1.0 - float(((table.sum(axis=0) / size.sum()) ** 2).sum())
