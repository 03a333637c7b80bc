"""The classifiers that are compared, each a way from a row to a class, and what they made of many skeins."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.traced import SMOOTHING_MM, Row
from roemetry.records import Fitted, Grade, Samples
from roemetry_shape.fuzzy_rules import FuzzyRules, FuzzyRulesOptions
from roemetry_shape.learned import Learned, LearnedOptions
from roemetry_shape.shape_limits import ShapeLimits, ShapeLimitsOptions

SHOWN_MM = 1.0
"""A defect that a lit stripe shows by this much ought to be caught."""

TAUGHT_MM = 0.5
"""A defect that stripes show by less is not learned from: its features are those of a good product."""

GOOD, NOT_GOOD, UNKNOWN = "good", "not-good", "unknown"
Judge = Callable[[Row], Grade]

NOT_LEARNED = ("humps", "hump_height_mm", "hump_area_mm2")
"""No simulated defect is a hump: what was never shown must not decide."""

_LIMITS_MOST = 12
_LEAST_CAUGHT = 3


def judges_of(model: Path, limits: ShapeLimitsOptions) -> dict[str, Judge]:
    """Give every classifier by name."""
    by_limits, learned = ShapeLimits(limits), Learned(LearnedOptions(model=model))
    by_rules = FuzzyRules(rules_of(limits))
    return {
        "paper's rule": lambda row: Grade(row.grades["paper"]),
        "paper's rule, best options": lambda row: Grade(row.grades["best options"]),
        "`shape-limits`": lambda row: by_limits.judge(row.features),
        "`fuzzy-rules`": lambda row: by_rules.judge(row.features),
        "`learned`": lambda row: learned.judge(row.features),
    }


def samples_of(rows: Sequence[Row]) -> Samples:
    """Make samples of rows that were measured; those of one body share a group."""
    used = [row for row in rows if row.features]
    names = tuple(name for name in used[0].features if name not in NOT_LEARNED)
    values = np.array([[row.features.get(name, np.nan) for name in names] for row in used])
    ids = tuple(str(k) for k in range(len(used)))
    groups = tuple(f"{row.rig} {row.seed}" for row in used)
    return Samples(ids, groups, names, values, tuple(row.name for row in used))


def fitted_model(rows: Sequence[Row]) -> Fitted:
    """Fit the learned classifier; a defect of which no stripe shows half a millimetre teaches nothing."""
    shown = [row for row in rows if row.name == GOOD or row.shown_mm >= TAUGHT_MM]
    return Learned.fit(samples_of(shown), good=GOOD, smoothing_mm=SMOOTHING_MM)


def fitted_limits(rows: Sequence[Row]) -> ShapeLimitsOptions:
    """Find limits one after the other: just beyond all good ones, where most of one class is caught.

    The class of a limit is the most frequent among those that it catches; each of another class that it
    catches, too, counts against it, until no limit is worth it; then what is left is caught in any way.
    """
    good = [row.features for row in rows if row.features and row.name == GOOD]
    left = [row for row in rows if row.features and row.shown_mm >= SHOWN_MM]
    every = good + [row.features for row in left]
    found: list[Mapping[str, object]] = []
    strict = True
    while len(found) < _LIMITS_MOST:
        best = max(
            ((_caught(left, name, key, at), name, key, at) for name, key, at in _candidates(good, every)),
            key=lambda one: _worth(one[0]) if strict else len(one[0]),
        )
        caught, name, key, at = best
        if _worth(caught) < _LEAST_CAUGHT and strict:
            strict = False
            continue
        if len(caught) < _LEAST_CAUGHT:
            break
        found.append({"feature": name, key: at, "label": _most_common(caught)[0]})
        left = [row for row in left if row not in caught]
    return ShapeLimitsOptions.model_validate({"limits": found, "good": GOOD, "smoothing_mm": SMOOTHING_MM})


def rules_of(limits: ShapeLimitsOptions) -> FuzzyRulesOptions:
    """Make every limit a word with a soft edge, a tenth of it to either side; the first word decides."""
    terms, rules = {}, []
    for number, limit in enumerate(limits.limits, start=1):
        high = limit.at_most is not None
        at = float(limit.at_most if limit.at_most is not None else limit.at_least or 0.0)
        soft = max(0.1 * abs(at), 1e-6)
        name = f"{limit.feature} {'high' if high else 'low'} {number}"
        ends = [0.0, 1.0] if high else [1.0, 0.0]
        terms[name] = {"feature": limit.feature, "points": [[at - soft, ends[0]], [at + soft, ends[1]]]}
        when = [name, *(f"not {earlier}" for earlier in terms if earlier != name)]
        rules.append({"when": when, "label": limit.label})
    rules.append({"when": [f"not {name}" for name in terms], "label": GOOD})
    return FuzzyRulesOptions.model_validate({"terms": terms, "rules": rules, "smoothing_mm": SMOOTHING_MM})


def _candidates(
    good: Sequence[Mapping[str, float]], every: Sequence[Mapping[str, float]]
) -> list[tuple[str, str, float]]:
    """Feature, kind of limit, and its place: beyond all good ones by a fifth of their outer spread.

    At least by a twentieth of the spread over all: some features are 0 for every good one.
    """
    found = []
    for name in (name for name in good[0] if name not in NOT_LEARNED):
        values = np.array([one.get(name, np.nan) for one in good])
        values = values[np.isfinite(values)]
        if values.size < len(good) // 2:
            continue
        low, usual_low, usual_high, high = np.quantile(values, (0.0, 0.05, 0.95, 1.0)).tolist()
        least = 0.05 * float(np.nanstd([one.get(name, np.nan) for one in every]))
        above, below = max(0.2 * (high - usual_high), least), max(0.2 * (usual_low - low), least)
        found.append((name, "at_most", float(f"{high + above:.3g}")))
        found.append((name, "at_least", float(f"{low - below:.3g}")))
    return found


def _caught(rows: Sequence[Row], name: str, key: str, at: float) -> list[Row]:
    sign = 1.0 if key == "at_most" else -1.0
    return [row for row in rows if sign * (row.features.get(name, np.nan) - at) > 0]


def _worth(rows: Sequence[Row]) -> int:
    """Those of the most frequent class, less the others."""
    return 2 * _most_common(rows)[1] - len(rows)


def _most_common(rows: Sequence[Row]) -> tuple[str, int]:
    counted = Counter(row.name for row in rows).most_common(1)
    return counted[0] if counted else ("", 0)


class Judged(NamedTuple):
    """A skein, the class it was given, and the probability stated."""

    row: Row
    label: str
    probability: float

    @property
    def caught(self) -> bool:
        """Whether it was called some defect; *unknown* is not."""
        return self.label not in (GOOD, UNKNOWN)

    @property
    def right(self) -> bool:
        """Whether it was given its class, or called `not-good` rightly."""
        return self.label == self.row.name or (self.label == NOT_GOOD and self.row.name != GOOD)


def judged_by(judge: Judge, rows: Sequence[Row]) -> list[Judged]:
    """Judge all skeins that were measured."""
    found = []
    for row in rows:
        if row.features and row.grades:
            grade = judge(row)
            found.append(Judged(row, grade.label, grade.probability))
    return found
