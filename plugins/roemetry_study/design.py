"""How many parts, operators and trials a gauge study needs, by simulation.

A study of each size is simulated many times with the variations that are expected, analysed as the real one
will be, and judged by the width of the interval of %GRR.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from roemetry.errors import DataError
from roemetry_study.table import Reading, StudyTable
from roemetry_study.variance import analyse

STUDIES = 60
"""Simulated for each size: a mean half width is then known to some 5 %."""
SIZES = (
    (5, 2, 2),
    (5, 3, 2),
    (10, 2, 2),
    (10, 3, 2),
    (10, 3, 3),
    (15, 3, 2),
    (15, 3, 3),
    (20, 3, 3),
    (30, 3, 3),
)
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
) -> Iterator[Size]:
    """Simulate studies of each size.

    Parameters
    ----------
    part_std, repeatability_std, operator_std
        Standard deviations expected, in one unit: of the parts among each other, of repeated readings, and of
        operators or heads (0 with one).
    sizes
        Parts, operators and trials of each; one operator where `operator_std` is 0 will do.
    studies
        Simulated for each size.

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
    for parts, operators, trials in sizes:
        found = []
        for study in range(studies):
            rng = np.random.default_rng([parts, operators, trials, study])
            made = analyse(
                simulated(rng, (parts, operators, trials), part_std, repeatability_std, operator_std)
            )
            low, high = made.interval(lambda draws: 100.0 * draws["gauge"] / draws["total"])
            share = 100.0 * made.std["gauge"] / made.std["total"]
            found.append((share, max(high - share, share - low)))
        middle = np.median(np.array(found), axis=0)
        yield Size(parts, operators, trials, float(middle[0]), float(middle[1]))


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
