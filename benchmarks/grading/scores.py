"""What a classifier made of many skeins."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.grading.judges import GOOD, SHOWN_MM, Judge
from benchmarks.traced.tables import Row
from roemetry_tools.compare.agreement import Interval, wilson

UNKNOWN = "unknown"
HEALTHY = "none"


class Judged(NamedTuple):
    """A skein, the class it was given, and the probability stated."""

    row: Row
    label: str
    probability: float

    @property
    def caught(self) -> bool:
        """Whether it was called some defect; *unknown* is not."""
        return self.label not in (GOOD, UNKNOWN)


class Score(NamedTuple):
    """Good against deformed, for defects of which a lit stripe shows a millimetre, and for all."""

    good: int
    kept: int
    """good, kept: good skeins, and those that were called good."""
    shown: int
    caught: int
    named: int
    """shown, caught, named: skeins whose defect is shown; those that were called deformed; those whose defect
    was named right."""
    deformed: int
    caught_of_all: int
    """deformed, caught_of_all: all with a defect, shown or not; those that were called deformed."""
    unknown: int
    """Of all, called neither."""

    @property
    def balanced(self) -> float:
        """Mean of the shares kept and caught."""
        return 0.5 * (self.kept / max(self.good, 1) + self.caught / max(self.shown, 1))

    @property
    def balanced_interval(self) -> Interval:
        """95 % interval of that: the two shares' intervals by Wilson, their half widths put together."""
        parts = [(self.kept, self.good), (self.caught, self.shown)]
        ends = [(k / max(n, 1), wilson(k, n)) for k, n in parts]
        low = 0.5 * float(np.hypot(*(share - interval.low for share, interval in ends)))
        high = 0.5 * float(np.hypot(*(interval.high - share for share, interval in ends)))
        return Interval(self.balanced - low, min(self.balanced + high, 1.0))


def judged_by(judge: Judge, rows: Sequence[Row]) -> list[Judged]:
    """Judge all skeins that were measured."""
    found = []
    for row in rows:
        if row.features and row.grades:
            grade = judge(row)
            found.append(Judged(row, grade.label, grade.probability))
    return found


def score_of(judged: Sequence[Judged]) -> Score:
    """Count."""
    good = [one for one in judged if one.row.name == GOOD]
    deformed = [one for one in judged if one.row.name != GOOD]
    shown = [one for one in deformed if one.row.defect["shown_mm"] >= SHOWN_MM]
    return Score(
        len(good),
        sum(one.label == GOOD for one in good),
        len(shown),
        sum(one.caught for one in shown),
        sum(one.label == one.row.name for one in shown),
        len(deformed),
        sum(one.caught for one in deformed),
        sum(one.label == UNKNOWN for one in judged),
    )


def confusion_of(judged: Sequence[Judged], *, by_kind: bool = False) -> Counter[tuple[str, str]]:
    """Count (what it is, what it was called); by kind, one dent and several are told apart."""
    return Counter(
        (one.row.kind if by_kind and one.row.kind != HEALTHY else one.row.name, one.label) for one in judged
    )
