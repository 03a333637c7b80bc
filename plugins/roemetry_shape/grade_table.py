"""Classes of a buyer: over shape, size, weight and colour; the first that a product fits wins.

Model. A table is a list of classes, each with half-open ranges of quantities and the shapes it takes. Going
down it, a limit is kept or broken only if the value lies off it by more than the guard band, `guard_factor`
standard uncertainties (the decision rule of ISO 14253-1, at every limit alike); between, it is open. So is
every limit on a quantity whose uncertainty is not stated in full, by an interval or by the table, and on a
weight for which the visible volume was taken for the true one: a part proves nothing. What a run knows of a
feature, such as a length, is a part: noise and calibration, not how the feature is defined. A product is of
the first class that is kept, if every class before it is broken. A table is looked through before it is used:
between all its limits lie cells, and each cell must belong to a class, each class to a cell, and two classes
may share cells only if one holds the other. More than `CELLS_MAX` cells are refused, not searched.
"""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roemetry.errors import MisfitError
from roemetry.records import Decision, Estimate, Grade, Product, Reason, Volume, Weight
from roemetry.records.units import mm3_to_cm3
from roemetry.stages import Capabilities, Grader, StageOptions

UNDECIDED = "undecided"

Std = Annotated[float, Field(gt=0.0, le=1e9)]
Verdict = Literal["in", "out", "open"]


class Limits(BaseModel):
    """A range of one quantity; the lower end belongs to it, the upper does not."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    at_least: float | None = Field(default=None, ge=-1e9, le=1e9, description="from this on, in its unit")
    below: float | None = Field(default=None, ge=-1e9, le=1e9, description="and below this")

    @model_validator(mode="after")
    def _is_a_range(self) -> Limits:
        if self.at_least is None and self.below is None:
            raise ValueError("neither at_least nor below is given")
        if self.at_least is not None and self.below is not None and self.at_least >= self.below:
            raise ValueError(f"nothing is at least {self.at_least:g} and below {self.below:g}")
        return self


class GradeClass(BaseModel):
    """One class: what a product of it is like."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    label: str = Field(min_length=1, description="its name")
    lane: str = Field(default="", description="where its products go: a belt, a bin")
    shape: tuple[str, ...] = Field(default=(), description="classes of the classifier it takes; none: any")
    limits: dict[str, Limits] = Field(
        default_factory=dict, description="range by quantity: `at_least`, `below`"
    )


class GradeTableOptions(StageOptions):
    """Options of `GradeTable`."""

    classes: tuple[GradeClass, ...] = Field(
        min_length=1,
        description="in order, the first that fits wins: `label`, `lane`, `shape`, `limits`",
    )
    guard_factor: float = Field(
        default=1.65,
        ge=0.0,
        le=10.0,
        description="guard band at each limit, in standard uncertainties; 1.65: 95 % of one side; 0: none",
    )
    std: dict[str, Std] = Field(
        default_factory=dict,
        description="standard uncertainty by quantity, in its unit, where the run does not state it in full",
    )
    unproven: Literal["undecided", "next"] = Field(
        default="undecided",
        description="where several classes are possible: say `undecided`, or take the `next` that is sure",
    )
    undecided_lane: str = Field(default="", description="where undecided products go")
    overlaps: Literal["refuse", "first-wins"] = Field(
        default="refuse", description="what of two classes that share products and neither holds the other"
    )

    @model_validator(mode="after")
    def _is_whole(self) -> GradeTableOptions:
        # missing limits are infinite ends; that every product has a class is then a matter of cells
        ranges = [
            {
                name: (
                    -math.inf if limits.at_least is None else limits.at_least,
                    math.inf if limits.below is None else limits.below,
                )
                for name, limits in row.limits.items()
            }
            for row in self.classes
        ]
        found: list[Fault] = [
            (("classes", number, "limits", name), f"no stage measures this; did you mean `{meant}`?")
            for number, row in enumerate(self.classes)
            for name in row.limits
            if (meant := _misspelt(name))
        ]
        if not found:  # two spellings of a quantity overlap, and leave gaps, where one would not
            # done second: a misspelt name would be reported as gaps that nobody understands
            found = faults_of(
                [row.label for row in self.classes],
                ranges,
                [row.shape for row in self.classes],
                overlaps_are_faults=self.overlaps == "refuse",
            )
            named = {name for row in self.classes for name in row.limits}
            found += [(("std", name), "no class has a limit on it") for name in self.std if name not in named]
        if found:
            raise MisfitError(*found)
        return self


class GradeTable(Grader[GradeTableOptions]):
    """Goes down a buyer's table and takes the first class that a product fits.

    A limit is kept, or broken, only if the value lies off it by more than the guard band, which is
    `guard_factor` standard uncertainties wide (the decision rule of ISO 14253-1, for every limit alike).
    Between, the limit is open: the product may be of this class, or of one below.
    """

    capabilities = Capabilities(fixture="roemetry_shape.grade_table:table_options")

    def needs(self) -> frozenset[str]:
        """Name the stages whose results the table asks for."""
        kinds = {needed_for(name) for row in self.options.classes for name in row.limits}
        if any(row.shape for row in self.options.classes):
            kinds.add("classifier")
        return frozenset(kinds - {""})

    def decide(
        self, product: Product, volume: Volume | None, weight: Weight | None, grade: Grade | None
    ) -> Decision:
        """Give the class, and for each class that was asked about why it is or is not this one."""
        found = Quantities(product, volume, weight, grade, self.options.std)
        said: list[Reason] = []
        possible: list[GradeClass] = []
        proven: GradeClass | None = None
        for row in self.options.classes:
            verdict, why = self._asked(row, found)
            if verdict == "out":
                # broken beyond doubt: whatever is not known of it no longer matters
                said.append(Reason("class-refused", f"{row.label}: {why}"))
                continue
            possible.append(row)
            # the first that fits wins, so nothing below can change the answer
            if verdict == "in":
                proven = row
                said.append(Reason("class-proven", f"{row.label}: {why}"))
                break
            said.append(Reason("class-open", f"{row.label}: {why}"))
        # one class only is possible: it is the answer even if one of its own limits is open, since every
        # product has a class
        chosen = possible[0] if len(possible) == 1 else None
        if chosen is not None and chosen is not proven:
            said.append(Reason("class-left", f"{chosen.label}: every other class is ruled out"))
        # several are possible; the caller may prefer the sure one, which need not be the first
        if chosen is None and proven is not None and self.options.unproven == "next":
            chosen = proven
            passed = ", ".join(row.label for row in possible if row is not proven)
            said.append(Reason("taken-unproven", f"{proven.label} is sure, {passed} would be possible"))
        return Decision(
            label=UNDECIDED if chosen is None else chosen.label,
            lane=self.options.undecided_lane if chosen is None else chosen.lane,
            # two rows may share a label, as where a class has two ranges
            possible=tuple(dict.fromkeys(row.label for row in possible)),
            reasons=tuple(said),
        )

    def _asked(self, row: GradeClass, found: Quantities) -> tuple[Verdict, str]:
        """Say whether a product is of a class, and by what."""
        asked = [_shape(row.shape, found.grade)] if row.shape else []
        factor = self.options.guard_factor
        asked += [_limit(name, limits, found, factor) for name, limits in row.limits.items()]
        # one broken limit rules a class out however many are open; so "out" is looked for first
        for wanted in ("out", "open"):
            for verdict, why in asked:
                if verdict == wanted:
                    return verdict, why
        return "in", "; ".join(why for _, why in asked) or "it asks for nothing"


_SHAPE_PROBABILITY_MIN = 0.95
"""A shape less likely than this is not sure: 5 % may be wrong, as at a limit with the usual guard band."""


def _shape(wanted: tuple[str, ...], grade: Grade | None) -> tuple[Verdict, str]:
    asked = " or ".join(wanted)
    # nothing known speaks neither for nor against
    if grade is None or grade.label == "unknown":
        return "open", f"the shape is not known, {asked} is required"
    sure = _sure(wanted, grade)
    if math.isnan(sure):
        denied = _denied(wanted)
        sure = float(grade.label in wanted or bool(denied and denied != {grade.label}))
    # what has to be likely is the verdict: that it is wanted, or that it is not
    if 1.0 - _SHAPE_PROBABILITY_MIN < sure < _SHAPE_PROBABILITY_MIN:
        return "open", f"the shape is {grade.label}, {asked} has a probability of {sure:.2f}"
    is_wanted = sure >= _SHAPE_PROBABILITY_MIN
    return ("in" if is_wanted else "out"), f"the shape is {grade.label}" + (
        "" if is_wanted else f", {asked} is required"
    )


def _sure(wanted: tuple[str, ...], grade: Grade) -> float:
    """Probability that the shape is one of those wanted; NaN where it is not modelled."""
    if math.isnan(grade.probability):
        return math.nan
    begin = "probability_"
    stated = {name.removeprefix(begin): p for name, p in grade.features.items() if name.startswith(begin)}
    named = any(label in stated for label in wanted)
    stated[grade.label] = grade.probability
    denied = _denied(wanted)
    if len(denied) > 1:
        return 1.0  # nothing is of both classes
    for one in denied:
        # all defects are in it: of the others wanted, only the denied class itself adds
        rest = stated.get(f"not-{one}", 1.0 - stated[one] if one in stated else grade.probability)
        return min(1.0, rest + (stated.get(one, 0.0) if one in wanted else 0.0))
    # without any probability of those wanted, all that the label leaves could be theirs
    if grade.label not in wanted and not named:
        return 1.0 - grade.probability
    return min(1.0, sum(stated.get(label, 0.0) for label in wanted))


def _denied(wanted: tuple[str, ...]) -> set[str]:
    """Give the classes that a product must not be of: `good` of `not-good`."""
    return {label.removeprefix("not-") for label in wanted if label.startswith("not-")}


def _limit(name: str, limits: Limits, found: Quantities, factor: float) -> tuple[Verdict, str]:
    value, std = found.value(name), found.std(name)
    if math.isnan(value):
        return "open", found.why_missing(name)
    # without a guard band the value alone decides, and no uncertainty is asked for
    if factor > 0.0 and math.isnan(std):
        known = found.known_part(name)
        part = f" ± {known:.2g} or more" if known > 0.0 else ""
        return "open", f"{name} is {value:.4g}{part}: its uncertainty is not stated in full; `std` may say it"
    guard = 0.0 if math.isnan(std) else factor * std
    at_least = -math.inf if limits.at_least is None else limits.at_least
    below = math.inf if limits.below is None else limits.below
    is_said = f"{name} is {value:.4g}" + ("" if math.isnan(std) else f" ± {std:.2g}")
    # half-open: a value at `below` itself is already out
    if value + guard < at_least or value - guard >= below:
        return "out", f"{is_said}, {_range(limits)} is required"
    # all that the value may be lies within
    if value - guard >= at_least and value + guard < below:
        return "in", f"{is_said}, {_range(limits)} is met"
    return "open", f"{is_said}, too close to the limit ({_range(limits)}) to decide"


def _range(limits: Limits) -> str:
    parts = [] if limits.at_least is None else [f"at least {limits.at_least:g}"]
    return " and ".join(parts + ([] if limits.below is None else [f"below {limits.below:g}"]))


_AIR_WEIGHED = "visible-taken-for-true"
"""Reason of a weight that counts the air below the product, which no uncertainty of it holds."""
WEIGHT, VISIBLE, TRUE = "weight_g", "visible_volume_cm3", "true_volume_cm3"


def _misspelt(name: str) -> str:
    """Name the volume or weight that a name is a slip for; "" where it is none.

    Names of features are the plugins' own, and known only once a product was measured.
    """
    close = difflib.get_close_matches(name, (WEIGHT, VISIBLE, TRUE), n=1, cutoff=0.85)
    return close[0] if close and close[0] != name else ""


def needed_for(name: str) -> str:
    """Name the kind of stage that gives a quantity; "" where several may."""
    return {WEIGHT: "weigher", VISIBLE: "volume", TRUE: "volume"}.get(name, "")


class Quantities:
    """A product's quantities by name, with their standard uncertainties.

    Attributes
    ----------
    grade
        The shape; None where there is none.
    """

    def __init__(
        self,
        product: Product,
        volume: Volume | None,
        weight: Weight | None,
        grade: Grade | None,
        stated: Mapping[str, float],
    ) -> None:
        self.grade = grade
        self._stated = stated
        self._estimates = _estimates(volume, weight)
        # where two state the same feature, the later source counts
        self._features = {} if product.outline is None else dict(product.outline.features)
        self._features |= {} if weight is None else weight.features
        self._features |= {} if grade is None else grade.features
        self._features_std = {} if grade is None else grade.features_std

    def value(self, name: str) -> float:
        """Give a quantity, in the unit its name says; NaN where there is none."""
        if name in self._estimates:
            return self._estimates[name].value
        return self._features.get(name, math.nan)

    def std(self, name: str) -> float:
        """Give its standard uncertainty: what the run states in full, else what the table does, else NaN.

        Of a volume or weight a run states the whole where it states an interval. Else the table's word
        counts, but for no less than the part that the run knows.
        """
        # the interval is the sign that every part of the uncertainty is in it
        estimate = self._estimates.get(name)
        if estimate is not None and all(map(math.isfinite, estimate.interval)):
            return estimate.std
        # the table's word stands in for what the run cannot state, but cannot be less than what it knows
        stated = self._stated.get(name, math.nan)
        return stated if math.isnan(stated) else max(stated, self.known_part(name))

    def known_part(self, name: str) -> float:
        """Give what the run knows of the uncertainty of a quantity; 0 for nothing."""
        if (estimate := self._estimates.get(name)) is not None:
            # a budget's parts are independent and add in squares
            parts = [estimate.std, math.hypot(*estimate.budget.values())]
        else:
            parts = [self._features_std.get(name, math.nan), self._features.get(f"{name}_std", math.nan)]
        return max((part for part in parts if not math.isnan(part)), default=0.0)

    def why_missing(self, name: str) -> str:
        """Say that a quantity is not there, and what is."""
        if needed_for(name) or name in self._features:
            return f"{name} could not be measured"
        known = ", ".join(sorted([*self._estimates, *self._features]))
        return f"there is no {name}; there are {known}"


def _estimates(volume: Volume | None, weight: Weight | None) -> dict[str, Estimate]:
    found = {}
    if weight is not None:
        # an interval that does not hold the air below the product is taken away, so that the limit stays open
        in_part = any(reason.code == _AIR_WEIGHED for reason in weight.reasons)
        found[WEIGHT] = replace(weight.mass_g, interval=(math.nan, math.nan)) if in_part else weight.mass_g
    if volume is not None:
        found[VISIBLE] = _in_cm3(volume.visible_mm3)
        if volume.true_mm3 is not None:
            found[TRUE] = _in_cm3(volume.true_mm3)
    return found


def _in_cm3(estimate: Estimate) -> Estimate:
    budget = {cause: mm3_to_cm3(part) for cause, part in estimate.budget.items()}
    low, high = map(mm3_to_cm3, estimate.interval)
    return Estimate(mm3_to_cm3(estimate.value), mm3_to_cm3(estimate.std), budget, (low, high))


Range = tuple[float, float]
Fault = tuple[tuple[str | int, ...], str]

CELLS_MAX = 2_000_000
"""A table that cuts its quantities into more cells than this is not looked through."""

_NEVER_NEGATIVE = ("_g", "_cm3", "_mm3", "_mm2", "_mm", "_px2", "_px")


def faults_of(
    labels: Sequence[str],
    ranges: Sequence[Mapping[str, Range]],
    shapes: Sequence[Sequence[str]],
    *,
    overlaps_are_faults: bool,
) -> list[Fault]:
    """Look a table through, cell by cell, between all limits that stand in it.

    Parameters
    ----------
    labels
        Of the classes, in order.
    ranges
        By class, the half-open range of each quantity it asks about.
    shapes
        By class, the shapes it takes; none: any.
    overlaps_are_faults
        Whether two classes may share cells though neither holds the other.

    Returns
    -------
    list
        Keys that lead to what is wrong, and what is wrong and what to do.
    """
    cells = _Cells(ranges, shapes)
    if cells.count > CELLS_MAX:
        said = f"the limits cut the quantities into {cells.count:,} cells: too many to look for gaps"
        # before any array is made: the number of cells grows as a product over the quantities
        return [(("classes",), f"{said}; use fewer quantities")]
    taken = [cells.of(one, shape) for one, shape in zip(ranges, shapes, strict=True)]
    faults: list[Fault] = []
    before = np.zeros_like(cells.real)
    for number, mine in enumerate(taken):
        # in no cell the first to fit: it can never be given
        if not (mine & ~before).any():
            said = "no product comes this far: the classes before take all of it"
            faults.append((("classes", number, "label"), f"{said}; put it before them, or leave it out"))
        elif overlaps_are_faults:  # of a class that is never reached, its overlaps would be a second fault
            faults += _overlaps(number, labels, taken, cells)
        # what is taken up to here; later classes only matter in what is left
        before |= mine
    left = cells.real & ~before
    if left.any():
        where = cells.named(left)
        # a gap belongs to no row: the fault points behind the last
        said = f"there is a gap: no class takes {where}; widen a class, or add a last one without limits"
        faults.append((("classes", len(labels)), said))
    return faults


def _overlaps(number: int, labels: Sequence[str], taken: Sequence[Any], cells: _Cells) -> list[Fault]:
    mine = taken[number]
    for earlier in range(number):
        other = taken[earlier]
        both = mine & other
        # A class within a later, wider one is what "the first wins" is for.
        # both share cells, and the earlier one also has some of its own: neither is a part of the other
        if both.any() and (other & ~mine).any():
            said = (
                f"overlaps class {labels[earlier]!r} at {cells.named(both)}; move a limit, or say "
                "`overlaps: first-wins`"
            )
            return [(("classes", number, "label"), said)]
    return []


class _Cells:
    """Every combination of shape and of the ranges between limits."""

    def __init__(self, ranges: Sequence[Mapping[str, Range]], shapes: Sequence[Sequence[str]]) -> None:
        self._names = list(dict.fromkeys(name for one in ranges for name in one))
        self._edges = {name: _edges(ranges, name) for name in self._names}
        # "" stands for every shape that no class names
        self._shapes = [*dict.fromkeys(shape for one in shapes for shape in one), ""]
        self._size = (len(self._shapes), *(len(self._edges[name]) - 1 for name in self._names))
        self.count = math.prod(self._size)
        self.real = np.ones(self._size if self.count <= CELLS_MAX else (0,), np.bool_)
        if self.count > CELLS_MAX:
            return
        for axis, name in enumerate(self._names, start=1):
            # a range wholly below 0 holds no product, so it needs no class; a quantity per mm may well be
            # negative
            if name.endswith(_NEVER_NEGATIVE) and "_per_" not in name:
                self.real &= self._along(axis, [high > 0.0 for _, high in self._ranges(name)])

    def of(self, ranges: Mapping[str, Range], shape: Sequence[str]) -> Any:
        """Cells that a class takes."""
        mine = self.real & self._along(0, [not shape or one in shape for one in self._shapes])
        for axis, name in enumerate(self._names, start=1):
            low, high = ranges.get(name, (-math.inf, math.inf))
            # every limit of every class is an edge, so a range lies wholly within a class's own or wholly
            # outside
            mine &= self._along(axis, [low <= a and b <= high for a, b in self._ranges(name)])
        return mine

    def named(self, which: Any) -> str:
        """Say in words where the first of these cells is; what does not matter is left out."""
        first = tuple(int(at[0]) for at in np.nonzero(which))
        said = []
        for axis, name in enumerate(self._names, start=1):
            low, high = self._ranges(name)[first[axis]]
            if math.isfinite(low) or math.isfinite(high):
                parts = [f"at least {low:g}"] if math.isfinite(low) else []
                said.append(f"{name} " + " and ".join(parts + [f"below {high:g}"] * math.isfinite(high)))
        if len(self._shapes) > 1:
            shape = self._shapes[first[0]]
            said.append(f"shape {shape}" if shape else "any other shape")
        return ", ".join(said) or "anything"

    def _ranges(self, name: str) -> list[Range]:
        return list(itertools.pairwise(self._edges[name]))

    def _along(self, axis: int, values: list[bool]) -> Any:
        shape = [1] * len(self._size)
        # along one axis only; numpy spreads it over the others
        shape[axis] = len(values)
        return np.array(values, np.bool_).reshape(shape)


def _edges(ranges: Sequence[Mapping[str, Range]], name: str) -> list[float]:
    # infinite ends: what lies beyond the outer limits must belong to a class, too
    return sorted({-math.inf, math.inf, *(edge for one in ranges if name in one for edge in one[name])})


def table_options() -> GradeTableOptions:
    """Give a table over weight: heavy, light, and the rest."""
    return GradeTableOptions(
        classes=(
            GradeClass(label="heavy", lane="1", limits={"weight_g": Limits(at_least=15.0)}),
            GradeClass(label="light", lane="2", limits={"weight_g": Limits(at_least=5.0)}),
            GradeClass(label="rest", lane="3"),
        )
    )
