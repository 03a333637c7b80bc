"""Where a variant stands: beside the truth, and beside the recipe as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from roemetry_tools.compare.aggregate import QUANTITIES, Figures
from roemetry_tools.compare.agreement import (
    Agreement,
    Shift,
    Terms,
    against_each_other,
    against_truth,
    nearer,
)
from roemetry_tools.compare.bootstrap import NO_INTERVAL, Interval
from roemetry_tools.compare.cross_validation import Choice, choose_by_class, choose_by_error
from roemetry_tools.compare.grading import (
    Recall,
    Reliability,
    balanced_interval,
    balanced_shift,
    recalls_of,
    reliability_of,
)
from roemetry_tools.compare.variants import Variant


@dataclass(frozen=True, slots=True)
class Standing:
    """A variant beside others.

    Attributes
    ----------
    truth
        By quantity, agreement with what is true.
    recipe
        By quantity, agreement with the recipe as it is, on the same products.
    nearer
        By quantity, mean absolute error less that of the recipe as it is, on the same products, %.
    recalls
        By true class.
    balanced_interval
        95 % interval of the balanced accuracy.
    balanced_shift
        Balanced accuracy less that of the recipe as it is; None for the recipe itself.
    reliability
        Of stated probabilities; None where none is stated.
    """

    truth: Mapping[str, Agreement] = field(default_factory=dict)
    recipe: Mapping[str, Agreement] = field(default_factory=dict)
    nearer: Mapping[str, Shift] = field(default_factory=dict)
    recalls: tuple[Recall, ...] = ()
    balanced_interval: Interval = NO_INTERVAL
    balanced_shift: Shift | None = None
    reliability: Reliability | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Compared:
    """A variant and what it came to.

    Attributes
    ----------
    variant
        What it is.
    figures
        None where it could not even be made: `Variant.fault` says why.
    standing
        How it agrees with the truth and with the recipe as it is.
    """

    variant: Variant
    figures: Figures | None
    standing: Standing = field(default_factory=Standing)

    @property
    def failure(self) -> str:
        """Why it has nothing to show; "" where it has."""
        if self.figures is None:
            return self.variant.fault
        if not self.figures.failed:
            return ""
        return f"no acquisition was measured: {self.figures.causes[0].text}"


def standing_of(own: Figures | None, base: Figures | None, terms: Terms) -> Standing:
    """Hold a variant against the truth and, where it is another, the recipe as it is."""
    if own is None:
        return Standing()
    truth, recipe, shifts = {}, {}, {}
    for name in QUANTITIES:
        if (found := against_truth(own.values[name], terms)) is not None:
            truth[name] = found
        if base is None:
            continue
        if (found := against_each_other(own.values[name], base.values[name], terms)) is not None:
            recipe[name] = found
        if (shift := nearer(own.values[name], base.values[name], terms)) is not None:
            shifts[name] = shift
    others = {} if base is None else {one.product: one for one in base.graded}
    return Standing(
        truth,
        recipe,
        shifts,
        recalls_of(own.graded),
        balanced_interval(own.graded, terms) if len({one.true for one in own.graded}) > 1 else NO_INTERVAL,
        balanced_shift(own.graded, others, terms) if others else None,
        reliability_of(own.graded, terms),
    )


def choices_of(compared: Sequence[Compared], terms: Terms) -> list[Choice]:
    """Choose the best variant by every figure that more than one of them has."""
    whole = {one.variant.number: one.figures for one in compared if one.figures and not one.failure}
    found = [
        choose_by_error(name, {n: of.values[name] for n, of in whole.items() if of.pairs[name]}, terms)
        for name in QUANTITIES
    ]
    found.append(choose_by_class({n: of.graded for n, of in whole.items() if of.graded}, terms))
    return [choice for choice in found if choice is not None]
