"""Repeatability and reproducibility of a gauge: how much of what one sees is the gauge.

Components come from `variance`, limits from AIAG MSA, 4th edition. Shares are of the study's total variation
or of a tolerance; the number of distinct categories is 1.41 times the parts' standard deviation over the
gauge's, truncated. The instrument's own stated uncertainties stand beside the repeatability: an instrument
that knows itself states about as much.

How large a study must be: one of each size is simulated many times with the variations that are expected,
analysed as the real one will be, and judged by the width of the interval of %GRR.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from roemetry.errors import DataError, InterruptedRunError
from roemetry.run.executors import Executor, Lost, Processes
from roemetry_study.table import Reading, StudyTable
from roemetry_study.variance import Effect, analyse, average_range

GOOD_PERCENT, POOR_PERCENT = 10.0, 30.0
"""Shares of the gauge in the total below which it is accepted, and above which it is not (AIAG MSA)."""
CATEGORIES_NEEDED = 5
"""Number of distinct categories asked for (AIAG MSA)."""
SPREAD = 6.0
"""Standard deviations that a tolerance is compared with: 99.73 % of readings."""
_CATEGORY = 1.41  # √2 as the manual rounds it: its published numbers of categories come out


class Line(NamedTuple):
    """One source of variation."""

    name: str
    std: float
    low: float
    high: float
    """std, low, high: standard deviation in the value's unit, and its 95 % interval; NaN where there is
    none."""
    percent: float
    """Share of the total standard deviation, per cent."""
    of_tolerance_percent: float
    """Six standard deviations over the tolerance, per cent; NaN without a tolerance."""


@dataclass(frozen=True, slots=True)
class GaugeStudy:
    """What a gauge study found."""

    missing: int
    """Readings that a balanced study of this size would have and this has not."""
    lines: tuple[Line, ...]
    effects: tuple[Effect, ...]
    gauge_percent: float
    gauge_percent_interval: tuple[float, float]
    """gauge_percent, gauge_percent_interval: %GRR, of the total variation."""
    categories: int
    categories_interval: tuple[float, float]
    verdict: str
    """``accepted``, ``conditional``, or ``not accepted``."""
    words: tuple[str, ...]


def gauge_study(
    table: StudyTable, *, tolerance: float = math.nan, nested: bool = False, method: str = "anova"
) -> GaugeStudy:
    """Judge a gauge by readings that are numbers.

    `tolerance` is its width, upper less lower limit, in the value's unit; NaN: none. `nested` says whether
    each operator had parts of their own, `method` is ``anova`` or ``average-range``.

    Raises
    ------
    DataError
        As `analyse` and `average_range`.
    """
    found = average_range(table) if method == "average-range" else analyse(table, nested=nested)
    std, total = found.std, found.std["total"]
    single = len(table.operators) == 1
    names = ["gauge", "repeatability", "reproducibility", "operator", "interaction", "part", "total"]
    if single or nested or std["interaction"] == 0.0:
        names.remove("interaction")
        names.remove("operator")
    if single:
        names.remove("reproducibility")
    lines = []
    for name in names:
        low, high = found.interval(itemgetter(name))
        lines.append(
            Line(
                name, std[name], low, high, 100.0 * std[name] / total, 100.0 * SPREAD * std[name] / tolerance
            )
        )
    share, interval = 100.0 * std["gauge"] / total, found.interval(lambda d: 100.0 * d["gauge"] / d["total"])
    categories = int(_CATEGORY * std["part"] / std["gauge"]) if std["gauge"] > 0.0 else 0
    verdict = _verdict(share)
    words = [
        f"{verdict}: the gauge is {share:.1f} % of the total variation"
        + (f" (95 %: {interval[0]:.1f} to {interval[1]:.1f} %)" if math.isfinite(interval[0]) else "")
        + f"; up to {GOOD_PERCENT:.0f} % is accepted, above {POOR_PERCENT:.0f} % is not"
    ]
    if math.isfinite(interval[1]) and _verdict(interval[0]) != _verdict(interval[1]):
        words.append(
            "the interval extends into another verdict: more parts or operators would settle it "
            "(`roemetry study plan`)"
        )
    if categories < CATEGORIES_NEEDED:
        words.append(
            f"it distinguishes {categories} categories of these parts; {CATEGORIES_NEEDED} are required"
        )
    if math.isfinite(tolerance):
        words.append(f"precision to tolerance: {100.0 * SPREAD * std['gauge'] / tolerance:.1f} %")
    if single:
        words.append("one operator: reproducibility is not known, and the gauge's share is a lower bound")
    elif len(table.operators) == 2:
        words.append("two operators: how much operators differ rests on one difference")
    if len(table.parts) < 5:
        words.append(f"{len(table.parts)} parts: how much parts vary is hardly known; ten are usual")
    if found.pooled:
        words.append("operators and parts do not interact significantly: pooled with the repeatability")
    stated = np.array([reading.std for reading in table.readings])
    if np.isfinite(stated).all():
        stated_std, repeatability = float(np.sqrt(np.mean(stated**2))), std["repeatability"]
        words.append(
            f"the instrument states a standard uncertainty of {stated_std:.3g}; it repeats within "
            f"{repeatability:.3g}"
            + (
                ": it does not repeat as well as it states"
                if repeatability > stated_std
                else ", as it must: what is common to all its readings does not show in repetition"
            )
        )
    # the fullest cell's number of trials is what was planned for every cell
    cells = Counter((reading.part, reading.operator) for reading in table.readings)
    planned = len(cells) if nested else len(table.parts) * len(table.operators)
    return GaugeStudy(
        missing=planned * max(cells.values()) - len(table.readings),
        lines=tuple(lines),
        effects=found.effects,
        gauge_percent=share,
        gauge_percent_interval=interval,
        categories=categories,
        categories_interval=found.interval(lambda d: _CATEGORY * d["part"] / d["gauge"]),
        verdict=verdict,
        words=tuple(words),
    )


def _verdict(share: float) -> str:
    if share <= GOOD_PERCENT:
        return "accepted"
    return "conditional" if share <= POOR_PERCENT else "not accepted"


STUDIES = 60
"""Simulated for each size: a mean half width is then known to some 5 %."""
SIZES = (
    (5, 2, 2), (5, 3, 2), (10, 2, 2), (10, 3, 2), (10, 3, 3), (15, 3, 2), (15, 3, 3), (20, 3, 3), (30, 3, 3),
)  # fmt: skip
"""Parts, operators, trials, by effort."""


class Size(NamedTuple):
    """A size of study and what it tells."""

    parts: int
    operators: int
    trials: int
    percent: float
    """Median %GRR found."""
    half_width_percent: float
    """Median half width of its 95 % interval, in per cent of the total variation; the upper half."""

    @property
    def readings(self) -> int:
        """How many readings it takes."""
        return self.parts * self.operators * self.trials


def plan(
    part_std: float,
    repeatability_std: float,
    operator_std: float,
    sizes: Sequence[tuple[int, int, int]] = SIZES,
    studies: int = STUDIES,
    executor: Executor | None = None,
) -> Iterator[Size]:
    """Simulate so many studies of each size: parts, operators and trials.

    The standard deviations are those expected, in one unit: of the parts among each other, of repeated
    readings, and of operators or heads (0 with one). The sizes are the same for any executor.

    Raises
    ------
    DataError
        Parts or readings do not vary.
    """
    if not (part_std > 0.0 and repeatability_std > 0.0 and operator_std >= 0.0):
        raise DataError(
            f"parts vary by {part_std:g}, readings by {repeatability_std:g}: both must be above 0",
            hint="parts: standard deviation of the process; readings: the instrument's, from one part",
        )
    tasks = [(size, study) for size in sizes for study in range(studies)]
    stds = part_std, repeatability_std, operator_std
    results = (executor or Processes(1)).in_order(partial, (_share_found, stds), tasks)
    for size in sizes:
        found = []
        for one in islice(results, studies):
            if isinstance(one, Lost):
                raise InterruptedRunError(f"a simulated study was lost: {one.why}")
            found.append(one)
        yield Size(*size, *np.median(np.array(found), axis=0).tolist())


def _share_found(
    stds: tuple[float, float, float], task: tuple[tuple[int, int, int], int]
) -> tuple[float, float]:
    """Give the %GRR that one simulated study finds, and the upper half of its interval's width."""
    size, study = task
    made = analyse(simulated(np.random.default_rng([*size, study]), size, *stds))
    low, high = made.interval(lambda draws: 100.0 * draws["gauge"] / draws["total"])
    share = 100.0 * made.std["gauge"] / made.std["total"]
    return share, max(high - share, share - low)


def simulated(
    rng: np.random.Generator,
    size: tuple[int, int, int],
    part_std: float,
    repeatability_std: float,
    operator_std: float,
    interaction_std: float = 0.0,
) -> StudyTable:
    """Draw a crossed study."""
    parts, operators, trials = size
    of_part, of_operator = rng.normal(0.0, part_std, parts), rng.normal(0.0, operator_std, operators)
    inner = rng.normal(0.0, interaction_std, (parts, operators))
    readings = [
        Reading(f"{p + 1}", f"{o + 1}", f"{t + 1}", repr(float(value)), "simulated")
        for p in range(parts)
        for o in range(operators)
        for t, value in enumerate(
            of_part[p] + of_operator[o] + inner[p, o] + rng.normal(0.0, repeatability_std, trials)
        )
    ]
    return StudyTable(tuple(readings), "simulated", "simulated")


def samples_for_mean(std: float, half_width: float) -> int:
    """Give how many weighed samples fix a mean (a density, a bias) to ± `half_width` at 95 %.

    Raises
    ------
    DataError
        A width or a scatter is not above 0.
    """
    if not (std > 0.0 and half_width > 0.0):
        raise DataError("scatter and wished half width must be above 0")
    from scipy.stats import t

    n = 2
    while float(t.ppf(0.975, n - 1)) * std / math.sqrt(n) > half_width:
        n += 1
    return n
