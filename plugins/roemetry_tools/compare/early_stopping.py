"""Variants that are certainly worse than another are not measured further.

At looks that come ever more rarely, the variant with the least mean absolute error so far is set against each
other one: on the products that both measured, specimen by specimen, by the difference of their absolute
errors. The test is a bet on that difference: a capital of 1 that is multiplied by 1 + λ·difference at every
specimen, and is split over ten stakes λ. Where the other variant is as good or better, the capital grows in
no expectation, so it ever reaches 1/α with probability α at most, however often one looks and however the
differences are distributed (Ville 1939; Waudby-Smith and Ramdas 2024, section 4). For that they must be
bounded: an error counts as `ERROR_MAX_PCT` at most. With each variant's α divided by the number of its
opponents, the chance that the best of all is ever stopped is `DOUBT` at most. Specimens must come in no order
that has to do with who measures them well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_tools.compare.agreement import PairedValue
from roemetry_tools.compare.score import QUANTITIES

DOUBT = 0.01
"""Chance that the best variant is stopped, at most."""
ERROR_MAX_PCT = 50.0
"""What an error counts as at most: who is so far off has not measured, and how far is no matter."""
SPECIMENS_MIN = 20
"""With fewer nothing is stopped: their kinds are hardly all seen."""
_LOOK_AGAIN = 1.25
"""Acquisitions from one look to the next grow by this factor: all looks together then cost little."""
_STAKES = 0.5 ** np.arange(10.0)
"""The best stake for differences of mean μ and standard deviation σ, as shares of the bound, is near μ/σ²."""

Values = Mapping[str, Mapping[str, PairedValue]]
"""By quantity and product, what a variant measured, beside what is true."""


class Stopped(NamedTuple):
    """Why a variant was measured no further."""

    by: int
    """Number of the variant that beat it."""
    figure: str
    """The quantity, of `QUANTITIES`."""
    more_pct: float
    """How much larger its mean absolute error was on the same products, %."""
    specimens: int
    acquisitions: int
    """specimens, acquisitions: after how many."""


def looks() -> Iterator[int]:
    """Give the numbers of acquisitions after which is looked."""
    at = SPECIMENS_MIN
    while True:
        yield at
        at = math.ceil(_LOOK_AGAIN * at)


def capital(differences: Floats) -> float:
    """Give the logarithm of what a bet has come to that (specimen,) differences, %, have a mean above 0."""
    with np.errstate(divide="ignore"):  # all may be lost
        grown = np.log1p(_STAKES[:, None] * differences / ERROR_MAX_PCT).sum(axis=1)
    return float(np.logaddexp.reduce(grown)) - math.log(_STAKES.size)


def beaten(values: Mapping[int, Values], opponents: int, acquisitions: int) -> dict[int, Stopped]:
    """Give those variants that are beaten now, each by the best of them; `values` by the variant's number.

    `opponents` is how many others each began with. Nothing is decided where no quantity is known in which
    they differ.
    """
    threshold = math.log(opponents / DOUBT) if opponents else math.inf
    for figure in QUANTITIES:
        known = {number: _errors(values[number][figure]) for number in values}
        means = {
            number: math.fsum(error for error, _ in of.values()) / len(of)
            for number, of in known.items()
            if of
        }
        if len(means) < 2 or max(means.values()) - min(means.values()) < 1e-9:
            continue
        best = min(sorted(means), key=means.__getitem__)
        found = {}
        for number in means:
            if number == best:
                continue
            differences, more_pct = _differences(known[number], known[best])
            if differences.size >= SPECIMENS_MIN and capital(differences) > threshold:
                found[number] = Stopped(best, figure, more_pct, differences.size, acquisitions)
        return found
    return {}


Errors = dict[str, tuple[float, str]]
"""By product, its absolute error, %, and which specimen it is."""


def _errors(values: Mapping[str, PairedValue]) -> Errors:
    return {
        name: (min(100.0 * abs(one.estimate / one.true - 1.0), ERROR_MAX_PCT), one.specimen)
        for name, one in values.items()
        if one.true > 0
    }


def _differences(errors: Errors, others: Errors) -> tuple[Floats, float]:
    """(specimen,) mean differences of the errors of the same products; their mean over the products."""
    both = [
        (error - others[name][0], specimen) for name, (error, specimen) in errors.items() if name in others
    ]
    if not both:
        return np.empty(0), math.nan
    change = np.array([difference for difference, _ in both])
    _, of, count = np.unique([specimen for _, specimen in both], return_inverse=True, return_counts=True)
    return np.bincount(of, change) / count, float(change.mean())
